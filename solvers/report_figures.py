"""Figures of a report as SVG: plan of vectors, photo residuals, correlations, standardized residuals, iterations, overlap."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .legend import INKS

MOST_ELLIPSES = 60
"""Points with names and ellipses; more would hide each other."""
CONFIDENCE_2D = 2.4477
"""Half axes of a 95 % error ellipse in standard errors: sqrt of the chi-square of 2 degrees of freedom."""


def figure(width: float, height: float, **kwargs: Any) -> tuple[Any, Any]:
    """A matplotlib figure without a display, and its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(fig)
    return fig, fig.subplots(**kwargs)


def svg(fig: Any) -> str:
    """The figure as SVG, letters as outlines, the same text for the same figure."""
    from matplotlib import rc_context

    out = io.StringIO()
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": "collinea", "path.simplify": True}):
        fig.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg"):]


def _name_points(ax: Any, names: Sequence[str], xy: np.ndarray) -> None:
    """Names beside points (n, 2), each on the side where it covers the fewest points and names before it."""
    ax.figure.draw_without_rendering()  # so that the limits are those of the finished plan
    points = ax.transData.transform(xy) * 72 / ax.figure.dpi
    taken = [(p - 2.5, p + 2.5) for p in points]  # lower and upper corners in printer's points, the marks first
    for name, at, place in zip(names, points, xy, strict=True):
        size, best = np.array([3.6 * len(name), 6.0]), (np.inf, np.zeros(2), at, at)
        for side in ((1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0)):
            low = at + np.array([3.0 if side[0] > 0 else -3 - size[0], (2.5, -3.0, -8.5)[(1, 0, -1).index(side[1])]])
            covered = sum(bool((low < b).all() and (low + size > a).all()) for a, b in taken)
            if covered < best[0]:
                best = (covered, low - at, low, low + size)
        taken.append(best[2:])
        ax.annotate(name, place, xytext=best[1], textcoords="offset points", fontsize=6, color="#555555")


def plan(points: Sequence[Mapping[str, Any]], enlarged: float) -> str:
    """Plan of horizontal residual vectors and, where they are not too many, 95 % ellipses, both enlarged.

    points: xy (2,) in project coordinates, off (2 or 3,) m, covariance (2, 2) m^2 or None, name, role.
    """
    from matplotlib.patches import Ellipse

    fig, ax = figure(7.2, 4.9)
    every = np.vstack([p["xy"] for p in points])
    origin = np.floor(every.min(axis=0) / 100) * 100 if np.abs(every).max() > 1e4 else np.zeros(2)
    few = len(points) <= MOST_ELLIPSES
    for role, mark in (("control", "o"), ("check", "s")):
        of = [p for p in points if p["role"] == role]
        if not of:
            continue
        xy = np.array([p["xy"] for p in of]) - origin
        off = np.array([p["off"][:2] for p in of]) * enlarged
        ax.plot(*xy.T, mark, color=INKS[role], ms=4, label=f"{role} point", zorder=3)
        ax.quiver(*xy.T, *off.T, color=INKS["residual"], angles="xy", scale_units="xy", scale=1, width=0.003, zorder=2)
        for p, at in zip(of, xy, strict=True):
            if few and p.get("covariance") is not None:
                w, v = np.linalg.eigh(p["covariance"])
                size = 2 * CONFIDENCE_2D * np.sqrt(np.maximum(w, 0)) * enlarged
                ax.add_patch(Ellipse(at, size[1], size[0], angle=np.degrees(np.arctan2(v[1, 1], v[0, 1])), fill=False,
                                     edgecolor=INKS[role], lw=0.9))
    ax.set_aspect("equal", adjustable="datalim")
    if few:
        _name_points(ax, [p["name"] for p in points], every - origin)
    _map_axes(ax, origin)
    ax.legend(fontsize=7, loc="best")
    return svg(fig)


def scale_of(lengths: np.ndarray, extent: float) -> float:
    """A round enlargement (1, 2 or 5 times a power of ten) that draws the largest length as a tenth of the extent."""
    longest = float(np.max(lengths, initial=0.0))
    if longest <= 0 or extent <= 0:
        return 1.0
    raw = extent / 10 / longest
    power = 10.0 ** np.floor(np.log10(raw))
    return float(max(step for step in (1, 2, 5) if step * power <= raw) * power)


def photo_residuals(pixels: np.ndarray, residuals: np.ndarray, size: tuple[int, int], enlarged: float, colour: str) -> str:
    """Residuals (n, 2) px on the format, enlarged; row grows downwards as in the photo."""
    fig, ax = figure(7.2, max(2.6, min(4.6, 7.0 * size[1] / size[0])))
    ax.add_patch(_frame(size))
    ax.quiver(*pixels.T, *(residuals * enlarged).T, color=colour, angles="xy", scale_units="xy", scale=1, width=0.002)
    ax.plot(*pixels.T, ".", color=colour, ms=2)
    ax.set(xlim=(-0.03 * size[0], 1.03 * size[0]), ylim=(1.03 * size[1], -0.03 * size[1]), xlabel="col [px]", ylabel="row [px]")
    ax.set_aspect("equal")
    ax.tick_params(labelsize=7)
    return svg(fig)


def _frame(size: tuple[int, int]) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((-0.5, -0.5), *size, fill=False, edgecolor="#999999", lw=0.8)


def correlations(matrices: Mapping[str, np.ndarray], labels: Mapping[str, Sequence[str]]) -> str:
    """Correlation matrices as heat maps with their values, up to three beside each other."""
    names = list(matrices)
    widest = max(len(m) for m in matrices.values())
    fig, axes = figure(min(7.4, 2.6 * len(names) + 0.35 * widest), 2.9 + 0.14 * widest, ncols=len(names), squeeze=False)
    for ax, name in zip(axes[0], names, strict=True):
        m = matrices[name]
        ax.imshow(m, cmap="RdBu_r", vmin=-1, vmax=1)
        for (i, j), r in np.ndenumerate(m):
            if len(m) <= 12 and i != j:
                ax.text(j, i, f"{r:.2f}".replace("0.", "."), ha="center", va="center", fontsize=5.5,
                        color="white" if abs(r) > 0.6 else "#333333")
        ax.set_xticks(range(len(m)), labels[name], fontsize=6.5, rotation=90)
        ax.set_yticks(range(len(m)), labels[name], fontsize=6.5)
        ax.set_title(name, fontsize=8)
    return svg(fig)


def standardized(w: np.ndarray, critical: float) -> str:
    """Histogram of standardized residuals beside the standard normal they should follow."""
    fig, ax = figure(4.6, 2.4)
    reach = max(4.5, min(8.0, float(np.abs(w).max(initial=0.0)) + 0.5))
    ax.hist(np.clip(w, -reach, reach), bins=np.linspace(-reach, reach, 37), density=True, color=INKS["perspective"], alpha=0.4,
            edgecolor="white")
    t = np.linspace(-reach, reach, 200)
    ax.plot(t, np.exp(-t**2 / 2) / np.sqrt(2 * np.pi), color="#333333", lw=1)
    for side in (-critical, critical):
        ax.axvline(side, color=INKS["residual"], lw=0.8, ls="--")
    ax.set(xlabel="standardized residual w", ylabel="density")
    ax.tick_params(labelsize=7)
    return svg(fig)


def iterations(traces: Mapping[str, Sequence[Mapping[str, float]]]) -> str:
    """sigma0 and step by iteration, a line for each trace; blue perspective, orange orthogonal."""
    fig, axes = figure(7.2, 2.6, ncols=2)
    for name, rows in traces.items():
        colour = INKS["orthogonal" if name.endswith("orthogonal") else "perspective"]
        index = [r["index"] for r in rows]
        for ax, key in zip(axes, ("sigma0", "step"), strict=True):
            values = np.array([r[key] for r in rows], float)
            shown = np.isfinite(values) & (values > 0)
            ax.semilogy(np.array(index)[shown], values[shown], "o-", ms=2.5, lw=0.8, color=colour, alpha=0.6)
    low, high = axes[0].get_ylim()
    if high / low < 30:  # tick labels such as 2 x 10^0 help nobody
        axes[0].set_yscale("linear")
    axes[0].set(xlabel="iteration", ylabel="sigma0 (1 as expected)")
    axes[1].set(xlabel="iteration", ylabel="step [standard errors]")
    for ax in axes:
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.tick_params(labelsize=7)
        ax.grid(alpha=0.3, lw=0.4)
    return svg(fig)


def mosaic(picture: Path, bounds: Sequence[float], unit: str) -> str | None:
    """A small picture of a mosaic with the coordinates of its bounds (west, south, east, north); None where it cannot be read."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(picture) as file:
            rgba = np.asarray(file.convert("RGBA"))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None
    west, south, east, north = bounds
    origin = np.floor(np.array([west, south]) / 100) * 100 if max(map(abs, bounds)) > 1e4 else np.zeros(2)
    fig, ax = figure(7.2, min(6.0, max(2.6, 6.8 * (north - south) / max(east - west, 1e-9))))
    ax.imshow(rgba, extent=(west - origin[0], east - origin[0], south - origin[1], north - origin[1]), interpolation="nearest")
    _map_axes(ax, origin, unit)
    return svg(fig)


def _map_axes(ax: Any, origin: np.ndarray, unit: str = "m") -> None:
    for name, of, label in (("X", origin[0], ax.set_xlabel), ("Y", origin[1], ax.set_ylabel)):
        label(f"{name} [{unit}]" + (f" − {of:.0f}" if origin.any() else ""))
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.tick_params(labelsize=7)


def overlap(outlines: Sequence[np.ndarray], cameras: np.ndarray) -> tuple[str, dict[int, float]]:
    """How many photos see each place: the map, and the area [m^2] seen by 1, 2, 3 ... photos.

    outlines: rings (m, 2 or 3) in project coordinates.
    """
    from matplotlib.path import Path as Outline

    rings = [o[:, :2] for o in outlines]
    low, high = np.min([r.min(axis=0) for r in rings], axis=0), np.max([r.max(axis=0) for r in rings], axis=0)
    cell = float(max(high - low)) / 1000
    cols, rows = (np.ceil((high - low) / cell).astype(int) + 1).tolist()
    x, y = low[0] + (np.arange(cols) + 0.5) * cell, low[1] + (np.arange(rows) + 0.5) * cell
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    count = np.zeros(len(grid), int)
    for ring in rings:
        near = ((grid >= ring.min(axis=0)) & (grid <= ring.max(axis=0))).all(axis=1)
        count[near] += Outline(ring).contains_points(grid[near])
    origin = np.floor(low / 100) * 100 if np.abs(high).max() > 1e4 else np.zeros(2)
    fig, ax = figure(7.2, min(4.6, max(2.6, 6.4 * (high - low)[1] / (high - low)[0])))
    shown = np.ma.masked_equal(count.reshape(rows, cols), 0)
    (x0, y0), (x1, y1) = low - origin, low - origin + np.array([cols, rows]) * cell
    picture = ax.imshow(shown, origin="lower", extent=(x0, x1, y0, y1), cmap="viridis", vmin=0.5, vmax=count.max() + 0.5,
                        interpolation="nearest")
    for ring in rings:
        ax.plot(*(np.vstack([ring, ring[:1]]) - origin).T, color="white", lw=0.5)
    if len(cameras):
        ax.plot(*(cameras - origin).T, "^", color="black", markeredgecolor="white", markeredgewidth=0.6, ms=5.5)
    bar = fig.colorbar(picture, ax=ax, shrink=0.8, label="photos that see it")
    bar.ax.yaxis.get_major_locator().set_params(integer=True)
    _map_axes(ax, origin)
    return svg(fig), {int(k): float((count == k).sum() * cell**2) for k in np.unique(count) if k}
