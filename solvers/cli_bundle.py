"""The commands that adjust blocks: adjust, calibrate, models."""

from __future__ import annotations

import argparse
from typing import Any

from .cli_parts import Parser, add_command, cannot, emit, names

LOSSES = ("huber", "cauchy", "danish")


def add(commands: Any) -> None:
    """Their options."""
    adjust = add_command(commands, "adjust", _adjust, "bundle adjustment of all images of a project together")
    _options(adjust)
    adjust.add_argument("--continue", dest="further", nargs="?", const="", metavar="RUN[:ROW]",
                        help="go on from a row of a run of the project (default: the last row of the latest), with its options")
    adjust.add_argument("--bal", metavar="FILE", help="instead of a project: a problem of bundle adjustment in the large")

    calibrate = add_command(commands, "calibrate", _calibrate, "calibrate cameras: adjust with all ten interior parameters free")
    _options(calibrate, "all")
    calibrate.add_argument("--compare", action="extend", nargs="+", default=[], metavar="RUN|PROJECT",
                           help="earlier calibrations, to compare parameters and distortion curves with")


    models = add_command(commands, "models", _models, "the same control by four models in one table: direct linear "
                         "transformation, affine, orthogonal and perspective")
    models.add_argument("project", metavar="PROJECT")
    models.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")


def _options(command: Parser, free: str = "none") -> None:
    command.add_argument("project", metavar="PROJECT", nargs="?")
    command.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")
    command.add_argument("--model", choices=("perspective", "orthogonal"), default="perspective",
                         help="projection; the orthogonal one frees c alone and is for narrow fields (default: perspective)")
    command.add_argument("--transform", choices=("iterated", "frozen"), default="iterated",
                         help="orthogonal model: rays made parallel anew in every iteration, or kept as the start makes them")
    command.add_argument("--datum", choices=("control", "free", "prior", "both"),
                         help="what gives place, attitude and scale: control points; inner constraints; GPS/IMU priors; control "
                              "and priors (default: control, prior where the project has no control)")
    command.add_argument("--corners", metavar="C.json",
                         help="image corners as control, from collinea georeference --corners: each image's four with their "
                              "covariance; takes datum both, or prior where the project has no control")
    command.add_argument("--free", type=_free, default=free, metavar="none|all|c,xp,yp,k1,...",
                         help=f"interior parameters to adjust (default: {free})")
    command.add_argument("--per-image", type=names, nargs="?", const=True, default=False, metavar="xp,yp,...",
                         help="free them for every image by itself, not for the camera; with names: these of every image, the "
                              "other free ones of the camera")
    command.add_argument("--start", choices=("auto", "resection", "dlt", "affine", "relative", "prior"), default="auto",
                         help="where the start values come from (default: auto, whatever the project offers)")
    command.add_argument("--rolling-shutter", nargs="?", choices=("translation", "rotation", "none"), const="translation",
                         default="auto", help="let every image move while it is read (velocity), or turn as well, by the "
                                              "camera's readout_ms (default: rotation where photos record it, else none)")
    command.add_argument("--robust", action="store_true", help="down-weight blunders and name them")
    command.add_argument("--loss", choices=LOSSES, default="danish", help="how --robust does it (default: danish)")


def _free(text: str) -> tuple[str, ...]:
    from .cameras import PARAMETERS

    if text in ("none", "all"):
        return PARAMETERS if text == "all" else ()
    return names(text)


def _request(args: argparse.Namespace) -> dict[str, Any]:
    return {"datum": args.datum, "free": _free(args.free) if isinstance(args.free, str) else args.free, "start": args.start,
            "per_image": args.per_image, "loss": args.loss if args.robust else None, "images": tuple(args.image) or None,
            "model": args.model, "transform": args.transform, "corners": args.corners, "rolling_shutter": args.rolling_shutter}


def _adjust(args: argparse.Namespace) -> int:
    from viewer_app.rerun_bundle import Live, record_bundle

    from .report_bundle import adjusted_text
    from .workflows_bundle import StoppedRun, adjust_bal, adjust_project

    if args.bal:
        given = {"loss": args.loss} if args.robust else {}
        done = adjust_bal(args.bal, **given)
    else:
        done = adjust_project(_where(args), "adjust", record_bundle, live=Live, further=args.further, **_request(args))
        if isinstance(done, StoppedRun):
            return _stopped(done)
    return emit(args, done.to_json() if args.json else None, adjusted_text(done))


def _stopped(done: Any) -> int:
    """An adjustment that Ctrl+C ended is none, but its rows are kept."""
    return cannot(f"stopped by Ctrl+C after {done.last.index} iterations (sigma0 {done.last.sigma0:.4g}); the rows are kept, go "
                  f"on with: collinea adjust {done.run.parent.parent} --continue {done.run.name}")


def _calibrate(args: argparse.Namespace) -> int:
    from viewer_app.rerun_bundle import Live, record_bundle

    from .report_calibration import calibrated_text
    from .workflows_bundle import StoppedRun
    from .workflows_calibration import calibrate_project

    done = calibrate_project(_where(args), args.compare, record_bundle, live=Live, **_request(args))
    if isinstance(done, StoppedRun):
        return _stopped(done)
    return emit(args, done.to_json() if args.json else None, calibrated_text(done))


def _models(args: argparse.Namespace) -> int:
    from .io import read_project
    from .orientation.models import compare_models
    from .report_bundle import models_text

    block = read_project(args.project)
    images, space = compare_models(block, tuple(args.image))
    value = {"project": str(args.project), "images": [f.to_json() for f in images], "space": [m.to_json() for m in space]}
    return emit(args, value, models_text(block, images, space))


def _where(args: argparse.Namespace) -> str:
    from .errors import BadProject

    if args.project is None:
        raise BadProject("which project? give its folder: collinea adjust PROJECT")
    return args.project
