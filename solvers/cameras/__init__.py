"""Interior orientation: photo frame and pixels, the ten-parameter model."""

from .curves import Calibrated, Curve, Difference, curve, difference
from .distortion import correct, correct_derivatives, correct_jacobian, distort
from .forward import Forward, Unsided
from .interior import PARAMETERS, Interior
from .projection import Projection, ideal_photo, project, project_derivatives

__all__ = ["PARAMETERS", "Calibrated", "Curve", "Difference", "Forward", "Interior", "Projection", "Unsided", "correct",
           "correct_derivatives", "correct_jacobian", "curve", "difference", "distort", "ideal_photo", "project",
           "project_derivatives"]
