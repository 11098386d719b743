"""Figures of a solution as SVG, pure: elements against their final values, correlations, residuals on the image format."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ..bundle_figures import cut_words, inside
from ..figures import NAMES, correlation, to_final
from ..ground import nice
from ..kept_run import kept_of
from ..scene import Sight, pale, sight
from ..state import MODELS, Photo, Solution, State
from ..theme import MODELS as COLOURS
from ..theme import PERSPECTIVE, RESIDUAL
from .plots import Curve, plot
from .widgets import MUTED, css, esc, jpeg, swatch

Button = Callable[[int, str], str]


def solutions(state: State) -> dict[str, Solution]:
    """The chosen image's solutions that have rows, by model."""
    return {m: s for m in MODELS if (s := state.solution(m)) and s.rows}


def elements_html(state: State, button: Button) -> str:
    """|element - final| of both models and of the run kept beside, over the rows, logarithmic: six plots on the slider's axis."""
    differences = {m: np.abs(to_final(s)) for m, s in solutions(state).items()}
    differences |= {f"{m} kept": np.abs(to_final(s)) for m, s in kept_of(state).items()}
    colours = COLOURS | {f"{m} kept": pale(COLOURS[m], state.view.dark) for m in MODELS}
    last = max((len(d) for d in differences.values()), default=1) - 1
    drawn = [
        plot(f"|{name} − final| {'m' if k < 3 else '°'}", [Curve(m, d[:, k], colours[m]) for m, d in differences.items()],
             min(state.shown_row, last), last, button)
        for k, name in enumerate(NAMES)
    ]
    rows = "".join(f'<div style="display:flex">{"".join(drawn[k : k + 3])}</div>' for k in (0, 3))
    return f'<div style="margin-top:6px">{rows}</div>'


def correlation_html(state: State) -> str:
    """Both solutions' correlation matrices side by side; they belong to the last row."""
    maps = [_heat(model, matrix) for model, s in solutions(state).items() if (matrix := correlation(s)) is not None]
    if not maps:
        return f"<div {MUTED}>No correlation: no solution has ended.</div>"
    scale = f"{swatch(PERSPECTIVE)}−1 … 0 … {swatch(RESIDUAL)}+1"
    return (
        f'<div style="margin-top:6px;display:flex;gap:8px">{"".join(maps)}</div>'
        f"<div {MUTED}>{scale} · in hundredths, of the adjusted elements (last row)</div>"
    )


def _heat(model: str, matrix: np.ndarray) -> str:
    cell, left, top = 30, 16, 30
    parts = [f'<text x="{left}" y="11" font-weight="600" fill="currentColor">{esc(model)}</text>']
    for i, name in enumerate(NAMES):
        middle = (i + 0.5) * cell
        parts.append(f'<text x="{left + middle}" y="{top - 5}" text-anchor="middle">{name}</text>')
        parts.append(f'<text x="{left - 4}" y="{top + middle + 3}" text-anchor="end">{name}</text>')
        for j, other in enumerate(NAMES):
            r = float(matrix[i, j])
            x, y, colour = left + j * cell, top + i * cell, css(RESIDUAL if r > 0 else PERSPECTIVE)
            words = "1" if i == j else f"{100 * r:+.0f}".replace("-", "−")
            parts.append(
                f'<rect data-r="{r:.4f}" x="{x}" y="{y}" width="{cell - 1}" height="{cell - 1}" fill="{colour}" '
                f'fill-opacity="{0.85 * abs(r):.3f}"><title>{name}, {other}: {r:+.4f}</title></rect>'
                f'<text x="{x + (cell - 1) / 2}" y="{y + cell / 2 + 3}" text-anchor="middle" pointer-events="none">{words}</text>'
            )
    size = left + 6 * cell, top + 6 * cell
    return (
        f'<svg role="img" aria-label="Correlation, {esc(model)}" viewBox="0 0 {size[0]} {size[1]}" '
        f'style="width:49%" font-size="10" fill="currentColor">{"".join(parts)}</svg>'
    )


def residuals_html(state: State) -> str:
    """Residual vectors of both models over the chosen photo, from the measured point, exaggerated; with a scale bar."""
    sights = {m: s for m in MODELS if (s := sight(state, m)) is not None and len(s.names)}
    if not sights:
        return f"<div {MUTED}>No residual: nothing is measured here.</div>"
    camera = state.block.camera_of(state.image)
    w, h, unit = camera.width, camera.height, camera.width / 400
    longest = max(float(np.linalg.norm(np.nan_to_num(s.residuals), axis=1).max()) for s in sights.values())
    times = max(nice(0.12 * w / longest), 1.0) if longest > 0 else 1.0
    photo, shapes = state.assets.photos.get(state.image), []
    share = np.concatenate([inside(s.observed + 0.5, times * s.residuals, (w, h)) for s in sights.values()])
    for width, (model, seen) in zip((3.4, 1.6), reversed(sights.items()), strict=False):  # the finer one over the broader one
        shapes += _vectors(seen, times, unit, width, model)
    bar = nice(0.12 * w / times)
    x, y, length = 12 * unit, h - 14 * unit, bar * times
    words = f"{bar:g} px"
    shapes.append(
        f'<path d="M{x:.1f} {y - 3 * unit:.1f}v{6 * unit:.1f}M{x:.1f} {y:.1f}h{length:.1f}m0 {-3 * unit:.1f}v{6 * unit:.1f}" '
        f'stroke="#fff" stroke-width="{4 * unit:.1f}" fill="none"/>'
        f'<path d="M{x:.1f} {y - 3 * unit:.1f}v{6 * unit:.1f}M{x:.1f} {y:.1f}h{length:.1f}m0 {-3 * unit:.1f}v{6 * unit:.1f}" '
        f'stroke="#000" stroke-width="{1.5 * unit:.1f}" fill="none"/>'
        f'<text x="{x + length + 6 * unit:.1f}" y="{y + 4 * unit:.1f}" font-size="{12 * unit:.1f}" fill="#000" stroke="#fff" '
        f'stroke-width="{3 * unit:.1f}" paint-order="stroke">{words}</text>'
    )
    picture = f'<image href="{_picture(photo)}" width="{w}" height="{h}" preserveAspectRatio="none"/>' if photo else ""
    legend = " ".join(f"{swatch(COLOURS[m])}{m}" for m in sights)
    return (
        f'<svg role="img" aria-label="Residuals on the photo {esc(state.image)}" viewBox="0 0 {w} {h}" '
        f'style="display:block;width:min(100%,calc(38vh*{w / h:.4f}));margin-top:6px;background:rgba(128,128,128,.2)">'
        f'{picture}<rect width="{w}" height="{h}" fill="#fff" fill-opacity=".45"/>{"".join(shapes)}</svg>'
        f"<div {MUTED}>{legend} · observed − projected, × {times:g} to fit{cut_words(share)} · ring: not used</div>"
    )


def _vectors(seen: Sight, times: float, unit: float, width: float, model: str) -> list[str]:
    shapes, colour = [], css(COLOURS[model])
    for name, (col, row), (dx, dy), used in zip(seen.names, seen.observed, seen.residuals, seen.used, strict=True):
        if not np.isfinite([col, row, dx, dy]).all():
            continue
        x, y = col + 0.5, row + 0.5
        hint = f"{esc(name)}, {model}: {dx:+.2f}, {dy:+.2f} px"
        fill = colour if used else "#fff"
        shapes.append(
            f'<g data-residual="{esc(name)}"><title>{hint}</title>'
            f'<path d="M{x:.1f} {y:.1f}l{dx * times:.1f} {dy * times:.1f}" '
            f'stroke="{colour}" stroke-width="{width * unit:.1f}"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{(1 + width) * unit:.1f}" '
            f'fill="{fill}" stroke="{colour}" stroke-width="{0.8 * unit:.1f}"/></g>'
        )
    return shapes


@lru_cache(maxsize=4)
def _picture(photo: Photo) -> str:
    return jpeg(photo.thumbnail, 75)
