"""The one adjustment engine, its trace and its statistics."""

from .engine import Options, Problem, iterate, solve
from .normal import Dense, Normal
from .precision import Linear, Precision, precision
from .trace import CONVERGED, SCALARS, Iteration, Trace

__all__ = ["CONVERGED", "SCALARS", "Dense", "Iteration", "Linear", "Normal", "Options", "Precision", "Problem", "Trace",
           "iterate", "precision", "solve"]
