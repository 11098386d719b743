"""The commands that orient single images: resect, georeference, intersect, monoplot."""

from __future__ import annotations

import argparse
from typing import Any

from .cli_parts import (
    Parser,
    add_command,
    and_more,
    cannot,
    emit,
    names,
    number,
    number_or_control,
    number_or_text,
    orientation_source,
    pixel,
    positive,
)


def add(commands: Any) -> None:
    """Their options."""
    resect = add_command(commands, "resect", _resect, "orient images by their control points, one by one")
    resect.add_argument("project", metavar="PROJECT")
    resect.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")
    resect.add_argument("--model", choices=("perspective", "orthogonal", "both"), default="both")
    resect.add_argument("--points", type=names, metavar="A,B,C", help="only these control points (default: all of the image)")
    resect.add_argument("--robust", action="store_true", help="find and leave out blunders")
    resect.add_argument("--prior", choices=("none", "initial", "weighted"), default="none",
                        help="use of the images' priors (default: none)")
    resect.add_argument("--one-pass", action="store_true", help="orthogonal: one pass from the prior as approximate orientation")
    resect.add_argument("--form", choices=("depth", "printed"), default="depth",
                        help="orthogonal: form of the exterior orientation (default: depth)")
    resect.add_argument("--recentre", choices=("on", "off"), default="on", help="orthogonal: re-centred bundle (default: on)")
    resect.add_argument("--free", type=names, default=(), metavar="c,xp,yp,k1,...",
                        help="perspective: interior parameters to adjust")

    geo = add_command(commands, "georeference", _georeference, "exterior orientation from onboard GPS and IMU")
    _georeference_options(geo)

    cross = add_command(commands, "intersect", _intersect, "object points from oriented images")
    cross.add_argument("project", metavar="PROJECT")
    cross.add_argument("--points", type=names, default=(), metavar="A,B", help="only these points (default: all seen twice)")
    cross.add_argument("--robust", action="store_true", help="leave out rays that the others refute, and name them")
    orientation_source(cross)

    mono = add_command(commands, "monoplot", _monoplot, "ground coordinates of a pixel of one oriented image")
    mono.add_argument("project", metavar="PROJECT")
    mono.add_argument("--image", required=True, metavar="N")
    mono.add_argument("--at", type=pixel, required=True, metavar="COL,ROW",
                      help="pixel of the full format; 0,0 is the centre of the top-left pixel")
    ground = mono.add_mutually_exclusive_group()
    ground.add_argument("--dem", metavar="DEM.tif", help="heights of the ground (default: [surface] of the project)")
    ground.add_argument("--z", type=number, metavar="H", help="level ground at this height [m]")
    mono.add_argument("--sigma-z", type=positive, metavar="S", help="standard error of the ground's height [m]")
    orientation_source(mono)


def _resect(args: argparse.Namespace) -> int:
    from viewer_app.paint_rerun import record

    from .report import resection_text
    from .workflows import MODELS, resect_project

    models = MODELS if args.model == "both" else (args.model,)
    done = resect_project(args.project, args.image, models, record, points=args.points, robust=args.robust, prior=args.prior,
                          one_pass=args.one_pass, form=args.form, recentre=args.recentre == "on", free=args.free)
    emit(args, done.to_json(), resection_text(done))
    if not done.failed:
        return 0
    first, total = done.failed[0], len(done.failed) + len(done.orientations)
    return cannot(f"{len(done.failed)} of {total} orientations cannot be computed, the first by the {first.model} model: "
                   f"{first.why}")


def _georeference(args: argparse.Namespace) -> int:
    from .orientation import Rig
    from .orientation.grades import COARSE_M
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
        write_priors=args.write_priors, from_priors=args.from_priors, corners=args.corners, relief=args.relief,
        compare=args.compare, coarse_m=three(args.coarse_m) or COARSE_M, pixel_um=args.pixel_um, c_mm=args.c_mm))
    emit(args, done.to_json(), georeference_text(done))
    if not done.failed:
        return 0
    return cannot(f"image '{done.failed[0][0]}': {done.failed[0][1]}{and_more(len(done.failed) - 1)}")


def _intersect(args: argparse.Namespace) -> int:
    from .report_orientation import intersection_text
    from .workflows_orientation import intersect_project

    done = intersect_project(args.project, args.points, robust=args.robust, source=args.source)
    emit(args, done.to_json(), intersection_text(done))
    failed = done.result.failed
    return 0 if not failed else cannot(failed[0][1] + and_more(len(failed) - 1))


def _monoplot(args: argparse.Namespace) -> int:
    from .report_orientation import monoplot_text
    from .workflows_orientation import monoplot_project

    done = monoplot_project(args.project, args.image, args.at, dem=args.dem, z=args.z, sigma_z=args.sigma_z, source=args.source)
    return emit(args, done.to_json(), monoplot_text(done))


def _georeference_options(command: Parser) -> None:
    three = {"nargs": 3, "type": number}
    command.add_argument("project", metavar="PROJECT|FOLDER", help="a project, a folder of photos, or a table of positions")
    command.add_argument("--image", action="extend", nargs="+", default=[], metavar="N", help="only these images (default: all)")
    command.add_argument("--crs", help="coordinate system for a folder: EPSG:CODE (default: its UTM zone)")
    command.add_argument("--footprints", metavar="F.geojson", help="write what each photo covers on the ground")
    command.add_argument("--write-priors", action="store_true", help="put the result into the project as priors")
    command.add_argument("--from-priors", action="store_true",
                         help="take the priors of the project in place of what photos and logs say")
    command.add_argument("--corners", metavar="C.json",
                         help="write the four corners of each image as control, with their covariance, for adjust --corners")
    command.add_argument("--compare", action="store_true",
                         help="errors at independent check points: onboard, coarse control, surveyed control")
    command.add_argument("--coarse-m", **three, metavar=("X", "Y", "Z"),
                         help="... standard errors of coarse control (default: 2.5 2.5 5 m)")
    data = command.add_argument_group("onboard data beside the photos")
    data.add_argument("--positions", metavar="TABLE", help="a line per photo: image, lat, lon, height, yaw, pitch, roll")
    data.add_argument("--mrk", metavar="FILE", help="DJI Timestamp.MRK, a line per photo in their order")
    data.add_argument("--log", metavar="LOG.csv", help="autopilot log: time, lat, lon, height, yaw, pitch, roll")
    data.add_argument("--log-offset", type=number, metavar="S", help="log time minus photo time [s] (default: estimated)")
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
    heights.add_argument("--undulation", type=number_or_text, metavar="M|GRID.tif|auto", help="geoid above the ellipsoid")
    heights.add_argument("--height-bias", type=number_or_control, metavar="M|control",
                         help="to add to all heights, or control: estimated by control points")
    heights.add_argument("--take-off", type=number, metavar="Z", help="height of the take-off point, to use heights above it")
    heights.add_argument("--flying-height", type=number, metavar="Z", help="for photos that state no height")
    ground = command.add_argument_group("ground and camera, for footprints, corners and headings")
    where = ground.add_mutually_exclusive_group()
    where.add_argument("--ground-z", type=number, metavar="Z",
                       help="level ground (default: [surface], or the take-off point's level)")
    where.add_argument("--dem", metavar="DEM.tif", help="heights of the ground")
    ground.add_argument("--relief", type=positive, metavar="S",
                        help="how far the ground under the corners departs from a level [m] (default: 2 %% of the flying height)")
    ground.add_argument("--pixel-um", type=positive, metavar="P", help="pixel size in micrometres, where EXIF does not tell it")
    ground.add_argument("--c-mm", type=positive, metavar="C", help="principal distance in mm, where EXIF does not tell it")
