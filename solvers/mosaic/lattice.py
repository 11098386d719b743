"""The way from a tile into a photo as a lattice: exact at its nodes, linear in between, as fine as it must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import Grid, Surface
from .placed import Placed
from .surface import Ground

COARSEST = 64
"""px between the nodes to begin with."""
EDGE = 4
"""px to which the horizon and the edges of a height grid are followed."""
ACCURACY = 0.01
"""px in the photo that linear interpolation between the nodes may be wrong by."""


@dataclass(frozen=True)
class Tile:
    """Rows and columns of a grid from `top`, `left`; may reach beyond the grid."""

    top: int
    left: int
    height: int
    width: int

    def nodes(self, step: int) -> tuple[int, int]:
        """Rows and columns of lattice nodes that hold the tile."""
        return tuple(max(-(-(n - 1) // step) + 1, 2) for n in (self.height, self.width))  # pyright: ignore[reportReturnType]


@dataclass(frozen=True)
class Net:
    """The surface at the nodes of a tile's lattice: map (m, n, 2), local (m, n, 3)."""

    tile: Tile
    step: int
    at: np.ndarray
    local: np.ndarray

    def thinned(self, factor: int) -> Net:
        """Every factor-th node; whole cells only where factor divides their number."""
        return Net(self.tile, self.step * factor, self.at[::factor, ::factor], self.local[::factor, ::factor])


def net_of(grid: Grid, tile: Tile, ground: Ground, step: int) -> Net:
    """The lattice of a tile."""
    rows, columns = (n + (n - 1) % 2 for n in tile.nodes(step))  # an even number of cells: every other node is a lattice too
    col, row = np.meshgrid(tile.left + step * np.arange(columns), tile.top + step * np.arange(rows))
    at = grid.to_map(np.stack([col, row], -1))
    return Net(tile, step, at, ground.local(at))


@dataclass(frozen=True)
class Lattice:
    """u, v (m, n): photo column and row at the nodes, NaN where unseen; good (m-1, n-1): cells whose four nodes are seen."""

    step: int
    u: np.ndarray
    v: np.ndarray
    good: np.ndarray
    net: Net


def _on_format(photo: Placed, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(m-1, n-1) whether the box of a cell's nodes meets the format."""
    low_u, high_u = _cells(u, np.fmin), _cells(u, np.fmax)
    low_v, high_v = _cells(v, np.fmin), _cells(v, np.fmax)
    return (high_u >= -0.5) & (low_u <= photo.interior.width - 0.5) & (high_v >= -0.5) & (low_v <= photo.interior.height - 0.5)


def _cells(values: np.ndarray, join: np.ufunc) -> np.ndarray:
    return join(join(values[:-1, :-1], values[:-1, 1:]), join(values[1:, :-1], values[1:, 1:]))


class Nets:
    """The lattices of one tile, finer ones made when a photo needs them."""

    def __init__(self, grid: Grid, tile: Tile, ground: Ground, step: int = COARSEST) -> None:
        self.grid, self.tile, self.ground = grid, tile, ground
        while step > 1 and step > max(tile.height, tile.width) // 2:
            step //= 2
        self.step, self._made = step, dict[int, Net]()

    def net(self, step: int) -> Net:
        """The net of a step."""
        if step not in self._made:
            self._made[step] = net_of(self.grid, self.tile, self.ground, step)
        return self._made[step]

    def lattice(self, photo: Placed, finest: int = 1) -> Lattice | None:
        """The photo's lattice, halved until every other node lies between its neighbours; None where the photo sees nothing."""
        step = self.step
        while True:
            net = self.net(step)
            pixels = photo.pixels(net.local)
            u, v = np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])
            good = _cells(np.isfinite(u), np.logical_and)
            on = good & _on_format(photo, u, v)
            edge = ~good & _on_format(photo, u, v)  # the horizon, a void
            if not on.any() and not edge.any():
                return None
            if step <= finest or (_error(u, v, on) <= ACCURACY and (step <= EDGE or not edge.any())):
                break
            step //= 2
        if not on.any():
            return None
        good = on & ~self._hidden(photo, net) if isinstance(self.ground.surface, Surface) else on
        return Lattice(step, u, v, good, net) if good.any() else None

    def _hidden(self, photo: Placed, net: Net) -> np.ndarray:
        """(m-1, n-1) cells with a node that the surface itself hides from the camera."""
        surface = self.ground.surface
        assert isinstance(surface, Surface)
        if photo.exterior is None:
            return np.zeros((net.at.shape[0] - 1, net.at.shape[1] - 1), bool)
        return _cells(occluded(surface, self.ground, photo, net.at, net.local), np.logical_or)


def occluded(surface: Surface, ground: Ground, photo: Placed, at: np.ndarray, local: np.ndarray) -> np.ndarray:
    """(...,) whether the height grid hides its points at map positions (..., 2), local (..., 3), from the camera."""
    from ..compiled import kernels

    assert photo.exterior is not None
    camera = ground.frame.to_map(photo.exterior.centre)
    z = surface.sample(at)
    out = np.zeros(z.shape, bool)
    if not np.isfinite(z).any() or _too_gentle(surface, local, photo):
        return out
    where, heights = surface.grid.to_pixels(at), np.where(np.isfinite(surface.z), surface.z, -np.inf)
    here = surface.grid.to_pixels(camera[:2])
    flat = out.reshape(-1)
    kernels("solvers.mosaic._kernels", "the resampling").hidden(
        heights, where[..., 0].ravel(), where[..., 1].ravel(), np.where(np.isfinite(z), z, np.inf).ravel(), float(here[0]),
        float(here[1]), float(camera[2]), float(np.nanmax(surface.z)), max(1e-3, 2 * surface.sigma), flat)
    return flat.reshape(z.shape)


def _too_gentle(surface: Surface, local: np.ndarray, photo: Placed) -> bool:
    """Whether no slope of the grid is as steep as the flattest ray: then nothing hides anything."""
    assert photo.exterior is not None
    ray = photo.exterior.centre - local
    with np.errstate(invalid="ignore"):
        flattest = np.nanmin(ray[..., 2] / np.maximum(np.hypot(ray[..., 0], ray[..., 1]), 1e-9))
    a, b, _, d, e, _ = surface.grid.affine
    down, across = np.abs(np.diff(surface.z, axis=0)), np.abs(np.diff(surface.z, axis=1))
    if not (np.isfinite(down).all() and np.isfinite(across).all()):
        return False
    return bool(np.hypot(down.max() / np.hypot(b, e), across.max() / np.hypot(a, d)) < flattest)


def _error(u: np.ndarray, v: np.ndarray, on: np.ndarray) -> float:
    """px that linear interpolation between these nodes is wrong by: from that between every other, half of it (a bend) at
    most; only beside cells that count."""
    worst = 0.0
    near = np.zeros(u.shape, bool)
    near[:-1, :-1] |= on
    near[1:, 1:] |= on
    near[:-1, 1:] |= on
    near[1:, :-1] |= on
    for values in (u, v):
        across = np.abs(values[:, 1:-1:2] - (values[:, :-2:2] + values[:, 2::2]) / 2)[near[:, 1:-1:2]]
        down = np.abs(values[1:-1:2] - (values[:-2:2] + values[2::2]) / 2)[near[1:-1:2]]
        for part in (across, down):
            part = part[np.isfinite(part)]
            worst = max(worst, float(part.max()) / 2 if len(part) else 0.0)
    return worst
