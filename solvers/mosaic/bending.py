"""Bends found: in turns with the adjustment of the plane coefficients, by the tie points' residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..adjustment import Options
from ..cameras import Interior
from .bends import straightened, terms
from .models import through
from .problem import Registering
from .simultaneous import Found, run

LEAST = 40
"""Observations from which on a photo is bent."""
ROUNDS = 10
STAGE = Options(max_iterations=6, max_trials=16, damping=1e-4, step_tolerance=1e-3, cost_tolerance=1e-5)


def bend_photos(found: Found, interiors: Sequence[Interior], cameras: np.ndarray, within: float) -> tuple[Found, np.ndarray]:
    """Bends (m, 6) of all photos, and the adjustment of their coefficients with them, in turns.

    cameras (m, 3, 3): ideal photo coordinates over c -> undistorted pixels; within: standard error [px] of "no bend".
    """
    problem = found.problem
    net, m = problem.network, len(interiors)
    bends = np.zeros((m, 6))
    rows = [np.flatnonzero(net.image == k) for k in range(m)]
    seen = [through(np.broadcast_to(c, (len(r), 3, 3)), net.q[r])[0] for c, r in zip(cameras, rows, strict=True)]
    for turn in range(ROUNDS):
        h, xy = found.warps, found.xy
        for k, r in enumerate(rows):
            level = net.lift[net.point[r]] == 0  # control points stand above or below the plane
            if level.sum() >= LEAST:
                at = through(np.broadcast_to(cameras[k] @ h[k], (len(r), 3, 3)), xy[net.point[r]])[0]
                bends[k] = _fitted(at[level], seen[k][level], interiors[k], within)
        q = net.q.copy()
        for k, r in enumerate(rows):
            straight = straightened(bends[k], interiors[k], seen[k])
            q[r] = through(np.broadcast_to(np.linalg.inv(cameras[k]), (len(r), 3, 3)), straight)[0]
        problem = Registering(replace(net, q=q), problem.model, problem.priors)
        found = run(problem, found.x, "bent", found, None if turn == ROUNDS - 1 else STAGE)
    return found, bends


def _fitted(at: np.ndarray, seen: np.ndarray, interior: Interior, within: float) -> np.ndarray:
    """(6,) bend from where points would be, `at` (k, 2), to where they are seen, by least squares that forget wrong matches."""
    ok = np.isfinite(at).all(-1)
    f, off = terms(interior.width, interior.height, at[ok]), (seen - at)[ok]
    bend, weight = np.zeros((3, 2)), np.ones(len(f))
    for _ in range(8):
        away = np.linalg.norm(off - f @ bend, axis=1)
        scale = max(float(np.median(away)), 1e-3)
        weight = 1 / (1 + (away / (2 * scale)) ** 2)
        normal = (f * weight[:, None]).T @ f + np.eye(3) * (scale / within) ** 2
        bend = np.linalg.solve(normal, (f * weight[:, None]).T @ off)
    return bend.T.ravel()
