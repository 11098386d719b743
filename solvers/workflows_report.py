"""The walk from a run to a report: read what the run left, see what it covers, write one HTML or PDF."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .adjustment import Trace
from .block import Block
from .errors import BadProject, DegenerateGeometry, PhotogrammetryError, Unsupported
from .geometry import Exterior
from .io import latest_run, load_residuals, load_trace, read_project
from .io.files import write_atomic
from .io.runs import PREVIEW
from .orientation import Known, Plane, footprint, monoplot
from .orientation.monoplot import Ground as Surface
from .report_material import Ground, Material, Wanted
from .workflows_orientation import ground_of

COMMANDS = ("adjust", "calibrate", "resect", "georeference")
"""Runs that a report can be made of, the best first where several are equally new."""
MOST_HEIGHTS = 50
"""Photos whose height above the take-off point is read."""
MOST_RAYS = 400
"""Rays drawn and tabulated on the ground; more would not be read."""


class Reported(NamedTuple):
    """Where the report is, what it tells of, and how much is in it."""

    path: Path
    run: Path
    sections: tuple[str, ...]
    warnings: int

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command report."""
        return {"report": str(self.path), "run": str(self.run), "sections": list(self.sections), "warnings": self.warnings}


def report_project(project_or_run: Path | str, output: Path | str, wanted: Wanted | None = None) -> Reported:
    """Write the report of a run, or of the latest run of a project, as .html or .pdf. Raises BadProject, Unsupported."""
    from .report_contents import contents

    output = Path(output)
    if output.suffix.lower() not in (".html", ".htm", ".pdf"):
        raise Unsupported(f"{output}: a report is written as .html or .pdf; give one of these endings")
    folder, run = find_run(Path(project_or_run))
    document = contents(material(folder, run), wanted or Wanted())
    write_atomic(output, lambda stream: stream.write(_drawn(document, output.suffix.lower())))
    first = next((s for s in document.sections if s.title == "Warnings"), None)
    warnings = sum(getattr(p, "kind", "") == "warning" for p in first.parts) if first else 0
    return Reported(output, run, tuple(s.title for s in document.sections), warnings)


def _drawn(document: Any, suffix: str) -> bytes:
    if suffix == ".pdf":
        from .report_pdf import pdf

        return pdf(document)
    from .report_html import html

    return html(document).encode()


def find_run(at: Path) -> tuple[Path, Path]:
    """The project folder and the run that a path means. Raises BadProject."""
    if at.parent.name == "runs" and at.is_dir():
        if not (at / "result.json").is_file():
            raise BadProject(f"{at}: this run has no result.json; compute it again")
        return at.parent.parent, at
    read_project(at)
    runs = [r for r in (latest_run(at, "result.json", c) for c in COMMANDS) if r is not None]
    alone = latest_run(at, "result.json", "mosaic") if not runs else None
    if alone is not None:
        return at, alone
    if not runs:
        raise BadProject(f"{at}: there is no run to report on; make one with: collinea adjust {at} (or resect)")
    return at, max(runs, key=lambda r: r.stat().st_mtime)


def material(folder: Path, run: Path) -> Material:
    """All that the report of a run is made of."""
    from . import __version__

    command = run.name.split("-")[2]
    block, result = read_project(folder), read_result(run) if command != "mosaic" else {}  # a mosaic has a section of its own
    said = list(_older(folder, run))
    known = _known(block, result)
    ground, name = _ground(folder, block, known, said)
    mosaic = run if command == "mosaic" else latest_run(folder, "result.json", "mosaic")
    when = datetime.strptime(run.name[:15], "%Y%m%d-%H%M%S")
    return Material(block, command, run.name, f"{when:%Y-%m-%d %H:%M:%S}", __version__, result, _traces(run, result),
                    () if "points" in result else _on_ground(block, known), _outlines(block, known, ground, said), name,
                    None if mosaic is None else read_result(mosaic), "" if mosaic is None else mosaic.name,
                    None if mosaic is None or not (mosaic / PREVIEW).is_file() else mosaic / PREVIEW, tuple(said))


def read_result(run: Path) -> dict[str, Any]:
    """result.json of a run. Raises BadProject where it is damaged."""
    path = run / "result.json"
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadProject(f"{path}: it cannot be read ({error}); delete this run and compute it again") from None
    if not isinstance(value, dict):
        raise BadProject(f"{path}: expected an object; delete this run and compute it again")
    if "observations_file" in value:
        seen = load_residuals(run)
        value["orientations"] = [{**o, "residuals": seen.get(o["image"], [])} for o in value["orientations"]]
    return value


def _older(folder: Path, run: Path) -> Sequence[str]:
    made = (run / "result.json").stat().st_mtime
    newer = [f for f in ("project.toml", "points.csv", "observations.csv")
             if (folder / f).exists() and (folder / f).stat().st_mtime > made]
    if not newer:
        return []
    return [f"{', '.join(newer)} changed after this run: the report shows the run beside today's project; compute it again"]


def _known(block: Block, result: Mapping[str, Any]) -> dict[str, Known]:
    """Perspective orientations of images that the project still has."""
    there = {i.name for i in block.images}
    out = {}
    for o in result.get("orientations", []):
        if o["model"] in ("perspective", "georeferenced", "onboard") and o["image"] in there:
            omega, phi, kappa = np.radians([o["omega_deg"], o["phi_deg"], o["kappa_deg"]])
            exterior = Exterior.from_angles(omega, phi, kappa, np.array([o["X"], o["Y"], o["Z"]]))
            out[o["image"]] = Known(o["image"], exterior, np.array(o["covariance"]) if o.get("covariance") else None)
    return out


def _ground(folder: Path, block: Block, known: Mapping[str, Known], said: list[str]) -> tuple[Surface | None, str]:
    try:
        ground = ground_of(folder, block, None, None)
    except PhotogrammetryError as error:
        said.append(f"the surface could not be read, level ground is used: {error}")
        ground = None
    if ground is not None:
        return ground, ground.name
    z = block.points.xyz[:, 2][np.isfinite(block.points.xyz[:, 2])]
    return (Plane(float(z.mean())), "") if len(z) else _take_off(folder, block, known)


def _take_off(folder: Path, block: Block, known: Mapping[str, Known]) -> tuple[Surface | None, str]:
    """The level of the take-off point by the heights above it that photos state."""
    from .io import read_onboard

    levels = []
    for image in block.images:
        path = None if image.file is None or image.name not in known else folder / image.file
        if path is not None and path.is_file() and len(levels) < MOST_HEIGHTS:
            above = read_onboard(path).relative
            if above is not None:
                levels.append(known[image.name].exterior.centre[2] - above)
    if not levels:
        return None, ""
    z = float(np.mean(levels))
    return Plane(z), f"level ground at z = {z:.1f} m, the take-off point by the photos' heights above it"


def _outlines(block: Block, known: Mapping[str, Known], ground: Surface | None, said: list[str]) -> dict[str, np.ndarray]:
    out, missing = {}, []
    for name, oriented in known.items():
        try:
            if ground is not None:
                out[name] = footprint(block, oriented, ground).outline
        except DegenerateGeometry:
            missing.append(name)
    if missing:
        said.append(f"no footprint for {', '.join(missing[:5])}{' ...' if len(missing) > 5 else ''}: a part of these photos "
                    f"shows no ground")
    return out


def _on_ground(block: Block, known: Mapping[str, Known]) -> list[Ground]:
    """Where each photo puts its control and check points at their given heights."""
    out: list[Ground] = []
    of = block.observations
    for row in range(len(of)):
        image, j = block.images[of.image[row]].name, of.point[row]
        xyz = block.points.xyz[j]
        if image not in known or block.points.role[j] == "tie" or not np.isfinite(xyz).all() or len(out) >= MOST_RAYS:
            continue
        try:
            hit = monoplot(block, known[image], (float(of.pixel[row, 0]), float(of.pixel[row, 1])), Plane(float(xyz[2])))
        except DegenerateGeometry:
            continue
        out.append(Ground(image, block.points.names[j], block.points.role[j], xyz[:2], hit.ground[:2] - xyz[:2],
                          hit.covariance[:2, :2]))
    return out


def _traces(run: Path, result: Mapping[str, Any]) -> dict[str, Trace]:
    """Every trace of the run, by image and model; the whole block's by its own name."""
    names = sorted(p.stem for p in run.glob("trace*.json") if p.with_suffix(".npz").exists())
    single = [n for n in names if n.startswith("trace-")]
    return {n.removeprefix("trace-") if n != "trace" else "block": load_trace(run, n) for n in single or names}
