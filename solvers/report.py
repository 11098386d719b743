"""Results as text for a terminal."""

from __future__ import annotations

import io
import math
import shutil
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from .orientation import Orientation

if TYPE_CHECKING:
    from .workflows import Resected

ELEMENTS = ("omega [deg]", "phi [deg]", "kappa [deg]", "X [m]", "Y [m]", "Z [m]")


def resection_text(done: Resected) -> str:
    """All orientations of a run: one table per image with both models and their difference, warnings and advice below."""
    parts = []
    for image in dict.fromkeys(o.image for o in done.orientations):
        of_image = [o for o in done.orientations if o.image == image]
        parts.append(image_text(of_image, done.advice.get(image)))
    return "\n\n".join([*parts, f"run: {done.run}"])


def image_text(orientations: list[Orientation], advice: Any = None) -> str:
    """The models' solutions of one image side by side."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, title=f"image {orientations[0].image}", title_justify="left", title_style="", header_style="")
    table.add_column("")
    for o in orientations:
        table.add_column(o.model, justify="right", no_wrap=True)
        table.add_column("sigma", justify="right", no_wrap=True)
    if len(orientations) == 2:
        table.add_column("difference", justify="right", no_wrap=True)
    values, sigmas = [_elements(o) for o in orientations], [_sigmas(o) for o in orientations]
    for i, name in enumerate(ELEMENTS):
        digits = _digits(min(s[i] for s in sigmas))
        cells = [f"{n[i]:.{digits}f}" for pair in zip(values, sigmas, strict=True) for n in pair]
        if len(orientations) == 2:
            gap = values[1][i] - values[0][i]
            cells.append(f"{(gap + 180) % 360 - 180 if i < 3 else gap:.{digits}f}")
        table.add_row(name, *cells)
    lines = [f"{o.model}: sigma0 {_sigma0(o)}, rms {o.rms_px:.3g} px in {int(o.used.sum())} points, "
             f"{o.trace.iterations} iterations, stop: {o.trace.last.stop}" for o in orientations]
    warnings = [f"{o.model}: {w}" for o in orientations for w in o.warnings]
    return "\n".join([_rendered(table), *lines, *_notes("warning", warnings), *_advised(advice)])


def _elements(o: Orientation) -> np.ndarray:
    return np.concatenate([np.degrees(o.exterior.angles), o.exterior.centre])


def _sigmas(o: Orientation) -> np.ndarray:
    return np.concatenate([np.degrees(o.sigma[3:]), o.sigma[:3]])


def _digits(sigma: float) -> int:
    """Decimals that show a standard error with two digits, between 3 and 7."""
    return int(np.clip(1 - math.floor(math.log10(sigma)), 3, 7)) if np.isfinite(sigma) and sigma > 0 else 6


def _sigma0(o: Orientation) -> str:
    return "undetermined (no redundancy)" if o.sigma0 is None else f"{o.sigma0:.3f} (redundancy {o.dof})"


def _advised(advice: Any) -> list[str]:
    return [] if advice is None else _notes("advice", [f"{advice.model}: {'; '.join(advice.reasons)}"])


def _notes(word: str, texts: list[str]) -> list[str]:
    width = max(60, shutil.get_terminal_size((100, 24)).columns)
    wrapper = textwrap.TextWrapper(width, subsequent_indent="  ", break_long_words=False)
    return [line for text in texts for line in wrapper.wrap(f"{word}: {text}")]


def _rendered(table: Any) -> str:
    from rich.console import Console

    out = io.StringIO()
    Console(file=out, width=160, highlight=False, emoji=False, markup=False).print(table)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines() if line.strip())
