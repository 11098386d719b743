"""The datum of a free network: the seven directions that no image sees, and how they are chosen.

Reference: Meissl 1969 (inner constraints); Baarda 1973, "S-transformations and criterion matrices"; Umeyama 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .network import Network

SEVEN = ("shift X", "shift Y", "shift Z", "rotation about X", "rotation about Y", "rotation about Z", "scale")


def motions(network: Network, x: np.ndarray) -> np.ndarray:
    """(u, 7) changes of all unknowns under small shifts, rotations (about the middle of the points) and scale of the world."""
    poses, _, points = network.split(x)
    m, f, live = network.sizes
    middle = points.mean(axis=0) if len(points) else np.zeros(3)
    out = np.zeros((6 * m + f + 3 * live, 7))
    images, objects = out[:6 * m].reshape(m, 6, 7), np.zeros((network.unknown, 3, 7))
    for rows, at in ((images[:, :3], poses[:, :3] - middle), (objects, points[:network.unknown] - middle)):
        rows[:, :, :3] = np.eye(3)
        rows[:, :, 3:6] = _turning(at)
        rows[:, :, 6] = at
    out[network.point_columns[:network.unknown].ravel()] = objects.reshape(-1, 7)
    if network.extras.moving:
        velocity = network.motion_at(x)[:, :3]
        rows = out[6 * m + f - network.extras.motions:6 * m + f].reshape(m, network.extras.moving, 7)
        rows[:, :3, 3:6], rows[:, :3, 6] = _turning(velocity), velocity
    images[:, 3:, 3:6] = -poses[:, 3:].reshape(m, 3, 3)  # M exp(-w) = exp(-M w) M
    return out


def _turning(at: np.ndarray) -> np.ndarray:
    """(n, 3, 3) changes w x at of points at (n, 3) by rotation vectors w."""
    out = np.zeros((len(at), 3, 3))
    out[:, 0, 1], out[:, 0, 2] = at[:, 2], -at[:, 1]
    out[:, 1, 0], out[:, 1, 2] = -at[:, 2], at[:, 0]
    out[:, 2, 0], out[:, 2, 1] = at[:, 1], -at[:, 0]
    return out


@dataclass(frozen=True)
class Inner:
    """Inner constraints: the datum points (rows among the unknown points) keep, as a whole, the place, attitude and scale of
    their reference coordinates (d, 3) m; the trace of their covariance is the least of all datums. scaled: the network knows its
    scale (from bars), which is left alone."""

    rows: np.ndarray
    reference: np.ndarray
    scaled: bool = False

    @property
    def count(self) -> int:
        """Constraints: seven, or six."""
        return 6 if self.scaled else 7

    def rows_of(self, network: Network, g: np.ndarray) -> np.ndarray:
        """(7 or 6, u) constraint matrix H: the motions g (u, 7), datum points only."""
        h = np.zeros_like(g)
        index = network.point_columns[self.rows].ravel()
        h[index] = g[index]
        return h.T[:self.count]

    def restored(self, network: Network, x: np.ndarray) -> np.ndarray:
        """x moved by the similarity that brings the datum points back to their reference, which changes no residual."""
        points = network.split(x)[2]
        scale, r, t = similarity(points[self.rows], self.reference)
        if self.scaled:
            t += (scale - 1) * r @ points[self.rows].mean(axis=0)
            scale = 1.0
        return moved(network, x, scale, r, t)


def moved(network: Network, x: np.ndarray, scale: float, r: np.ndarray, t: np.ndarray) -> np.ndarray:
    """x of the whole world under the similarity scale R P + t; no image sees it."""
    poses, interiors, points = network.split(x)
    to = poses.copy()
    to[:, :3] = scale * poses[:, :3] @ r.T + t
    to[:, 3:] = (poses[:, 3:].reshape(-1, 3, 3) @ r.T).reshape(-1, 9)
    motion = network.motion_at(x).copy()
    if network.extras.moving:
        motion[:, :3] = scale * motion[:, :3] @ r.T
    return network.pack(to, interiors, scale * points @ r.T + t, network.shifts_at(x), motion)


def pins(network: Network, x: np.ndarray) -> tuple[int, int, int]:
    """A minimal datum: the image whose six elements are held, another image, and the axis of its centre that is held.

    Of the images' centres the two that are farthest apart, so that the held base is as long as can be.
    """
    centres = network.split(x)[0][:, :3]
    a = int(np.argmax(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))
    base = centres - centres[a]
    b = int(np.argmax(np.linalg.norm(base, axis=1)))
    return a, b, int(np.argmax(np.abs(base[b])))


def similarity(source: np.ndarray, target: np.ndarray,
               weight: np.ndarray | None = None) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation (3, 3) and shift (3,) of least squares: target = scale R source + t, points (n, 3), weights (n,)."""
    w = np.ones(len(source)) if weight is None else weight
    a, b = w @ source / w.sum(), w @ target / w.sum()
    u, d, vt = np.linalg.svd((target - b).T @ (w[:, None] * (source - a)))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    r = (u * sign) @ vt
    scale = float((d * sign).sum() / (w @ ((source - a) ** 2).sum(axis=1)))
    return scale, r, b - scale * r @ a
