"""Interior orientation: photo frame and pixels, the ten-parameter model."""

from .distortion import correct, correct_derivatives, correct_jacobian, distort
from .forward import Forward, Unsided
from .interior import PARAMETERS, Interior
from .projection import Projection, ideal_photo, project, project_derivatives

__all__ = ["PARAMETERS", "Forward", "Interior", "Projection", "Unsided", "correct", "correct_derivatives",
           "correct_jacobian", "distort", "ideal_photo", "project", "project_derivatives"]
