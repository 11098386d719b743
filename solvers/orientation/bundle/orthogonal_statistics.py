"""How sure an orthogonal bundle is: a fixed point of G^T P v = 0 is not a minimum, so its covariance is a sandwich.

With J the derivatives of the residuals' own (perspective) model, A = G^T P J bordered by the datum, an error e of the
observations moves the solution by A^-1 G^T P e. Frozen, J = G: errors of the kept transformation are not in the covariance.

Reference: docs/formulas.md 3.6; Baarda 1968.
"""

from __future__ import annotations

import numpy as np

from ...adjustment import Linear
from ...adjustment.fronts import alone
from ...adjustment.precision import BAARDA_DELTA0
from ...errors import DegenerateGeometry
from .orthogonal import NULL, OrthogonalBundle
from .orthogonal_sparse import NODE, Equations, left_free
from .problem import Bundle
from .statistics import Statistics, datum_defects, direction, sentence, undetermined


def orthogonal_statistics(problem: OrthogonalBundle, x: np.ndarray) -> Statistics:
    """Statistics of an orthogonal bundle at its solution, a priori. Raises DegenerateGeometry naming what is free."""
    if problem.sparse:
        with alone():
            return _sparse(problem, x)
    net = problem.network
    m, f, live = net.sizes
    n = len(net.image)
    linear, flat_j, gain, deviation, q = propagated(problem, x)
    spread = np.eye(len(flat_j)) - flat_j @ gain  # residuals of observations
    redundancy = np.diag(spread)[:2 * n].reshape(n, 2)
    own = np.sqrt(((spread * deviation) ** 2).sum(axis=1))[:2 * n].reshape(n, 2)
    checked = (redundancy > 1e-9) & (own > 1e-6 * net.sigma[:, None])
    own, r = np.where(checked, own, 1.0), np.where(checked, redundancy, 1.0)
    factor = problem.factor(*problem.image_rows(x))
    poses = q[:6 * m, :6 * m].reshape(m, 6, m, 6)[np.arange(m), :, np.arange(m), :]
    points = q[6 * m + f:, 6 * m + f:].reshape(live, 3, live, 3)[np.arange(live), :, np.arange(live), :]
    cross = q[:6 * m, 6 * m:6 * m + f].reshape(m, 6, f)
    return Statistics.of(net, poses, q[6 * m:6 * m + f, 6 * m:6 * m + f], points, cross, redundancy=redundancy,
                         w=np.where(checked, linear.v[:n] / own, np.nan),
                         detectable=np.where(checked, BAARDA_DELTA0 * own / r, np.inf), factor=factor)


def _sparse(problem: OrthogonalBundle, x: np.ndarray) -> Statistics:
    """The same, from the entries of the inverse where the network is not zero."""
    net, made = problem.network, Equations(problem, x)
    f = net.sizes[1]
    try:
        system, y = made.double(not problem.frozen)
        of_observations, images, points, across, corner = system.quadratic(y)
    except np.linalg.LinAlgError:
        raise DegenerateGeometry(_said(made)) from None
    k = len(system.corner) // 2
    computed = np.einsum("oab,oba->oa", of_observations[:, 2:, :2], made.p)
    redundancy = 1 - computed
    own = net.sigma[:, None] ** 2 * (1 - 2 * computed) - np.einsum("oaa->oa", of_observations[:, 2:, 2:])
    own = np.sqrt(np.maximum(own, 0.0))
    poses = -images[:, NODE:NODE + 6, NODE:NODE + 6] / made.by_image[:, :6, None] / made.by_image[:, None, :6]
    cross = -across[:, NODE:NODE + 6, k:k + f] / made.by_image[:, :6, None] / made.by_border
    border = -corner[k:k + f, k:k + f] / made.by_border / made.by_border[:, None]
    at = -points[:, 3:, 3:] / made.by_point[:, :, None] / made.by_point[:, None]
    if problem.frozen:  # whose steps of c take the cameras with them
        along = np.concatenate([made.along, np.zeros_like(made.along)], axis=1)
        cross, before = cross + along @ border, cross
        poses = poses + along @ np.swapaxes(before, 1, 2) + cross @ np.swapaxes(along, 1, 2)
    checked = (redundancy > 1e-9) & (own > 1e-6 * net.sigma[:, None])
    own, r = np.where(checked, own, 1.0), np.where(checked, redundancy, 1.0)
    if not (np.isfinite(poses).all() and (np.einsum("mii->mi", poses) > 0).all()):
        raise DegenerateGeometry(_said(made))
    return Statistics.of(net, poses, border, at, cross, redundancy=redundancy, w=np.where(checked, made.v / own, np.nan),
                         detectable=np.where(checked, BAARDA_DELTA0 * own / r, np.inf), factor=made.factor)


def _said(made: Equations) -> str:
    """A sentence that names what a large network does not determine."""
    try:
        named = [] if made.problem.inner else datum_defects(made.problem, made.x)
        named = named or [direction(made.problem, v) for v in left_free(made, NULL).T]
    except np.linalg.LinAlgError:
        named = []
    return sentence(named or ["a combination of unknowns that could not be singled out"])


def propagated(problem: OrthogonalBundle, x: np.ndarray) -> tuple[Linear, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The linear problem, derivatives (2 o, u) and gain (u, 2 o) in scaled unknowns, standard deviations (2 o,) of the
    observations and covariance (u, u) of the unknowns."""
    net = problem.network
    linear = problem.linear(x)
    g, p, n = linear.j, linear.p, len(net.image)
    u = g.shape[2]
    j = g if problem.frozen else Bundle(net).linear(x).j
    scale = np.sqrt(np.maximum(np.einsum("oau,oab,obu->u", g, p, g), 1e-300))
    flat_j = (j / scale).reshape(-1, u)
    pg = (p @ (g / scale)).reshape(-1, u)
    gain = _inverse(pg.T @ flat_j, linear.h, scale, problem, x) @ pg.T  # (u, 2 o) scaled unknowns of observations
    deviation = np.ones(2 * len(g))
    deviation[:2 * n] = np.repeat(net.sigma, 2)
    q = (gain * deviation**2) @ gain.T / scale / scale[:, None]
    if problem.frozen:  # whose steps of c take the cameras with them
        along = problem.steps_of(np.eye(u), x)
        q = along @ q @ along.T
    return linear, flat_j, gain, deviation, q


def _inverse(a: np.ndarray, h: np.ndarray | None, scale: np.ndarray, problem: OrthogonalBundle, x: np.ndarray) -> np.ndarray:
    """(u, u) upper left block of the inverse of A bordered by the datum H, both in scaled unknowns."""
    u, k = len(a), 0 if h is None else len(h)
    bordered = np.zeros((u + k, u + k))
    bordered[:u, :u] = a
    if h is not None:
        rows = h / scale
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        bordered[u:, :u] = rows
        bordered[:u, u:] = rows.T  # on this side any complement of what G^T P can give serves
    if np.linalg.cond(bordered) > 1e14:
        raise DegenerateGeometry(undetermined(problem, x))
    return np.linalg.inv(bordered)[:u, :u]

