"""Initial values without approximation: how often every start leads to the best solution, and what it costs."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..adjustment import Options, Trace, solve
from ..cameras import ideal_photo, project, project_derivatives
from ..geometry import Exterior, rotation
from ..orientation import Orthogonal, Resection, candidates, three_points
from ..orientation.initial import (
    apart,
    direct_linear,
    plane_homography,
    recentring,
    refine,
    scaled_orthography,
    turned,
    wide_triples,
)
from ..orientation.orthogonal_c import OrthogonalFreeC
from . import page
from .design import CAMERA, PITCH, TABLE_I, Sample, cluster

RUNS = 60
SEED = 2004
FOVS_DEG = (2.0, 10.0, 40.0)
TILTS_DEG = {"steep": (0.0, 5.0), "oblique": (25.0, 35.0), "slanting": (50.0, 60.0)}
COUNTS = (4, 6, 12)
RELIEFS = (0.0, 0.1, 0.5)  # of the width of the field
NOISE_PX = 0.3
FIRST_C = 34.0
UNKNOWN_C = tuple((fov, relief) for fov in (6.0, 20.0, 40.0) for relief in (5.0, 30.0))
Start = Callable[[np.ndarray, np.ndarray, float], list[Exterior]]


def _parallel(*kinds: str | float, updates: int = 2) -> Start:
    """Parallel rays in the re-centred photo."""
    def start(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
        r = recentring(xy, c)
        return [Exterior(r.T @ e.m, e.centre) for e in scaled_orthography(points, turned(xy, c, r), c, updates, kinds)]

    return start


def four_points(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    """Parallel rays through four points, the widest tetrahedron, which they determine without redundancy.

    Reference: after Kyle 2004, "Using parallel projection mathematics to orient an object relative to a single image".
    """
    order = np.argsort(-((points - points.mean(axis=0)) ** 2).sum(axis=1))[:8]
    sets = np.array(list(itertools.combinations(order, 4)))
    p = points[sets]
    volume = np.abs(np.linalg.det(p[:, 1:] - p[:, :1]))
    rows = sets[int(np.argmax(volume))]
    return _parallel("affine", updates=0)(points[rows], xy[rows], c)


def _three(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    return [e for rows in wide_triples(points) for e in three_points(points[rows], xy[rows], c)]


def _all(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    return [k.exterior for k in candidates(points, xy, c)[:1]]


STARTS: dict[str, tuple[Start, int, str]] = {
    "scaled orthography": (_parallel("affine"), 4, "space"),
    "both planar": (_parallel(1.0, -1.0), 4, "any"),
    "four points, parallel": (four_points, 4, "space"),
    "three points": (_three, 4, "any"),
    "direct linear": (direct_linear, 6, "space"),
    "homography": (plane_homography, 4, "plane"),
    "all, refined": (_all, 4, "any"),
}
"""Start, the number of points it needs, and whether it wants them in space or in a plane (nearly: relief 0.1)."""


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: starts.csv, starts-unknown-c.csv, starts-iterations.csv, two figures (PNG, SVG) and
    starts.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(SEED)
    rows: list[dict[str, Any]] = []
    for relief in RELIEFS:
        for view in TILTS_DEG:
            progress(f"starts: relief {relief:g}, {view}")
            for n, fov in itertools.product(COUNTS, FOVS_DEG):
                rows += cell(n, fov, relief, view, runs, rng)
    unknown, by_iteration = [], []
    for fov, relief in UNKNOWN_C:
        progress(f"starts: unknown principal distance, {fov:g} degrees, relief {relief:g} m")
        row, traces = unknown_c(fov, relief, runs, rng)
        unknown.append(row)
        by_iteration += [{"fov_deg": fov, "relief_m": relief, "total": total, "iteration": k, "off_mm": float(r.x[20] - CAMERA.c)}
                         for total, trace in traces.items() for k, r in enumerate(trace.rows)]
    files = [page.write_csv(folder / "starts.csv", rows), page.write_csv(folder / "starts-unknown-c.csv", unknown),
             page.write_csv(folder / "starts-iterations.csv", by_iteration), *figures(folder)]
    text = folder / "starts.md"
    text.write_text(_page(rows, unknown, runs), encoding="utf-8")
    return [*files, text]


def figures(folder: Path) -> list[Path]:
    """The figures, drawn from the tables in the folder."""
    return (_success_figure(folder, page.read_csv(folder / "starts.csv"))
            + _unknown_figure(folder, page.read_csv(folder / "starts-iterations.csv")))


def scene(n: int, fov: float, relief: float, view: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Exterior]:
    """Control (n, 3) m reduced to its centroid, its noisy ideal photo coordinates (n, 2) mm, and the true orientation.

    The points spread over a circle of the photo and a level field seen under a tilt; then the world is turned at random.
    """
    tilt, c = np.radians(rng.uniform(*TILTS_DEG[view])), CAMERA.c
    at = Exterior(rotation(tilt, 0, rng.uniform(-np.pi, np.pi)), np.array([0.0, 0.0, 300 * np.cos(tilt)]))
    angle, r = rng.uniform(0, 2 * np.pi, n), c * np.tan(np.radians(fov / 2)) * np.sqrt(rng.uniform(0, 1, n))
    rays = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(n, -c)]) @ at.m
    height = relief * 600 * np.tan(np.radians(fov / 2)) * rng.uniform(-0.5, 0.5, n)
    points = at.centre + rays * ((height - at.centre[2]) / rays[:, 2])[:, None]
    xy = ideal_photo(c, at, points) + rng.normal(0, NOISE_PX * PITCH, (n, 2))
    q, up = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(up))
    q = q * np.linalg.det(q)
    return (points - points.mean(axis=0)) @ q.T, xy, Exterior(at.m @ q.T, q @ (at.centre - points.mean(axis=0)))


def cell(n: int, fov: float, relief: float, view: str, runs: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """One kind of scene: for every start its success, its error before refinement and its cost."""
    use = {k: s for k, (s, least, want) in STARTS.items()
           if n >= least and (want == "any" or (want == "space") == (relief > 0) or (want == "plane" and relief == 0.1))}
    done = {k: [] for k in use}
    for _ in range(runs):
        points, xy, truth = scene(n, fov, relief, view, rng)
        ends, raw, micro = {}, {}, {}
        for name, start in use.items():
            begin = time.process_time()
            raw[name] = start(points, xy, CAMERA.c)
            micro[name] = (time.process_time() - begin) * 1e6
            ends[name] = _end(points, xy, raw[name])
        best, cost = min([*ends.values(), _end(points, xy, [truth])], key=lambda e: e[1])
        for name in use:
            end, value = ends[name]
            success = end is not None and best is not None and (apart(end, best) < np.radians(0.01) or value <= cost * (1 + 1e-6))
            off = min((apart(e, truth) for e in raw[name]), default=np.pi)
            done[name].append((success, np.degrees(off), micro[name]))
    return [{"start": k, "n": n, "fov_deg": fov, "relief": relief, "view": view, "runs": runs,
             "success": float(np.mean([d[0] for d in v])), "raw_error_deg": float(np.median([d[1] for d in v])),
             "us": float(np.median([d[2] for d in v]))} for k, v in done.items()]


def _end(points: np.ndarray, xy: np.ndarray, found: list[Exterior]) -> tuple[Exterior | None, float]:
    """The best solution refined from some starts and its cost."""
    ends, costs = refine(points, xy, CAMERA.c, found)
    if not len(costs) or not np.isfinite(costs.min()):
        return None, np.inf
    k = int(np.argmin(costs))
    return ends[k], float(costs[k])


# -- unknown principal distance ----------------------------------------------------------------------------------------------


def unknown_c(fov: float, relief: float, runs: int, rng: np.random.Generator) -> tuple[dict[str, Any], dict[bool, Trace]]:
    """The principal distance from one photo of 12 points, started 1 mm off: noise-free iterations with the total and with
    the printed, partial derivative; RMSE of c by the orthogonal and the perspective model, and its prediction [mm]."""
    points = cluster((0.0, 0.0), 12, fov, relief)
    at = project_derivatives(CAMERA, TABLE_I, points)
    sample = Sample.draw(points, NOISE_PX, runs, rng)
    sd = sample.sigma / PITCH
    j = np.concatenate([at.centre, at.rotation, at.interior[:, :, :1]], axis=2) / sd[:, None, None]
    predicted = float(np.sqrt(np.linalg.inv(np.einsum("nai,naj->ij", j, j))[6, 6]))
    traces = {total: _free(points, project(CAMERA, TABLE_I, points), sd, total) for total in (True, False)}
    found = []
    for seen, xy in zip(sample.seen, sample.xy, strict=True):
        pixels = CAMERA.pixels(xy)
        orthogonal = _free(seen, pixels, sd, True)
        problem = Resection(replace(CAMERA, c=FIRST_C), seen, pixels, np.eye(2) / (sd**2)[:, None, None], ("c",))
        perspective = solve(problem, problem.start(TABLE_I))
        found.append((orthogonal.last.x[20] - CAMERA.c, orthogonal.converged, perspective.last.x[12] - CAMERA.c,
                      perspective.converged))
    e = np.array(found, float)
    row = {"fov_deg": fov, "relief_m": relief, "predicted_mm": predicted,
           "orthogonal_mm": _rms(e[e[:, 1] > 0, 0]), "perspective_mm": _rms(e[e[:, 3] > 0, 2]),
           "orthogonal_converged": float(e[:, 1].mean()), "perspective_converged": float(e[:, 3].mean())}
    for total, name in ((True, "total"), (False, "partial")):
        trace = traces[total]
        right = trace.converged and abs(trace.last.x[20] - CAMERA.c) < 1e-3
        row |= {f"{name}_iterations": _arrival(trace), f"{name}_right": right, f"{name}_c_mm": float(trace.last.x[20])}
    return row, traces


def _free(points: np.ndarray, pixels: np.ndarray, sd_px: np.ndarray, total: bool) -> Trace:
    """The iteration of the printed form with c unknown, started at FIRST_C."""
    interior = replace(CAMERA, c=FIRST_C)
    model = Orthogonal(interior, points, pixels, np.eye(2) * (sd_px**2)[:, None, None], "printed", False)
    mean = points.mean(axis=0)
    first = candidates(points - mean, interior.ideal(pixels), FIRST_C)[0].exterior.shifted(-mean)
    start = np.append(model.start(model.affine_of(first)), FIRST_C)
    with np.errstate(all="ignore"):  # the partial derivative can run away
        return solve(OrthogonalFreeC(model, total), start, Options.gauss_newton(max_iterations=200))


def _arrival(trace: Trace) -> int | None:
    """The iteration from which c stays within a millionth of a millimetre of the truth; None when it never does."""
    far = np.flatnonzero([not abs(row.x[20] - CAMERA.c) < 1e-6 for row in trace.rows])
    first = int(far[-1]) + 1 if len(far) else 0
    return first if first < len(trace.rows) else None


def _rms(e: np.ndarray) -> float:
    return float(np.sqrt((e**2).mean())) if len(e) else float("nan")


# -- figures and the page ------------------------------------------------------------------------------------------------------


def _mean(rows: Sequence[dict[str, Any]], key: str, **want: Any) -> float | None:
    chosen = [r[key] for r in rows if all(r[k] == v for k, v in want.items())]
    return float(np.mean(chosen)) if chosen else None


_COLOURS = {"scaled orthography": "orthogonal", "both planar": "orthogonal", "four points, parallel": "printed",
            "three points": "perspective", "direct linear": "prior", "homography": "prior", "all, refined": "truth"}
_MARKERS = dict(zip(STARTS, "osv^Dx*", strict=True))


def _success_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(9.5, 4.4, ncols=3, sharey=True)
    for ax, relief in zip(axes, RELIEFS, strict=True):
        for i, name in enumerate(STARTS):
            y = [_mean(rows, "success", start=name, relief=relief, fov_deg=f) for f in FOVS_DEG]
            if y[0] is not None:
                x = np.arange(len(FOVS_DEG)) + (i - 3) * 0.1
                ax.plot(x, np.array(y, float) * 100, _MARKERS[name], color=page.COLOURS[_COLOURS[name]], ms=6, mfc="none",
                        label=name)
        ax.set_xticks(range(len(FOVS_DEG)), [f"{f:g}" for f in FOVS_DEG])
        ax.set(title="level control" if relief == 0 else f"relief {relief:g} of the width", xlabel="field of view [degrees]")
        ax.grid(axis="y", alpha=0.25)
    axes[0].set_ylabel("leads to the best solution [%]")
    handles = {label: h for ax in axes for h, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return page.save(fig, folder, "starts-success")


def _unknown_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = page.figure(8.5, 4.0, ncols=2, sharey=True)
    for ax, total in zip(axes, (True, False), strict=True):
        for (fov, relief), marker in zip(UNKNOWN_C, "os^vDx", strict=True):
            off = np.array([r["off_mm"] for r in rows if (r["fov_deg"], r["relief_m"], r["total"]) == (fov, relief, total)])
            ax.plot(np.maximum(np.abs(off), 1e-10), marker=marker, ms=4, lw=1, mfc="none",
                    color=page.COLOURS["orthogonal" if relief < 10 else "printed"], label=f"{fov:g}°, relief {relief:g} m")
        ax.set(yscale="log", xlabel="iteration", title="total derivative" if total else "partial derivative, as printed",
               xlim=(0, 60), ylim=(1e-10, 1e3))
        ax.grid(alpha=0.25)
    axes[0].set_ylabel("|c - 35 mm| [mm]")
    fig.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return page.save(fig, folder, "starts-unknown-c")


def _page(rows: list[dict[str, Any]], unknown: list[dict[str, Any]], runs: int) -> str:
    def percent(value: float | None) -> str:
        return "" if value is None else f"{value:.1%}"

    unit = _mean(rows, "us", start="three points") or 1.0
    overall = [[name, percent(_mean(rows, "success", start=name)), *(percent(_mean(rows, "success", start=name, relief=r))
                                                                      for r in RELIEFS),
                *(percent(_mean(rows, "success", start=name, fov_deg=f)) for f in FOVS_DEG),
                *(percent(_mean(rows, "success", start=name, n=n)) for n in COUNTS),
                *(percent(_mean(rows, "success", start=name, view=v)) for v in TILTS_DEG),
                _mean(rows, "raw_error_deg", start=name), _mean(rows, "us", start=name),
                (_mean(rows, "us", start=name) or 0.0) / unit] for name in STARTS]
    single = [name for name in STARTS if name != "all, refined"]
    best = max(single, key=lambda k: _mean(rows, "success", start=k) or 0.0)
    worst = min((r for r in rows if r["start"] == "all, refined"), key=lambda r: r["success"])
    cheap = min(single, key=lambda k: _mean(rows, "us", start=k) or np.inf)
    body = [[f"{u['fov_deg']:g}", f"{u['relief_m']:g}", u["predicted_mm"], u["orthogonal_mm"], u["perspective_mm"],
             percent(u["orthogonal_converged"]), 
             *("never" if u[k] is None else u[k] for k in ("total_iterations", "partial_iterations")),
             "right" if u["partial_right"] else f"wrong, c = {u['partial_c_mm']:.4g}"] for u in unknown]
    narrow = unknown[0]
    gap = max(abs(u["orthogonal_mm"] / u["perspective_mm"] - 1) for u in unknown if u["fov_deg"] <= 20)
    return page.flow(f"""# Initial values: every start, its success and its cost

Written by `collinea study starts --runs {runs}`; every number below comes from that run.

{COUNTS[0]} to {COUNTS[-1]} points seen by a 35 mm camera from 300 m over {FOVS_DEG[0]:g}, {FOVS_DEG[1]:g} or {FOVS_DEG[2]:g}
degrees, {NOISE_PX:g} px of noise; the field is level or has relief of
{RELIEFS[1]:g} or {RELIEFS[2]:g} of its width and is seen steeply (0 to 5 degrees off the vertical), obliquely (25 to 35) or
slantingly (50 to 60); then the whole
world is turned at random. {runs} scenes of each of {len(COUNTS) * len(FOVS_DEG) * len(RELIEFS) * len(TILTS_DEG)} kinds. A
start succeeds when least squares from it alone (from the best of its solutions, where it
has several) ends in the best solution found from any start or from the truth.

## Success and cost

{page.table(["start", "success", "level", *(f"relief {r:g}" for r in RELIEFS[1:]), *(f"{f:g}°" for f in FOVS_DEG),
             *(f"n = {n}" for n in COUNTS),
             *TILTS_DEG, "error before refinement [°]", "µs per call", "cost, three points = 1"], overall)}

The error is the median distance of the attitude from the truth before refinement. Costs are processor time of
this package as it is (parallel projections and refinement are compiled, the other starts are Python) on
the machine of the run; only their ratio travels.
"Scaled orthography" and "both planar" work in the photo re-centred to the mean ray, with two POSIT updates; "four points,
parallel" has none; "three points" tries
four wide triples; "all, refined" is what `resect` uses and its cost includes the refinement. The first, third and fifth need
points in space, the homography a plane (level, or relief 0.1).

![Success of every start](starts-success.png)

The best single start overall is {best} ({percent(_mean(rows, "success", start=best))}), the cheapest {cheap}. All together
succeed in {percent(_mean(rows, "success", start="all, refined"))}, in their
worst kind of scene in {percent(worst["success"])} ({worst["n"]} points, {worst["fov_deg"]:g} degrees, relief
{worst["relief"]:g}, {worst["view"]}).

## Unknown principal distance

One photo of 12 points with c unknown, started at {FIRST_C:g} mm for 35 mm (Ono & Hattori 2002, equations (15) and (16)).
Iterations without noise, with the total
derivative and with the partial one as printed; RMSE of c [mm] with {NOISE_PX:g} px from {runs} draws, and its prediction for
the perspective model:

{page.table(["field of view [°]", "relief [m]", "predicted", "orthogonal", "perspective", "orthogonal at rest",
             "iterations, total", "iterations, partial",
             "partial ends"], body)}

![The principal distance by iteration](starts-unknown-c.png)

Iterations count until c is right to a millionth of a millimetre. The total derivative gets there in
{sum(u["total_right"] for u in unknown)} of {len(unknown)} cases, after at most
{max((u["total_iterations"] or 0) for u in unknown)}; the partial one in {sum(u["partial_right"] for u in unknown)}, after up
to {max((u["partial_iterations"] or 0) for u in unknown)}. Up to 20 degrees the two models' RMSE differ by at most {gap:.0%}.
A cluster of {narrow["fov_deg"]:g} degrees with
{narrow["relief_m"]:g} m of relief determines c to ±{narrow["predicted_mm"]:.1f} mm only: keep c fixed there.
""")
