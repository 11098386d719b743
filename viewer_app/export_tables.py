"""Everything the project and its solutions say in numbers, as CSV: complete, in full precision, units in the headings; pure.

Unlike the tables on the screen they hold every row, whatever is looked for or sorted there. Coordinates are the project's.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from solvers.adjustment import SCALARS
from solvers.cameras import PARAMETERS
from solvers.geometry import Exterior
from solvers.orientation import Orientation

from .bundle_rows import last_misfit, point_rms
from .bundle_state import Bundle
from .lists import status
from .state import MODELS, State, measured

Table = tuple[Sequence[str], Iterable[Sequence[Any]]]
"""Headings and rows."""
NAMES = ("points", "images", "observations", "cameras", "orientations", "residuals", "iterations", "bundle_images",
         "bundle_points", "bundle_observations", "bundle_cameras")  # fmt: skip
"""The tables there may be."""
ELEMENTS = ("X [m]", "Y [m]", "Z [m]", "ω [°]", "φ [°]", "κ [°]")
ERRORS = ("sX [m]", "sY [m]", "sZ [m]", "sω [°]", "sφ [°]", "sκ [°]")
PLACE = ("X [m]", "Y [m]", "Z [m]", "sX [m]", "sY [m]", "sZ [m]")
OF_PIXELS = ("v col [px]", "v row [px]", "redundancy col", "redundancy row", "w col", "w row")
UNITS = {"c": "mm", "xp": "mm", "yp": "mm", "k1": "mm^-2", "k2": "mm^-4", "k3": "mm^-6", "p1": "mm^-1", "p2": "mm^-1"}


def tables(state: State) -> dict[str, str]:
    """CSV texts by file name: points, images, observations, cameras, and of what has been solved orientations, residuals and
    iterations; of a bundle that has ended its images, points, observations and cameras."""
    made: dict[str, Table] = {
        "points": _points(state), "images": _images(state), "observations": _observations(state), "cameras": _cameras(state),
        "orientations": _orientations(state), "residuals": _residuals(state), "iterations": _iterations(state),
        **_bundle(state),
    }  # fmt: skip
    return {f"{name}.csv": as_csv(*table) for name, table in made.items()}


def as_csv(headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Numbers as they read back to the last bit; what is not known is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows([_cell(v) for v in row] for row in rows)
    return out.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return "" if value != value else repr(float(value))
    return "" if value is None else value


def _points(state: State) -> Table:
    points, off = state.block.points, state.work.off
    groups = points.group or ("",) * len(points)
    rows = ((n, r, g, n not in off, *x, *s) for n, r, g, x, s in
            zip(points.names, points.role, groups, points.xyz, points.sigma, strict=True))  # fmt: skip
    return ("point", "role", "group", "on", *PLACE), rows


def _images(state: State) -> Table:
    counts, waits = measured(state.block), state.held != state.work.revision

    def rows() -> Iterator[Sequence[Any]]:
        for image in state.block.images:
            rms = [None if o is None else o.rms_px for o in (_solved(state, m, image.name) for m in MODELS)]
            n, prior = counts[image.name], image.prior
            centre = [None] * 3 if prior is None or prior.centre is None else prior.centre.tolist()
            angles = [None] * 3 if prior is None or prior.angles is None else np.degrees(prior.angles).tolist()
            yield image.name, image.camera, image.file, status(state, image.name, n, waits), n, *rms, *centre, *angles

    given = [f"given {e}" for e in ELEMENTS]
    return ("image", "camera", "file", "status", "points", *(f"rms {m} [px]" for m in MODELS), *given), rows()


def _observations(state: State) -> Table:
    of, block = state.block.observations, state.block
    rows = ((block.images[i].name, block.points.names[j], *at, s) for i, j, at, s in
            zip(of.image, of.point, of.pixel, of.sigma, strict=True))  # fmt: skip
    return ("image", "point", "col [px]", "row [px]", "sigma [px]"), rows


def _interior_headings() -> tuple[str, ...]:
    return ("camera", *(f"{p} [{UNITS[p]}]" if p in UNITS else p for p in PARAMETERS))


def _cameras(state: State) -> Table:
    rows = ((n, *(float(getattr(c, p)) for p in PARAMETERS), c.width, c.height, *c.pitch) for n, c in state.block.cameras.items())
    return (*_interior_headings(), "width [px]", "height [px]", "pixel width [mm]", "pixel height [mm]"), rows


def _solved(state: State, model: str, image: str) -> Orientation | None:
    solution = state.solution(model, image)
    return None if solution is None else solution.orientation


def _every(state: State) -> Iterator[Orientation]:
    """What has been solved, in the order of the images."""
    for image in state.block.images:
        for model in MODELS:
            if (found := _solved(state, model, image.name)) is not None:
                yield found


def _orientations(state: State) -> Table:
    rows = ((o.image, o.model, *o.exterior.centre, *np.degrees(o.exterior.angles), *o.sigma[:3], *np.degrees(o.sigma[3:]),
             o.sigma0, o.dof, o.rms_px, len(o.trace) - 1, o.trace.converged, o.trace.last.stop)
            for o in _every(state))  # fmt: skip
    return ("image", "model", *ELEMENTS, *ERRORS, "sigma0", "redundancy", "rms [px]", "iterations", "converged", "stop"), rows


def _residuals(state: State) -> Table:
    rows = ((o.image, o.model, p, u, *v, *r, *w) for o in _every(state)
            for p, u, v, r, w in zip(o.points, o.used, o.residuals, o.redundancy, o.w, strict=True))  # fmt: skip
    return ("image", "model", "point", "used", *OF_PIXELS), rows


def _iterations(state: State) -> Table:
    """Every row of every trace, in the scene's frame, in which the solver works: metres from its origin."""
    rows = ((o.image, o.model, r.index, *(getattr(r, n) for n in SCALARS), r.stop, *at.centre, *np.degrees(at.angles))
            for o in _every(state) for r in o.trace.rows for at in (Exterior.from_vector(r.x),))  # fmt: skip
    return ("image", "model", "iteration", *SCALARS, "stop", *(f"local {e}" for e in ELEMENTS)), rows


def _bundle(state: State) -> Mapping[str, Table]:
    """Of the last row, for which alone standard errors hold."""
    room = state.room(Bundle)
    result, layout = room.result, room.layout
    if result is None or layout is None or not room.rows:
        return {}
    names, of = layout.images, result
    sigma = np.sqrt(np.array([np.diag(q) for q in of.exterior]).reshape(-1, 6))
    images = ((names[k], *of.values[k], *sigma[k, :3], *np.degrees(sigma[k, 3:]), of.image_sigma0[k], of.rms[k], int(of.seen[k]))
              for k in range(len(names)))  # fmt: skip
    xyz = state.assets.frame.to_map(layout.places(room.rows[-1].x)) if len(layout.points) else np.zeros((0, 3))
    s = np.sqrt(np.array([np.diag(q) for q in of.covariance]).reshape(-1, 3))
    rms, given = point_rms(layout, last_misfit(of)), np.isin(np.array(of.roles), ("control", "check"))
    points = ((n, of.roles[k], *xyz[k], *s[k], *(of.off[k] if given[k] else [None] * 3), int(of.rays[k]), rms[k])
              for k, n in enumerate(layout.points))  # fmt: skip
    rays = ((names[i], layout.points[j], u, *at, *v, *r, *w) for i, j, u, at, v, r, w in
            zip(of.image, of.point, of.used, of.pixel, of.v, of.redundancy, of.w, strict=True))  # fmt: skip
    freed = dict(zip(of.freed, np.sqrt(np.diag(of.interior_covariance)), strict=True)) if of.freed else {}

    def sigmas(camera: str) -> list[float | None]:
        return [next((float(v) for (c, q), v in freed.items() if q == p and (camera == c or camera.startswith(f"{c}@"))), None)
                for p in PARAMETERS]

    cameras = ((n, *(float(getattr(c, p)) for p in PARAMETERS), *sigmas(n))
               for n, c in zip(layout.cameras, of.interiors, strict=True))  # fmt: skip
    return {
        "bundle_images": (("image", *ELEMENTS, *ERRORS, "sigma0", "rms [px]", "points"), images),
        "bundle_points": (("point", "role", *PLACE[:3], "local sX [m]", "local sY [m]", "local sZ [m]", "local dX [m]",
                           "local dY [m]", "local dZ [m]", "rays", "rms [px]"), points),
        "bundle_observations": (("image", "point", "used", "col [px]", "row [px]", *OF_PIXELS), rays),
        "bundle_cameras": ((*_interior_headings(), *(f"s{h}" for h in _interior_headings()[1:])), cameras),
    }  # fmt: skip

