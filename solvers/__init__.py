"""Collinea's solvers: how an image finds its place."""

from .block import Block, Image, Observations, Points, Prior
from .cameras import Interior
from .errors import BadProject, BadTable, DegenerateGeometry, PhotogrammetryError, Unsupported
from .geometry import Exterior

__version__ = "0.1.0"
__all__ = ["BadProject", "BadTable", "Block", "DegenerateGeometry", "Exterior", "Image", "Interior", "Observations",
           "PhotogrammetryError", "Points", "Prior", "Trace", "Unsupported"]

from .adjustment import Trace
