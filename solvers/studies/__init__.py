"""Honest comparisons: run many adjustments, tabulate, plot, say it in words. `KINDS` names them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from ..errors import BadProject

KINDS = {
    "clusters": "33 control points, narrow clusters: the design of the orthogonal single-image orientation paper",
    "fov": "field of view, relief, number of points, noise and prior quality",
    "ono": "free networks of long focal length: Ono & Hattori's tables over many runs, their field geometry",
    "starts": "initial values: success and cost of every start",
    "drift": "36-photo mosaics, one after the other or all at once: drift, control, relief, distortion",
    "monitoring": "epochs of one network: false alarms at the stated level, movements found",
    "gcp": "how many ground control points a mosaic needs, and where",
}


def run(kind: str, folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run a study into a folder: CSV, PNG and SVG figures and one page; returns the files written."""
    return import_module(f".{kind}", __name__).study(folder, runs=runs, progress=progress)


def redraw(kind: str, folder: Path) -> list[Path]:
    """The figures (PNG, SVG) of a study drawn anew from the tables in its folder; returns the files written.

    Raises: BadProject where the folder holds no tables of this study.
    """
    try:
        return import_module(f".{kind}", __name__).figures(folder)
    except (KeyError, IndexError, TypeError, ValueError, StopIteration) as e:
        raise BadProject(f"{folder}: its tables are not those of a whole study of {kind}; run the study again") from e
