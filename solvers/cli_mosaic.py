"""The commands mosaic and rectify."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from .cli_parts import Parser, add_command, emit, number, positive, reach


def add(commands: Any) -> None:
    """Their options."""
    mosaic = add_command(commands, "mosaic", _mosaic, "join photos into one picture with coordinates")
    mosaic.add_argument("project", metavar="PROJECT|FOLDER", help="a project, or a folder of photos")
    mosaic.add_argument("-o", "--output", required=True, metavar="OUT.tif", help="GeoTIFF (or PNG, JPEG) to write")
    mosaic.add_argument("--kind", choices=("uncontrolled", "semicontrolled", "controlled"),
                        help="by the photo of least tilt alone, by flight data or a few control points, or by weighted control "
                             "points (default: the best that the data allow)")
    mosaic.add_argument("--register", choices=("sequential", "simultaneous"), default="simultaneous",
                        help="photo after photo onto the growing mosaic, or all at once (default: simultaneous)")
    mosaic.add_argument("--model", choices=("auto", "plane", "exterior", "adapted", "bundle"), default="auto",
                        help="what is adjusted: eight plane coefficients a photo, exterior orientations on the plane, these with "
                             "coefficients held near them, or a bundle with free points (default: auto)")
    mosaic.add_argument("--plane", type=_plane, metavar="Z|fitted",
                        help="height of the mosaic plane [m], or a tilted plane fitted to the points (default: their median "
                             "height)")
    mosaic.add_argument("--reference", metavar="N", help="photo that gives the plane of an uncontrolled mosaic (default: the one "
                                                         "of least tilt)")
    mosaic.add_argument("--surface", default="plane", metavar="plane|DEM.tif", help="what the photos are put on (default: plane)")
    mosaic.add_argument("--crs", help="of a folder of photos: EPSG:CODE (default: their UTM zone)")
    mosaic.add_argument("--corners", metavar="C.json",
                        help="image corners as weighted control, from collinea georeference --corners")
    mosaic.add_argument("--allow-partial", action="store_true", help="end with 0 even if photos had to be left out")
    _composition(mosaic)
    mosaic.add_argument("--blend", choices=("none", "average", "feather", "multiband"), default="feather",
                        help="how overlapping photos are mixed (default: feather)")
    mosaic.add_argument("--seams", action="store_true", help="seam lines: every place shows one photo, nothing ghosts")
    mosaic.add_argument("--gain", action="store_true", help="even out exposure and vignetting, jointly")
    mosaic.add_argument("--memory", type=positive, metavar="GB", help="memory to stay within")
    mosaic.add_argument("--workers", type=reach, metavar="N", help="processes (default: one for each core)")
    mosaic.add_argument("--scheduler", metavar="ADDRESS", help="of dask.distributed, to work over several machines")

    rectify = add_command(commands, "rectify", _rectify, "put one photo on a plane, tilt and distortion removed")
    rectify.add_argument("project", metavar="PROJECT")
    rectify.add_argument("--image", required=True, metavar="N", help="name of the image")
    rectify.add_argument("-o", "--output", required=True, metavar="OUT.tif", help="GeoTIFF to write")
    rectify.add_argument("--plane", type=_plane, metavar="Z|fitted",
                         help="height of the plane [m], or the plane fitted to the known points (default: the project's surface, "
                              "else their mean height)")
    _composition(rectify)


def _composition(command: Parser) -> None:
    command.add_argument("--gsd", type=positive, metavar="M", help="ground size of a pixel [m] (default: the photos' own)")
    command.add_argument("--resample", choices=("nearest", "bilinear", "bicubic"), default="bilinear", help="(default: bilinear)")
    command.add_argument("--compression", choices=("deflate", "zstd", "jpeg", "none"), default="deflate",
                         help="of the GeoTIFF; jpeg loses a little and takes a tenth of the room (default: deflate)")
    command.add_argument("--nodata", type=_byte, metavar="V",
                         help="value 0 to 255 where no photo shows anything, in place of alpha")


def _byte(text: str) -> int:
    value = reach(text)
    if value > 255:
        raise argparse.ArgumentTypeError(f"'{text}': pixels are bytes; give a value from 0 to 255")
    return value


def _plane(text: str) -> float | str:
    return text if text == "fitted" else number(text)


def _mosaic(args: argparse.Namespace) -> int:
    from .execution import Progress, cores
    from .report_mosaic import mosaic_text
    from .workflows_compose import ComposeRequest
    from .workflows_mosaic import MosaicRequest, mosaic_of

    shown = sys.stderr.isatty() and not args.quiet

    def progress(at: Progress) -> None:
        if shown:
            print(f"\r\033[K{at.stage} {at.done} of {at.total}, {at.left:.0f} s left", end="", file=sys.stderr, flush=True)

    compose = ComposeRequest(args.surface, args.gsd, args.resample, args.blend, args.seams, args.gain, args.memory,
                             args.workers or cores(), args.scheduler, args.compression, nodata=args.nodata)
    try:
        done = mosaic_of(args.project, args.output,
                         MosaicRequest(args.kind, args.register, args.model, args.plane, args.reference, args.allow_partial,
                                       args.crs, args.corners, compose), progress)
    finally:
        if shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
    emit(args, done.to_json(), mosaic_text(done.to_json(), args.output))
    return 0 if done.complete or args.allow_partial else 1


def _rectify(args: argparse.Namespace) -> int:
    from .report_mosaic import rectify_text
    from .workflows_compose import ComposeRequest
    from .workflows_mosaic import rectify_photo

    done = rectify_photo(args.project, args.image, args.output, args.plane,
                         ComposeRequest(gsd=args.gsd, resample=args.resample, blend="none", compression=args.compression,
                                        nodata=args.nodata))
    return emit(args, done, rectify_text(done, args.output))
