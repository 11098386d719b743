"""The commands around a project: demo, init, view, simulate, study, log."""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path
from typing import Any

from .cli_parts import (
    PROG,
    Parser,
    add_command,
    coordinate_options,
    count,
    emit,
    mapping_options,
    number_or_text,
    positive,
    show_mappings,
    teller,
)

SIMULATIONS = ("uav_cluster", "ono_stereo", "ono_triplet", "field_long_range", "uav_block", "calibration_plate", "cliff_epochs",
               "large_block")


def add(commands: Any) -> None:
    """Their options."""
    demo = add_command(commands, "demo", _demo, "open the viewer on the demo project")
    _viewer_options(demo)

    init = add_command(commands, "init", _init, "make a project from photos and a list of control points")
    init.add_argument("files", nargs="+", metavar="FILE",
                      help="photos (or folders of photos), and a list of control points, a calibration, orientations or "
                           "positions in any "
                           "format that convert reads")
    init.add_argument("-o", "--output", metavar="PROJECT", help="folder of the new project")
    mapping_options(init)
    init.add_argument("--crs", help="coordinate system of the project: EPSG code or compound code, WKT, a .prj file, or local")
    init.add_argument("--control-format", metavar="FORMAT",
                      help="format of the list where it is not found out, such as gcp-pix4dmatic (collinea convert --list)")
    init.add_argument("--control-crs", metavar="CRS", help="coordinate system of the list, over what it says itself")
    coordinate_options(init)
    init.add_argument("--undulation", type=number_or_text, metavar="M",
                      help="height of the geoid above the ellipsoid: metres, the file of a geoid grid, or auto")
    init.add_argument("--pixel-origin", choices=("center", "corner"),
                      help="what pixel (0, 0) of the list is, of the top-left pixel")
    init.add_argument("--pixel-um", type=positive, metavar="P", help="pixel size in micrometres, where EXIF does not tell it")
    init.add_argument("--c-mm", type=positive, metavar="C", help="principal distance in mm, where EXIF does not tell it")

    view = add_command(commands, "view", _view, "open a project in the viewer")
    view.add_argument("project", metavar="PROJECT")
    _viewer_options(view)

    simulate = add_command(commands, "simulate", _simulate, "make a project with known truth")
    simulate.add_argument("kind", metavar="KIND", choices=SIMULATIONS, help=" | ".join(SIMULATIONS))
    simulate.add_argument("-o", "--output", required=True, metavar="FOLDER")
    simulate.add_argument("--seed", type=int, default=0, help="of the random numbers (default: 0)")
    simulate.add_argument("--reduction", type=int, choices=range(1, 17), default=4, metavar="N",
                          help="photos N times smaller (default: 4)")
    simulate.add_argument("--images", type=count, metavar="N", help="of a large_block, which has no photos (default: 500)")

    from .studies import KINDS

    study = add_command(commands, "study", _study, "compare models honestly: tables, figures and a page of plain words")
    study.add_argument("kind", metavar="KIND", choices=tuple(KINDS), help="; ".join(f"{k}: {v}" for k, v in KINDS.items()))
    study.add_argument("-o", "--output", required=True, metavar="FOLDER")
    study.add_argument("--runs", type=count, metavar="N", help="draws of every case (default: a few minutes' worth)")
    study.add_argument("--figures", action="store_true", help="only draw the figures anew, from the tables in FOLDER")

    log = add_command(commands, "log", _log, "open the recording of a run in rerun's web viewer on 127.0.0.1")
    log.add_argument("project", metavar="PROJECT|RUN")
    log.add_argument("--no-browser", action="store_true", help="only print the address")

    export = add_command(commands, "export", _export, "what is to be shared: replay, recording, picture, tables, scene, mosaic, "
                                                      "or the project itself, as files")
    export.add_argument("project", metavar="PROJECT")
    for kind, target, words in EXPORTS:
        export.add_argument(f"--{kind}", metavar=target, help=words)


EXPORTS = (
    ("html", "FILE", "one page that plays the adjustment, without a server or network"),
    ("rrd", "FILE", "recording for rerun's viewer"),
    ("png", "FILE", "picture of the scene with its legend, 3840 x 2160 pixels; needs Chromium or Chrome"),
    ("csv", "FOLDER", "points, images, observations, orientations, residuals and iterations as tables"),
    ("glb", "FILE", "the scene as binary glTF, metres from the scene's origin"),
    ("ply", "FILE", "terrain, planes and frustums as one coloured mesh, metres from the scene's origin"),
    ("tif", "FILE", "the mosaic as GeoTIFF, as the viewer made it last, else with the viewer's defaults"),
    ("zip", "FILE", "the project with all its photos, without what is derived"),
)
"""Kind, target and help of the ways out; the tab Export of the viewer has the same."""


def _demo(args: argparse.Namespace) -> int:
    from viewer_app import spare

    from .io import demo_copy

    spare.prepare()
    return _open_viewer(args, demo_copy())


def _view(args: argparse.Namespace) -> int:
    from viewer_app import spare

    from .io import read_project

    spare.prepare()
    folder = Path(args.project)
    read_project(folder)
    return _open_viewer(args, folder)


def _open_viewer(args: argparse.Namespace, folder: Path) -> int:
    from viewer_app.app import run

    emit(args, {"project": str(folder), "host": args.host, "port": args.port}, "")
    out = sys.stderr if args.json == "-" else sys.stdout  # JSON stands alone on standard output
    with contextlib.redirect_stdout(out), contextlib.suppress(KeyboardInterrupt):  # Ctrl+C is how a person ends it
        run(folder, host=args.host, port=args.port, open_browser=not args.no_browser, token=args.token)
    return 0


def _init(args: argparse.Namespace) -> int:
    from .workflows import init_project

    if args.show_mapping:
        return _show_mapping(args)
    if args.output is None:
        print(f"{PROG}: init wants a folder for the new project; give -o PROJECT; see {PROG} init --help", file=sys.stderr)
        return 2
    ask = ask_at_terminal()
    made = init_project(args.files, args.output, mapping=args.map,
                        control_format=args.control_format, project_crs=args.crs, control_crs=args.control_crs,
                        swap_xy=args.swap_xy, unit=args.unit, height_unit=args.height_unit, pixel_origin=args.pixel_origin,
                        pixel_um=args.pixel_um, c_mm=args.c_mm, undulation=args.undulation, angles=args.angles,
                        angle_unit=args.angle_unit, ask=ask, tell=None if ask else teller(args))
    block = made.block
    notes = [n for n in made.notes if not n.startswith("columns: ")]  # they were shown
    text = "\n".join([*notes, f"{made.folder}: {len(block.images)} images, {len(block.points)} points, "
                                   f"{len(block.observations)} observations in {block.crs}",
                      f"next: {PROG} view {made.folder}"])
    return emit(args, made.to_json(), text)


def _show_mapping(args: argparse.Namespace) -> int:
    from .errors import BadProject
    from .io.exchange.options import Reading
    from .io.photos import EXTENSIONS

    lists = [f for f in args.files if not Path(f).is_dir() and Path(f).suffix.lower() not in EXTENSIONS]
    if not lists:
        raise BadProject("--show-mapping: there is no list among the files; name one")
    reading = Reading(args.control_crs or args.crs, args.angles, args.angle_unit, None, args.map, args.pixel_origin)
    return show_mappings(args, lists, args.control_format, reading)


def _simulate(args: argparse.Namespace) -> int:
    from .errors import BadProject
    from .simulation import SERIES
    from .workflows import simulate_epochs, simulate_project

    if args.images is not None and args.kind != "large_block":
        raise BadProject(f"--images belongs to large_block; '{args.kind}' has its own number of images")
    if args.kind in SERIES:
        folders = simulate_epochs(args.kind, args.output, seed=args.seed)
        value = {"projects": [str(f) for f in folders], "kind": args.kind, "seed": args.seed}
        return emit(args, value, f"{args.output}: {len(folders)} epochs\nnext: {PROG} compare {' '.join(map(str, folders))}")
    size = {} if args.images is None else {"images": args.images}
    block = simulate_project(args.kind, args.output, seed=args.seed, reduction=args.reduction, **size)
    value = {"project": args.output, "kind": args.kind, "seed": args.seed, "images": [i.name for i in block.images],
             "points": len(block.points), "observations": len(block.observations)}
    return emit(args, value,
                 f"{args.output}: {len(block.images)} images, {len(block.points)} points\nnext: {PROG} view {args.output}")


def _study(args: argparse.Namespace) -> int:
    from .studies import redraw, run

    shown = sys.stderr.isatty()

    def progress(line: str) -> None:
        if not args.quiet:
            print(f"\r\033[K{line}" if shown else line, end="" if shown else "\n", file=sys.stderr, flush=True)

    folder = Path(args.output)
    files = redraw(args.kind, folder) if args.figures else run(args.kind, folder, args.runs, progress)
    if shown:
        progress("")
    return emit(args, {"study": args.kind, "files": [str(f) for f in files]}, f"{files[-1]}: {len(files)} files written")


def _log(args: argparse.Namespace) -> int:
    from viewer_app.rerun_server import open_log

    from .workflows import recording_of

    recording = recording_of(args.project)
    emit(args, {"recording": str(recording)}, "")
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl+C is how a person ends it
        open_log(recording, open_browser=not args.no_browser)
    return 0


def _export(args: argparse.Namespace) -> int:
    from viewer_app.exporting import export

    from .errors import BadProject

    wishes = {kind: Path(getattr(args, kind)) for kind, _, _ in EXPORTS if getattr(args, kind)}
    if not wishes:
        said = [f"--{kind} {target}" for kind, target, _ in EXPORTS]
        raise BadProject(f"nothing to export; say what: {', '.join(said[:-1])} or {said[-1]}")
    files, failed = export(Path(args.project), wishes)
    if files or args.json:
        emit(args, {"project": str(args.project), "files": [str(f) for f in files], "failed": failed}, "\n".join(map(str, files)))
    if failed:
        raise BadProject("; ".join(failed))
    return 0


def _viewer_options(command: Parser) -> None:
    command.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1)")
    command.add_argument("--port", type=int, default=0, help="port to listen on (default: a free one)")
    command.add_argument("--no-browser", action="store_true", help="only print the address")
    command.add_argument("--token", help="a word that visitors must know (default: a new one)")


def ask_at_terminal() -> Any:
    """How to ask the person at the terminal, None where there is none."""
    return _ask if sys.stdin.isatty() and sys.stderr.isatty() else None


def _ask(question: str) -> str:
    """Ask the person at the terminal; the question goes to standard error, so that JSON on standard output stays clean."""
    print(question, end="", file=sys.stderr, flush=True)
    try:
        return input()
    except EOFError:
        return ""
