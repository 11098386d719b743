"""When a bundle fails: the network alone, oriented by its tie points, tells which control points and priors contradict the rest.

Reference: Fischler & Bolles 1981 (consensus over minimal samples); Umeyama 1991.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...block import Block
from ...errors import PhotogrammetryError
from .datum import similarity
from .given import BundleRequest, given
from .start import network_alone

FEET = 0.3048
SAMPLES = 600
"""Triples of control points that are tried, at most."""


@dataclass(frozen=True)
class Screened:
    """Control points that do not fit the others (names), and what is wrong with them, in words."""

    names: tuple[str, ...]
    said: tuple[str, ...]


def screen(block: Block, request: BundleRequest) -> Screened:
    """Control points against the network of tie points: at least five of them, seen in a network that hangs together."""
    data = given(block, replace(request, datum="free"))
    names = [j for j, role in enumerate(block.points.role) if role == "control"]
    try:
        xyz = network_alone(data)
    except PhotogrammetryError:
        return Screened((), ())
    rows = np.array([j for j in names if np.isfinite(xyz[j]).all() and np.isfinite(data.approximate[j]).all()], int)
    if len(rows) < 5:
        return Screened((), ())
    source, target = xyz[rows], data.approximate[rows]
    fitted = consensus(source, target)
    if fitted is None:
        return Screened((), ())
    moved, good = fitted
    off = np.linalg.norm(moved - target, axis=1)
    bad = np.flatnonzero(~good)
    if not len(bad) or len(bad) > len(rows) - 4:
        return Screened((), ())
    labels = [block.points.names[j] for j in rows]
    said = [_described(int(k), labels, moved, target, off, bad) for k in bad]
    return Screened(tuple(labels[k] for k in bad), tuple(dict.fromkeys(said)))


def consensus(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The source points moved by the similarity that most pairs agree on, and which those are; None where fewer than four do.

    Agreeing: within 3 % of the extent of those that agree (a free network bends).
    """
    n = len(source)
    triples = list(combinations(range(n), 3))
    if len(triples) > SAMPLES:
        pick = np.random.default_rng(0).choice(len(triples), SAMPLES, replace=False)
        triples = [triples[k] for k in pick]
    best: tuple[int, float, np.ndarray] | None = None
    for t in map(list, triples):
        if np.linalg.svd(source[t] - source[t].mean(axis=0), compute_uv=False)[1] < 1e-3 * np.ptp(source):
            continue
        good = _agreeing(source, target, *similarity(source[t], target[t]))
        for _ in range(3):
            if good.sum() < 3:
                break
            good = _agreeing(source, target, *similarity(source[good], target[good]))
        if good.sum() < 4:
            continue
        scale, r, shift = similarity(source[good], target[good])
        rms = float(np.sqrt((((scale * source @ r.T + shift) - target)[good] ** 2).sum(axis=1).mean()))
        if best is None or (-good.sum(), rms) < (-best[0], best[1]):
            best = int(good.sum()), rms, good
    if best is None:
        return None
    scale, r, shift = similarity(source[best[2]], target[best[2]])
    return scale * source @ r.T + shift, best[2]


def _agreeing(source: np.ndarray, target: np.ndarray, scale: float, r: np.ndarray, shift: np.ndarray) -> np.ndarray:
    off = np.linalg.norm(scale * source @ r.T + shift - target, axis=1)
    extent = scale * np.linalg.norm(source - np.median(source, axis=0), axis=1)
    return off < 0.03 * float(np.median(extent))


def _described(k: int, labels: list[str], moved: np.ndarray, target: np.ndarray, off: np.ndarray, bad: np.ndarray) -> str:
    """One control point that is wrong, and how."""
    for other in bad:
        if other != k and np.linalg.norm(target[k] - moved[other]) < 0.1 * off[k] and \
                np.linalg.norm(target[other] - moved[k]) < 0.1 * off[k]:
            a, b = sorted((labels[k], labels[other]))
            return f"control points '{a}' and '{b}' look exchanged: each has the coordinates of the other"
    return f"control point '{labels[k]}' does not fit the others by {off[k]:.3g} m"


def unit_of(block: Block, name: str, xyz: np.ndarray) -> str:
    """A guess at feet: the given coordinates against adjusted ones (3,), as a clause, empty where they do not say so."""
    given_xyz = block.points.xyz[block.point_index(name)]
    with np.errstate(all="ignore"):
        ratio = given_xyz / xyz
    off = np.abs(given_xyz - xyz)
    feet = (np.abs(ratio * FEET - 1) < 0.01) & (off > 1)
    if not feet.any():
        return ""
    return f"; its {', '.join(c for c, f in zip('XYZ', feet, strict=True) if f)} look given in feet"


def exchanged(block: Block, centres: dict[str, np.ndarray]) -> list[str]:
    """Pairs of images whose priors suit each other better than themselves, in words. centres: adjusted, project coordinates."""
    given_at = {i.name: i.prior.centre for i in block.images if i.name in centres and i.prior is not None
                and i.prior.centre is not None}
    if len(given_at) < 3:
        return []
    names = list(given_at)
    off = {n: float(np.linalg.norm(centres[n] - given_at[n])) for n in names}
    usual = float(np.median(list(off.values())))
    far = [n for n in names if off[n] > 5 * usual + 1e-6]
    said = []
    for a, b in combinations(far, 2):
        cross = max(float(np.linalg.norm(centres[a] - given_at[b])), float(np.linalg.norm(centres[b] - given_at[a])))
        if cross < 3 * usual + 0.1 * off[a]:
            said.append(f"images '{a}' and '{b}' look exchanged: each lies {off[a]:.3g} m from its own GPS position and on the "
                        "other's")
    return said


def control_in_feet(block: Block, centres: dict[str, np.ndarray]) -> list[str]:
    """A sentence where control places the images as many times farther apart than their priors as a metre has feet. centres:
    adjusted, project coordinates."""
    given = [(centres[i.name], i.prior.centre) for i in block.images
             if i.name in centres and i.prior is not None and i.prior.centre is not None]
    if len(given) < 3:
        return []
    ours, theirs = (a - a.mean(axis=0) for a in np.swapaxes(np.array(given, float), 0, 1))
    length = max(float(np.linalg.norm(ours)), 1e-9)
    share = float((ours * theirs).sum()) / length**2  # the priors' noise does not bias it
    spread = float(np.linalg.norm(theirs - share * ours)) / np.sqrt(max(theirs.size - 4, 1))  # of the priors, as they turn out
    if abs(share / FEET - 1) > 0.1 or 1 - share < 5 * spread / length:
        return []
    ratio = 1 / share
    return [f"the control points look given in feet: placed by them the images lie {ratio:.3g} times as far apart as by their "
            f"GPS positions; give X, Y and Z in metres (multiply by {FEET})"]
