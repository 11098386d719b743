"""Free networks by the orthogonal and the perspective model: Ono & Hattori's simulations over many runs, their field geometry,
and
what parallel rays leave free."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..orientation.bundle import coplanarity
from ..orientation.initial import direct_linear, scaled_orthography
from ..simulation import ono_triplet
from . import page
from .estimators import exponential
from .free_networks import (
    Networks,
    adjust,
    after_affinity,
    after_similarity,
    free_steps,
    parallel_coordinates,
    pooled,
    spectrum,
    stepped,
)
from .published_ono import CASES, FIELD, INTERVALS, PRINTED, PRINTED_C, QUANTITIES

RUNS = 500
SEED = 2002
MODELS = ("perspective", "orthogonal")
NOISE_MM = 0.001
FIELD_MM = 0.0026
"""Noise of the field's photo coordinates: a quarter of a pixel, the size of the printed sigma0."""
SPANS_DEG = (60, 30)
RELIEFS_M = (1.5, 0.2)
TURN = 0.1
"""Rotation [rad] at which a step is shortened where the repetition is held back."""
METHODS = {"perspective": ("perspective", np.inf), "orthogonal": ("orthogonal", np.inf),
           "orthogonal, held back": ("orthogonal", TURN)}
STARTS = ("coarse", "affine", "DLT")
FALSE = 2.0
"""Perspective residuals, over the noise, beyond which a place of rest is a false fixed point."""
ZERO = 1e-10


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: ono-tables.csv, ono-indefinite.csv, ono-deformation.csv, ono-field.csv, four figures (PNG,
    SVG)
    and ono.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    tables: list[dict[str, Any]] = []
    for case in CASES:
        progress(f"ono: Table {case}")
        for model in MODELS:
            tables += table(case, model, runs, rng)[0]
    progress("ono: what stays free")
    free, bent = indefinite(), deformation()
    field: list[dict[str, Any]] = []
    for relief in RELIEFS_M:
        for span in SPANS_DEG:
            progress(f"ono: field, relief {relief:g} m, span {span} degrees")
            for images in (5, 3):
                field += field_cell(span, relief, images, runs, rng)
    files = [page.write_csv(folder / "ono-tables.csv", tables), page.write_csv(folder / "ono-indefinite.csv", free),
             page.write_csv(folder / "ono-deformation.csv", bent), page.write_csv(folder / "ono-field.csv", field)]
    files += figures(folder)
    text = folder / "ono.md"
    text.write_text(_page(tables, free, bent, field, runs), encoding="utf-8")
    return [*files, text]


def figures(folder: Path) -> list[Path]:
    """The figures, drawn from the tables in the folder."""
    field = page.read_csv(folder / "ono-field.csv")
    return (_tables_figure(folder, page.read_csv(folder / "ono-tables.csv"))
            + _deformation_figure(folder, page.read_csv(folder / "ono-deformation.csv"))
            + _field_figure(folder, field) + _rate_figure(folder, field))


# -- the simulations ---------------------------------------------------------------------------------------------------------


def simulated(images: int, runs: int, c: float, rng: np.random.Generator) -> tuple[Networks, np.ndarray, Networks]:
    """Truth, noisy photo coordinates (R, I, 12, 2) mm and start of the networks of their Table 1, with c to begin with [mm].

    Start: points and stations in error by 10 mm, attitudes by 2 degrees about each axis; the axes aim at the middle of the
    points.
    """
    scene = ono_triplet(0, noise=0.0)
    true = list(scene.exteriors.values())[:images]
    m, at, points = np.array([e.m for e in true]), np.array([e.centre for e in true]) * 1e3, scene.xyz * 1e3
    truth = Networks(np.full(runs, 300.0), *(np.broadcast_to(v, (runs, *v.shape)) for v in (m, at, points)))
    xy = truth.project() + rng.normal(0, NOISE_MM, (runs, images, len(points), 2))
    turn = exponential(np.radians(rng.normal(0, 2, (runs * images, 3)))).reshape(runs, images, 3, 3)
    start = Networks(np.full(runs, c), turn @ m, at + rng.normal(0, 10, (runs, images, 3)),
                     points + rng.normal(0, 10, (runs, len(points), 3)))
    return truth, xy, start


def table(case: str, model: str, runs: int, rng: np.random.Generator) -> tuple[list[dict[str, Any]], np.ndarray]:
    """One of Tables 2 to 5 by one model: a row for every quantity, and all runs' values (R, 13); failures would be NaN."""
    truth, xy, start = simulated(2 if case == "2" else 3, runs, 300.0 if case in "23" else 290.0, rng)
    defect = int((spectrum(truth.take(np.arange(1)), model, case == "5")[0] < ZERO).sum())
    done = adjust(xy, start, model, case == "5", defect)
    found = [np.column_stack([v, pooled(v)]) for v in (done.internal, after_similarity(done.networks.points, truth.points),
                                                       after_affinity(done.networks.points, truth.points))]
    values = np.column_stack([done.sigma0 * 1e3, *found])
    values[~done.converged] = np.nan
    rows = []
    for k, name in enumerate(QUANTITIES):
        v, printed, (low, high) = values[:, k], PRINTED[case][k], INTERVALS[case, model][k]
        p5, p25, p50, p75, p95 = np.nanpercentile(v, [5, 25, 50, 75, 95])
        rows.append({"table": case, "model": model, "quantity": name, "runs": runs, "converged": float(done.converged.mean()),
                     "defect": defect, "iterations": float(done.iterations.mean()), "mean": float(np.nanmean(v)), "p5": float(p5),
                     "p25": float(p25), "p50": float(p50), "p75": float(p75), "p95": float(p95), "reference_p5": low,
                     "reference_p95": high, "printed": printed, "printed_inside": bool(p5 <= printed <= p95),
                     "printed_quantile": float((v < printed).mean())})
    if case == "5":
        c = done.networks.c
        rows.append({"table": case, "model": model, "quantity": "c", "runs": runs, "converged": float(done.converged.mean()),
                     "defect": defect, "mean": float(c.mean()), "p5": float(np.percentile(c, 5)), "p50": float(np.median(c)),
                     "p95": float(np.percentile(c, 95)), "printed": PRINTED_C})
    return rows, values


# -- what stays free ---------------------------------------------------------------------------------------------------------


def indefinite() -> list[dict[str, Any]]:
    """For stereo, triplet and triplet with unknown c: the rank defects of four models' free networks, and the numbers that the
    coplanarity (17) and the rank-3 condition (19) determine, all counted by singular values at the true configuration."""
    out = []
    for images, free_c in ((2, False), (3, False), (3, True)):
        truth, _, _ = simulated(images, 1, 300.0, np.random.default_rng(0))
        row: dict[str, Any] = {"images": images, "c": "unknown" if free_c else "known"}
        for model in MODELS:
            values = spectrum(truth, model, free_c)[0]
            row[model] = int((values < ZERO).sum())
            row[f"{model}_next"] = float(values[row[model]])
        for name, projective in (("affine", False), ("dlt", True)):
            values = linear_spectrum(truth, projective)
            row[name] = int((values < ZERO).sum())
        s, m, t, xa, by_c = parallel_images(truth)
        a = np.concatenate([s[:, None, None] * m[:, :2], t[:, :, None]], axis=2)
        row["determinants"] = float(np.abs(coplanarity.determinants(a, xa)).max())
        ranks = np.linalg.svd(coplanarity.stacked(a, xa), compute_uv=False)
        row["fourth_singular_value"], row["third_singular_value"] = float(ranks[:, 3].max()), float(ranks[:, 2].min())
        for name, condition in (("determined_17", coplanarity.determinants), ("determined_19", coplanarity.minors)):
            row[name] = coplanarity.count(coplanarity.determined(s, m, t, xa, condition, by_c if free_c else None))
        row["unknowns"] = 6 * images + free_c
        row["left"] = row["unknowns"] - row["determined_17"]
        out.append(row)
    return out


def parallel_images(truth: Networks) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scales (I,), rotations (I, 3, 3), t (I, 2) mm, x_a (I, n, 2) mm and d x_a / d c (I, n, 2) of one network, points about
    their middle."""
    m, middle, c = truth.m[0], truth.points[0].mean(axis=0), float(truth.c[0])
    to = np.einsum("iab,ib->ia", m, middle - truth.centre[0])
    s = c / -to[:, 2]
    ahead = (truth.points[0] - middle) @ m[:, 2].T  # (n, I)
    xy = truth.project()
    return s, m, s[:, None] * to[:, :2], parallel_coordinates(truth, xy)[0], xy[0] * (s[:, None] * ahead.T / c**2)[..., None]


def linear_spectrum(truth: Networks, projective: bool) -> np.ndarray:
    """Eigenvalues, over the largest, of the scaled normal matrix of a free network of 11-parameter (projective) or 8-parameter
    (affine) images, smallest first."""
    s, m, t, _, _ = parallel_images(truth)
    x = truth.points[0] - truth.points[0].mean(axis=0)
    size = np.abs(x).max()
    x1 = np.column_stack([x / size, np.ones(len(x))])
    count, n, k = len(s), len(x), 11 if projective else 8
    j = np.zeros((count, n, 2, k * count + 3 * n))
    for i in range(count):
        p = np.column_stack([s[i] * m[i, :2] * size, t[i]]) / 300.0
        depth = np.array([*(-m[i, 2] * size * s[i] / 300.0), 1.0])
        w = x1 @ depth if projective else np.ones(n)
        uv = x1 @ p.T / w[:, None]
        for b in range(2):
            j[i, :, b, k * i + 4 * b:k * i + 4 * b + 4] = x1 / w[:, None]
            if projective:
                j[i, :, b, k * i + 8:k * i + 11] = -uv[:, b, None] * x1[:, :3] / w[:, None]
            by = (p[b, :3] - (uv[:, b, None] * depth[:3] if projective else 0.0)) / w[:, None]
            for q in range(n):
                j[i, q, b, k * count + 3 * q:k * count + 3 * q + 3] = by[q]
    flat = j.reshape(-1, j.shape[-1])
    flat = flat / np.linalg.norm(flat, axis=0)
    values = np.linalg.svd(flat, compute_uv=False) ** 2
    values = np.append(values, np.zeros(max(flat.shape[1] - len(values), 0)))[::-1]
    return values / values[-1]


def deformation(amounts: Sequence[float] = tuple(np.geomspace(0.01, 20, 12))) -> list[dict[str, Any]]:
    """The stereo pair without noise, deformed along the direction that its frozen normal equations leave free.

    amounts: root mean square deformation of the points [mm]. What residuals remain when everything else is adjusted: to the
    kept parallel coordinates, and to the perspective photo.
    """
    truth, _, _ = simulated(2, len(amounts), 300.0, np.random.default_rng(0))
    photo = truth.project()
    kept = parallel_coordinates(truth, photo)
    points, images = free_steps(truth, "frozen", 8)
    bend, along = _not_similar(points[0], truth.points[0]), images[0]
    step = bend * np.sqrt(bend.size / 3)  # 1 mm in the root mean square of a point
    share = np.linalg.lstsq(points[0], step, rcond=None)[0]
    scale = np.asarray(amounts, float)
    moved = stepped(truth, scale[:, None] * (along @ share), scale[:, None, None] * step.reshape(-1, 3), "frozen")
    out = []
    frozen = adjust(kept, moved, "frozen", False, 8)
    perspective = adjust(photo, moved, "perspective", False, 8)
    shape = pooled(after_similarity(frozen.networks.points, truth.points)) * np.sqrt(3)
    for k, a in enumerate(scale):
        out.append({"deformation_mm": float(a), "after_similarity_mm": float(shape[k]),
                    "frozen_residual_mm": float(frozen.sigma0[k] * np.sqrt(8 / 48)),
                    "perspective_residual_mm": float(perspective.residual[k])})
    return out


def _not_similar(free: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(3 n,) unit vector of the free directions (3 n, 8) that no similarity of the points (n, 3) makes."""
    x = points - points.mean(axis=0)
    moves = [np.tile(e, (len(x), 1)) for e in np.eye(3)] + [np.cross(e, x) for e in np.eye(3)] + [x]
    q = np.linalg.qr(np.array([v.ravel() for v in moves]).T)[0]
    u, s, _ = np.linalg.svd(free - q @ (q.T @ free), full_matrices=False)
    return u[:, 0] * (1.0 if s[0] > 0.5 else np.nan)


# -- the field ----------------------------------------------------------------------------------------------------------------


def field(span: float, relief: float, images: int, runs: int, rng: np.random.Generator) -> tuple[Networks, np.ndarray, Networks]:
    """Truth, noisy photo coordinates and coarse start of networks like the field test: 28 targets, 400 mm, 100 to 110 m.

    span: angle between the outer of five stations [degrees]; relief [m], drawn anew in every run; start: points rounded to 0.5
    m,
    stations in error by 1 m, attitudes by 0.01 rad. The paper does not print its geometry: this is one like it.
    """
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-2400, 2400, 7), np.linspace(-1400, 1400, 4)))
    z = 0.35 * y * relief + 1e3 * relief * (rng.uniform(size=(runs, 28)) - 0.5)
    points = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z], axis=-1)
    turn = np.radians(np.linspace(-span / 2, span / 2, 5))[slice(None) if images == 5 else slice(1, 4)]
    at = np.stack([105e3 * np.sin(turn), 2000 + 1500 * np.cos(3 * turn), 105e3 * np.cos(turn)], axis=-1)
    at = np.broadcast_to(at, (runs, images, 3))
    z_axis = at - points.mean(axis=1)[:, None]
    z_axis = z_axis / np.linalg.norm(z_axis, axis=-1, keepdims=True)
    x_axis = np.cross([0.0, 1.0, 0.0], z_axis)
    x_axis /= np.linalg.norm(x_axis, axis=-1, keepdims=True)
    m = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], axis=-2)
    truth = Networks(np.full(runs, 400.0), m, at, points)
    xy = truth.project() + rng.normal(0, FIELD_MM, (runs, images, 28, 2))
    turned = exponential(rng.normal(0, 0.01, (runs * images, 3))).reshape(m.shape) @ m
    return truth, xy, Networks(truth.c, turned, at + rng.normal(0, 1000, at.shape), np.round(points / 500) * 500)


def started(xy: np.ndarray, coarse: Networks, how: str) -> tuple[Networks, np.ndarray]:
    """A start and for which runs there is one: the coarse values themselves, or every image oriented by the coarse points with
    the
    direct linear transformation or the affine model (of a plane's two solutions the better)."""
    ok = np.ones(len(xy), bool)
    if how == "coarse":
        return coarse, ok
    m, centre = coarse.m.copy(), coarse.centre.copy()
    for r, points in enumerate(coarse.points):
        s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        for i in range(xy.shape[1]):
            c = float(coarse.c[r])
            if how == "DLT":
                found = direct_linear(points, xy[r, i], c) if s[2] > 1e-3 * s[0] else []
            else:
                found = scaled_orthography(points, xy[r, i], c, 0)
            off = [_misfit(e.camera(points), xy[r, i], c) for e in found]
            if not off or not np.isfinite(min(off)):
                ok[r] = False
                break
            best = found[int(np.argmin(off))]
            m[r, i], centre[r, i] = best.m, best.centre
    return Networks(coarse.c, m, centre, coarse.points), ok


def _misfit(cam: np.ndarray, xy: np.ndarray, c: float) -> float:
    if not (cam[:, 2] < 0).all():
        return np.inf
    return float(((xy + c * cam[:, :2] / cam[:, 2:]) ** 2).sum())


def field_cell(span: float, relief: float, images: int, runs: int, rng: np.random.Generator,
               starts: Sequence[str] = STARTS) -> list[dict[str, Any]]:
    """One geometry: a row for every c (known, unknown), start and method. Runs that fail, or come to rest at a false fixed
    point,
    count as infinitely far: there are no averages of survivors."""
    out = []
    for free_c in (True, False):
        truth, xy, coarse = field(span, relief, images, runs, rng)
        for how in starts if free_c else starts[:1]:
            start, ok = started(xy, coarse, how)
            for method, (model, turn) in METHODS.items():
                done = adjust(xy[ok], start.take(ok), model, free_c, 7, turn=turn)
                rest = done.converged.astype(bool)
                right = rest & (done.residual < FALSE * FIELD_MM)
                false = rest & ~right
                row: dict[str, Any] = {
                    "images": images, "span_deg": span, "relief_m": relief, "c": "unknown" if free_c else "known", "start": how,
                    "method": method, "runs": runs, "started": float(ok.mean()), "converged": float(rest.sum() / runs),
                    "false": float(false.sum() / runs), "right": float(right.sum() / runs),
                    "iterations": float(np.median(done.iterations[right])) if right.any() else float("nan")}
                for name, error in (("similarity", after_similarity), ("affinity", after_affinity)):
                    off = np.full(runs, np.inf)
                    off[np.flatnonzero(ok)[right]] = pooled(error(done.networks.points[right], truth.points[ok][right]))
                    row[f"{name}_p50_mm"], row[f"{name}_p90_mm"] = _quantiles(off, (0.5, 0.9))
                sigma = np.full(runs, np.inf)
                sigma[np.flatnonzero(ok)[right]] = done.sigma0[right] * 1e3
                row["sigma0_p50_um"] = _quantiles(sigma, (0.5,))[0]
                out.append(row)
    return out


def _quantiles(values: np.ndarray, at: Sequence[float]) -> list[float]:
    """Quantiles in which failures are infinite."""
    ordered = np.sort(values)
    return [float(ordered[min(int(q * len(ordered)), len(ordered) - 1)]) for q in at]


# -- figures ------------------------------------------------------------------------------------------------------------------


def _tables_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(9.5, 4.6, ncols=3)
    titles = ("sigma0 [µm]", "(3) after similarity [mm]", "(4) after affinity [mm]")
    for ax, k, title in zip(axes, (0, 8, 12), titles, strict=True):
        for x, case in enumerate(CASES):
            for side, model in ((-0.17, "perspective"), (0.17, "orthogonal")):
                (row,) = (r for r in _pick(rows, model=model, quantity=QUANTITIES[k]) if str(r["table"]) == case)
                p5, p25, p50, p75, p95 = (row[key] for key in ("p5", "p25", "p50", "p75", "p95"))
                colour = page.COLOURS[model]
                ax.plot([x + side] * 2, [p5, p95], color=colour, lw=1.5)
                ax.plot([x + side] * 2, [p25, p75], color=colour, lw=6, solid_capstyle="butt", alpha=0.6,
                        label=model if x == 0 else None)
                ax.plot(x + side, p50, "o", color="white", mec=colour, ms=4)
            ax.plot(x + 0.38, PRINTED[case][k], "D", color=page.COLOURS["truth"], ms=5,
                    label="printed, one run" if x == 0 else None)
        ax.set(title=title, yscale="log")
        page.plain_ticks(ax)
        ax.set_xticks(range(len(CASES)), [f"Table {c}" for c in CASES])
        ax.grid(axis="y", alpha=0.25)
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return page.save(fig, folder, "ono-tables")


def _deformation_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, ax = page.figure(6.5, 4.2)
    x = [r["deformation_mm"] for r in rows]
    for key, name, marker in (("perspective_residual_mm", "perspective photo (rays made parallel anew)", "o"),
                              ("frozen_residual_mm", "kept parallel coordinates", "s")):
        colour = page.COLOURS["perspective" if marker == "o" else "orthogonal"]
        ax.plot(x, np.maximum([r[key] * 1e3 for r in rows], 1e-10), marker + "-", color=colour, label=name, mfc="none")
    ax.axhline(NOISE_MM * 1e3, color="#999999", lw=1, ls="--")
    ax.text(x[0], NOISE_MM * 1e3 * 1.4, "noise of the photo, 1 µm", fontsize=8, color="#666666")
    ax.set(xscale="log", yscale="log", xlabel="deformation of the points along the free direction, rms [mm]",
           ylabel="residuals that remain, rms [µm]", title="A stereo pair bent: who notices?", ylim=(1e-11, 1e2))
    ax.grid(alpha=0.25)
    ax.legend(frameon=False, loc="center right")
    return page.save(fig, folder, "ono-deformation")


def _field_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(9.5, 4.2, ncols=2, sharey=True)
    colours = {"perspective": "perspective", "orthogonal": "orthogonal", "orthogonal, held back": "prior"}
    for ax, relief in zip(axes, RELIEFS_M, strict=True):
        labels = []
        cells = [(n, s) for n in (5, 3) for s in SPANS_DEG]
        for x, (images, span) in enumerate(cells):
            labels.append(f"{images} images\n{span}°")
            for k, method in enumerate(METHODS):
                (r,) = _pick(rows, relief_m=relief, images=images, span_deg=span, c="unknown", start="coarse", method=method)
                at = x + 0.22 * (k - 1)
                colour = page.COLOURS[colours[method]]
                if np.isfinite(r["similarity_p50_mm"]):
                    top = r["similarity_p90_mm"] if np.isfinite(r["similarity_p90_mm"]) else 40
                    ax.plot([at, at], [r["similarity_p50_mm"], top], color=colour, lw=1.5)
                    ax.plot(at, r["similarity_p50_mm"], "o", color=colour, ms=5, label=method if x == 0 else None)
                else:
                    ax.plot(at, 40, "x", color=colour, ms=7, label=method if x == 0 else None)
        ax.set_xticks(range(len(cells)), labels, fontsize=8)
        ax.set(title=f"relief {relief:g} m", yscale="log", ylim=(0.3, 60))
        page.plain_ticks(ax)
        ax.grid(axis="y", alpha=0.25)
    axes[0].set_ylabel("error after similarity [mm]\nmedian (dot) to 90 % of all runs")
    axes[1].text(0.02, 0.83, "× more than half of the runs fail", transform=axes[1].transAxes, fontsize=8)
    handles, labels = axes[1].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return page.save(fig, folder, "ono-field")


def _rate_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(9.5, 4.6, ncols=3, sharey=True)
    cells = [(z, n, s) for z in RELIEFS_M for n in (5, 3) for s in SPANS_DEG]
    for ax, method in zip(axes, METHODS, strict=True):
        for k, how in enumerate(STARTS):
            picked = [_pick(rows, relief_m=z, images=n, span_deg=s, c="unknown", start=how, method=method)[0]
                      for z, n, s in cells]
            y = np.arange(len(cells)) + 0.26 * (k - 1)
            shade = ("#444444", "#888888", "#bbbbbb")[k]
            ax.barh(y, [100 * r["right"] for r in picked], 0.24, color=shade, label=f"right, start {how}")
            ax.barh(y, [100 * r["false"] for r in picked], 0.24, left=[100 * r["right"] for r in picked],
                    color=page.COLOURS["residual"], label="false fixed point" if k == 0 else None)
        ax.set(title=method, xlabel="of all runs [%]", xlim=(0, 100))
    axes[0].set_yticks(range(len(cells)), [f"relief {z:g} m, {n} images, {s}°" for z, n, s in cells], fontsize=8)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return page.save(fig, folder, "ono-rates")


def _pick(rows: Sequence[dict[str, Any]], **want: Any) -> list[dict[str, Any]]:
    return [r for r in rows if all(r[k] == v for k, v in want.items())]


# -- the page -----------------------------------------------------------------------------------------------------------------


def _page(tables: list[dict[str, Any]], free: list[dict[str, Any]], bent: list[dict[str, Any]], rows: list[dict[str, Any]],
          runs: int) -> str:
    from .ono_page import written

    return written(tables, free, bent, rows, runs)


__all__ = ["CASES", "FIELD", "deformation", "field", "field_cell", "indefinite", "simulated", "started", "study", "table"]
