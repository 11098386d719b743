"""Bundle adjustment beside pycolmap (Ceres): the same simulated blocks, from the same start to the same cost.

    python benchmarks/bundle.py [images ...] [--threads N] [--free c,xp,yp] [--covariance]

Every run is a process of its own. Blocks: double grids of near-vertical photos, 35 mm, 6000 x 4000 px, 120 m, noise 0.3 px, about
seven rays to a point; start off by 0.5 m and 0.5 degrees, c by 0.4 %. The camera has no distortion and c, xp, yp are adjusted, so
that our photo-to-ideal correction and pycolmap's SIMPLE_PINHOLE are the same model and the costs can be compared digit by digit;
with --free every freed parameter of ours is paid for in time, and the peer stays as it is.
pycolmap runs hand-tuned (centred coordinates, free gauge, function tolerance 1e-8) and by its defaults, where it is installed.
CPU seconds disturb least on a busy machine; peak memory is that of the whole process, and above what the imports
and the block took. --tools chooses some of: collinea, tuned, defaults. After each block the ratios to the first tool are printed.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from solvers import Interior
from solvers.geometry import exp, rotation, to_opencv
from solvers.geometry.pose import Exterior

PIXEL, WIDTH, HEIGHT, NOISE = 0.00392, 6000, 4000, 0.3
TRUE = Interior(35.0, 0.02, -0.015, pixel_mm=PIXEL, width=WIDTH, height=HEIGHT)
START = Interior(35.14, pixel_mm=PIXEL, width=WIDTH, height=HEIGHT)


def block(m: int, points_per_image: int = 200) -> dict[str, Any]:
    """Start values and observations (sorted by point) of a block of m images, every point in three to twelve of them."""
    rng = np.random.default_rng(m)
    wide, high = np.array([WIDTH, HEIGHT]) * PIXEL / TRUE.c * 120.0
    rows = max(2, int(np.sqrt(m / 2)))
    columns = -(-(m // 2) // rows)
    step = np.array([0.4 * wide, 0.2 * high])
    size = step * [rows - 1, columns - 1]
    grid = [(i * step[0], j * step[1], 120.0, np.pi * (i % 2)) for i in range(rows) for j in range(columns)][:m // 2]
    across = m - len(grid)
    lines = max(2, int(np.sqrt(across * size[1] / max(size[0], 1) / 2)))
    each = -(-across // lines)
    grid += [(u * size[0] / max(each - 1, 1), v * size[1] / (lines - 1), 150.0, np.pi / 2 * (-1) ** v)
             for v in range(lines) for u in range(each)][:across]
    plan = np.array(grid)
    centres = plan[:, :3] + rng.normal(0, [1.5, 1.5, 1.0], (m, 3))
    tilts = np.radians(rng.normal(0, 2.5, (m, 2)))
    ms = [rotation(o, p, k + np.radians(rng.normal(0, 4))) for (o, p), k in zip(tilts, plan[:, 3], strict=True)]
    n = m * points_per_image
    xyz = np.column_stack([rng.uniform(-0.3 * wide, size[0] + 0.3 * wide, n), rng.uniform(-0.3 * high, size[1] + 0.3 * high, n),
                           np.zeros(n)])
    xyz[:, 2] = 6 * (np.sin(xyz[:, 0] / 40) * np.cos(xyz[:, 1] / 55) + 1)
    image, point, pixel = _seen(centres, ms, xyz, rng)
    return {
        "poses": np.array([Exterior(exp(np.radians(rng.normal(0, 0.5, 3))) @ r, c + rng.normal(0, 0.5, 3)).vector
                           for r, c in zip(ms, centres, strict=True)]),
        "xyz": xyz[np.unique(point)] + rng.normal(0, 0.5, (len(np.unique(point)), 3)),
        "image": image, "point": np.unique(point, return_inverse=True)[1], "pixel": pixel,
    }


def _seen(centres: np.ndarray, ms: list[np.ndarray], xyz: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Image, point and pixel of the observations, sorted by point and image."""
    from scipy.spatial import KDTree

    tree, found = KDTree(xyz[:, :2]), []
    for i, (r, c) in enumerate(zip(ms, centres, strict=True)):
        near = np.array(tree.query_ball_point(c[:2], c[2] * 0.45))
        uvw = (xyz[near] - c) @ r.T
        pixel = TRUE.pixels(-TRUE.c * uvw[:, :2] / uvw[:, 2:] + TRUE.principal_point)
        ok = TRUE.inside(pixel, -20) & (rng.random(len(near)) < 0.6)
        found.append((np.full(int(ok.sum()), i), near[ok], pixel[ok]))
    image, point, pixel = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((rng.random(len(point)), point))
    image, point, pixel = image[order], point[order], pixel[order]
    first = np.searchsorted(point, point)
    keep = np.arange(len(point)) - first < rng.integers(3, 13, len(xyz))[point]
    keep &= np.bincount(point[keep], minlength=len(xyz))[point] >= 3
    image, point, pixel = image[keep], point[keep], pixel[keep]
    order = np.lexsort((image, point))
    return image[order], point[order], (pixel + rng.normal(0, NOISE, pixel.shape))[order]


# -- the runs, each in a process of its own -----------------------------------------------------------------------------------


def run_ours(b: dict[str, Any], threads: int, free: tuple[str, ...], covariance: bool) -> dict[str, Any]:
    from solvers.adjustment import Options, solve
    from solvers.orientation.bundle.compiled import Compiled
    from solvers.orientation.bundle.datum import Inner
    from solvers.orientation.bundle.given import _sorted
    from solvers.orientation.bundle.network import Network
    from solvers.orientation.bundle.problem import Bundle

    def problem() -> tuple[Bundle, np.ndarray]:
        n, m = len(b["xyz"]), len(b["poses"])
        order = _sorted(b["image"], b["point"], np.zeros(n, bool), n)
        place = np.argsort(order)
        rows = np.lexsort((b["image"], place[b["point"]]))
        middle = b["xyz"].mean(axis=0)
        net = Network(tuple(map(str, range(m))), ("camera",), (START,), np.zeros(m, int), tuple(map(str, order)),
                      b["image"][rows],
                      place[b["point"]][rows], b["pixel"][rows], np.ones(len(rows)), (free,), np.full((n, 3), np.nan),
                      np.zeros((n, 3)),
                      n, (None,) * m)
        compiled = Compiled(net, threads)
        _ = compiled.pattern, compiled.lut  # the analysis belongs to the building
        poses = b["poses"].copy()
        poses[:, :3] -= middle
        return Bundle(net, None, compiled), net.pack(poses, START.parameters[None], (b["xyz"] - middle)[order])

    options = Options(cost_tolerance=1e-8, step_tolerance=1e-7)
    warm, x = problem()
    solve(warm, x, Options(max_iterations=1))  # compilation, or loading from the cache, is not counted
    if covariance and isinstance(warm.compiled, Compiled):
        warm.compiled.judge(x, warm.prior_rows(x), Inner(np.arange(len(b["xyz"])), b["xyz"]), observations=False)
    t0 = time.perf_counter()
    made, x = problem()
    t1, c1 = time.perf_counter(), time.process_time()
    trace = solve(made, x, options)
    out = {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": trace.last.cost,
           "iterations": trace.iterations}
    if covariance:
        from dataclasses import replace

        inner = Inner(np.arange(len(b["xyz"])), made.network.split(trace.last.x)[2].copy())
        t2, c2 = time.perf_counter(), time.process_time()
        held = replace(made, inner=inner)
        assert isinstance(made.compiled, Compiled)
        made.compiled.judge(trace.last.x, held.prior_rows(trace.last.x), inner, observations=False)
        out |= {"covariance": time.perf_counter() - t2, "covariance cpu": time.process_time() - c2}
    return out


def run_pycolmap(b: dict[str, Any], threads: int, tuned: bool, covariance: bool) -> dict[str, Any]:
    import pycolmap  # pyright: ignore[reportMissingImports]

    pycolmap.logging.minloglevel = 2
    t0 = time.perf_counter()
    middle = b["xyz"].mean(axis=0) if tuned else np.zeros(3)
    reconstruction, m = pycolmap.Reconstruction(), len(b["poses"])
    c = START.pixels(START.principal_point)
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[START.c / PIXEL, *c])
    camera.camera_id = 1
    reconstruction.add_camera_with_trivial_rig(camera)
    order = np.argsort(b["image"], kind="stable")
    begin = np.searchsorted(b["image"][order], np.arange(m + 1))
    place = np.empty(len(order), int)
    place[order] = np.arange(len(order)) - np.repeat(begin[:-1], np.diff(begin))
    for i in range(m):
        image = pycolmap.Image(name=f"{i}", keypoints=b["pixel"][order[begin[i]:begin[i + 1]]], camera_id=1, image_id=i + 1)
        r, centre = to_opencv(Exterior.from_vector(b["poses"][i]))
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(r), -r @ (centre - middle)))
    ends = np.searchsorted(b["point"], np.arange(len(b["xyz"]) + 1))
    images, places = (b["image"] + 1).tolist(), place.tolist()
    for j, xyz in enumerate(b["xyz"] - middle):
        track = [pycolmap.TrackElement(images[k], places[k]) for k in range(ends[j], ends[j + 1])]
        reconstruction.add_point3D(xyz, pycolmap.Track(track))
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary, options.refine_principal_point = False, True
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations = threads, 100
    config = pycolmap.BundleAdjustmentConfig()
    for i in range(m):
        config.add_image(i + 1)
    if tuned:
        solver.function_tolerance = 1e-8
    else:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    t1, c1 = time.perf_counter(), time.process_time()
    summary = adjuster.solve().ceres_summary
    out = {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": summary.final_cost,
           "iterations": summary.num_successful_steps + summary.num_unsuccessful_steps}
    if covariance:
        t2, c2 = time.perf_counter(), time.process_time()
        wanted = pycolmap.BACovarianceOptions()
        wanted.params = pycolmap.BACovarianceOptionsParams.ALL
        done = pycolmap.estimate_ba_covariance(wanted, reconstruction, adjuster) is not None
        spent = (time.perf_counter() - t2, time.process_time() - c2) if done else (float("nan"),) * 2
        out |= {"covariance": spent[0], "covariance cpu": spent[1]}
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", type=int, default=[50, 100, 500])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--free", default="c,xp,yp")
    parser.add_argument("--covariance", action="store_true")
    parser.add_argument("--tools", default="collinea,tuned,defaults")
    parser.add_argument("--run", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        b = block(args.images[0])
        importlib.import_module("numba" if args.run == "collinea" else "pycolmap")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        done = (run_ours(b, args.threads, tuple(args.free.split(",")), args.covariance) if args.run == "collinea"
                else run_pycolmap(b, args.threads, args.run == "pycolmap tuned", args.covariance
                                  and args.run == "pycolmap tuned"))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print("RESULT", json.dumps(done | {"peak": peak, "above": peak - before}))
        return
    tools = ["collinea", *(["pycolmap tuned", "pycolmap defaults"] if importlib.util.find_spec("pycolmap") else [])]
    tools = [tool for tool in tools if tool.split()[-1] in args.tools.split(",")]
    if tools == ["collinea"]:
        print("pycolmap is not asked for or not installed here: ours alone")
    environment = os.environ | {f"{name}_NUM_THREADS": str(args.threads) for name in ("OPENBLAS", "OMP", "MKL")}
    for m in args.images:
        b = block(m)
        print(f"\n{m} images, {len(b['xyz'])} points, {len(b['image'])} observations, {args.threads} thread(s), "
              f"load {os.getloadavg()[0]:.1f}")
        print(f"{'':18s} {'cost':>16s} {'iterations':>10s} {'build s':>8s} {'solve s':>8s} {'CPU s':>8s} {'peak MB':>8s} "
              f"{'above MB':>8s} "
              f"{'covariance s':>12s} {'CPU s':>8s}")
        first: dict[str, float] = {}
        for tool in tools:
            words = [sys.executable, __file__, str(m), "--threads", str(args.threads), "--free", args.free, "--run", tool,
                     *(["--covariance"] if args.covariance else [])]
            got = subprocess.run(words, capture_output=True, text=True, env=environment)
            lines = [line for line in got.stdout.splitlines() if line.startswith("RESULT ")]
            if not lines:
                print(f"{tool:18s} failed: {(got.stderr.strip().splitlines() or ['no word'])[-1][:120]}")
                continue
            r = json.loads(lines[0][7:])
            print(f"{tool:18s} {r['cost']:16.6f} {r['iterations']:10d} {r['build']:8.2f} {r['solve']:8.2f} {r['cpu']:8.2f} "
                  f"{r['peak']:8.0f} "
                  f"{r['above']:8.0f} {r.get('covariance', float('nan')):12.2f} {r.get('covariance cpu', float('nan')):8.2f}",
                  flush=True)
            if first:
                kinds = ("solve", "cpu", "peak", "above", "covariance cpu")
                print(" " * 18, "ratios to the first: " + ", ".join(f"{k} {r[k] / max(first[k], 1e-9):.2f}" for k in kinds
                                                                    if k in r and k in first), flush=True)
            first = first or r


if __name__ == "__main__":
    main()
