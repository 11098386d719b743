"""When a bundle fails or fits badly: what is wrong with the data is named, and left out where it made the bundle fail.

Tried in turn: heights in feet, marks exchanged in an image, control that contradicts the network of tie points (`rescue`),
control that heads the suspects, marks that a robust loss sets aside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...block import Block
from ...cameras import PARAMETERS, project
from ...errors import BadProject, DegenerateGeometry
from ...geometry import Exterior
from .given import BundleRequest
from .rescue import FEET, Screened, screen, unit_of
from .result import Adjusted

Attempt = Callable[[Block, BundleRequest], Adjusted]
"""attempt(block, request): the adjusted block. Raises DegenerateGeometry."""
MOST_LOST = 0.05
"""Share of the marks that may contradict the others and be left out."""
MOST_WRONG = 3
"""Control points that are left out one after the other, at most, to find those that are wrong."""
CLEAR = 20.0
"""Fall of the cost that chance does not make."""
WITHIN = 6.0
"""Standard errors of its pixels within which a mark that took no part fits (points of few rays are known no better)."""
RELIEF = 5.0
"""Standard errors of their heights that control points must differ by before feet are told from metres."""
BAD = 5.0
"""sigma0 from which the control is screened for points that contradict the network."""


def remedied(block: Block, request: BundleRequest, attempt: Attempt, watched: Attempt, result: Adjusted | None,
             trouble: DegenerateGeometry | None) -> Adjusted:
    """The better of what there is and of a new beginning from the network alone, with what is wrong said first.

    attempt: adjusts a block; watched: the same, its rows shown. Raises the first error where that is all there is.
    """
    if feet := heights_in_feet(block, request, attempt, result):
        if result is None:
            raise DegenerateGeometry(f"{trouble}; {feet}")
        return replace(result, warnings=(feet, *result.warnings))
    if result is not None and (said := _exchanged_marks(block, request, attempt, result, _suspected(result))):
        return replace(result, warnings=(said, *result.warnings))
    wrong = screen(block, request) if request.datum in ("control", "both") else Screened((), ())
    if not wrong.names and result is not None and request.datum in ("control", "both"):
        wrong = _dropped(block, request, attempt, result)
    failed = result is None or not result.trace.converged
    again: Adjusted | None = None
    if request.start == "auto" and (failed or wrong.names):
        clean = block
        for name in wrong.names:
            clean = clean.with_role(name, "check")
        for start in ("auto", "relative"):
            try:
                tried = watched(clean, replace(request, start=start))  # type: ignore[arg-type]
            except DegenerateGeometry:
                continue
            if again is None or not again.trace.converged or tried.cost < again.cost:
                again = tried
            if again.trace.converged and (again.sigma0 or 0.0) < BAD:
                break
    if again is not None and again.trace.converged and (failed or (result is not None and again.cost < 0.5 * result.cost)):
        at = {p.name: p.xyz for p in again.points}
        said = [s + unit_of(block, n, at[n]) if n in at else s for n, s in zip(wrong.names, wrong.said, strict=False)]
        left = [f"left out of the control: {', '.join(wrong.names)}; correct points.csv"] if wrong.names else []
        return replace(again, warnings=(*said, *left, *again.warnings))
    if request.loss is None:  # control that looked wrong, but whose absence mends nothing, may be accused by a wrong mark
        clean, said = _marks(block, request, attempt, result)
        if clean is not None:
            return replace(clean, warnings=(said, *clean.warnings))
        if said and result is None:
            raise DegenerateGeometry(f"{trouble}; {said}")
        if said and result is not None:
            return replace(result, warnings=(said, *result.warnings))
    if result is None:
        assert trouble is not None
        raise DegenerateGeometry(f"{trouble}{'; ' if wrong.said else ''}{'; '.join(wrong.said)}")
    return replace(result, warnings=(*wrong.said, *result.warnings))


def _exchanged_marks(block: Block, request: BundleRequest, attempt: Attempt, result: Adjusted | None,
                     pairs: list[tuple[str, str, str]]) -> str:
    """A sentence where two points of one image fit once their names are exchanged there, else nothing. pairs: image, points."""
    of = block.observations
    for name, a, b in pairs:
        image, j, k = block.image_index(name), block.point_index(a), block.point_index(b)
        here = of.image == image
        point = np.where(here & (of.point == j), k, np.where(here & (of.point == k), j, of.point))
        try:
            tried = attempt(replace(block, observations=replace(of, point=point)), request)
        except (DegenerateGeometry, BadProject):
            continue
        better = result is None or (tried.cost < 0.1 * result.cost and tried.dof >= result.dof)
        if better and tried.trace.converged and (tried.sigma0 or 0.0) < BAD:
            before = f" instead of {result.sigma0:.3g}" if result is not None and result.sigma0 else ""
            return (f"points '{a}' and '{b}' look exchanged in image '{name}': with their names exchanged there, sigma0 is "
                    f"{tried.sigma0 or 0:.3g}{before}; correct observations.csv")
    return ""


def _suspected(result: Adjusted) -> list[tuple[str, str, str]]:
    """Image and points of the two worst pairs of suspects in the image of the worst one."""
    worst = list(result.suspects)
    if not result.trace.converged or not worst or worst[0]["kind"] != "image":
        return []
    return [(worst[0]["image"], worst[0]["point"], s["point"]) for s in worst[1:] if s.get("image") == worst[0]["image"]][:2]


def _marks(block: Block, request: BundleRequest, attempt: Attempt,
           result: Adjusted | None) -> tuple[Adjusted | None, str]:
    """What a robust loss finds where least squares failed: marks that are exchanged (in words), or marks that contradict the
    rest, with the bundle without them."""
    try:
        robust = attempt(block, replace(request, loss="cauchy"))
    except DegenerateGeometry:
        return None, ""
    lost = [(o.image, point) for o in robust.orientations for point in o.rejected]
    if not robust.trace.converged or not lost or len(lost) > MOST_LOST * len(block.observations):
        return None, ""
    pairs = [(o.image, *pair) for o in robust.orientations for pair in combinations(o.rejected[:4], 2)]
    if said := _exchanged_marks(block, request, attempt, result, pairs[:6]):
        return None, said
    of, names = block.observations, block.points.names
    gone = np.array([(block.images[i].name, names[j]) in set(lost) for i, j in zip(of.image, of.point, strict=True)])
    try:
        clean = attempt(_without(block, gone), request)
        off = _misfits(block, clean, np.flatnonzero(gone))
        if (off < WITHIN).any():  # a robust loss also sets aside what only suffered from the others
            gone[np.flatnonzero(gone)[off < WITHIN]] = False
            clean, off = attempt(_without(block, gone), request), off[~(off < WITHIN)]
    except DegenerateGeometry:
        return None, ""
    if not gone.any() or not clean.trace.converged or (clean.sigma0 or 0.0) > BAD:
        return None, ""
    rows = np.flatnonzero(gone)[np.argsort(np.where(np.isnan(off), -1.0, -off), kind="stable")]
    shown = ", ".join(f"'{names[of.point[k]]}' in '{block.images[of.image[k]].name}'" for k in rows[:6])
    return clean, (f"left out, because they contradict all others: the mark{'s' if len(rows) > 1 else ''} of "
                   f"{shown}{' ...' if len(rows) > 6 else ''}; correct observations.csv")


def _without(block: Block, gone: np.ndarray) -> Block:
    """The block without some observations (o,)."""
    of, keep = block.observations, ~gone
    return replace(block, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                               sigma=of.sigma[keep]))


def _misfits(block: Block, clean: Adjusted, rows: np.ndarray) -> np.ndarray:
    """(r,) residuals, in their standard errors, of observations that took no part; NaN where their image or point took none."""
    of, manifest, x = block.observations, clean.trace.manifest, clean.trace.last.x
    m, k = len(manifest["images"]), len(manifest["cameras"])
    images, points = ({name: i for i, name in enumerate(manifest[part])} for part in ("images", "points"))
    xyz = x[12 * m + len(PARAMETERS) * k:][:3 * len(points)].reshape(-1, 3)
    interiors = list(clean.interiors.values())
    sigma, out = np.where(np.isfinite(of.sigma), of.sigma, block.image_px), np.full(len(rows), np.nan)
    for n, row in enumerate(rows):
        i, j = images.get(block.images[of.image[row]].name), points.get(block.points.names[of.point[row]])
        if i is not None and j is not None:
            seen = project(interiors[manifest["camera_of"][i]], Exterior.from_vector(x[12 * i:12 * i + 12]), xyz[j][None])[0]
            out[n] = np.linalg.norm(of.pixel[row] - seen) / sigma[row] if np.isfinite(seen).all() else np.inf
    return out


def _dropped(block: Block, request: BundleRequest, attempt: Attempt, result: Adjusted) -> Screened:
    """Where the network alone cannot judge: the control point that heads the suspects, and the next, left out until it fits."""
    names: list[str] = []
    now, left = result, block
    for _ in range(MOST_WRONG):
        worst = next((s["point"] for s in now.suspects if s["kind"] == "control" and s["point"] not in names), None)
        if worst is None:
            break
        names.append(worst)
        left = left.with_role(worst, "check")
        try:
            now = attempt(left, request)
        except DegenerateGeometry:
            break
        if now.trace.converged and (now.sigma0 or 0.0) < BAD and now.cost < 0.1 * result.cost:
            off = {p.name: float(np.linalg.norm(p.off)) for p in now.points}
            wrong = [n for n in names if off.get(n, 0.0) > 0]
            return Screened(tuple(wrong), tuple(f"control point '{n}' does not fit the others by {off[n]:.3g} m" for n in wrong))
    return Screened((), ())


def heights_in_feet(block: Block, request: BundleRequest, attempt: Attempt, result: Adjusted | None) -> str:
    """A sentence where the bundle fits once the heights of all control points are taken as feet, else nothing."""
    control = np.array(block.points.role) == "control"
    if request.datum not in ("control", "both") or request.model != "perspective" or not control.any():
        return ""
    xyz = block.points.xyz.copy()
    least = np.where(np.isfinite(block.points.sigma[control, 2]), block.points.sigma[control, 2], block.control_m[2])
    if (1 - FEET) * np.ptp(xyz[control, 2]) < RELIEF * np.median(least):
        return ""  # whatever the heights are, they hardly differ
    xyz[control, 2] *= FEET
    try:
        tried = attempt(replace(block, points=replace(block.points, xyz=xyz)), request)
    except DegenerateGeometry:
        return ""
    better = tried.trace.converged and (tried.sigma0 or 0.0) < BAD and (result is None or tried.dof >= result.dof)
    if not better or (result is not None and result.trace.converged
                      and (tried.cost > 0.5 * result.cost or result.cost - tried.cost < CLEAR)):
        return ""
    before = f" instead of {result.sigma0:.3g}" if result is not None and result.sigma0 else ""
    return (f"the heights of all control points look given in feet: taken as feet, sigma0 is {tried.sigma0 or 0:.3g}{before}; "
            "correct Z in points.csv")
