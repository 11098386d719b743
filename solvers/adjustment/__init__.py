"""The one adjustment engine, its trace and its statistics."""

from .engine import Options, Problem, iterate, solve
from .normal import Dense, Normal
from .precision import Linear, Precision, precision
from .trace import CONVERGED, LARGE, SCALARS, Iteration, Trace, thin

__all__ = ["CONVERGED", "LARGE", "SCALARS", "Dense", "Iteration", "Linear", "Normal", "Options", "Precision", "Problem", "Trace",
           "iterate", "precision", "solve", "thin"]
