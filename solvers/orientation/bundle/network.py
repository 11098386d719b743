"""What a bundle adjusts, as parallel arrays in the order of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...cameras import PARAMETERS, Interior
from ...cameras.distortion import fold
from ..resection import PriorOrientation
from .extras import Extras, border_rows


@dataclass(frozen=True)
class Network:
    """m images, k cameras, n object points, o observations sorted by point, fixed points last.

    camera (m,): of each image. interiors: as given. free: interior parameters adjusted, for each camera. image, point (o,);
    pixels (o, 2); sigma (o,) px. known (n, 3) m: given coordinates of weighted and fixed points, NaN where free. weight (n, 3)
    m^-2, 0 where free. live: points below it are unknowns, those from it on are fixed (behind those held in the border, see
    `Extras`). priors: one for each image, or None. loss: of the image observations, None for least squares. base: the camera
    behind each one of `cameras`, itself where not given; those of one base share all freed parameters that are not among `own`.
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
    extras: Extras = field(default_factory=Extras)
    base: tuple[str, ...] = ()
    own: tuple[str, ...] = PARAMETERS

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of images, of unknowns in the border (freed interior parameters, then `extras`) and of unknown points."""
        return len(self.images), self.freed + self.extras.count, self.live

    @cached_property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Camera and parameter of every unknown of the interior orientation; the base's name where cameras share it."""
        base = self.base or self.cameras
        of = zip(self.cameras, base, self.free, strict=True)
        return tuple(dict.fromkeys((c if p in self.own else b, p) for c, b, free in of for p in free))

    @cached_property
    def tie(self) -> np.ndarray:
        """(len(which),) which unknown every freed parameter of every camera is: shared ones are the same."""
        at = {label: k for k, label in enumerate(self.labels)}
        base = self.base or self.cameras
        return np.array([at[c if p in self.own else b, p] for c, b, free in zip(self.cameras, base, self.free, strict=True)
                         for p in free], np.int64)

    @property
    def freed(self) -> int:
        """Unknowns of the interior orientations."""
        return len(self.labels)

    @property
    def sharing(self) -> bool:
        """Whether cameras share parameters."""
        return len(self.labels) < len(self.which)

    @cached_property
    def border(self) -> np.ndarray:
        """(raw,) `which`, filled up: the kernels leave the rest of the border alone."""
        return np.concatenate([self.which, np.zeros(self.extras.count, np.int64)])

    @property
    def unknown(self) -> int:
        """Points below it are unknown, held ones too."""
        return self.live + self.extras.held

    @cached_property
    def point_columns(self) -> np.ndarray:
        """(n, 3) place of every point in the tangent, -1 where it is fixed."""
        m, f, live = self.sizes
        out = np.full((len(self.points), 3), -1)
        out[:live] = 6 * m + f + np.arange(3 * live).reshape(-1, 3)
        out[live:self.unknown] = 6 * m + self.freed + np.arange(3 * self.extras.held).reshape(-1, 3)
        return out

    @cached_property
    def which(self) -> np.ndarray:
        """(raw,) position among `PARAMETERS` of every freed parameter, camera after camera."""
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

    def seen_in(self, image: int) -> np.ndarray:
        """Rows of the observations of one image."""
        order, ends = self._by_image
        return order[ends[image]:ends[image + 1]]

    @cached_property
    def _by_image(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the observations, image by image, and where each image's begin."""
        order = np.argsort(self.image, kind="stable")
        return order, np.searchsorted(self.image[order], np.arange(len(self.images) + 1))

    @cached_property
    def border_groups(self) -> dict[str, slice]:
        """Rows of `border_rows` by kind, weighted coordinates of held points aside."""
        first = int((self.weight[self.live:self.unknown] > 0).sum())
        counts = {"scale bars": len(self.extras.bars), "control": sum(3 * len(p) for p, _ in self.extras.correlated),
                  "shifts": 3 * len(self.extras.shifts), "motion": self.extras.motions}
        out, at = {}, first
        for name, n in counts.items():
            out[name], at = slice(at, at + n), at + n
        return {name: s for name, s in out.items() if s.stop > s.start}

    @cached_property
    def shift_columns(self) -> list[np.ndarray | None]:
        """For each image the three places in the border of its strip's shift, None where it has none."""
        of, first = self.extras.shift_of, self.freed + 3 * self.extras.held
        if of is None:
            return [None] * len(self.images)
        return [None if s < 0 else first + 3 * int(s) + np.arange(3) for s in of]

    @property
    def observed(self) -> int:
        """Scalar observations: image coordinates, weighted coordinates of points, priors."""
        given = int((self.weight > 0).sum()) + sum(p.count for p in self.priors if p)
        return 2 * len(self.image) + given + self.extras.observed

    # -- x = 12 numbers of every image, ten of every camera, three of every point ------------------------------------------

    def pack(self, poses: np.ndarray, interiors: np.ndarray, points: np.ndarray, shifts: np.ndarray | None = None,
             motion: np.ndarray | None = None) -> np.ndarray:
        """x of poses (m, 12), interior parameters (k, 10), points (n, 3), shifts (s, 3), 0 where not given, and motions, as they
        are known beforehand where not given."""
        e = self.extras
        tail = np.zeros(3 * len(e.shifts)) if shifts is None else shifts.ravel()
        motion = e.motion[:, :e.moving] if motion is None else motion
        return np.concatenate([poses.ravel(), interiors.ravel(), points.ravel(), tail, motion.ravel()])

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poses (m, 12), interior parameters (k, 10) and points (n, 3) of x."""
        a = 12 * len(self.images)
        b = a + 10 * len(self.cameras)
        return x[:a].reshape(-1, 12), x[a:b].reshape(-1, 10), x[b:b + 3 * len(self.points)].reshape(-1, 3)

    def shifts_at(self, x: np.ndarray) -> np.ndarray:
        """(s, 3) shifts of the strips' GPS positions [m]."""
        end = len(x) - self.extras.motions
        return x[end - 3 * len(self.extras.shifts):end].reshape(-1, 3)

    def motion_at(self, x: np.ndarray) -> np.ndarray:
        """(m, 0, 3 or 6) motions of the images: velocity [m/s], rate of rotation [rad/s]."""
        e = self.extras
        return x[len(x) - e.motions:].reshape(len(e.motion), e.moving)

    def border_rows(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(r,) misclosures and (r, f) derivatives of what touches the border only, in standard deviations."""
        return border_rows(self.extras, self.split(x)[2], self.known, self.weight, self.shifts_at(x), self.live, self.freed,
                           self.motion_at(x))

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
