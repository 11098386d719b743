"""The networks that the mosaic studies share: 36 vertical photos over a plane, as a strip or a serpentine block.

Photos of 6000 x 4000 px, c = height = 8935 px, so that one mosaic unit is one pixel; tie points on a regular grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..adjustment import Options, solve
from ..mosaic.models import Coefficients, Exteriors, through
from ..mosaic.network import Network
from ..mosaic.precision import GRID, Response
from ..mosaic.problem import Registering
from ..mosaic.simultaneous import homographies

C, WIDTH, HEIGHT = 8935.0, 6000.0, 4000.0
HALF = np.array([WIDTH, HEIGHT]) / 2 / C
SIGMA_PX = 0.3
METRES = 300.0
"""Flying height [m] of the studies' relief: a pixel is 300 m / 8935 on the ground."""
METHODS = {"coefficients": "eight plane coefficients", "exterior": "exterior orientations"}
ENGINE = Options(max_iterations=60, step_tolerance=1e-3, cost_tolerance=1e-9)


@dataclass(frozen=True)
class Layout:
    """A network. centre (m, 2): photos; points (n, 2); image, point (o,): what sees what."""

    kind: str
    forward: float
    side: float
    grid: float
    centre: np.ndarray
    points: np.ndarray
    image: np.ndarray
    point: np.ndarray

    @property
    def name(self) -> str:
        side = f" / {self.side:.0%}" if self.kind == "block" else ""
        return f"{self.kind} {self.forward:.0%}{side}, grid {self.grid:.0f}"

    @cached_property
    def q(self) -> np.ndarray:
        """(o, 2) true photo coordinates over c."""
        return (self.points[self.point] - self.centre[self.image]) / C

    @cached_property
    def truth(self) -> np.ndarray:
        """(m, 3, 3) true homographies."""
        h = np.zeros((len(self.centre), 3, 3))
        h[:, 0, 0] = h[:, 1, 1] = 1 / C
        h[:, :2, 2], h[:, 2, 2] = -self.centre / C, 1.0
        return h

    def photos(self, method: str) -> np.ndarray:
        """True photos as the model of a method stores them."""
        if method == "coefficients":
            return self.truth.reshape(-1, 9)
        eye = np.broadcast_to(np.eye(3).ravel(), (len(self.centre), 9))
        return np.hstack([self.centre, np.full((len(self.centre), 1), C), eye])

    def gcps(self, count: int) -> np.ndarray:
        """Indices of tie points that serve as control: four at the corners, or twelve around the border (a 4 x 4 grid without
        its middle), 5 % inside the network."""
        places = np.linspace(0.05, 0.95, 2 if count == 4 else 4)
        ends = {places[0], places[-1]}
        return self.nearest(np.array([(u, v) for u in places for v in places if u in ends or v in ends]))

    def nearest(self, share: np.ndarray) -> np.ndarray:
        """Tie points nearest to places given in shares (k, 2) of the network's extent; of two equally near ones the farther."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        return np.array([int(np.argmin(((self.points - p) ** 2).sum(axis=1))) for p in low + (share + 1e-6) * (high - low)])

    def problem(self, method: str, gcps: np.ndarray, q: np.ndarray | None = None, control: np.ndarray | None = None,
                sigma_gcp: float = SIGMA_PX) -> Registering:
        """The adjustment: the first photo held, or control points (at `control`, by default the truth) weighted."""
        n = len(self.points)
        known, weight = np.full((n, 2), np.nan), np.zeros((n, 2))
        if len(gcps):
            known[gcps] = self.points[gcps] if control is None else control
            weight[gcps] = 1 / sigma_gcp**2
        held = np.zeros(len(self.centre), bool)
        held[0] = not len(gcps)
        net = Network(tuple(f"{k + 1}" for k in range(len(self.centre))), self.image, self.point, self.q if q is None else q,
                      np.full((len(self.image), 2), C / SIGMA_PX), known, weight, np.zeros(n), held)
        return Registering(net, Coefficients() if method == "coefficients" else Exteriors())

    def response(self, method: str, gcps: np.ndarray) -> Response:
        """Linear theory at the truth."""
        problem = self.problem(method, gcps)
        return Response(problem, problem.pack(self.photos(method), self.points), np.tile(HALF, (len(self.centre), 1)))

    def adjusted(self, method: str, gcps: np.ndarray, q: np.ndarray,
                 control: np.ndarray | None = None) -> tuple[np.ndarray, bool]:
        """(m, 3, 3) homographies adjusted to observations q (o, 2), from the truth, and whether the engine came to rest."""
        problem = self.problem(method, gcps, q, control)
        x = problem.pack(self.photos(method), self.points)
        trace = solve(problem, x, Options.gauss_newton(30, 1e-3))  # damping creeps where little is determined
        trace = trace if trace.converged else solve(problem, x, ENGINE)
        return homographies(problem.model, problem.split(trace.last.x)[0]), trace.converged

    def drift(self, h: np.ndarray) -> np.ndarray:
        """(..., m) rms distance [px] of places in a photo from where they belong; h (..., m, 3, 3)."""
        q = GRID * HALF
        at, _ = through(np.linalg.inv(h).reshape(-1, 1, 3, 3).repeat(len(q), 1).reshape(-1, 3, 3),
                        np.tile(q, (h[..., 0, 0].size, 1)))
        true = (q * C)[None] + self.centre[:, None]
        off = at.reshape(*h.shape[:-2], len(q), 2) - true
        return np.sqrt((off**2).sum(axis=-1).mean(axis=-1))

    def seam(self, h: np.ndarray, q: np.ndarray) -> float:
        """Rms distance [px] of the tie points on the mosaic from the mean of their photos."""
        at, _ = through(np.linalg.inv(h)[self.image], q)
        n = np.bincount(self.point)
        mean = np.stack([np.bincount(self.point, at[:, k]) for k in (0, 1)], axis=1) / n[:, None]
        return float(np.sqrt(((at - mean[self.point]) ** 2).sum(axis=1).mean()))


def layout(kind: str, forward: float, side: float, grid: float) -> Layout:
    """The 36 photos of a strip or a 6 x 6 block and the tie points that two of them see."""
    dx, dy = WIDTH * (1 - side), HEIGHT * (1 - forward)
    if kind == "strip":
        centre = np.array([(0.0, k * dy) for k in range(36)])
    else:
        centre = np.array([(r * dx, (k if r % 2 == 0 else 5 - k) * dy) for r in range(6) for k in range(6)])
    half = HALF * C
    low, high = centre.min(axis=0) - half, centre.max(axis=0) + half
    x = 137 + grid * np.arange(np.floor((low[0] - 137) / grid), np.ceil((high[0] - 137) / grid) + 1)
    y = 211 + grid * np.arange(np.floor((low[1] - 211) / grid), np.ceil((high[1] - 211) / grid) + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    off = np.abs(points[:, None] - centre)
    seen = (off[..., 0] < WIDTH / 2) & (off[..., 1] < HEIGHT / 2)
    tie = seen.sum(axis=1) >= 2
    point, image = np.nonzero(seen[tie])
    return Layout(kind, forward, side, grid, centre, points[tie], image, point)


def sequential(net: Layout, q: np.ndarray) -> np.ndarray:
    """(runs, m, 3, 3) homographies of many sequential registrations at once: photo after photo by eight coefficients onto the
    mosaic, where a point lies at the mean of the photos that show it so far. q (runs, o, 2): observations.

    The batched twin of `mosaic.growing.grow`.
    """
    runs, m = len(q), len(net.centre)
    total, count, out = np.zeros((runs, len(net.points), 2)), np.zeros(len(net.points)), np.empty((runs, m, 3, 3))
    for k in range(m):
        mine = np.flatnonzero(net.image == k)
        points = net.point[mine]
        old = count[points] > 0
        shift = np.array([[1 / C, 0, -net.centre[k, 0] / C], [0, 1 / C, -net.centre[k, 1] / C], [0, 0, 1]])
        out[:, k] = shift
        if k:
            at = total[:, points[old]] / count[points[old]][:, None]
            out[:, k] = _fitted((at - net.centre[k]) / C, q[:, mine[old]]) @ shift
        rays = np.concatenate([q[:, mine], np.ones((runs, len(mine), 1))], axis=2)
        p = np.einsum("rij,roj->roi", np.linalg.inv(out[:, k]), rays)
        total[:, points] += p[..., :2] / p[..., 2:]
        count[points] += 1
    return out


def _fitted(xy: np.ndarray, q: np.ndarray, steps: int = 6) -> np.ndarray:
    """(runs, 3, 3) least squares homographies xy -> q (runs, k, 2): Gauss-Newton on the image residuals from an affinity."""
    one = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2)
    h = np.zeros((len(xy), 9))
    a = np.linalg.solve(np.einsum("rki,rkj->rij", one, one), np.einsum("rki,rkj->rij", one, q))
    h[:, :6], h[:, 8] = np.swapaxes(a, 1, 2).reshape(-1, 6), 1.0
    for _ in range(steps):
        p = np.einsum("rij,rkj->rki", h.reshape(-1, 3, 3), one)
        at, w = p[..., :2] / p[..., 2:], p[..., 2]
        j = np.zeros((*at.shape, 8))
        j[..., 0, 0:3] = j[..., 1, 3:6] = one / w[..., None]
        j[..., 6:] = -at[..., :, None] * xy[..., None, :] / w[..., None, None]
        n = np.einsum("rkea,rkeb->rab", j, j)
        n[:, range(8), range(8)] *= 1 + 1e-12  # a column of points leaves a direction free: it then stays where it was
        g = np.einsum("rkea,rke->ra", j, q - at)
        h[:, :8] += np.linalg.solve(n, g[..., None])[..., 0]
    return h.reshape(-1, 3, 3)


def systematic(net: Layout, relief_m: float, corner_px: float, rng: np.random.Generator, draws: int = 1) -> np.ndarray:
    """(draws, o, 2) observations with noise, points off the plane by N(0, relief) and radial distortion left in."""
    heights = rng.normal(0, relief_m / METRES * C, (draws, len(net.points)))[:, net.point, None] if relief_m else 0.0
    q = net.q / (1 - heights / C)
    q = q * (1 + corner_px / C / np.linalg.norm(HALF) ** 3 * (q**2).sum(axis=-1, keepdims=True))
    return q + rng.normal(0, SIGMA_PX / C, (draws, len(net.image), 2))


