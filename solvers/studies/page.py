"""Tables, figures and pages of the studies: CSV, PNG and SVG with one look, Markdown."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import BadProject, BadTable
from ..legend import INKS

COLOURS = {**INKS, "prior": INKS["georeferenced"], "printed": INKS["residual"]}
"""The legend; what a prior holds is green, the printed one-pass forms are vermilion."""


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Rows of one table; columns in the order of their first appearance, numbers with six digits."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, columns)
        out.writeheader()
        out.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return path


def read_csv(path: Path) -> list[dict[str, Any]]:
    """The rows that `write_csv` wrote: numbers and truths as such, None where a cell is empty.

    Raises: BadProject where there is no such table; BadTable where it is none.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [{k: _value(v) for k, v in row.items()} for row in csv.DictReader(file, strict=True)]
    except FileNotFoundError as e:
        raise BadProject(f"{path}: there is no such table; run the study first, without --figures") from e
    except (OSError, UnicodeDecodeError, csv.Error, AttributeError) as e:
        raise BadTable(f"{path}: this is not a table of a study; run the study again") from e


def _value(text: str) -> Any:
    if text in ("", "True", "False"):
        return {"": None}.get(text, text == "True")
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def figure(width: float = 7.0, height: float = 4.2, **kwargs: Any) -> tuple[Any, Any]:
    """A matplotlib figure and its axes, made without a display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(fig)
    return fig, fig.subplots(**kwargs)


def plain_ticks(ax: Any) -> None:
    """Numbers on a logarithmic y axis as people write them."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    ax.yaxis.set_major_locator(LogLocator(10, (1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def save(fig: Any, folder: Path, name: str) -> list[Path]:
    """PNG (120 dpi) and SVG of a figure, the SVG with text as text and without dates so that it can be compared."""
    from matplotlib import rc_context

    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    fig.savefig(paths[0], dpi=120)
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        fig.savefig(paths[1], metadata={"Date": None})
    return paths


def flow(text: str) -> str:
    """Markdown with every paragraph and list item on one line; tables and headings stay."""
    blocks = (b if b.startswith(("|", "#")) else re.sub(r"\n(?!- ) *", " ", b) for b in text.split("\n\n"))
    return "\n\n".join(b.strip() for b in blocks) + "\n"


def number(value: float, digits: int = 3) -> str:
    """A number with at most so many significant digits, never in powers of ten; "none" for NaN."""
    from numpy import format_float_positional

    return "none" if value != value else format_float_positional(float(f"{value:.{digits}g}"), trim="-")


def probability(p: float) -> str:
    """A probability in words that stay readable when it is tiny."""
    return f"{p:.1%}" if p >= 0.001 else f"1 in {1 / p:.0e}" if p > 0 else "0"


def table(header: Sequence[str], rows: Iterable[Sequence[Any]], digits: int = 3) -> str:
    """A Markdown table; floats with so many significant digits."""
    def cell(value: Any) -> str:
        return number(value, digits) if isinstance(value, float) else str(value)

    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(map(cell, row)) + " |" for row in rows)])
