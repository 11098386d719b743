"""The geometry that the single-image studies share: the seed's camera and attitude, and clusters of control.

Reference: Tjahjadi & Agustina, "Single image orientation of UAV's imagery using orthogonal projection model", Table I.
"""

from __future__ import annotations

import numpy as np

from ..cameras import Interior, ideal_photo, project_derivatives
from ..geometry import Exterior, angle_derivatives
from .estimators import Poses, best_of, exponential, orthogonal_iterated, orthogonal_pass, perspective

CAMERA = Interior(35.0, pixel_mm=23.5 / 6000, width=6000, height=4000)
TABLE_I = Exterior.from_angles(*np.radians([-2.6368, 3.9069, 88.933]), centre=np.array([0.0, 0.0, 300.0]))
"""The benchmark attitude 300 m above the ground, in a local frame."""
CONTROL_M = 0.002


def cluster(centre_mm: tuple[float, float], n: int, fov_deg: float, relief: float) -> np.ndarray:
    """(n, 3) m control around the ground point seen at centre_mm, filling fov_deg, with the given relief."""
    ray = TABLE_I.m.T @ np.array([*centre_mm, -CAMERA.c])
    ground = TABLE_I.centre - ray * TABLE_I.centre[2] / ray[2]
    radius = np.linalg.norm(ground - TABLE_I.centre) * np.tan(np.radians(fov_deg / 2))
    k = np.arange(n)
    if n == 4:
        azimuth, r, z = 0.3 + k * np.pi / 2, np.full(n, radius), relief / 2 * np.array([1, -1, 1, -1])
    else:
        azimuth, r = 0.3 + k * np.pi * (3 - np.sqrt(5)), radius * np.sqrt((k + 0.5) / (n - 0.5))
        z = relief * (k * 0.6180339887498949 % 1 - 0.5)
    return np.stack([ground[0] + r * np.cos(azimuth), ground[1] + r * np.sin(azimuth), z], axis=1)


def estimate(points: np.ndarray, sigma_px: float, runs: int, rng: np.random.Generator,
             priors: tuple[tuple[float, float], ...]) -> dict[str, Poses]:
    """Every estimator on the same `runs` noisy copies of one control set. priors: (degrees, metres) of the approximation.

    Names: P perspective, the best of all starts (P_near: started at the truth, as an adjustment with a good approximation is);
    O1 one orthogonal pass as printed, O1rc re-centred; Oit, Oitrc iterated to rest; B perspective with the weighted
    prior; behind them the prior's sigmas, or "truth" where the transformation uses the true orientation.
    """
    n, c, pitch = len(points), CAMERA.c, CAMERA.pitch[0]
    xy = ideal_photo(c, TABLE_I, points) + rng.normal(0, sigma_px * pitch, (runs, n, 2))
    seen = points + rng.normal(0, CONTROL_M, (runs, n, 3))
    scale = project_derivatives(CAMERA, TABLE_I, points).point
    ground_px = CONTROL_M * np.sqrt((scale**2).sum(axis=(1, 2)) / 2)
    sigma_mm = np.broadcast_to(np.hypot(sigma_px, ground_px) * pitch, (runs, n))
    truth = Poses(np.broadcast_to(TABLE_I.m, (runs, 3, 3)), np.broadcast_to(TABLE_I.centre, (runs, 3)), np.ones(runs, bool))
    free = [perspective(seen, xy, c, sigma_mm, s) for s in (truth, _mirrored(truth, seen))]
    out = {"P_near": free[0][0], "P": best_of(*free)}
    for form, recentre, name in (("printed", False, "O1"), ("depth", True, "O1rc")):
        out[f"{name}_truth"] = orthogonal_pass(seen, xy, c, truth, form, recentre)
    out["Oit"] = orthogonal_iterated(seen, xy, c, truth, "printed", False)
    out["Oitrc"] = orthogonal_iterated(seen, xy, c, truth)
    for degrees, metres in priors:
        sd = np.array([metres] * 3 + [np.radians(degrees)] * 3)
        gap = rng.normal(0, 1, (runs, 6)) * sd
        given = Poses(exponential(gap[:, 3:]) @ truth.m, truth.centre + gap[:, :3], truth.ok)
        tag = f"{degrees:g}_{metres:g}"
        out[f"O1_{tag}"] = orthogonal_pass(seen, xy, c, given, "printed", False)
        out[f"O1rc_{tag}"] = orthogonal_pass(seen, xy, c, given)
        weight = np.diag(1 / sd**2)
        out[f"B_{tag}"] = best_of(*(perspective(seen, xy, c, sigma_mm, s, (given, weight)) for s in (given, out["P"])))
    return out


def _mirrored(truth: Poses, points: np.ndarray) -> Poses:
    """The reversed attitude: the plane's normal mirrored about the ray to the centroid; the distance is kept."""
    mean = points.mean(axis=1)
    reach = mean - truth.centre
    ray = reach / np.linalg.norm(reach, axis=1, keepdims=True)
    normal = np.array([0.0, 0.0, 1.0])
    half = -ray  # mirrored normal = 2 (n . half) half - n; the camera turns the other way about the centroid
    target = 2 * (half @ normal)[:, None] * half - normal
    axis = np.cross(target, normal)
    sine, cosine = np.linalg.norm(axis, axis=1), target @ normal
    turn = exponential(axis / np.where(sine > 0, sine, 1)[:, None] * np.arctan2(sine, cosine)[:, None])
    # turning the object by `turn` equals turning the camera back about the centroid
    m = truth.m @ np.swapaxes(turn, 1, 2)
    return Poses(m, mean - np.einsum("bij,bj->bi", turn, reach), truth.ok)


def tilt_and_more(poses: Poses, converged_only: bool = True) -> dict[str, float]:
    """RMSE of omega, phi, kappa [deg], X, Y, Z [m] and of the tilt [deg], its 68 % quantile, and the share that came to rest."""
    error = poses.error(TABLE_I.m, TABLE_I.centre)
    keep = poses.ok if converged_only else np.ones(len(error), bool)
    angles = np.degrees(error[:, 3:] @ angle_derivatives(TABLE_I.m).T)
    tilt = np.hypot(angles[:, 0], angles[:, 1])
    rms = np.sqrt((np.hstack([angles, error[:, :3]])[keep] ** 2).mean(axis=0)) if keep.any() else np.full(6, np.nan)
    names = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")
    values = dict(zip(names, map(float, rms), strict=True))
    return {**values, "tilt_deg": float(np.sqrt((tilt[keep] ** 2).mean())) if keep.any() else float("nan"),
            "tilt_p68_deg": float(np.quantile(tilt[keep], 0.6827)) if keep.any() else float("nan"), "converged": float(poses.ok.mean())}
