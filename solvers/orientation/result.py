"""What an orientation is when it is done: the exterior orientation with all that says how far to trust it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..adjustment import Trace
from ..adjustment.reliability import ChiSquare, correlation
from ..cameras import PARAMETERS, Interior
from ..geometry import Exterior

ANGLES = ("omega_deg", "phi_deg", "kappa_deg")


@dataclass(frozen=True)
class Orientation:
    """Exterior orientation of one image by one model.

    exterior: in project coordinates (m). local: the same in the block's local frame, where the trace lives.
    covariance (6, 6): X, Y, Z, omega, phi, kappa (m, rad), a priori. sigma0: None without redundancy.
    points: names; residuals (n, 2) px observed minus projected; redundancy, w (n, 2); used (n,) takes part in the solution.
    detectable (n, 2): minimal detectable blunder [px]; effect (n, 2): largest change of an adjusted parameter, in its
    standard error, that such a blunder would cause unseen (external reliability). condition: of the scaled normal matrix.
    initial: approximate value in the local frame. discrimination: D of a reversal ambiguity, None where there is none.
    """

    image: str
    model: str
    exterior: Exterior
    local: Exterior
    initial: Exterior
    covariance: np.ndarray
    sigma0: float | None
    dof: int
    points: tuple[str, ...]
    residuals: np.ndarray
    redundancy: np.ndarray
    w: np.ndarray
    detectable: np.ndarray
    effect: np.ndarray
    condition: float
    chi_square: ChiSquare | None
    used: np.ndarray
    trace: Trace
    warnings: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()
    alternatives: tuple[Orientation, ...] = ()
    discrimination: float | None = None
    interior: Interior | None = None
    interior_sigma: tuple[tuple[str, float], ...] = ()

    @property
    def sigma(self) -> np.ndarray:
        """(6,) a-priori standard errors of X, Y, Z [m], omega, phi, kappa [rad]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms_px(self) -> float:
        """sqrt(sum(v_col^2 + v_row^2) / n) over the points used: the length of the two-dimensional residual."""
        v = self.residuals[self.used]
        return float(np.sqrt((v**2).sum() / len(v)))

    def to_json(self, residuals: bool = True) -> dict[str, Any]:
        """The orientation object of the JSON contract; angles in degrees, covariance in metres and radians. Without `residuals`
        these are empty (large blocks keep them beside the JSON)."""
        angles = np.degrees(self.exterior.angles)
        sigma = np.concatenate([self.sigma[:3], np.degrees(self.sigma[3:])])
        keys = ("X", "Y", "Z", *ANGLES)
        values = dict(zip(keys, [*map(float, self.exterior.centre), *map(float, angles)], strict=True))
        scaled = None if self.sigma0 is None else dict(zip(keys, map(float, sigma * self.sigma0), strict=True))
        interior: dict[str, Any] = {}
        if self.interior is not None:
            interior = {_key(n): float(getattr(self.interior, n)) for n in PARAMETERS}
            interior["sigma"] = {_key(n): s for n, s in self.interior_sigma}
        return {
            "image": self.image, "model": self.model, **values,
            "sigma": dict(zip(keys, map(float, sigma), strict=True)), "sigma_scaled": scaled,
            "covariance": self.covariance.tolist(),
            "sigma0": self.sigma0, "dof": self.dof, "rms_px": self.rms_px, "rms_px_coordinate": self.rms_px / np.sqrt(2),
            "iterations": self.trace.iterations, "converged": self.trace.converged, "stop": self.trace.last.stop,
            "residuals": [self._residual(i) for i in range(len(self.points))] if residuals else [],
            "observations": int(self.used.sum()),
            "chi_square": None if self.chi_square is None else asdict(self.chi_square), "condition": self.condition,
            "correlation": correlation(self.covariance).tolist(),
            "rejected": list(self.rejected), **({"interior": interior} if interior else {}),
            "warnings": list(self.warnings), "alternatives": [a.to_json() for a in self.alternatives],
            "discrimination": self.discrimination,
        }

    def _residual(self, i: int) -> dict[str, Any]:
        def finite(pair: np.ndarray) -> list[float | None]:
            return [float(x) if np.isfinite(x) else None for x in pair]

        return {"point": self.points[i], "col": float(self.residuals[i, 0]), "row": float(self.residuals[i, 1]),
                "redundancy": [float(x) for x in self.redundancy[i]], "w": finite(self.w[i]), "used": bool(self.used[i]),
                "detectable_px": finite(self.detectable[i]), "effect_sigma": finite(self.effect[i])}


def _key(name: str) -> str:
    return f"{name}_mm" if name in ("c", "xp", "yp") else name
