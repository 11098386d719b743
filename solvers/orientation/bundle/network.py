"""What a bundle adjusts, as parallel arrays in the order of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...cameras import PARAMETERS, Interior
from ...cameras.distortion import fold
from ..resection import PriorOrientation


@dataclass(frozen=True)
class Network:
    """m images, k cameras, n object points, o observations sorted by point, fixed points last.

    camera (m,): of each image. interiors: as given. free: interior parameters adjusted, for each camera. image, point (o,);
    pixels (o, 2); sigma (o,) px. known (n, 3) m: given coordinates of weighted and fixed points, NaN where free. weight (n, 3)
    m^-2, 0 where free. live: points below it are unknowns, those from it on are fixed. priors: one for each image, or None.
    loss: of the image observations, None for least squares.
    """

    images: tuple[str, ...]
    cameras: tuple[str, ...]
    interiors: tuple[Interior, ...]
    camera: np.ndarray
    points: tuple[str, ...]
    image: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    sigma: np.ndarray
    free: tuple[tuple[str, ...], ...]
    known: np.ndarray
    weight: np.ndarray
    live: int
    priors: tuple[PriorOrientation | None, ...]
    loss: str | None = None

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of images, of freed interior parameters and of unknown points."""
        return len(self.images), len(self.which), self.live

    @cached_property
    def which(self) -> np.ndarray:
        """(f,) position among `PARAMETERS` of every freed parameter, camera after camera."""
        return np.array([PARAMETERS.index(name) for names in self.free for name in names], np.int64)

    @cached_property
    def count(self) -> np.ndarray:
        """(k,) freed parameters of each camera."""
        return np.array([len(names) for names in self.free], np.int64)

    @cached_property
    def first(self) -> np.ndarray:
        """(k,) position of each camera's first freed parameter among all freed ones."""
        return np.concatenate([[0], np.cumsum(self.count)[:-1]]).astype(np.int64)

    @cached_property
    def start(self) -> np.ndarray:
        """(n + 1,) first observation of each point."""
        return np.searchsorted(self.point, np.arange(len(self.points) + 1)).astype(np.int64)

    @property
    def observed(self) -> int:
        """Scalar observations: image coordinates, weighted coordinates of points, priors."""
        return 2 * len(self.image) + int((self.weight > 0).sum()) + sum(p.count for p in self.priors if p)

    # -- x = 12 numbers of every image, ten of every camera, three of every point ------------------------------------------

    def pack(self, poses: np.ndarray, interiors: np.ndarray, points: np.ndarray) -> np.ndarray:
        """x of poses (m, 12), interior parameters (k, 10) and points (n, 3)."""
        return np.concatenate([poses.ravel(), interiors.ravel(), points.ravel()])

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poses (m, 12), interior parameters (k, 10) and points (n, 3) of x."""
        a = 12 * len(self.images)
        b = a + 10 * len(self.cameras)
        return x[:a].reshape(-1, 12), x[a:b].reshape(-1, 10), x[b:].reshape(-1, 3)

    def interiors_at(self, x: np.ndarray) -> tuple[Interior, ...]:
        """Interior orientations of x."""
        return tuple(type(i)(*map(float, row), pixel_mm=i.pixel_mm, width=i.width, height=i.height)
                     for i, row in zip(self.interiors, self.split(x)[1], strict=True))

    def camera_rows(self, parameters: np.ndarray) -> np.ndarray:
        """(k, 16) cameras as the kernels read them."""
        out = np.empty((len(self.cameras), 16))
        out[:, :10] = parameters
        for row, interior in zip(out, self.interiors, strict=True):
            row[10:12] = 1 / interior.pitch
            row[12:14] = (interior.width - 1) / 2, (interior.height - 1) / 2
            other = {"forward": 2.0, "unsided": 3.0}.get(interior.kind)
            row[14] = fold(*map(float, row[3:6])) if row[3:6].any() and other is None else np.inf
            row[15] = float(row[3:10].any()) if other is None else other
        return out

    @cached_property
    def prior_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Images with priors (a,), their poses (a, 12) and roots (a, 6, 6)."""
        rows = np.array([i for i, p in enumerate(self.priors) if p is not None], int)
        chosen = [p for p in self.priors if p is not None]
        return (rows, np.array([p.exterior.vector for p in chosen]).reshape(-1, 12),
                np.array([p.root for p in chosen]).reshape(-1, 6, 6))
