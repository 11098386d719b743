"""How far a registration with bends can be trusted.

Bends are found after the exterior orientations, which took them for noise: what bends a photo has by then turned it, and its
neighbours, a little. The covariance of that is the orientations' own response to bends of the size found, by draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..cameras import Interior
from .bending import ROUNDS
from .bends import by_bend
from .precision import Response

DRAWS = 24


class BentPrecision(NamedTuple):
    """covariance (m, 6, 6) of the exterior orientations; bends (m, 6, 6) of the bends, these given; noise (m,): standard error of
    the photos' places by both; alike (m,): how far they would move if all photos were bent alike, by bends of the same size."""

    covariance: np.ndarray
    bends: np.ndarray
    noise: np.ndarray
    alike: np.ndarray


def bent_precision(sure: Response, near: Response, weight: np.ndarray, interiors: Sequence[Interior], bends: np.ndarray,
                   within: float, seed: int = 6) -> BentPrecision:
    """sure: the exterior orientations of the photos; weight (o, 2): of the observations, as well as they fit with bends; bends
    (m, 6) [px], of standard error `within` beforehand. Raises DegenerateGeometry where singular."""
    problem, m = sure.problem, len(bends)
    net = problem.network
    by = by_bend(interiors, net.image, net.q)
    drawn = np.random.default_rng(seed).standard_normal((m, 6, DRAWS))
    errors = np.einsum("oea,oak->oek", by, drawn[net.image])
    steps = sure.to(errors * net.weight[:, :, None])
    size = max(within, float(np.sqrt(np.mean(bends**2))) / _left(sure, near, by, drawn, steps))
    white = Response(replace(problem, network=replace(net, weight=weight)), sure.x, sure.half)
    covariance = white.covariance + size**2 * (steps @ np.swapaxes(steps, 1, 2)) / DRAWS
    own = np.linalg.inv(_normal(net.image, by * weight[:, :, None], m) + np.eye(6) / within**2)
    at, bent = sure.onto, sure.bending(interiors)
    noise = np.einsum("mgea,mab,mgeb->mg", at, covariance, at) + np.einsum("mgea,mab,mgeb->mg", bent, own, bent)
    alike = size * np.linalg.norm(sure.moved(sure.to(by * net.weight[:, :, None])), axis=1)
    return BentPrecision(covariance, own, np.sqrt(np.nanmean(noise, axis=1)), alike)


def _left(sure: Response, near: Response, by: np.ndarray, drawn: np.ndarray, steps: np.ndarray) -> float:
    """What part of bends is found as bends, in turns, once the orientations have taken their steps: rms of both, over draws."""
    net = sure.problem.network
    weight, image = near.problem.network.weight[:, :, None], net.image
    photos, xy = sure.problem.split(sure.x)
    seen = sure.problem.model.see(photos, image, xy[net.point], net.lift[net.point])
    errors = np.einsum("oea,oak->oek", by, drawn[image]) - np.einsum("oea,oak->oek", seen.by_photo, steps[image])
    normal = _normal(image, by, len(drawn))
    normal += 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(6)
    found = np.zeros(drawn.shape)
    for _ in range(ROUNDS):
        e = (errors - np.einsum("oea,oak->oek", by, found[image])) * weight
        left = near.left(e, near.to(e)) / weight
        right = np.zeros(drawn.shape)
        np.add.at(right, image, np.einsum("oea,oek->oak", by, left))
        found += np.linalg.solve(normal, right)
    return float(np.sqrt(np.mean(found**2) / np.mean(drawn**2)))


def _normal(image: np.ndarray, by: np.ndarray, count: int) -> np.ndarray:
    """(m, 6, 6) normal matrices of the photos' bends."""
    out = np.zeros((count, 6, 6))
    np.add.at(out, image, np.swapaxes(by, 1, 2) @ by)
    return out


__all__ = ["BentPrecision", "bent_precision"]
