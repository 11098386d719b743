"""From half a degree to forty: how the models' errors grow as the field of view narrows, predicted and simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import erf, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from . import page
from .design import Sample, cluster, estimate, predict, summary, tilt_deg
from .estimators import Poses

RUNS = 1000
SEED = 2002
FOVS_DEG = (0.5, 1.0, 2.0, 4.0, 6.0, 10.0, 20.0, 30.0, 40.0)
RELIEFS_M = (0.0, 1.0, 5.0)
PRIORS = ((0.01, 0.05), (0.1, 1.0), (1.0, 5.0))
PLACES_MM = {"centre": (0.0, 0.0), "corner": (8.0, 5.0)}
SERIES = (("centre", 4, 0.3), ("centre", 4, 0.1), ("centre", 4, 0.5), ("centre", 10, 0.3), ("corner", 4, 0.3))
WIDEST_AT_CORNER = 10.0  # degrees; wider clusters would leave the photo
NECKER_FOVS = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0)
NECKER_SERIES = tuple((w, n, s) for w, n in (("centre", 4), ("corner", 4), ("centre", 10)) for s in (0.1, 0.3))
DETERMINED_DEG = 2.0  # predicted tilt error beyond which an image does not determine its orientation


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: fov.csv, fov-reversal.csv, five figures (PNG, SVG) and fov.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    rows: list[dict[str, Any]] = []
    for where, n, noise in SERIES:
        for fov in FOVS_DEG:
            if where == "corner" and fov > WIDEST_AT_CORNER:
                continue
            progress(f"fov: {where}, {n} points, {noise:g} px, {fov:g} degrees")
            for relief in RELIEFS_M:
                rows += cell(where, n, fov, relief, noise, runs, rng)
    progress("fov: reversal")
    necker = [reversal(w, n, fov, s, runs, rng) for w, n, s in NECKER_SERIES for fov in NECKER_FOVS]
    files = [page.write_csv(folder / "fov.csv", rows), page.write_csv(folder / "fov-reversal.csv", necker)]
    files += figures(folder)
    text = folder / "fov.md"
    text.write_text(_page(rows, necker, runs), encoding="utf-8")
    return [*files, text]


def figures(folder: Path) -> list[Path]:
    """The figures, drawn from the tables in the folder."""
    rows = page.read_csv(folder / "fov.csv")
    files = _tilt_figure(folder, rows) + _corner_figure(folder, rows) + _leak_figure(folder, rows)
    return files + _reversal_figure(folder, page.read_csv(folder / "fov-reversal.csv")) + _prediction_figure(folder, rows)


def cell(where: str, n: int, fov: float, relief: float, noise: float, runs: int,
         rng: np.random.Generator) -> list[dict[str, Any]]:
    """One geometry: a row for every method, simulated and predicted tilt [degrees]."""
    points = cluster(PLACES_MM[where], n, fov, relief)
    prediction = predict(points, noise, PRIORS)
    found = estimate(Sample.draw(points, noise, runs, rng), rng, PRIORS)
    rows = []
    for method, poses in found.items():
        named = {"Pbest": "P"}.get(method, method)
        rows.append({"where": where, "n": n, "fov_deg": fov, "relief_m": relief, "sigma_px": noise, "method": method,
                     **summary(poses), "tilt_predicted_deg": tilt_deg(prediction[named]),
                     "rho_printed": float(prediction["rho"]), "rho_recentred": float(prediction["rho_rc"])})
    return rows


def reversal(where: str, n: int, fov: float, noise: float, runs: int, rng: np.random.Generator) -> dict[str, Any]:
    """The two solutions of level control: D and their distance without noise, and how often the right one fits better."""
    points = cluster(PLACES_MM[where], n, fov, 0.0)
    exact = Sample.draw(points, noise, 1, rng)
    exact = Sample(points, points[None], exact.truth.project(points, 35.0), exact.sigma)
    (one, _), (two, cost) = exact.both_minima()
    apart = float(np.degrees(np.linalg.norm(one.error(two.m, two.centre)[0, 3:])))
    d = float(np.sqrt(2 * cost[0])) if apart > 0.01 else None
    (near, good), (far, bad) = Sample.draw(points, noise, runs, rng).both_minima()
    met = np.linalg.norm(near.error(far.m, far.centre)[:, 3:], axis=1) < 1e-6
    return {"where": where, "n": n, "fov_deg": fov, "sigma_px": noise, "D": d, "apart_deg": apart if d is not None else None,
            "predicted": _phi(d / 2) if d is not None else 1.0, "simulated": float((met | (good <= bad)).mean())}


def _phi(z: float) -> float:
    return 0.5 * (1 + erf(z / sqrt(2)))


def _pick(rows: Sequence[dict[str, Any]], **want: Any) -> list[dict[str, Any]]:
    return [r for r in rows if all(r[k] == v for k, v in want.items())]


# -- figures --------------------------------------------------------------------------------------------------------------


def _curves(ax: Any, rows: Sequence[dict[str, Any]], shown: Sequence[tuple[str, str, str, str]], **want: Any) -> None:
    """Simulated tilt as markers, predicted as lines; shown: method, colour, marker, label."""
    for method, colour, marker, label in shown:
        chosen = _pick(rows, method=method, **want)
        x = [r["fov_deg"] for r in chosen]
        rests = [not method.startswith("Oit") or r["rho_recentred"] < 1 for r in chosen]
        ax.plot(x, np.where(rests, [r["tilt_predicted_deg"] for r in chosen], np.nan), color=page.COLOURS[colour], lw=1,
                ls=":" if colour == "printed" else "-")
        ax.plot(x, [r["tilt_deg"] for r in chosen], marker, color=page.COLOURS[colour], ms=5, label=label,
                mfc="none" if marker in "os" else None)
    ax.set(xscale="log", yscale="log", xlabel="field of view [degrees]")
    ticks = [0.5, 1, 2, 4, 10, 20, 40]
    ticks = [t for t in ticks if t <= max(r["fov_deg"] for r in _pick(rows, **want))]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.grid(alpha=0.25)


def _tilt_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    shown = (("P", "perspective", "o", "perspective, near start"), ("Pbest", "perspective", "x", "perspective, no approximation"),
             ("Oitrc", "orthogonal", "s", "orthogonal, iterated"), ("O1rc_0.1_1", "orthogonal", "+", "one pass, prior 0.1° 1 m"),
             ("O1rc_1_5", "printed", "^", "one pass, prior 1° 5 m"), ("B_1_5", "prior", "D", "perspective with prior 1° 5 m"))
    fig, axes = page.figure(9.5, 4.4, ncols=3, sharey=True)
    for ax, relief in zip(axes, RELIEFS_M, strict=True):
        _curves(ax, rows, shown, where="centre", n=4, sigma_px=0.3, relief_m=relief)
        ax.set_title(f"relief {relief:g} m")
    axes[0].set(ylabel="tilt error [degrees]", ylim=(0.008, 30))
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return page.save(fig, folder, "fov-tilt")


def _corner_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    shown = (("P", "perspective", "o", "perspective, near start"),
             ("O1_1_5", "printed", "v", "one pass as printed, prior 1° 5 m"),
             ("O1rc_1_5", "orthogonal", "^", "one pass re-centred, prior 1° 5 m"),
             ("B_1_5", "prior", "D", "perspective with prior 1° 5 m"))
    fig, axes = page.figure(9.5, 4.2, ncols=3, sharey=True)
    for ax, relief in zip(axes, RELIEFS_M, strict=True):
        _curves(ax, rows, shown, where="corner", n=4, sigma_px=0.3, relief_m=relief)
        ax.set_title(f"corner, relief {relief:g} m")
    axes[0].set_ylabel("tilt error [degrees]")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return page.save(fig, folder, "fov-corner")


def _leak_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(8.5, 3.9, ncols=2, sharey=True)
    for ax, where in zip(axes, ("centre", "corner"), strict=True):
        for relief, marker in zip(RELIEFS_M, "o^s", strict=True):
            chosen = _pick(rows, where=where, n=4, sigma_px=0.3, relief_m=relief, method="P")
            x = [r["fov_deg"] for r in chosen]
            for key, colour, label in (("rho_printed", "printed", "as printed"), ("rho_recentred", "orthogonal", "re-centred")):
                ax.plot(x, [max(r[key], 1e-4) for r in chosen], color=page.COLOURS[colour], marker=marker, ms=5, lw=1,
                        ls="--" if colour == "printed" else "-", mfc="none", label=f"{label}, relief {relief:g} m")
        ax.axhline(1, color=page.COLOURS["truth"], lw=1)
        ax.set(xscale="log", yscale="log", xlabel="field of view [degrees]", title=f"cluster at the {where}")
        ticks = [0.5, 1, 2, 4, 10, 20, 40] if where == "centre" else [0.5, 1, 2, 4, 10]
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
        ax.grid(alpha=0.25)
    axes[0].set_ylabel("spectral radius of the prior leak [1]")
    axes[0].text(0.5, 1.15, "above: repetition runs away", fontsize=8, color=page.COLOURS["truth"])
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return page.save(fig, folder, "fov-leak")


def _reversal_figure(folder: Path, necker: list[dict[str, Any]]) -> list[Path]:
    fig, ax = page.figure(6.0, 4.0)
    d = np.linspace(0, 8, 200)
    ax.plot(d, [_phi(v / 2) for v in d], color=page.COLOURS["truth"], label="Φ(D/2)")
    for (where, n), marker in zip((("centre", 4), ("corner", 4), ("centre", 10)), "o^s", strict=True):
        chosen = [r for r in _pick(necker, where=where, n=n) if r["D"] is not None and r["D"] <= 8]
        ax.plot([r["D"] for r in chosen], [r["simulated"] for r in chosen], marker, mfc="none", ms=6,
                color=page.COLOURS["perspective"], label=f"simulated, {where}, {n} points")
    ax.set(xlabel="discrimination D [1]", ylabel="probability of the right choice [1]", ylim=(0.45, 1.02))
    ax.grid(alpha=0.25)
    ax.legend(frameon=False, fontsize=8)
    return page.save(fig, folder, "fov-reversal")


def _prediction_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, ax = page.figure(6.5, 4.2)
    for method, colour, marker in (("P", "perspective", "o"), ("O1rc_0.1_1", "orthogonal", "^"), ("O1_0.01_0.05", "printed", "v"),
                                   ("B_0.1_1", "prior", "D"), ("Oitrc", "orthogonal", "s")):
        chosen = [r for r in _pick(rows, method=method) if method != "Oitrc" or r["rho_recentred"] < 0.35]
        ax.plot([r["tilt_predicted_deg"] for r in chosen], [r["tilt_deg"] / r["tilt_predicted_deg"] for r in chosen], marker,
                color=page.COLOURS[colour], mfc="none", ms=4, label=_LABELS[method])
    ax.axhspan(0.9, 1.1, color="0.9", zorder=0)
    ax.axvline(DETERMINED_DEG, color=page.COLOURS["truth"], lw=1, ls="--")
    ax.set(xscale="log", xlabel="predicted tilt error [degrees]", ylabel="simulated / predicted [1]")
    ax.grid(alpha=0.25)
    ax.legend(frameon=False, fontsize=8)
    return page.save(fig, folder, "fov-prediction")


_LABELS = {"P": "perspective, near start", "O1rc_0.1_1": "one pass re-centred, prior 0.1° 1 m",
           "O1_0.01_0.05": "one pass as printed, prior 0.01° 0.05 m", "B_0.1_1": "perspective with prior 0.1° 1 m",
           "Oitrc": "orthogonal, iterated (radius below 0.35)"}


# -- the page -------------------------------------------------------------------------------------------------------------


def gains(rows: Sequence[dict[str, Any]], against: str = "P") -> list[tuple[float, dict[str, Any]]]:
    """Tilt error of `against` over that of each orthogonal method in the same geometry, the largest first."""
    base = {_key(r): r["tilt_deg"] for r in rows if r["method"] == against}
    found = [(base[_key(r)] / r["tilt_deg"], r) for r in rows if r["method"].startswith("O") and r["tilt_deg"] > 0]
    return sorted(found, key=lambda g: -g[0])


def _key(r: dict[str, Any]) -> tuple[Any, ...]:
    return r["where"], r["n"], r["fov_deg"], r["relief_m"], r["sigma_px"]


def _again(row: dict[str, Any], runs: int) -> tuple[float, float, float]:
    """The gain of a row's method over P with fresh random numbers, and its 95 % bootstrap interval over pairs."""
    rng = np.random.default_rng(SEED + 1)
    points = cluster(PLACES_MM[row["where"]], row["n"], row["fov_deg"], row["relief_m"])
    found = estimate(Sample.draw(points, row["sigma_px"], runs, rng), rng, PRIORS)
    a, b = (_squares(found[k]) for k in ("P", row["method"]))
    weights = rng.multinomial(runs, np.full(runs, 1 / runs), 400)
    many = np.sqrt((weights @ a) / (weights @ b))
    return float(np.sqrt(a.mean() / b.mean())), float(np.quantile(many, 0.025)), float(np.quantile(many, 0.975))


def _squares(poses: Poses) -> np.ndarray:
    from .design import errors

    return (errors(poses)[:, :2] ** 2).sum(axis=1)


def _place(r: dict[str, Any]) -> str:
    return (f"{r['where']}, {r['n']} points, {r['fov_deg']:g} degrees, relief {r['relief_m']:g} m, {r['sigma_px']:g} px")


def _page(rows: list[dict[str, Any]], necker: list[dict[str, Any]], runs: int) -> str:
    return page.flow("\n\n".join([f"""# The field of view: 0.5 to 40 degrees

Written by `collinea study fov --runs {runs}`; every number below comes from that run.

One photo of a 35 mm camera 300 m above the ground; {SERIES[0][1]} or {SERIES[3][1]} control points fill a circle of the field
of view, at the centre of the photo
or at its corner (8 mm, 5 mm), with {RELIEFS_M[0]:g}, {RELIEFS_M[1]:g} or {RELIEFS_M[2]:g} m of relief, 2 mm of error on the
ground and 0.1 to 0.5 px in the photo. Every case was drawn
{runs:,} times. Priors are named by their sigmas in degrees and metres. Lines are predictions by linear theory made before any
simulation
(the covariances of the methods section of the [clusters page](clusters.md)), markers the simulation; where repetition
runs away there is no prediction of the iterated model. `fov.csv` has every case.""",
                        _errors(rows), _gain(rows, runs), _leak(rows), _reversal(necker, runs)]))


def _errors(rows: list[dict[str, Any]]) -> str:
    head = ["field of view [°]", "P", "P predicted", "Pbest", "Oitrc", "O1rc_0.1_1", "O1rc_1_5", "B_0.1_1", "B_1_5"]
    out = ["## Errors of the tilt", "![Tilt error against field of view](fov-tilt.png)",
           "Centre, four points, 0.3 px: RMSE of the tilt in degrees (methods as on the clusters page)."]
    for relief in RELIEFS_M:
        body = []
        for fov in FOVS_DEG:
            m = {r["method"]: r for r in _pick(rows, where="centre", n=4, sigma_px=0.3, relief_m=relief, fov_deg=fov)}
            body.append([f"{fov:g}", m["P"]["tilt_deg"], m["P"]["tilt_predicted_deg"],
                         *(m[k]["tilt_deg"] for k in ("Pbest", "Oitrc", "O1rc_0.1_1", "O1rc_1_5", "B_0.1_1", "B_1_5"))])
        out += [f"Relief {relief:g} m:", page.table(head, body)]
    valid = [r for r in rows if r["method"] in ("P", "O1_0.01_0.05", "O1rc_0.1_1", "B_0.1_1")]
    low = [r["tilt_deg"] / r["tilt_predicted_deg"] for r in valid if r["tilt_predicted_deg"] <= 1]
    high = [r["tilt_deg"] / r["tilt_predicted_deg"] for r in valid if r["tilt_predicted_deg"] > DETERMINED_DEG]
    out += ["![Simulated over predicted](fov-prediction.png)",
            f"Where the predicted tilt error is at most 1 degree, simulated over predicted lies between "
            f"{min(low):.2f} and {max(low):.2f} "
            f"({sum(0.9 <= v <= 1.1 for v in low) / len(low):.0%} of {len(low)} values within 10 %: P, one pass with good "
            "priors, B). Beyond "
            f"{DETERMINED_DEG:g} degrees linear theory ends ({min(high):.2f} to {max(high):.2f}): the control does not "
            "determine the tilt, by either model, and only a registration of the cluster itself should be claimed."]
    wide = {r["method"]: r for r in _pick(rows, where="centre", n=4, sigma_px=0.3, relief_m=5.0, fov_deg=40.0)}
    out.append(f"\"None\" marks cases in which no run came to rest. At 40 degrees and 5 m of relief the perspective model has "
               f""
               f"{page.number(wide['P']['tilt_deg'])} degrees and one pass with a 1 degree, 5 m prior "
               f"{page.number(wide['O1rc_1_5']['tilt_deg'])}; "
               f"of the iterated orthogonal runs {wide['Oitrc']['converged']:.0%} came to rest.")
    return "\n\n".join(out)


def _gain(rows: list[dict[str, Any]], runs: int) -> str:
    determined = [r for r in rows if _pick(rows, method="P", **_named(r))[0]["tilt_predicted_deg"] <= DETERMINED_DEG]
    best, row = gains(determined)[0]
    again = _again(row, 4 * runs)
    p = _pick(rows, method="P", **_named(row))[0]
    anywhere, there = gains(rows)[0]
    predicted = max((_pick(rows, method="P", **_named(r))[0]["tilt_predicted_deg"] / r["tilt_predicted_deg"], i)
                    for i, r in enumerate(rows) if r["method"].startswith("O1") and "truth" not in r["method"])
    free, without = gains([r for r in determined if r["method"] in ("P", "Oitrc", "Oit")])[0]
    with_prior = []
    for tag in (f"{a:g}_{b:g}" for a, b in PRIORS):
        some = [r for r in determined if r["method"] in (f"B_{tag}", f"O1_{tag}", f"O1rc_{tag}")]
        with_prior.append(gains(some, f"B_{tag}")[0])
    bayes, against = max(with_prior, key=lambda g: g[0])
    unaided = [r for r in determined if r["method"] in ("Pbest", "Oitrc", "P")]
    choice, chosen = gains([r for r in unaided if r["method"] != "P"], "Pbest")[0]
    return f"""## The largest gain of the orthogonal model

Where the control determines the tilt (predicted error of P at most {DETERMINED_DEG:g} degrees), the largest ratio of the tilt
error of the prior-free
perspective model P to that of any orthogonal method is **{best:.2f}**: {row["method"]} with {row["tilt_deg"]:.3g} degrees
against {p["tilt_deg"]:.3g}
({_place(row)}). The largest of many ratios is flattered by chance, so that case was drawn again with fresh numbers,
{4 * runs:,} times:
{again[0]:.2f} (95 %: {again[1]:.2f} to {again[2]:.2f}). Linear theory predicts at most {predicted[0]:.2f} with these priors
({_place(rows[predicted[1]])},
{rows[predicted[1]]["method"]}). Over all geometries, determined or not, the largest simulated ratio is {anywhere:.2f}
({there["method"]}; {_place(there)}).

One pass owes such a gain to its approximation, which P may not use. Against the perspective
model with the same prior as weighted observations (B) the largest ratio is {bayes:.2f} ({against["method"]};
{_place(against)}). Iterated, without any prior in the end,
the orthogonal model reaches at most {free:.2f} against P ({without["method"]}; {_place(without)}). A perspective adjustment
that has no approximation
and must choose between two
reversal solutions by their residuals (Pbest) loses up to {choice:.2f} times against an orthogonal iteration started at the
right one ({_place(chosen)}):
that is the worth of an approximation, not of a model."""


def _named(r: dict[str, Any]) -> dict[str, Any]:
    return {k: r[k] for k in ("where", "n", "fov_deg", "relief_m", "sigma_px")}


def _leak(rows: list[dict[str, Any]]) -> str:
    six = {(r["where"], r["relief_m"]): r for r in _pick(rows, n=4, sigma_px=0.3, fov_deg=6.0, method="P")}
    table = page.table(["cluster", "relief [m]", "as printed", "re-centred"],
                       [[w, f"{z:g}", r["rho_printed"], r["rho_recentred"]] for (w, z), r in six.items()])
    worst = max((r for r in rows if r["method"] == "P"), key=lambda r: r["rho_printed"])
    small = [r for r in rows if r["method"] == "Oitrc" and r["rho_recentred"] < 0.3]
    p = {_key(r): r["tilt_deg"] for r in rows if r["method"] == "P"}
    fair = [r["tilt_deg"] / p[_key(r)] for r in small]
    return f"""## How much of the approximation comes through

One pass carries a share of the error of its approximation into the result: the prior leak K. Its spectral radius also tells
whether
repeating the pass converges (below 1). At 6 degrees:

{table}

![Spectral radius of the leak](fov-leak.png)

The largest printed radius in the sweep is {worst["rho_printed"]:.1f} ({_place(worst)}). At the corner the printed
transformation amplifies, the re-centred one does not:

![Tilt error of clusters at the corner](fov-corner.png)

Where the re-centred radius is below 0.3 ({len(small)} cases), the iterated orthogonal model has {min(fair):.2f} to
{max(fair):.2f} times the tilt error of P (median
{np.median(fair):.2f}): a linear, equivalent choice there when the median matters, no more. What it is really good for is
initial values without any approximation:
see the [starts page](starts.md)."""


def _reversal(necker: list[dict[str, Any]], runs: int) -> str:
    two = [r for r in necker if r["D"] is not None]
    gap = max(two, key=lambda r: abs(r["simulated"] - r["predicted"]))
    table = page.table(["cluster", "points", "field of view [°]", "noise [px]", "D", "apart [°]", "Φ(D/2)", "simulated"],
                       [[r["where"], r["n"], f"{r['fov_deg']:g}", f"{r['sigma_px']:g}", r["D"], r["apart_deg"], r["predicted"],
                         r["simulated"]] for r in two if r["D"] < 8])
    ones = sum(r["D"] is None for r in necker)
    return f"""## Level control: two solutions

A narrow photo of level ground has two attitudes that fit almost alike, the true one and its reversal. D is the root of the
chi-square by
which the false one fits worse without noise; the right one then has the smaller residuals with probability Φ(D/2). Of
{len(necker)} geometries {len(two)} have
two solutions, {ones} only one. Largest difference between Φ(D/2) and the simulation ({runs:,} draws each):
{abs(gap["simulated"] - gap["predicted"]):.3f}
({gap["where"]}, {gap["n"]} points, {gap["fov_deg"]:g} degrees, {gap["sigma_px"]:g} px, D = {gap["D"]:.1f}). Where D is below 8:

{table}

![Probability of the right choice](fov-reversal.png)"""
