"""Plots of a bundle as SVG, pure: residuals over the format, the radial profile, correlations as a heat map."""

from __future__ import annotations

import numpy as np

from solvers import Interior

from .. import theme
from ..bundle_figures import Field, Profile, Vectors, cut_words, inside
from ..ground import nice
from .widgets import css, esc

MOST = 1500
"""Vectors drawn at most, the longest."""
AXIS = 'stroke="currentColor" stroke-opacity=".45" fill="none"'


def vectors_svg(of: Vectors | Field, chosen: str | None = None, width: int = 386) -> str:
    """Residuals over the photo's format, exaggerated, with the length of the bar below in pixels of the photo."""
    at, v = (of.pixel, of.v) if isinstance(of, Vectors) else (of.middle, of.mean)
    interior = of.interior
    scale = width / interior.width if interior.width >= interior.height else 0.62 * width / interior.height
    w, h = interior.width * scale, interior.height * scale
    rms = float(np.sqrt((v**2).sum(axis=1).mean())) if len(v) else 0.0
    bar = nice(max(2 * rms, 1e-6))  # px of the photo, drawn an eighth of the plot, of a field a sixteenth
    factor = max(w, h) / (8 if isinstance(of, Vectors) else 16) / bar
    left = (width - w) / 2
    parts = [f'<rect x="{left:.1f}" y="1" width="{w:.1f}" height="{h:.1f}" {AXIS}/>', _middle(interior, scale, left)]
    longest = np.argsort(-np.linalg.norm(v, axis=1), kind="stable")[:MOST]
    share = inside((at + 0.5) * scale, factor * v, (w, h))
    colour = css(theme.RESIDUAL)
    for i in longest:
        x, y = left + (at[i, 0] + 0.5) * scale, 1 + (at[i, 1] + 0.5) * scale
        name = of.names[i] if isinstance(of, Vectors) else f"{of.count[i]} measurements"
        ring = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" {AXIS}/>' if name == chosen else ""
        dot = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.4" fill="currentColor" fill-opacity=".6"/>' if len(v) <= 400 else ""
        parts.append(f'<g><title>{esc(name)}: {v[i, 0]:+.2f}, {v[i, 1]:+.2f} px</title>{ring}{dot}'
                     f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{x + share[i] * factor * v[i, 0]:.1f}" '
                     f'y2="{y + share[i] * factor * v[i, 1]:.1f}" stroke="{colour}" stroke-width="1.4"/></g>')
    y = h + 12
    length = factor * bar
    parts.append(f'<path d="M{left:.1f} {y - 3:.1f}v6m0 -3h{length:.1f}m0 -3v6" {AXIS} stroke-opacity="1"/>'
                 f'<text x="{left + length + 6:.1f}" y="{y + 3:.1f}">{bar:g} px (drawn × {factor / scale:.0f}'
                 f'{cut_words(share[longest])})</text>')
    what = f"Residuals over the format, rms {rms:.2f} px" if isinstance(of, Vectors) else "Mean residual field on the format"
    return _svg(what, width, h + 20, "".join(parts))


def _middle(interior: Interior, scale: float, left: float) -> str:
    """A cross at the principal point."""
    x, y = (interior.pixels(interior.principal_point) + 0.5) * scale
    return f'<path d="M{left + x - 4:.1f} {1 + y:.1f}h8m-4 -4v8" {AXIS}/>'


def profile_svg(of: Profile, width: int = 386, height: int = 130) -> str:
    """Mean radial residual by radius with twice its standard error; the spread of single residuals pale behind."""
    left, right, top, bottom = 44, 8, 8, 30
    if not len(of.radius):
        return ""
    most = float(np.max(np.abs(of.mean) + np.maximum(2 * of.error, of.spread)))
    most = max(most, 1e-3)
    far = float(of.radius.max() * 1.06)

    def x(r: float) -> float:
        return left + r / far * (width - left - right)

    def y(value: float) -> float:
        return top + (most - value) / (2 * most) * (height - top - bottom)

    step = nice(most / 1.01)
    parts = [f'<line x1="{left}" x2="{width - right}" y1="{y(t):.1f}" y2="{y(t):.1f}" {AXIS} '
             f'stroke-width="{1 if t == 0 else 0.5}"/><text x="{left - 4}" y="{y(t) + 3:.1f}" text-anchor="end">{t:+g}</text>'
             for t in (-step, 0.0, step)]
    tick = nice(far / 3)
    parts += [f'<text x="{x(r):.1f}" y="{height - bottom + 12}" text-anchor="middle">{r:g}</text>'
              for r in np.arange(0, far, tick)]
    upper = [f"{x(r):.1f},{y(m + s):.1f}" for r, m, s in zip(of.radius, of.mean, of.spread, strict=True)]
    lower = [f"{x(r):.1f},{y(m - s):.1f}" for r, m, s in zip(of.radius, of.mean, of.spread, strict=True)]
    colour = css(theme.RESIDUAL)
    parts.append(f'<polygon points="{" ".join([*upper, *lower[::-1]])}" fill="{colour}" fill-opacity=".12"/>')
    line = " ".join(f"{x(r):.1f},{y(m):.1f}" for r, m in zip(of.radius, of.mean, strict=True))
    parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
    for r, m, e, n in zip(of.radius, of.mean, of.error, of.count, strict=True):
        parts.append(f'<g><title>{r:.2f} mm: {m:+.3f} ± {e:.3f} px, {n} measurements</title>'
                     f'<line x1="{x(r):.1f}" x2="{x(r):.1f}" y1="{y(m - 2 * e):.1f}" y2="{y(m + 2 * e):.1f}" stroke="{colour}"/>'
                     f'<circle cx="{x(r):.1f}" cy="{y(m):.1f}" r="2.6" fill="{colour}"/></g>')
    parts.append(f'<text x="{(left + width) / 2:.1f}" y="{height - 5}" text-anchor="middle">radius [mm]</text>'
                 f'<text transform="translate(9 {height / 2 - 8:.1f}) rotate(-90)" text-anchor="middle">v outwards [px]</text>')
    return _svg("Radial residual by radius", width, height, "".join(parts))


def correlation_svg(title: str, names: tuple[str, ...], covariance: np.ndarray, width: int = 386) -> str:
    """Correlation coefficients in percent on blue (negative) to orange (positive)."""
    sigma = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    r = np.clip(covariance / np.outer(sigma, sigma), -1, 1)
    n, left, top = len(names), 54, 16
    cell = min((width - left) / n, 44.0)
    tall = min(cell, 24.0)
    parts = []
    for i in range(n):
        parts.append(f'<text x="{left - 4}" y="{top + (i + 0.5) * tall + 3:.1f}" text-anchor="end">{esc(names[i])}</text>'
                     f'<text x="{left + (i + 0.5) * cell:.1f}" y="{top - 5}" text-anchor="middle">{esc(names[i])}</text>')
        for j in range(n):
            colour = theme.ORTHOGONAL if r[i, j] > 0 else theme.PERSPECTIVE
            ink = "" if abs(r[i, j]) < 0.5 else 'fill="#141414"' if r[i, j] > 0 else 'fill="#fff"'
            parts.append(f'<g><title>{esc(names[i])}, {esc(names[j])}: {r[i, j]:+.3f}</title>'
                         f'<rect x="{left + j * cell:.1f}" y="{top + i * tall:.1f}" width="{cell - 1:.1f}" '
                         f'height="{tall - 1:.1f}" fill="{css(colour)}" fill-opacity="{abs(r[i, j]):.2f}"/>'
                         f'<text x="{left + (j + 0.5) * cell:.1f}" y="{top + (i + 0.5) * tall + 3:.1f}" text-anchor="middle" '
                         f'{ink}>{100 * r[i, j]:.0f}</text></g>')
    return _svg(title, width, top + n * tall, "".join(parts))


def _svg(label: str, width: float, height: float, body: str) -> str:
    return (f'<svg role="img" aria-label="{esc(label)}" viewBox="0 0 {width} {height:.1f}" style="width:100%;max-width:560px" '
            f'font-size="9.5" fill="currentColor">{body}</svg>')
