"""The command `collinea`: arguments -> workflow -> exit code (0 done, 1 cannot, 2 usage)."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from .errors import PhotogrammetryError

PROG = "collinea"
SIMULATIONS = ("uav_cluster", "ono_stereo", "ono_triplet", "field_long_range", "uav_block", "calibration_plate")


class Parser(argparse.ArgumentParser):
    """argparse that says what is wrong in one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{PROG}: {message}; see {self.prog} --help\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; every error becomes one sentence on standard error."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or (words[0].startswith("-") and words[0] not in ("-h", "--help", "--version")):
        words = ["demo", *words]
    args = None
    try:
        args = parser().parse_args(words)
        code = args.run(args)
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # argparse: help, version, usage
        return stop.code if isinstance(stop.code, int) else 0
    except PhotogrammetryError as error:
        return _cannot(str(error))
    except KeyboardInterrupt:
        return _cannot("stopped by Ctrl+C")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing more can be written there, not even at exit
        return _cannot("the output was closed before it was complete")
    except OSError as error:
        return _cannot(f"{error.filename or 'input or output'}: {error.strerror or error}; check the path, its permissions and "
                       "the space left")
    except MemoryError:
        return _cannot("the memory is not enough; close other programs or give fewer or smaller photos")
    except Exception as error:
        return _unexpected(error, getattr(args, "project", None))


def parser() -> Parser:
    """All commands and their options."""
    top = Parser(PROG, description="See how an image finds its place: exterior orientation, step by step in the browser.",
                 epilog="Without a command the viewer opens on the demo project.")
    top.add_argument("--version", action="version", version=f"{PROG} {_version()}")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)

    demo = _command(commands, "demo", _demo, "open the viewer on the demo project")
    _viewer_options(demo)

    init = _command(commands, "init", _init, "make a project from photos and a list of control points")
    init.add_argument("files", nargs="+", metavar="FILE", help="photos (or folders of photos) and one GCPS.csv or gcp_list.txt")
    init.add_argument("-o", "--output", required=True, metavar="PROJECT", help="folder of the new project")
    init.add_argument("--map", metavar="MAP",
                      help="columns of the list by name or number: name=ID,X=East,Y=North,Z=H[,image=..,col=..,row=..]")
    init.add_argument("--crs", help="coordinate system of the project: EPSG:CODE or local")
    init.add_argument("--pixel-origin", choices=("center", "corner"),
                      help="what pixel (0, 0) of the list is, of the top-left pixel")
    init.add_argument("--pixel-um", type=_positive, metavar="P", help="pixel size in micrometres, where EXIF does not tell it")
    init.add_argument("--c-mm", type=_positive, metavar="C", help="principal distance in mm, where EXIF does not tell it")

    view = _command(commands, "view", _view, "open a project in the viewer")
    view.add_argument("project", metavar="PROJECT")
    _viewer_options(view)

    resect = _command(commands, "resect", _resect, "orient images by their control points, one by one")
    resect.add_argument("project", metavar="PROJECT")
    resect.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")
    resect.add_argument("--model", choices=("perspective", "orthogonal", "both"), default="both")
    resect.add_argument("--points", type=_names, metavar="A,B,C", help="only these control points (default: all of the image)")
    resect.add_argument("--robust", action="store_true", help="find and leave out blunders")
    resect.add_argument("--prior", choices=("none", "initial", "weighted"), default="none",
                        help="use of the images' priors (default: none)")
    resect.add_argument("--one-pass", action="store_true", help="orthogonal: one pass from the prior as approximate orientation")
    resect.add_argument("--form", choices=("depth", "printed"), default="depth",
                        help="orthogonal: form of the exterior orientation (default: depth)")
    resect.add_argument("--recentre", choices=("on", "off"), default="on", help="orthogonal: re-centred bundle (default: on)")
    resect.add_argument("--free", type=_names, default=(), metavar="c,xp,yp,k1,...",
                        help="perspective: interior parameters to adjust")

    geo = _command(commands, "georeference", _georeference, "exterior orientation from onboard GPS and IMU")
    _georeference_options(geo)

    cross = _command(commands, "intersect", _intersect, "object points from oriented images")
    cross.add_argument("project", metavar="PROJECT")
    cross.add_argument("--points", type=_names, default=(), metavar="A,B", help="only these points (default: all seen twice)")
    cross.add_argument("--robust", action="store_true", help="leave out rays that the others refute, and name them")
    _orientation_source(cross)

    mono = _command(commands, "monoplot", _monoplot, "ground coordinates of a pixel of one oriented image")
    mono.add_argument("project", metavar="PROJECT")
    mono.add_argument("--image", required=True, metavar="N")
    mono.add_argument("--at", type=_pixel, required=True, metavar="COL,ROW",
                      help="pixel of the full format; 0,0 is the centre of the top-left pixel")
    ground = mono.add_mutually_exclusive_group()
    ground.add_argument("--dem", metavar="DEM.tif", help="heights of the ground (default: [surface] of the project)")
    ground.add_argument("--z", type=_number, metavar="H", help="level ground at this height [m]")
    mono.add_argument("--sigma-z", type=_positive, metavar="S", help="standard error of the ground's height [m]")
    _orientation_source(mono)

    targets = _command(commands, "targets", _targets, "measure the signalised points of a photo")
    targets.add_argument("image", metavar="IMAGE")
    targets.add_argument("--kind", choices=("dot", "ring"), default="dot",
                         help="filled circles or concentric rings (default: dot)")
    targets.add_argument("-o", "--output", metavar="observations.csv", help="write them as a table of observations")

    match = _command(commands, "match", _match, "find a point of one photo in another")
    match.add_argument("images", nargs=2, metavar="IMAGE")
    match.add_argument("--at", type=_pixel, required=True, metavar="COL,ROW",
                       help="in the first photo; 0,0 is the centre of the top-left pixel")
    match.add_argument("--start", type=_pixel, metavar="COL,ROW",
                       help="near it in the second photo (default: by the photos' features)")
    match.add_argument("--window", type=_count, default=21, metavar="N", help="side of the window, odd [px] (default: 21)")
    match.add_argument("--search", type=_reach, metavar="N",
                       help="how far around the start [px] (default: 12, or 40 without features)")
    match.add_argument("--method", choices=("ncc", "lsm"), default="lsm",
                       help="correlation, or least squares matching after it (default: lsm)")

    ties = _command(commands, "tiepoints", _tiepoints, "find points that photos share")
    ties.add_argument("project", metavar="PROJECT|FOLDER", help="a project, whose tables they join, or a folder of photos")
    ties.add_argument("-o", "--output", metavar="FILE",
                      help="write a table of observations instead (default for a folder: FOLDER/tiepoints.csv)")
    ties.add_argument("--feature", default="sift", metavar="NAME", help="sift, orb, akaze or brisk (default: sift)")
    ties.add_argument("--per-photo", type=_count, default=1000, metavar="N", help="points wanted in each photo (default: 1000)")
    ties.add_argument("--workers", type=_reach, metavar="N", help="processes (default: one for each core)")
    ties.add_argument("--scheduler", metavar="ADDRESS", help="of dask.distributed, to work over several machines")

    simulate = _command(commands, "simulate", _simulate, "make a project with known truth")
    simulate.add_argument("kind", metavar="KIND", choices=SIMULATIONS, help=" | ".join(SIMULATIONS))
    simulate.add_argument("-o", "--output", required=True, metavar="FOLDER")
    simulate.add_argument("--seed", type=int, default=0, help="of the random numbers (default: 0)")
    simulate.add_argument("--reduction", type=int, choices=range(1, 17), default=4, metavar="N",
                          help="photos N times smaller (default: 4)")

    from .studies import KINDS

    study = _command(commands, "study", _study, "compare models honestly: tables, figures and a page of plain words")
    study.add_argument("kind", metavar="KIND", choices=tuple(KINDS), help="; ".join(f"{k}: {v}" for k, v in KINDS.items()))
    study.add_argument("-o", "--output", required=True, metavar="FOLDER")
    study.add_argument("--runs", type=_count, metavar="N", help="draws of every case (default: a few minutes' worth)")

    log = _command(commands, "log", _log, "open the recording of a run in rerun's web viewer on 127.0.0.1")
    log.add_argument("project", metavar="PROJECT|RUN")
    log.add_argument("--no-browser", action="store_true", help="only print the address")
    return top


# -- commands -------------------------------------------------------------------------------------------------------------


def _demo(args: argparse.Namespace) -> int:
    from .io import demo_copy

    return _open_viewer(args, demo_copy())


def _view(args: argparse.Namespace) -> int:
    from .io import read_project

    folder = Path(args.project)
    read_project(folder)
    return _open_viewer(args, folder)


def _open_viewer(args: argparse.Namespace, folder: Path) -> int:
    from viewer_app.app import run

    _emit(args, {"project": str(folder), "host": args.host, "port": args.port}, "")
    out = sys.stderr if args.json == "-" else sys.stdout  # JSON stands alone on standard output
    with contextlib.redirect_stdout(out), contextlib.suppress(KeyboardInterrupt):  # Ctrl+C is how a person ends it
        run(folder, host=args.host, port=args.port, open_browser=not args.no_browser, token=args.token)
    return 0


def _init(args: argparse.Namespace) -> int:
    from .workflows import init_project

    ask = _ask if sys.stdin.isatty() and sys.stderr.isatty() else None
    made = init_project(args.files, args.output, mapping=args.map, project_crs=args.crs, pixel_origin=args.pixel_origin,
                        pixel_um=args.pixel_um, c_mm=args.c_mm, ask=ask)
    block = made.block
    text = "\n".join([*made.notes, f"{made.folder}: {len(block.images)} images, {len(block.points)} points, "
                                   f"{len(block.observations)} observations in {block.crs}",
                      f"next: {PROG} view {made.folder}"])
    return _emit(args, made.to_json(), text)


def _resect(args: argparse.Namespace) -> int:
    from viewer_app.paint_rerun import record

    from .report import resection_text
    from .workflows import MODELS, resect_project

    models = MODELS if args.model == "both" else (args.model,)
    done = resect_project(args.project, args.image, models, record, points=args.points, robust=args.robust, prior=args.prior,
                          one_pass=args.one_pass, form=args.form, recentre=args.recentre == "on", free=args.free)
    _emit(args, done.to_json(), resection_text(done))
    if not done.failed:
        return 0
    first, total = done.failed[0], len(done.failed) + len(done.orientations)
    return _cannot(f"{len(done.failed)} of {total} orientations cannot be computed, the first by the {first.model} model: "
                   f"{first.why}")


def _georeference(args: argparse.Namespace) -> int:
    from .orientation import Rig
    from .report_orientation import georeference_text
    from .workflows_georeference import Flown, georeference_flight

    def three(values: list[float] | None) -> tuple[float, float, float] | None:
        return None if values is None else (values[0], values[1], values[2])

    rig = Rig(three(args.lever_arm) or (0.0, 0.0, 0.0), three(args.boresight) or (0.0, 0.0, 0.0), three(args.sigma_m),
              three(args.sigma_deg))
    done = georeference_flight(args.project, Flown(
        images=tuple(args.image), crs=args.crs, positions=args.positions, mrk=args.mrk, log=args.log, log_offset=args.log_offset,
        heights=args.heights.replace("-", " "), photo_heights=args.photo_heights, undulation=args.undulation,
        height_bias=args.height_bias, take_off=args.take_off, flying_height=args.flying_height, rig=rig, ground_z=args.ground_z,
        dem=args.dem, check_headings=args.check_headings, correct_headings=args.correct_headings, footprints=args.footprints,
        write_priors=args.write_priors, pixel_um=args.pixel_um, c_mm=args.c_mm))
    _emit(args, done.to_json(), georeference_text(done))
    if not done.failed:
        return 0
    return _cannot(f"image '{done.failed[0][0]}': {done.failed[0][1]}{_and_more(len(done.failed) - 1)}")


def _intersect(args: argparse.Namespace) -> int:
    from .report_orientation import intersection_text
    from .workflows_orientation import intersect_project

    done = intersect_project(args.project, args.points, robust=args.robust, source=args.source)
    _emit(args, done.to_json(), intersection_text(done))
    failed = done.result.failed
    return 0 if not failed else _cannot(failed[0][1] + _and_more(len(failed) - 1))


def _monoplot(args: argparse.Namespace) -> int:
    from .report_orientation import monoplot_text
    from .workflows_orientation import monoplot_project

    done = monoplot_project(args.project, args.image, args.at, dem=args.dem, z=args.z, sigma_z=args.sigma_z, source=args.source)
    return _emit(args, done.to_json(), monoplot_text(done))


def _targets(args: argparse.Namespace) -> int:
    from .report_matching import targets_text
    from .workflows_matching import targets_of_photo

    done = targets_of_photo(args.image, args.kind, args.output)
    return _emit(args, done, targets_text(done, args.output))


def _match(args: argparse.Namespace) -> int:
    from .report_matching import match_text
    from .workflows_matching import match_photos

    first, second = args.images
    done = match_photos(first, second, args.at, start=args.start, window=args.window, search=args.search, method=args.method)
    return _emit(args, done, match_text(done))


def _tiepoints(args: argparse.Namespace) -> int:
    from .execution import Progress, cores
    from .matching import TieOptions
    from .report_matching import ties_text
    from .workflows_matching import find_ties

    shown = sys.stderr.isatty() and not args.quiet

    def progress(at: Progress) -> None:
        if shown:
            print(f"\r\033[K{at.stage} {at.done} of {at.total}, {at.left:.0f} s left", end="", file=sys.stderr, flush=True)

    try:
        done = find_ties(args.project, args.output, TieOptions(feature=args.feature, per_photo=args.per_photo),
                         workers=args.workers or cores(), scheduler=args.scheduler, report=progress)
    finally:
        if shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
    return _emit(args, done.to_json(), ties_text(done))


def _simulate(args: argparse.Namespace) -> int:
    from .workflows import simulate_project

    block = simulate_project(args.kind, args.output, seed=args.seed, reduction=args.reduction)
    value = {"project": args.output, "kind": args.kind, "seed": args.seed, "images": [i.name for i in block.images],
             "points": len(block.points), "observations": len(block.observations)}
    return _emit(args, value,
                 f"{args.output}: {len(block.images)} images, {len(block.points)} points\nnext: {PROG} view {args.output}")


def _study(args: argparse.Namespace) -> int:
    from .studies import run

    shown = sys.stderr.isatty()

    def progress(line: str) -> None:
        if not args.quiet:
            print(f"\r\033[K{line}" if shown else line, end="" if shown else "\n", file=sys.stderr, flush=True)

    files = run(args.kind, Path(args.output), args.runs, progress)
    if shown:
        progress("")
    return _emit(args, {"study": args.kind, "files": [str(f) for f in files]}, f"{files[-1]}: {len(files)} files written")


def _log(args: argparse.Namespace) -> int:
    from viewer_app.rerun_server import open_log

    from .workflows import recording_of

    recording = recording_of(args.project)
    _emit(args, {"recording": str(recording)}, "")
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl+C is how a person ends it
        open_log(recording, open_browser=not args.no_browser)
    return 0


# -- shared -----------------------------------------------------------------------------------------------------------------


def _command(commands: Any, name: str, run: Callable[[argparse.Namespace], int], what: str) -> Parser:
    command = commands.add_parser(name, help=what, description=what[0].upper() + what[1:] + ".")
    command.add_argument("--json", metavar="FILE", help="write the result as JSON to FILE, or - for standard output")
    command.add_argument("--quiet", action="store_true", help="print nothing but errors")
    command.set_defaults(run=run)
    return command


def _georeference_options(command: Parser) -> None:
    three = {"nargs": 3, "type": _number}
    command.add_argument("project", metavar="PROJECT|FOLDER", help="a project, a folder of photos, or a table of positions")
    command.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")
    command.add_argument("--crs", help="coordinate system for a folder: EPSG:CODE (default: its UTM zone)")
    command.add_argument("--footprints", metavar="F.geojson", help="write what each photo covers on the ground")
    command.add_argument("--write-priors", action="store_true", help="put the result into the project as priors")
    data = command.add_argument_group("onboard data beside the photos")
    data.add_argument("--positions", metavar="TABLE", help="a line per photo: image, lat, lon, height, yaw, pitch, roll")
    data.add_argument("--mrk", metavar="FILE", help="DJI Timestamp.MRK, a line per photo in their order")
    data.add_argument("--log", metavar="LOG.csv", help="autopilot log: time, lat, lon, height, yaw, pitch, roll")
    data.add_argument("--log-offset", type=_number, metavar="S", help="log time minus photo time [s] (default: estimated)")
    data.add_argument("--lever-arm", **three, metavar=("F", "R", "D"), help="antenna to camera: forward, right, down [m]")
    data.add_argument("--boresight", **three, metavar=("X", "Y", "Z"), help="turn of the camera on its mount [degrees]")
    data.add_argument("--sigma-m", **three, metavar=("E", "N", "U"), help="standard errors of the positions [m]")
    data.add_argument("--sigma-deg", **three, metavar=("T", "T", "YAW"), help="standard errors of the attitudes [degrees]")
    data.add_argument("--check-headings", action="store_true", help="compare the yaw angles with what the photos show")
    data.add_argument("--correct-headings", action="store_true", help="... and turn the photos whose yaw is wrong")
    heights = command.add_argument_group("heights")
    heights.add_argument("--heights", choices=("as-given", "levelled", "ellipsoidal"), default="as-given",
                         help="what the project's heights are (default: whatever the photos' are)")
    heights.add_argument("--photo-heights", choices=("levelled", "ellipsoidal"),
                         help="what the photos' heights are, if they do not say it")
    heights.add_argument("--undulation", type=_number_or_text, metavar="M|GRID.tif|auto", help="geoid above the ellipsoid")
    heights.add_argument("--height-bias", type=_number_or_control, metavar="M|control",
                         help="to add to all heights, or control: estimated by control points")
    heights.add_argument("--take-off", type=_number, metavar="Z", help="height of the take-off point, to use heights above it")
    heights.add_argument("--flying-height", type=_number, metavar="Z", help="for photos that state no height")
    ground = command.add_argument_group("ground and camera, for footprints and headings")
    where = ground.add_mutually_exclusive_group()
    where.add_argument("--ground-z", type=_number, metavar="Z",
                       help="level ground (default: [surface], or the take-off point's level)")
    where.add_argument("--dem", metavar="DEM.tif", help="heights of the ground")
    ground.add_argument("--pixel-um", type=_positive, metavar="P", help="pixel size in micrometres, where EXIF does not tell it")
    ground.add_argument("--c-mm", type=_positive, metavar="C", help="principal distance in mm, where EXIF does not tell it")


def _orientation_source(command: Parser) -> None:
    command.add_argument("--from", dest="source", choices=("auto", "resect", "georeference"), default="auto",
                         help="orientations: of the latest resect run, else resected now (auto); resected now; of the latest "
                              "georeference run")


def _viewer_options(command: Parser) -> None:
    command.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1)")
    command.add_argument("--port", type=int, default=0, help="port to listen on (default: a free one)")
    command.add_argument("--no-browser", action="store_true", help="only print the address")
    command.add_argument("--token", help="a word that visitors must know (default: a new one)")


def _emit(args: argparse.Namespace, value: Any, text: str) -> int:
    """Write the JSON where it is wanted, and the text unless quiet or in the way of the JSON."""
    import json

    from .io import jsonable, write_json

    if args.json == "-":
        print(json.dumps(jsonable(value), indent=1, allow_nan=False, ensure_ascii=False), flush=True)
        return 0
    if args.json:
        write_json(Path(args.json), value)
    if text and not args.quiet:
        print(text, flush=True)
    return 0


def _ask(question: str) -> str:
    """Ask the person at the terminal; the question goes to standard error, so that JSON on standard output stays clean."""
    print(question, end="", file=sys.stderr, flush=True)
    try:
        return input()
    except EOFError:
        return ""


def _cannot(message: str) -> int:
    print(f"{PROG}: {' '.join(message.split())}", file=sys.stderr)
    return 1


def _unexpected(error: Exception, project: str | None) -> int:
    """One sentence for what nobody foresaw; its traceback goes to a file."""
    import tempfile
    import traceback

    runs = Path(project) / "runs" if project else None
    folder = runs if runs is not None and runs.is_dir() and os.access(runs, os.W_OK) else None
    handle, path = tempfile.mkstemp(prefix=f"{PROG}-error-", suffix=".log", dir=folder)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        stream.write(" ".join([PROG, *sys.argv[1:]]) + "\n" + "".join(traceback.format_exception(error)))
    return _cannot(f"something unforeseen happened ({type(error).__name__}: {error}); please report it with {path}")


def _names(text: str) -> tuple[str, ...]:
    names = tuple(n.strip() for n in text.split(",") if n.strip())
    if not names:
        raise argparse.ArgumentTypeError("expected names separated by commas")
    return names


def _count(text: str) -> int:
    if not text.isascii() or not text.isdecimal() or int(text) < 2:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 2")
    return int(text)


def _reach(text: str) -> int:
    if not text.isascii() or not text.isdecimal() or int(text) > 1000:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to 1000")
    return int(text)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number")
    return value


def _number_or_text(text: str) -> float | str:
    try:
        return _number(text)
    except argparse.ArgumentTypeError:
        return text


def _number_or_control(text: str) -> float | str:
    value = _number_or_text(text)
    if isinstance(value, str) and value != "control":
        raise argparse.ArgumentTypeError(f"'{text}' is neither a number of metres nor control")
    return value


def _pixel(text: str) -> tuple[float, float]:
    col, comma, row = text.partition(",")
    if not comma:
        raise argparse.ArgumentTypeError(f"'{text}' is not a pixel; write COL,ROW such as 1200,840.5")
    return _number(col), _number(row)


def _and_more(count: int) -> str:
    return f" (and {count} more)" if count else ""


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number")
    return value


def _version() -> str:
    from . import __version__

    return __version__


if __name__ == "__main__":
    sys.exit(main())
