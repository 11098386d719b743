"""The forward camera of computer vision: distortion acts on ideal, normalised coordinates, not on measured ones.

With n = (x, y) / c ideal (x right, y up), the photo shows c D(n), where D has the terms of `distortion.correct` with coefficients
without unit. OpenCV's fx fy cx cy k1 k2 p1 p2 k3 and the problems of bundle adjustment in the large (f k1 k2) are such cameras.
Reference: Agarwal et al. 2010, "Bundle adjustment in the large"; OpenCV 4 documentation, "Camera Calibration".
"""

from __future__ import annotations

import numpy as np

from .distortion import correct, correct_derivatives, correct_jacobian, distort
from .interior import Interior


class Forward(Interior):
    """An interior orientation whose k1..b2 distort (ideal -> measured); fields as in `Interior`, coefficients without unit."""

    kind = "forward"

    def distorted(self, ideal: np.ndarray) -> np.ndarray:
        """Measured coordinates (..., 2) mm, reduced, of ideal ones (..., 2) mm."""
        return self.c * correct(self.coefficients, np.asarray(ideal, float) / self.c)

    def undistorted(self, reduced: np.ndarray) -> np.ndarray:
        """Ideal coordinates (..., 2) mm of measured, reduced ones; NaN where there are none."""
        return self.c * distort(self.coefficients, np.asarray(reduced, float) / self.c)

    def slope(self, ideal: np.ndarray, reduced: np.ndarray) -> np.ndarray:
        """(n, 2, 2) d measured / d ideal."""
        return correct_jacobian(self.coefficients, ideal / self.c)

    def by_parameters(self, ideal: np.ndarray, reduced: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """(n, 2, 8) d measured / d(c, k1 .. b2); the object point stays where it is."""
        by_c = (reduced / self.c)[:, :, None]
        return np.concatenate([by_c, self.c * correct_derivatives(ideal / self.c)], axis=2)


class Unsided(Forward):
    """A forward camera that shows also what lies behind it, through its centre: so problems in the large define their cost."""

    kind = "unsided"
    front = False
