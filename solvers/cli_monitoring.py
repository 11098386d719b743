"""The command that watches objects over time: compare."""

from __future__ import annotations

import argparse
from typing import Any

from .cli_parts import add_command, emit, names, positive


def add(commands: Any) -> None:
    """Its options."""
    compare = add_command(commands, "compare", _compare, "displacements between adjusted epochs of one network")
    compare.add_argument("epochs", nargs="+", metavar="EPOCH", help="projects, the first is what the others are compared with")
    compare.add_argument("--stable", type=names, metavar="A,B,..",
                         help="points that may hold the datum (default: all that the epochs share)")
    compare.add_argument("--level", type=positive, default=0.05, metavar="P",
                         help="chance of one false alarm or more in the whole comparison (default: 0.05)")
    compare.add_argument("--adjust", choices=("auto", "now"), default="auto",
                         help="each epoch as its latest adjust run did (auto, where it is newer than the project), or anew")
    compare.add_argument("--model", choices=("perspective", "orthogonal"), help="projection, where no run says otherwise")
    compare.add_argument("--free", type=names, metavar="c,xp,..", help="interior parameters to adjust in every epoch")
    compare.add_argument("--robust", action="store_true", help="down-weight blunders in every epoch")
    compare.add_argument("--start", choices=("auto", "resection", "dlt", "affine", "relative", "prior"),
                         help="where the start values come from")


def _compare(args: argparse.Namespace) -> int:
    from .report_monitoring import compared_text
    from .workflows_monitoring import compare_projects

    options = {k: v for k in ("model", "free", "start") if (v := getattr(args, k)) is not None}
    options |= {"loss": "danish"} if args.robust else {}
    done = compare_projects(args.epochs, args.stable, args.level, args.adjust, **options)
    return emit(args, done.to_json(), compared_text(done))
