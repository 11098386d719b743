"""Brightness of the photos: what evens out exposure and vignetting, as factors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .placed import Placed


@dataclass(frozen=True)
class Tone:
    """Logarithms of how bright a photo is: exposure, and vignetting (3,) as a polynomial in r^2, r^4, r^6 over the distance r
    from the format's centre (corner: 1), 0 in the centre."""

    exposure: float = 0.0
    vignetting: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def plain(self) -> bool:
        """Whether there is nothing to even out."""
        return self.exposure == 0 and not any(self.vignetting)

    def factor(self, photo: Placed, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(...,) what values at photo columns u and rows v are multiplied with."""
        if self.plain:
            return np.ones(np.shape(u))
        return np.exp(-self.exposure - radial(photo, u, v) @ np.array(self.vignetting))


def radial(photo: Placed, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(..., 3) r^2, r^4, r^6 of photo columns and rows, r the distance from the format's centre as a part of the corner's."""
    wide, high = photo.interior.width, photo.interior.height
    r2 = ((u - (wide - 1) / 2) ** 2 + (v - (high - 1) / 2) ** 2) / ((wide**2 + high**2) / 4)
    r2 = np.minimum(r2, 1.1)
    return np.stack([r2, r2**2, r2**3], -1)


PLAIN = Tone()
