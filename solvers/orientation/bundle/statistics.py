"""How sure a bundle is: covariances, redundancy, standardized residuals, and what the network does not determine at all."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...adjustment import precision
from ...adjustment.precision import BAARDA_DELTA0
from ...errors import DegenerateGeometry
from .datum import SEVEN, motions
from .network import Network
from .problem import Bundle

NULL = 1e-12
"""Eigenvalue, over the largest, of the scaled normal matrix (of the datum alone, of the whole) that counts as zero."""
ELEMENTS = ("X", "Y", "Z", "rotation 1", "rotation 2", "rotation 3")


@dataclass(frozen=True)
class Statistics:
    """A priori, with the given sigmas. poses (m, 6, 6) of (centre, left rotation vector); interior (f, f); points (live, 3, 3);
    redundancy, w, detectable (o, 2) of the image observations: redundancy number, standardized residual (NaN where unchecked),
    minimal detectable blunder [px]; factor (o,): share of its weight that a robust loss leaves to each; loose: points
    whose rays are parallel, their standard errors lower bounds."""

    poses: np.ndarray
    interior: np.ndarray
    points: np.ndarray
    redundancy: np.ndarray
    w: np.ndarray
    detectable: np.ndarray
    factor: np.ndarray
    loose: tuple[int, ...] = ()
    border: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    cross: np.ndarray = field(default_factory=lambda: np.zeros((0, 6, 0)))

    @classmethod
    def of(cls, net: Network, poses: np.ndarray, border: np.ndarray, points: np.ndarray, cross: np.ndarray,
           **judged: Any) -> Statistics:
        """The border taken apart: interior orientation, and points that were held in it, behind those that were not."""
        free, held = net.freed, net.extras.held
        own = border[free:free + 3 * held, free:free + 3 * held].reshape(held, 3, held, 3)
        points = np.concatenate([points, own[np.arange(held), :, np.arange(held), :]])
        return cls(poses, border[:free, :free], points, border=border, cross=cross, **judged)


def statistics(problem: Bundle, x: np.ndarray) -> Statistics:
    """Statistics of a bundle at its solution. Raises DegenerateGeometry naming what is not determined."""
    net = problem.network
    m, f, live = net.sizes
    v = problem.residuals(x)
    factor = _factor(problem, v)
    if problem.compiled:
        try:
            poses, border, points, residual, computed, cross = problem.compiled.judge(x, problem.prior_rows(x), problem.inner)
        except np.linalg.LinAlgError:
            raise DegenerateGeometry(undetermined(problem, x)) from None
        redundancy = 1 - np.einsum("oaa->oa", computed)
        checked = redundancy > 1e-9
        root = np.sqrt(np.where(checked, redundancy, 1.0))
        sigma = (net.sigma / np.sqrt(factor))[:, None]
        return Statistics.of(net, poses, border, points, cross, redundancy=redundancy,
                             w=np.where(checked, residual / root, np.nan),
                             detectable=np.where(checked, BAARDA_DELTA0 * sigma / root, np.inf), factor=factor,
                             loose=tuple(map(int, problem.compiled.loose(x, problem.prior_rows(x), problem.inner))))
    if named := defects(problem, x):
        raise DegenerateGeometry(sentence(named))
    stats, o = precision(problem.linear(x), "the bundle"), len(net.image)
    q = stats.covariance
    poses = q[:6 * m, :6 * m].reshape(m, 6, m, 6)[np.arange(m), :, np.arange(m), :]
    points = q[6 * m + f:, 6 * m + f:].reshape(live, 3, live, 3)[np.arange(live), :, np.arange(live), :]
    cross = q[:6 * m, 6 * m:6 * m + f].reshape(m, 6, f)
    return Statistics.of(net, poses, q[6 * m:6 * m + f, 6 * m:6 * m + f], points, cross, redundancy=stats.redundancy[:o],
                         w=stats.w[:o], detectable=stats.detectable[:o], factor=factor)


def _factor(problem: Bundle, v: np.ndarray) -> np.ndarray:
    from ...adjustment.losses import LOSSES

    net = problem.network
    return LOSSES[net.loss](np.linalg.norm(v, axis=1) / net.sigma) if net.loss else np.ones(len(v))


# -- rank defects -------------------------------------------------------------------------------------------------------------


def undetermined(problem: Bundle, x: np.ndarray) -> str:
    """A sentence that names what the observations leave free."""
    return sentence(defects(problem, x) or ["a combination of unknowns that could not be singled out"])


def sentence(named: list[str]) -> str:
    """What to say of a singular bundle that leaves free what is named."""
    shown = "; ".join(named[:8]) + ("; ..." if len(named) > 8 else "")
    return f"the bundle is singular, it does not determine: {shown}; add control, priors or images, or free fewer parameters"


def defects(problem: Bundle, x: np.ndarray) -> list[str]:
    """What the network does not determine, in words; empty where it determines everything."""
    net = problem.network
    out = [] if problem.inner else datum_defects(problem, x)
    if out:
        return out
    if problem.compiled:
        return [direction(problem, v) for v in problem.compiled.weakest(x, problem.prior_rows(x), problem.inner, NULL)]
    normal = problem.normal(x)
    n = normal.scaled  # type: ignore[union-attr]
    if problem.inner:
        h = problem.inner.rows_of(net, motions(net, x)) / normal.scale
        h = np.linalg.qr(h.T)[0]
        n = n + h @ h.T
    values, vectors = np.linalg.eigh(n)
    return [direction(problem, vectors[:, k]) for k in np.flatnonzero(values < NULL * values[-1])]


def datum_defects(problem: Bundle, x: np.ndarray) -> list[str]:
    """Which of the seven motions of the world neither control nor priors forbid."""
    net = problem.network
    m, f, _ = net.sizes
    g = motions(net, x)
    points = net.split(x)[2]
    size = np.r_[1, 1, 1, np.full(4, max(float(np.ptp(points, axis=0).max(initial=0.0)) / 2, 1e-9))]  # metres at the rim
    g = g / size
    rows, (_, d) = net.prior_arrays[0], problem.prior_rows(x)
    parts = [(d @ g[:6 * m].reshape(m, 6, 7)[rows]).reshape(-1, 7)]
    weight = np.sqrt(net.weight[:net.unknown])[:, :, None]
    parts.append((weight * g[net.point_columns[:net.unknown]]).reshape(-1, 7))
    if net.extras.count:
        rows = net.border_rows(x)[1]  # velocities, weakly known, are no datum
        parts.append(rows[:len(rows) - net.extras.motions] @ g[6 * m:6 * m + f])
    if net.unknown < len(points):
        at = points[net.unknown:] - points.mean(axis=0)
        held = np.zeros((len(at), 3, 7))
        held[:, :, :3] = np.eye(3)
        held[:, 0, 4], held[:, 0, 5] = at[:, 2], -at[:, 1]
        held[:, 1, 3], held[:, 1, 5] = -at[:, 2], at[:, 0]
        held[:, 2, 3], held[:, 2, 4] = at[:, 1], -at[:, 0]
        held[:, :, 6] = at
        parts.append((held / size).reshape(-1, 7) * 1e4)
    a = np.concatenate(parts)
    _, s, vt = np.linalg.svd(np.linalg.qr(np.concatenate([a, np.zeros((7, 7))]), mode="r"))  # 7 x 7 however large the block
    free = s <= 1e-7 * max(s[0], 1e-300)
    if free.all():
        return ["the datum (place, attitude and scale): there is neither control nor a prior with a sigma in it"]
    return [_motion(row) for row in vt[free]]


def _motion(v: np.ndarray) -> str:
    """A motion (7,) of the world that nothing forbids, in words."""
    turn = np.linalg.norm(v[3:6])
    if turn > 0.3:
        axis = v[3:6] / turn * np.sign(v[3 + np.argmax(np.abs(v[3:6]))])
        return f"the datum's rotation about the direction ({', '.join(f'{a:.2f}' for a in axis)})"
    return " with ".join(f"the datum's {SEVEN[k]}" for k in np.flatnonzero(np.abs(v) > 0.3))


def direction(problem: Bundle, vector: np.ndarray) -> str:
    """The unknowns that make up most of a null vector (scaled parameters)."""
    net = problem.network
    m, f, _ = net.sizes
    names = [f"{p} of camera '{c}'" for c, p in net.labels]
    share = np.abs(vector) / np.abs(vector).max()
    said: list[str] = []
    for k in np.argsort(-share, kind="stable"):
        if share[k] < 0.3 or len(said) == 4:
            break
        if k < 6 * m:
            text = f"{ELEMENTS[k % 6]} of image '{net.images[k // 6]}'"
        elif k < 6 * m + len(names):
            text = names[k - 6 * m]
        elif k < 6 * m + len(names) + 3 * net.extras.held:
            text = f"point '{net.points[net.live + (k - 6 * m - len(names)) // 3]}'"
        elif 6 * m + f - net.extras.motions <= k < 6 * m + f:
            text = f"motion of image '{net.images[(k - 6 * m - f + net.extras.motions) // net.extras.moving]}'"
        elif k < 6 * m + f:
            text = f"shift of strip '{net.extras.shifts[(k - 6 * m - len(names) - 3 * net.extras.held) // 3]}'"
        else:
            text = f"point '{net.points[(k - 6 * m - f) // 3]}'"
        if text not in said:
            said.append(text)
    return " with ".join(said)
