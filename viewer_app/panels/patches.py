"""What a match looks like inside, as HTML: correlation, template, warped window, their difference, and the numbers."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solvers.matching import Stepped

from ..matching_state import Found, Matching
from ..theme import PERSPECTIVE, RESIDUAL
from .plots import Curve, plot
from .widgets import BOX, MUTED, css, decimals, esc, png, table


def found_html(m: Matching) -> str:
    """The match in view, at the row shown."""
    now = m.current
    if now is None or now.stepped is None:
        return ""
    return f"<div {BOX}>{pictures(now, m.row)}{numbers(now, m.row)}</div>"


def headline(found: Found) -> str:
    """One sentence: found or refused, and why."""
    who = esc(found.ask.point or "point")
    told = f" <span {MUTED}>predicted by {esc(found.guess.how)}</span>" if found.guess is not None else ""
    if found.ok:
        return f'<b>✓ {who} found in {esc(found.ask.second)}</b>{told}'
    return f'<b style="color:{css(RESIDUAL)}">✗ {who} not found in {esc(found.ask.second)}</b>: {esc(found.why)}.{told}'


def pictures(found: Found, row: int) -> str:
    """Correlation over the search window, template, warped window, difference."""
    stepped = found.stepped
    assert stepped is not None
    cells = [_figure(surface_png(stepped), "correlation", surface_words(stepped), _peak(found))]
    shown = stepped.patches(row)
    if shown is not None:
        low, high = np.nanpercentile(shown.template, [1, 99])
        reach = max(3.0 * float(np.nanstd(stepped.patches(10**6).difference)), 1e-6)  # type: ignore[union-attr]
        cells += [
            _figure(_grey(shown.template, low, high), "template", "the window in the left photo, as it is compared"),
            _figure(
                _grey(shown.warped, low, high),
                "warped",
                "the right photo's window, carried onto the template as this iteration has it",
            ),
            _figure(
                _signed(shown.difference, reach),
                f"difference ± {reach:.0f}",
                "template minus warped, grey values: blue below, orange above",
            ),
        ]
    return f'<div style="display:flex;gap:6px;margin-top:6px">{"".join(cells)}</div>'


def _figure(source: str, words: str, hint: str, over: str = "") -> str:
    return (
        f'<figure style="flex:1 1 0;min-width:0;max-width:170px;margin:0" title="{esc(hint)}"><div style="position:relative">'
        f'<img alt="{esc(words)}" src="{source}" style="display:block;width:100%;aspect-ratio:1;image-rendering:pixelated;'
        f'border:1px solid rgba(128,128,128,.5)">{over}</div><figcaption style="font-size:11px;opacity:.75">{esc(words)}'
        "</figcaption></figure>"
    )


def _peak(found: Found) -> str:
    """A ring around the correlation's peak."""
    stepped = found.stepped
    if stepped is None or not np.isfinite(stepped.surface).any():
        return ""
    side = len(stepped.surface)
    y, x = np.unravel_index(int(np.nanargmax(stepped.surface)), stepped.surface.shape)
    left, top = (100 * (v + 0.5) / side for v in (x, y))
    return (
        f'<span style="position:absolute;left:{left:.1f}%;top:{top:.1f}%;width:10px;height:10px;margin:-6px 0 0 -6px;'
        'border:1.5px solid #f0f;border-radius:50%"></span>'
    )


def surface_words(stepped: Stepped) -> str:
    reach = len(stepped.surface) // 2
    return f"correlation of the template at every whole pixel within {reach} px of the prediction: dark −1, bright 1"


@lru_cache(maxsize=16)
def surface_png(stepped: Stepped) -> str:
    """Grey-blue to yellow, −1 to 1; red where it is undefined."""
    t = np.nan_to_num((stepped.surface + 1) / 2)[..., None]
    colour = (1 - t) * (10, 12, 40) + t * (255, 240, 120)
    colour[~np.isfinite(stepped.surface)] = (120, 30, 30)
    return png(np.clip(colour, 0, 255).astype(np.uint8))


def _grey(values: np.ndarray, low: float, high: float) -> str:
    scaled = 255 * (np.nan_to_num(values, nan=low) - low) / max(high - low, 1e-9)
    return png(np.repeat(np.clip(scaled, 0, 255).astype(np.uint8)[..., None], 3, axis=2))


def _signed(values: np.ndarray, reach: float) -> str:
    t = np.clip(np.nan_to_num(values) / reach, -1, 1)[..., None]
    white, above, below = np.array([245.0, 245, 245]), np.array(RESIDUAL, float), np.array(PERSPECTIVE, float)
    return png((white + np.where(t > 0, t * (above - white), -t * (below - white))).astype(np.uint8))


_NOTE = "display:inline-block;white-space:normal;max-width:9em"
"""Of words beside numbers: they take a second line before a narrow panel cuts them."""


def numbers(found: Found, row: int) -> str:
    """Place, score and shape at the row shown, with what is known of the result beside it."""
    stepped = found.stepped
    assert stepped is not None
    ncc, lsm = stepped.ncc, stepped.lsm
    rows = []
    peak = ncc.pixel[0]
    if np.isfinite(peak).all():
        col, r = found.full(peak)
        unique = f"second peak {ncc.uniqueness[0]:.2f} of it" if ncc.count[0] else "no second peak"
        rows.append(("", ("NCC", f"{col:.2f}", f"{r:.2f}", f"{ncc.score[0]:.3f}", unique)))
    shown = stepped.patches(row)
    if shown is not None and stepped.rows:
        now = stepped.rows[min(row, len(stepped.rows) - 1)]
        col, r = found.full(now.x[[0, 3]])
        move = "start" if now.index == 0 else f"σ0 {now.sigma0:.2f} grey values{'' if now.stop is None else ', ' + now.stop}"
        rows.append(("", (f"LSM row {now.index}", f"{col:.3f}", f"{r:.3f}", f"{shown.score:.4f}", move)))
    if found.pixel is not None and found.sigma is not None:
        sigma, pixel = found.sigma, found.pixel
        places = decimals(float(sigma.min()), 4)
        gain = 1 + lsm.radiometric[0, 1]
        rows.append(
            (
                "",
                (
                    "result",
                    f"<b>{pixel[0]:.{places}f}</b>",
                    f"<b>{pixel[1]:.{places}f}</b>",
                    f"{lsm.score[0]:.4f}",
                    f"gain {gain:.2f}, {int(lsm.kept[0])} of 6 parameters",
                ),
            )
        )
        rows.append(
            ("", ("σ [px]", f"±{sigma[0]:.{places}f}", f"±{sigma[1]:.{places}f}", "", f"noise {lsm.noise[0]:.1f} grey values"))
        )
    if not rows:
        return ""
    rows = [(title, (*cells[:-1], f'<span style="{_NOTE}">{cells[-1]}</span>')) for title, cells in rows]
    return f'<div style="margin-top:4px">{table(("", "col", "row", "score", ""), rows, "Match")}</div>{plots(stepped, row)}'


def plots(stepped: Stepped, row: int) -> str:
    """σ0, score left to 1, and move per iteration."""
    if len(stepped.rows) < 2:
        return ""
    at = min(row, len(stepped.rows) - 1)
    x = np.array([r.x for r in stepped.rows])
    scores = np.array([stepped.patches(n).score for n in range(len(stepped.rows))])  # type: ignore[union-attr]
    moves = np.concatenate([[np.nan], np.linalg.norm(np.diff(x[:, [0, 3]], axis=0), axis=1)])
    curves = (("σ0 [grey values]", np.array([r.sigma0 for r in stepped.rows])), ("1 − score", 1 - scores), ("move [px]", moves))
    drawn = "".join(
        plot(title, [Curve("LSM", values, PERSPECTIVE)], at, len(stepped.rows) - 1, lambda r, hint: f'title="{esc(hint)}"')
        for title, values in curves
    )
    return f'<div style="margin-top:4px;display:flex">{drawn}</div>'
