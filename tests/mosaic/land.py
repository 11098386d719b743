"""A painted land that is exact at every place, photos of it, and where they were taken: truth for mosaics."""

import numpy as np

from solvers import Exterior, Interior
from solvers.geometry import Grid, LocalFrame, Surface
from solvers.mosaic import Ground, MosaicPlane, Placed

CAMERA = Interior(10.0, pixel_mm=0.025, width=400, height=300, xp=0.05, k1=4e-4)
HEIGHT = 100.0  # m above the land: a pixel is 0.25 m


def land(xy: np.ndarray) -> np.ndarray:
    """(..., 3) colours 0..255 at map positions (..., 2) m: waves of 4 to 30 m, nothing finer than a pixel shows."""
    x, y = xy[..., 0], xy[..., 1]
    waves = np.stack([np.sin(x / 1.1 + 0.3) * np.cos(y / 1.4), np.sin(x / 2.3 + y / 1.9), np.cos(x / 4.7 - y / 3.1)], -1)
    return 128 + 40 * waves + 25 * np.sin(x / 0.8 + y / 0.7)[..., None]


def seen_from(photo: Placed, ground: Ground, surface: MosaicPlane | Surface | None = None) -> np.ndarray:
    """The photo (h, w, 3) uint8 as it would be taken."""
    i = photo.interior
    col, row = np.meshgrid(np.arange(i.width), np.arange(i.height))
    at = photo.on_map(np.stack([col.ravel(), row.ravel()], -1).astype(float), ground)
    colours = np.nan_to_num(land(at), nan=0.0)
    return np.clip(np.round(colours), 0, 255).astype(np.uint8).reshape(i.height, i.width, 3)


def at(photo: Placed) -> Exterior:
    """Its exterior orientation."""
    assert photo.exterior is not None
    return photo.exterior


def strip(n: int = 3, step: float = 35.0, tilt: float = 0.04) -> list[Placed]:
    """Photos along a strip, each a little tilted and turned."""
    rng = np.random.default_rng(4)
    photos = []
    for k in range(n):
        omega, phi, kappa = rng.uniform([-tilt, -tilt, 0.2], [tilt, tilt, 0.4])
        centre = np.array([step * k, 5.0 * (k % 2), HEIGHT])
        photos.append(Placed(f"p{k}", CAMERA, Exterior.from_angles(float(omega), float(phi), float(kappa), centre)))
    return photos


FRAME = LocalFrame(np.array([500000.0, 5200000.0, 50.0]))
FLAT = Ground(FRAME, MosaicPlane(0.0))


def hills(cell: float = 2.0, height: float = 6.0) -> Surface:
    """A height grid over the strip, on the map."""
    west, north, n = 499850.0, 5200150.0, 200
    x, y = np.meshgrid(west + cell * (np.arange(n) + 0.5), north - cell * (np.arange(n) + 0.5))
    z = 50 + height * np.sin((x - 500000) / 17) * np.cos((y - 5200000) / 13)
    return Surface(Grid((n, n), (cell, 0.0, west, 0.0, -cell, north)), z)


class Album:
    """Photos in memory, read as a store would give them, with a count of readings."""

    def __init__(self, photos: list[Placed], ground: Ground, change=None) -> None:
        self.pictures = {p.name: seen_from(p, ground) for p in photos}
        for name, picture in self.pictures.items():
            self.pictures[name] = picture if change is None else change(name, picture)

    def window(self, name: str, top: int, left: int, bottom: int, right: int) -> np.ndarray:
        return self.pictures[name][top:bottom, left:right]

    def small(self, name: str, side: int) -> np.ndarray:
        import cv2

        picture = self.pictures[name]
        scale = min(side / max(picture.shape[:2]), 1.0)
        size = round(picture.shape[1] * scale), round(picture.shape[0] * scale)
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


def offset(values: np.ndarray, xy: np.ndarray, good: np.ndarray, gsd: float) -> np.ndarray:
    """(2,) px right and up by which colours (h, w, 3) lie off the land at their coordinates (h, w, 2): least squares."""
    step = 0.01 * gsd
    right, up = np.array([step, 0]), np.array([0, step])
    by_x = (land(xy + right) - land(xy - right)) / (2 * step)
    by_y = (land(xy + up) - land(xy - up)) / (2 * step)
    a = np.stack([by_x[good].ravel(), by_y[good].ravel()], 1)
    return -np.linalg.lstsq(a, (values[good] - land(xy)[good]).ravel(), rcond=None)[0] / gsd
