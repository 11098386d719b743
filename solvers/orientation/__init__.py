"""Orientation of images: initial values, perspective and orthogonal resection."""

from .advisor import Advice, Prediction, advise
from .initial import Candidate, candidates, three_points
from .orthogonal import Leak, Orthogonal
from .resection import PriorOrientation, Resection
from .result import Orientation
from .single import Request, Start, conclude, orient, prepare, resect, resect_orthogonal

__all__ = ["Advice", "Candidate", "Leak", "Orientation", "Orthogonal", "Prediction", "PriorOrientation", "Request", "Resection",
           "Start", "advise", "candidates", "conclude", "orient", "prepare", "resect", "resect_orthogonal", "three_points"]
