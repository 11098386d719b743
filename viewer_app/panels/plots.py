"""Small plots of a trace as SVG, pure: both models on one axis, logarithmic, the row shown marked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..theme import Colour
from .widgets import css, esc


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (rows,) of one model; NaN and values <= 0 are left out."""

    name: str
    values: np.ndarray
    colour: Colour


def plot(
    title: str,
    curves: Sequence[Curve],
    row: int,
    last: int,
    button: Callable[[int, str], str],
    width: int = 156,
    height: int = 118,
) -> str:
    """One plot. button(row, hint) gives the attributes that make a column of the plot choose its row."""
    left, right, top, bottom = 34, 6, 18, 16
    shown = [c.values[np.isfinite(c.values) & (c.values > 0)] for c in curves]
    every = np.concatenate([*shown, np.zeros(0)])
    low, high = _decades(every)
    x = np.linspace(left + 4, width - right - 4, last + 1) if last else np.array([(left + width - right) / 2])

    def y(value: float) -> float:
        return top + (high - np.log10(value)) / (high - low) * (height - top - bottom)

    parts = [f'<text x="{left - 30}" y="11" font-weight="600">{esc(title)}</text>']
    step = max(1, (high - low) // 3)
    for decade in range(low, high + 1, step):
        at = y(10.0**decade)
        parts.append(
            f'<line x1="{left}" x2="{width - right}" y1="{at:.1f}" y2="{at:.1f}" stroke="currentColor" stroke-opacity=".15"/>'
            f'<text x="{left - 4}" y="{at + 3:.1f}" text-anchor="end" opacity=".7">{_power(decade)}</text>'
        )
    parts.append(
        f'<line data-now="{row}" x1="{x[row]:.1f}" x2="{x[row]:.1f}" y1="{top}" y2="{height - bottom}" stroke="currentColor" '
        'stroke-width="1.5" stroke-dasharray="3 2"/>'
    )
    for i in {0, last, row}:
        parts.append(
            f'<text x="{x[i]:.1f}" y="{height - 4}" text-anchor="middle" opacity="{1 if i == row else 0.6}">{i}</text>'
            if i == row or abs(x[i] - x[row]) > 14
            else ""
        )
    for curve in curves:
        parts += _curve(curve, x, y, row)
    parts += _columns(curves, x, last, top, height - bottom, button, (left, width - right))
    return (
        f'<svg role="img" aria-label="{esc(title)}, row {row} of {last} marked" viewBox="0 0 {width} {height}" '
        f'style="width:{100 / 3:.4f}%;display:inline-block" font-size="9" fill="currentColor">{"".join(parts)}</svg>'
    )


def _curve(curve: Curve, x: np.ndarray, y: Callable[[float], float], row: int) -> list[str]:
    good = [(i, float(v)) for i, v in enumerate(curve.values) if np.isfinite(v) and v > 0]
    points = " ".join(f"{x[i]:.1f},{y(v):.1f}" for i, v in good)
    colour = css(curve.colour)
    parts = [f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.8"/>']
    at = min(row, len(curve.values) - 1)
    return parts + [f'<circle cx="{x[i]:.1f}" cy="{y(v):.1f}" r="{3.2 if i == at else 1.6}" fill="{colour}"/>' for i, v in good]


def _columns(
    curves: Sequence[Curve],
    x: np.ndarray,
    last: int,
    top: int,
    bottom: int,
    button: Callable[[int, str], str],
    edges: tuple[int, int],
) -> list[str]:
    middles = np.concatenate([[edges[0]], (x[1:] + x[:-1]) / 2, [edges[1]]])
    parts = []
    for i in range(last + 1):
        words = ", ".join(f"{c.name} {c.values[i]:.4g}" for c in curves if i < len(c.values) and np.isfinite(c.values[i]))
        hint = f"row {i}: {words}" if words else f"row {i}"
        parts.append(
            f'<rect x="{middles[i]:.1f}" width="{middles[i + 1] - middles[i]:.1f}" y="{top}" height="{bottom - top}" '
            f'fill="transparent" {button(i, hint)}><title>{esc(hint)}</title></rect>'
        )
    return parts


def _decades(values: np.ndarray) -> tuple[int, int]:
    if not len(values):
        return -1, 1
    low, high = int(np.floor(np.log10(values.min()))), int(np.ceil(np.log10(values.max())))
    return (low, high) if high > low else (low, low + 1)


def _power(decade: int) -> str:
    return f"{10.0**decade:g}" if -3 <= decade <= 3 else f"1e{decade}"
