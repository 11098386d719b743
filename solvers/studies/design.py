"""The geometry that the single-image studies share: the paper's camera and attitude, and clusters of control.

Reference: Tjahjadi & Agustina, "Single image orientation of UAV's imagery using orthogonal projection model", Table I.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cameras import Interior, ideal_photo, project, project_derivatives
from ..geometry import Exterior
from ..orientation import Orthogonal
from ..orientation.orthogonal import Form
from .estimators import Poses, best_of, exponential, orthogonal_iterated, orthogonal_pass, perspective

CAMERA = Interior(35.0, pixel_mm=23.5 / 6000, width=6000, height=4000)
TABLE_I = Exterior.from_angles(*np.radians([-2.6368, 3.9069, 88.933]), centre=np.array([0.0, 0.0, 300.0]))
"""The benchmark attitude 300 m above the ground, in a local frame."""
CONTROL_M = 0.002
ELEMENTS = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")
PITCH = float(CAMERA.pitch[0])
FORMS: dict[str, tuple[Form, bool]] = {"O1": ("printed", False), "O1rc": ("printed", True), "O1d": ("depth", True)}
"""Form and re-centring of the orthogonal methods."""


def ground(photo_mm: np.ndarray, level: float = 0.0) -> np.ndarray:
    """(n, 3) m, the ground points at a height that TABLE_I sees at photo positions (n, 2) mm."""
    rays = np.column_stack([photo_mm, np.full(len(photo_mm), -CAMERA.c)]) @ TABLE_I.m
    return TABLE_I.centre + rays * ((level - TABLE_I.centre[2]) / rays[:, 2])[:, None]


def cluster(centre_mm: tuple[float, float], n: int, fov_deg: float, relief: float) -> np.ndarray:
    """(n, 3) m control around the ground point seen at centre_mm, filling fov_deg, with the given relief."""
    middle = ground(np.array([centre_mm]))[0]
    radius = np.linalg.norm(middle - TABLE_I.centre) * np.tan(np.radians(fov_deg / 2))
    k = np.arange(n)
    if n == 4:
        azimuth, r, z = 0.3 + k * np.pi / 2, np.full(n, radius), relief / 2 * np.array([1, -1, 1, -1])
    else:
        azimuth, r = 0.3 + k * np.pi * (3 - np.sqrt(5)), radius * np.sqrt((k + 0.5) / (n - 0.5))
        z = relief * (k * 0.6180339887498949 % 1 - 0.5)
    return np.stack([middle[0] + r * np.cos(azimuth), middle[1] + r * np.sin(azimuth), z], axis=1)


def sigma_mm(points: np.ndarray, sigma_px: float) -> np.ndarray:
    """(n,) mm, measurement and control error of each point together, in the photo."""
    by_point = project_derivatives(CAMERA, TABLE_I, points).point
    return np.hypot(sigma_px, CONTROL_M * np.sqrt((by_point**2).sum(axis=(1, 2)) / 2)) * PITCH


@dataclass(frozen=True)
class Sample:
    """Noisy copies of one control set: points (n, 3) true, seen (B, n, 3) m, xy (B, n, 2) mm, sigma (n,) mm."""

    points: np.ndarray
    seen: np.ndarray
    xy: np.ndarray
    sigma: np.ndarray

    @classmethod
    def draw(cls, points: np.ndarray, sigma_px: float, runs: int, rng: np.random.Generator) -> Sample:
        """`runs` copies with sigma_px in the image and CONTROL_M on the ground."""
        xy = ideal_photo(CAMERA.c, TABLE_I, points) + rng.normal(0, sigma_px * PITCH, (runs, len(points), 2))
        return cls(points, points + rng.normal(0, CONTROL_M, (runs, len(points), 3)), xy, sigma_mm(points, sigma_px))

    def take(self, index: np.ndarray | slice) -> Sample:
        """The same runs with some of the points."""
        return Sample(self.points[index], self.seen[:, index], self.xy[:, index], self.sigma[index])

    @property
    def runs(self) -> int:
        return len(self.seen)

    @property
    def truth(self) -> Poses:
        return Poses.same(TABLE_I.m, TABLE_I.centre, self.runs)

    def perspective(self, start: Poses, prior: tuple[Poses, np.ndarray] | None = None) -> tuple[Poses, np.ndarray]:
        """Perspective orientations and costs from starts."""
        return perspective(self.seen, self.xy, CAMERA.c, np.broadcast_to(self.sigma, self.xy.shape[:2]), start, prior)

    def both_minima(self) -> tuple[tuple[Poses, np.ndarray], tuple[Poses, np.ndarray]]:
        """Perspective orientations and costs from the truth, and from its reversal about the control's plane."""
        return self.perspective(self.truth), self.perspective(mirrored(self.truth, self.seen))


def estimate(sample: Sample, rng: np.random.Generator, priors: tuple[tuple[float, float], ...],
             reference: tuple[str, Poses] | None = None) -> dict[str, Poses]:
    """Every estimator on the same runs. priors: (degrees, metres), the sigmas of rotation and centre of an approximation.

    Names: P perspective started at the truth, as an adjustment with a good approximation is; Pbest the better of both
    reversal solutions, as an adjustment without any approximation must choose; O1 one orthogonal pass as printed, O1rc
    the same re-centred, O1d re-centred with the depth form; Oit, Oitrc as printed and re-centred, iterated to rest; B
    perspective with the weighted prior, the best of its starts. Behind O1, O1rc, O1d and B the sigmas of the prior, or the
    name of the reference orientation that the transformation uses (default: truth).
    """
    tag, given = reference or ("truth", sample.truth)
    near, reversed_ = sample.both_minima()
    out = {"P": near[0], "Pbest": best_of(near, reversed_)}
    data = sample.seen, sample.xy, CAMERA.c
    out |= {f"{k}_{tag}": orthogonal_pass(*data, given, *form) for k, form in FORMS.items()}
    out |= {k.replace("O1", "Oit"): orthogonal_iterated(*data, given, *FORMS[k]) for k in ("O1", "O1rc")}
    for degrees, metres in priors:
        sd = np.array([metres] * 3 + [np.radians(degrees)] * 3)
        gap = rng.normal(0, 1, (sample.runs, 6)) * sd
        prior = Poses(exponential(gap[:, 3:]) @ TABLE_I.m, TABLE_I.centre + gap[:, :3], np.ones(sample.runs, bool))
        tag = f"{degrees:g}_{metres:g}"
        out |= {f"{k}_{tag}": orthogonal_pass(*data, prior, *form) for k, form in FORMS.items()}
        out[f"B_{tag}"] = best_of(*(sample.perspective(s, (prior, 1 / sd**2)) for s in (prior, near[0], reversed_[0])))
    return out


def mirrored(truth: Poses, points: np.ndarray) -> Poses:
    """The reversed attitude: a level plane's normal mirrored about the ray to the centroid of points (B, n, 3); the
    distance is kept."""
    mean = points.mean(axis=1)
    reach = mean - truth.centre
    half = -reach / np.linalg.norm(reach, axis=1, keepdims=True)
    normal = np.array([0.0, 0.0, 1.0])
    target = 2 * (half @ normal)[:, None] * half - normal
    axis = np.cross(target, normal)
    sine, cosine = np.linalg.norm(axis, axis=1), target @ normal
    turn = exponential(axis / np.where(sine > 0, sine, 1)[:, None] * np.arctan2(sine, cosine)[:, None])
    # turning the object by `turn` equals turning the camera back about the centroid
    return Poses(truth.m @ np.swapaxes(turn, 1, 2), mean - np.einsum("bij,bj->bi", turn, reach), truth.ok)


def predict(points: np.ndarray, sigma_px: float, priors: tuple[tuple[float, float], ...]) -> dict[str, np.ndarray]:
    """Covariance (6, 6) of (X, Y, Z [m], omega, phi, kappa [rad]) by linear theory for the names of `estimate`, and
    "rho", "rho_rc": the spectral radius of the prior leak as printed and re-centred (docs/formulas.md 3.6)."""
    sd_px = sigma_mm(points, sigma_px) / PITCH
    at = project_derivatives(CAMERA, TABLE_I, points)
    j = np.concatenate([at.centre, at.rotation], axis=2) / sd_px[:, None, None]
    normal = np.einsum("nai,naj->ij", j, j)
    covariance = np.linalg.inv(normal)
    sigma = np.eye(2) * (sd_px**2)[:, None, None]
    pixels = project(CAMERA, TABLE_I, points)
    leaks = {k: Orthogonal(CAMERA, points, pixels, sigma, f, r).statistics(TABLE_I) for k, (f, r) in FORMS.items()}
    out = {"P": covariance, "Oit": leaks["O1"].iterated, "Oitrc": leaks["O1rc"].iterated,
           **{f"{k}_truth": leak.noise for k, leak in leaks.items()}}
    for degrees, metres in priors:
        tag, sd = f"{degrees:g}_{metres:g}", np.array([metres] * 3 + [np.radians(degrees)] * 3)
        for k, leak in leaks.items():
            out[f"{k}_{tag}"] = leak.noise + leak.leak @ np.diag(sd**2) @ leak.leak.T
        out[f"B_{tag}"] = np.linalg.inv(normal + np.diag(1 / sd**2))
    return {**{k: TABLE_I.angle_covariance(v) for k, v in out.items()},
            "rho": np.array(leaks["O1"].radius), "rho_rc": np.array(leaks["O1rc"].radius)}


def tilt_deg(covariance: np.ndarray) -> float:
    """Standard deviation of the tilt, sqrt(omega^2 + phi^2), of a covariance (6, 6) of `predict` [degrees]."""
    return float(np.degrees(np.sqrt(covariance[3, 3] + covariance[4, 4])))


def errors(poses: Poses) -> np.ndarray:
    """(B, 6) errors of ELEMENTS: omega, phi, kappa [degrees], X, Y, Z [m]."""
    m = poses.m
    omega, kappa = np.arctan2(-m[:, 2, 1], m[:, 2, 2]), np.arctan2(-m[:, 1, 0], m[:, 0, 0])
    opk = np.stack([omega, np.arcsin(np.clip(m[:, 2, 0], -1, 1)), kappa], axis=1)
    turns = (opk - TABLE_I.angles + np.pi) % (2 * np.pi) - np.pi
    return np.hstack([np.degrees(turns), poses.centre - TABLE_I.centre])


def summary(poses: Poses) -> dict[str, float]:
    """Of the runs that came to rest: RMSE of ELEMENTS and of the tilt [degrees] and the tilt's 68.3 % quantile; the share
    of runs that did."""
    e = errors(poses)[poses.ok]
    if not len(e):
        return {**dict.fromkeys((*ELEMENTS, "tilt_deg", "tilt_p68_deg"), float("nan")), "converged": 0.0}
    tilt = np.hypot(e[:, 0], e[:, 1])
    values = dict(zip(ELEMENTS, map(float, np.sqrt((e**2).mean(axis=0))), strict=True))
    return {**values, "tilt_deg": float(np.sqrt((tilt**2).mean())), "tilt_p68_deg": float(np.quantile(tilt, 0.6827)),
            "converged": float(poses.ok.mean())}
