"""How overlapping photos become one tile: one of them, their mean, feathered, or in bands along seam lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from .labels import Labels
from .lattice import Lattice, Nets, Tile
from .placed import Placed
from .resample import Resample, Window, compiled, warp_onto
from .tones import Tone

Blend = Literal["none", "average", "feather", "multiband"]
BANDS = 5
"""Octaves that are blended apart; the coarsest reaches over some 2^BANDS px."""
MARGIN = 4 * 2**BANDS
"""px around a tile that its coarsest band needs."""


class Shot(NamedTuple):
    """A photo over a tile: its lattice, its feather weight and brightness at the nodes, its seam weight or None, its place."""

    photo: Placed
    lattice: Lattice
    feather: np.ndarray
    bright: np.ndarray
    label: np.ndarray | None
    nearness: np.ndarray


@dataclass(frozen=True)
class Layers:
    """What is put on a tile: photos with their tones and places (n, 2), seam labels (None: without), the numbers the labels
    call the photos."""

    photos: tuple[Placed, ...]
    tones: tuple[Tone, ...]
    feet: np.ndarray
    numbers: tuple[int, ...]
    labels: Labels | None = None


def shots_of(nets: Nets, layers: Layers) -> list[Shot]:
    """The photos that see a tile."""
    shots = []
    for k, photo in enumerate(layers.photos):
        lattice = nets.lattice(photo)
        if lattice is None:
            continue
        net, u, v = lattice.net, lattice.u, lattice.v
        off = (net.at - layers.feet[k]) / np.linalg.norm(net.at[0, 1] - net.at[0, 0]) * lattice.step  # px
        label = None if layers.labels is None else layers.labels.weight(layers.numbers[k], net)
        shots.append(Shot(photo, lattice, feather(photo, u, v), np.nan_to_num(layers.tones[k].factor(photo, u, v), nan=1.0),
                          label, -(off**2).sum(-1)))
    return shots


def feather(photo: Placed, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Weight that falls from 1 in the photo's middle to 0 at its edges, squared; 0 where it is not seen."""
    wide, high = photo.interior.width, photo.interior.height
    inside = np.minimum(np.minimum(u + 0.5, wide - 0.5 - u) / wide, np.minimum(v + 0.5, high - 0.5 - v) / high) * 2
    return np.clip(np.nan_to_num(inside, nan=0.0), 0, 1) ** 2


def blended(acc: np.ndarray, first: int, shots: Sequence[Shot], blend: Blend, window: Window, method: Resample) -> None:
    """Weighted sums and weights acc (rows, w, 4), float32, of rows of a tile from `first` on; of blends without bands."""
    acc.fill(0)
    best = blend == "none"
    lift = -min((float(s.nearness.min()) for s in shots), default=0.0) + 1.0
    for s in shots:
        good = s.lattice.good
        if s.label is not None:
            weight, good = s.label, good & _any(s.label > 0)
        elif best:
            weight = (s.nearness + lift) / lift
        else:
            weight = np.ones_like(s.feather) if blend == "average" else s.feather
        warp_onto(acc, s.photo, s.lattice, window, method, weight, s.bright, good, best, first)
    if best:
        acc[..., 3] = acc[..., 3] > 0
    if any(s.label is not None for s in shots):
        _fill(acc, first, shots, window, method)


def _fill(acc: np.ndarray, first: int, shots: Sequence[Shot], window: Window, method: Resample) -> None:
    """Where the photo that the seams want shows nothing (hidden, its edge), the others take over."""
    empty = acc[..., 3] == 0
    if not empty.any():
        return
    more = np.zeros_like(acc)
    for s in shots:
        good = s.lattice.good & _cells_with(empty, first, s.lattice)
        if good.any():
            warp_onto(more, s.photo, s.lattice, window, method, s.feather, s.bright, good, first=first)
    acc[empty] = more[empty]


def _any(nodes: np.ndarray) -> np.ndarray:
    return nodes[:-1, :-1] | nodes[:-1, 1:] | nodes[1:, :-1] | nodes[1:, 1:]


def _cells_with(mask: np.ndarray, first: int, lattice: Lattice) -> np.ndarray:
    """Cells of a lattice that hold a pixel of a mask, rows of the tile from `first` on."""
    (m, n), step = lattice.good.shape, lattice.step
    out, rows, columns = np.zeros((m, n), bool), *np.nonzero(mask)
    i, j = (rows + first) // step, columns // step
    inside = (i < m) & (j < n)
    out[i[inside], j[inside]] = True
    return out


# -- bands ------------------------------------------------------------------------------------------------------------------


def widened(tile: Tile) -> Tile:
    """The tile with the margin that bands need, its size a multiple of the coarsest band's pixel."""
    unit = 2**BANDS
    return Tile(tile.top - MARGIN, tile.left - MARGIN, -(-tile.height // unit) * unit + 2 * MARGIN,
                -(-tile.width // unit) * unit + 2 * MARGIN)


def multiband(shots: Sequence[Shot], shape: tuple[int, int], window: Window, method: Resample) -> np.ndarray:
    """Colours and whether they are seen (h, w, 4), of Laplacian pyramids joined along the seams (Burt & Adelson 1983).

    Beyond its edges a photo goes on with what the others show, and where no one does with what lies nearest, so that no edge
    of a photo shines through.
    """
    acc = np.empty((*shape, 4), np.float32)
    blended(acc, 0, shots, "feather", window, method)
    shown = (acc[..., 3] > 0).astype(np.float32)
    base = acc[..., :3] / np.maximum(acc[..., 3:], 1e-12)
    sums: list[np.ndarray] = []
    weights: list[np.ndarray] = []
    if len(shots) > 1 and shown.any():
        base = _gone_on(base, shown)
        for s in shots:
            if s.label is None or not (s.label > 0).any():
                continue
            acc.fill(0)
            warp_onto(acc, s.photo, s.lattice, window, method, bright=s.bright)
            mask, empty = interpolated(s.label, s.lattice.step, shape), acc[..., 3] <= 0
            mask[empty] = 0
            for colour in range(3):
                np.copyto(acc[..., colour], base[..., colour], where=empty)
            _add_bands(acc, mask, sums, weights)
        left = np.clip(1 - weights[0], 0, None) if sums else np.zeros(0)  # nobody's: the feathered picture
        if (left > 1e-3).any():
            _add_bands(base, left, sums, weights)
    acc[..., :3] = _joined(sums, weights) if sums else base
    acc[..., 3] = shown
    return acc


def _add_bands(picture: np.ndarray, mask: np.ndarray, sums: list[np.ndarray], weights: list[np.ndarray]) -> None:
    """Bands of a picture, weighted, onto the sums; one colour after the other, for less memory at a time."""
    import cv2

    masks = [mask]
    for _ in range(BANDS):
        masks.append(cv2.pyrDown(masks[-1]))
    if not sums:
        sums += [np.zeros((*m.shape, 3), np.float32) for m in masks]
        weights += [np.zeros(m.shape, np.float32) for m in masks]
    for w, m in zip(weights, masks, strict=True):
        w += m
    for colour in range(3):
        band = np.ascontiguousarray(picture[..., colour])
        for level, m in enumerate(masks):
            small = cv2.pyrDown(band) if level < BANDS else band
            if level < BANDS:
                band -= cv2.pyrUp(small, dstsize=band.shape[1::-1])
            sums[level][..., colour] += band * m
            band = small


def _joined(sums: list[np.ndarray], weights: list[np.ndarray]) -> np.ndarray:
    """The picture of all bands; the sums are used up."""
    import cv2

    for total, weight in zip(sums, weights, strict=True):
        total /= np.maximum(weight, 1e-6)[..., None]
    picture = sums[-1]
    for total in sums[-2::-1]:
        total += cv2.pyrUp(picture, dstsize=total.shape[1::-1])
        picture = total
    return picture


def _gone_on(picture: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The picture with its gaps filled from ever coarser means of what lies around."""
    import cv2

    if seen.all() or min(seen.shape) < 4:
        return picture if seen.any() else np.zeros_like(picture)
    weight = cv2.pyrDown(seen)
    small = cv2.pyrDown(picture * seen[..., None]) / np.maximum(weight, 1e-6)[..., None]
    up = cv2.pyrUp(_gone_on(small, (weight > 1e-3).astype(np.float32)), dstsize=picture.shape[1::-1])
    return np.where(seen[..., None] > 0, picture, up)


def interpolated(nodes: np.ndarray, step: int, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) float32 of values at lattice nodes, linear in between."""
    rows, columns = np.arange(shape[0]) / step, np.arange(shape[1]) / step
    i, j = np.minimum(rows.astype(int), nodes.shape[0] - 2), np.minimum(columns.astype(int), nodes.shape[1] - 2)
    a, b = (rows - i).astype(np.float32)[:, None], (columns - j).astype(np.float32)
    n = nodes.astype(np.float32)
    lines = n[:, j] * (1 - b) + n[:, j + 1] * b
    return lines[i] * (1 - a) + lines[i + 1] * a


def finish(acc: np.ndarray, out: np.ndarray) -> None:
    """RGBA out uint8 (h, w, 4) of sums and weights acc (h, w, 4) float32."""
    compiled().finish(acc, out)


def half(rgba: np.ndarray) -> np.ndarray:
    """RGBA uint8 (h, w, 4), sides even, at half the resolution, its colours those of what is seen."""
    out = np.empty((rgba.shape[0] // 2, rgba.shape[1] // 2, 4), np.uint8)
    compiled().halve(rgba, out)
    return out
