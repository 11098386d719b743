"""Interior orientation: photo frame and pixels, the ten-parameter model."""

from .distortion import correct, correct_derivatives, correct_jacobian, distort
from .interior import PARAMETERS, Interior
from .projection import Projection, ideal_photo, project, project_derivatives

__all__ = ["PARAMETERS", "Interior", "Projection", "correct", "correct_derivatives", "correct_jacobian", "distort", "ideal_photo",
           "project", "project_derivatives"]
