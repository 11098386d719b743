"""The commands that measure: targets, match, tiepoints."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from .cli_parts import add_command, count, emit, pixel, positive, reach


def add(commands: Any) -> None:
    """Their options."""
    targets = add_command(commands, "targets", _targets, "measure the signalised points of a photo or of a project's photos")
    targets.add_argument("image", metavar="IMAGE|PROJECT")
    targets.add_argument("--kind", choices=("dot", "ring", "chessboard"), default="dot",
                         help="filled circles, concentric rings or the corners of a chessboard (default: dot)")
    targets.add_argument("--board", type=_board, metavar="COLUMNSxROWS", help="inner corners of the chessboard, such as 9x6")
    targets.add_argument("--square", type=positive, default=1.0, metavar="M",
                         help="of a project: from one corner or row of targets to the next [m] (default: 1)")
    targets.add_argument("-o", "--output", metavar="observations.csv", help="write them as a table of observations")

    match = add_command(commands, "match", _match, "find a point of one photo in another")
    match.add_argument("images", nargs=2, metavar="IMAGE")
    match.add_argument("--at", type=pixel, required=True, metavar="COL,ROW",
                       help="in the first photo; 0,0 is the centre of the top-left pixel")
    match.add_argument("--start", type=pixel, metavar="COL,ROW",
                       help="near it in the second photo (default: by the photos' features)")
    match.add_argument("--window", type=count, default=21, metavar="N", help="side of the window, odd [px] (default: 21)")
    match.add_argument("--search", type=reach, metavar="N",
                       help="how far around the start [px] (default: 12, or 40 without features)")
    match.add_argument("--method", choices=("ncc", "lsm"), default="lsm",
                       help="correlation, or least squares matching after it (default: lsm)")

    ties = add_command(commands, "tiepoints", _tiepoints, "find points that photos share")
    ties.add_argument("project", metavar="PROJECT|FOLDER", help="a project, whose tables they join, or a folder of photos")
    ties.add_argument("-o", "--output", metavar="FILE",
                      help="write a table of observations instead (default for a folder: FOLDER/tiepoints.csv)")
    ties.add_argument("--feature", default="sift", metavar="NAME", help="sift, orb, akaze or brisk (default: sift)")
    ties.add_argument("--per-photo", type=count, default=1000, metavar="N", help="points wanted in each photo (default: 1000)")
    ties.add_argument("--workers", type=reach, metavar="N", help="processes (default: one for each core)")
    ties.add_argument("--scheduler", metavar="ADDRESS", help="of dask.distributed, to work over several machines")


def _board(text: str) -> tuple[int, int]:
    """COLUMNSxROWS."""
    across, _, down = text.lower().partition("x")
    if not (across.isdecimal() and down.isdecimal() and min(int(across), int(down)) > 2 and max(int(across), int(down)) < 100):
        raise argparse.ArgumentTypeError(f"'{text}' is no board; write the inner corners across and down, such as 9x6")
    return int(across), int(down)


def _targets(args: argparse.Namespace) -> int:
    from .report_matching import targets_text
    from .workflows_matching import targets_of_photo

    if (Path(args.image) / "project.toml").is_file():
        from .report_matching import sheet_text
        from .workflows_targets import targets_of_project

        sheet = targets_of_project(args.image, args.kind, args.board, args.square)
        return emit(args, sheet, sheet_text(sheet))
    done = targets_of_photo(args.image, args.kind, args.output, args.board)
    return emit(args, done, targets_text(done, args.output))


def _match(args: argparse.Namespace) -> int:
    from .report_matching import match_text
    from .workflows_matching import match_photos

    first, second = args.images
    done = match_photos(first, second, args.at, start=args.start, window=args.window, search=args.search, method=args.method)
    return emit(args, done, match_text(done))


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
    return emit(args, done.to_json(), ties_text(done))
