"""The command that makes deliverables of a run: report."""

from __future__ import annotations

import argparse
from typing import Any

from .cli_parts import add_command, emit, positive


def add(commands: Any) -> None:
    """Its options."""
    report = add_command(commands, "report", _report, "write a report of a run as one HTML or PDF file")
    report.add_argument("project", metavar="PROJECT|RUN", help="a project (its latest run) or one of its runs")
    report.add_argument("-o", "--output", required=True, metavar="R.pdf|R.html")
    report.add_argument("--edition", choices=("2014", "2023", "2024"), default="2024",
                        help="of the ASPRS accuracy standard (default: 2024, that is edition 2 version 2)")
    report.add_argument("--class-h-cm", type=positive, metavar="C", help="horizontal accuracy class the data were made for [cm]")
    report.add_argument("--class-v-cm", type=positive, metavar="C", help="vertical accuracy class the data were made for [cm]")


def _report(args: argparse.Namespace) -> int:
    from .report_material import Wanted
    from .workflows_report import report_project

    done = report_project(args.project, args.output, Wanted(args.edition, args.class_h_cm, args.class_v_cm))
    text = f"{done.path}: {len(done.sections)} sections, {done.warnings} warnings, of the run {done.run.name}"
    return emit(args, done.to_json(), text)
