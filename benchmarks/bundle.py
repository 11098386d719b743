"""Bundle adjustment beside pycolmap (Ceres), gtsam and scipy: the same problems, from the same start to the same cost.

    python benchmarks/bundle.py [images ...] [--threads N] [--free c,xp,yp] [--covariance] [--utm] [--tools collinea,tuned,...]
    python benchmarks/bundle.py --bal problem-49-7776-pre.txt      # a problem in the large: f, k1, k2 of every image
    python benchmarks/bundle.py --first-call                       # an empty cache of compiled code, then a new process

Every run is a process of its own. Blocks: double grids of near-vertical photos, 35 mm, 6000 x 4000 px, 120 m, noise 0.3 px, about
seven rays to a point; start off by 0.5 m and 0.5 degrees, c by 0.4 %. The camera has no distortion and c, xp, yp are adjusted, so
that our photo-to-ideal correction and pycolmap's SIMPLE_PINHOLE are the same model and the costs can be compared digit by digit;
with --free every freed parameter of ours is paid for in time, and the peer stays as it is.

Tools, where they are installed: collinea; traced (ours, every row written to the run and to a rerun recording); tuned (pycolmap,
centred coordinates, free gauge, function tolerance 1e-8); uncentred (the same, coordinates as they come: see --utm); defaults
(pycolmap as it comes); gtsam (Levenberg-Marquardt, its camera has two parameters more, fy and skew); scipy (trf, lsmr, analytic
sparse Jacobian). `to 1e-6`: CPU seconds until the cost is within a millionth of the tool's own end.
CPU seconds disturb least on a busy machine; peak memory is that of the whole process, imports included, and above what the
imports and the block took. After each block the ratios to the first tool are printed. --limit: seconds until a tool is given up.
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

UTM = np.array([679_421.0, 9_123_785.0, 100.0])
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


def run_ours(b: dict[str, Any], threads: int, free: tuple[str, ...], covariance: bool, traced: bool) -> dict[str, Any]:
    from solvers.adjustment import Options, iterate, solve
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
    watch = _watch(made, x) if traced else None
    t1, c1 = time.perf_counter(), time.process_time()
    rows, spent, last = [], 0.0, x
    for row in iterate(made, x, options):
        if watch is not None:
            before = time.process_time()
            watch(row)
            spent += time.process_time() - before
        rows.append((time.process_time() - c1, row.cost, row.index))
        last = row.x
    out = {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": rows[-1][1],
           "iterations": rows[-1][2], "reached": _reached([(t, c) for t, c, _ in rows]), "trace": spent}
    if covariance:
        from dataclasses import replace

        inner = Inner(np.arange(len(b["xyz"])), made.network.split(last)[2].copy())
        t2, c2 = time.perf_counter(), time.process_time()
        held = replace(made, inner=inner)
        assert isinstance(made.compiled, Compiled)
        made.compiled.judge(last, held.prior_rows(last), inner, observations=False)
        out |= {"covariance": time.perf_counter() - t2, "covariance cpu": time.process_time() - c2}
    return out


def _reached(rows: list[tuple[float, float]]) -> float:
    """When the cost was first within a millionth of the last one."""
    return next(t for t, cost in rows if cost <= rows[-1][1] * (1 + 1e-6)) if rows else float("nan")


def _watch(made: Any, x: np.ndarray) -> Any:
    """What an adjustment of a project does with every row: append it to the run, draw it into the recording."""
    import tempfile

    from solvers import Block, Image, Observations, Points
    from solvers.io import RowWriter
    from viewer_app.rerun_bundle import Live

    net, folder = made.network, Path(tempfile.mkdtemp())
    n = len(net.points)
    points = Points(net.points, np.full((n, 3), np.nan), np.full((n, 3), np.nan), ("tie",) * n)
    block = Block("benchmark", "local", {"camera": START}, tuple(Image(name, "camera") for name in net.images), points,
                  Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)))
    manifest = {"images": list(net.images), "cameras": list(net.cameras), "points": list(net.points), "origin": [0.0, 0.0, 0.0]}
    writer = RowWriter(folder, manifest, 12 * len(net.images) + 10, len(x))
    live = Live(folder / "recording.rrd", block, manifest, x)

    def watch(row: Any) -> None:
        writer.add(row)
        live.row(row)

    return watch


def _progress(solve: Any) -> tuple[Any, list[tuple[float, float]]]:
    """What solve() gives back, and Ceres' own table of seconds and costs, printed by C++ past Python's standard output."""
    import tempfile

    sys.stdout.flush()
    kept, rows = os.dup(1), []
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 1)
        try:
            done = solve()
        finally:
            os.dup2(kept, 1)
            os.close(kept)
        file.seek(0)
        for line in file.read().decode(errors="replace").splitlines():
            words = line.split()
            if len(words) >= 10 and words[0].isdigit():
                rows.append((float(words[-1]), float(words[1])))
    return done, rows


def run_gtsam(b: dict[str, Any], threads: int) -> dict[str, Any]:
    """gtsam's Levenberg-Marquardt with one Cal3_S2 for all images; a weak prior on the first pose would change the cost: none."""
    import gtsam  # pyright: ignore[reportMissingImports]
    from gtsam.symbol_shorthand import K, L, X  # pyright: ignore[reportMissingImports]

    t0 = time.perf_counter()
    graph, values, noise = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    middle = b["xyz"].mean(axis=0)
    col, row = START.pixels(START.principal_point)
    values.insert(K(0), gtsam.Cal3_S2(START.c / PIXEL, START.c / PIXEL, 0.0, col, row))
    for i, pose in enumerate(b["poses"]):
        r, centre = to_opencv(Exterior.from_vector(pose))
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(r.T), centre - middle))
    for j, xyz in enumerate(b["xyz"] - middle):
        values.insert(L(j), xyz)
    for i, j, pixel in zip(b["image"].tolist(), b["point"].tolist(), b["pixel"], strict=True):
        graph.add(gtsam.GeneralSFMFactor2Cal3_S2(pixel, noise, X(i), L(j), K(0)))
    how = gtsam.LevenbergMarquardtParams.CeresDefaults()
    t1, c1 = time.perf_counter(), time.process_time()
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, how)
    rows = [(0.0, optimizer.error())]
    for _ in range(100):
        optimizer.iterate()
        rows.append((time.process_time() - c1, optimizer.error()))
        if abs(rows[-2][1] - rows[-1][1]) <= 1e-8 * rows[-2][1]:
            break
    return {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": rows[-1][1],
            "iterations": len(rows) - 1, "reached": _reached(rows)}


def run_scipy(b: dict[str, Any], threads: int) -> dict[str, Any]:
    """scipy's trust region, its inner systems solved by LSMR, with our analytic derivatives as a sparse matrix."""
    from scipy.optimize import least_squares
    from scipy.sparse import csr_matrix

    t0 = time.perf_counter()
    m, n, o = len(b["poses"]), len(b["xyz"]), len(b["image"])
    middle, size = b["xyz"].mean(axis=0), START.c / PIXEL
    r0, i, j = b["poses"][:, 3:].reshape(m, 3, 3), b["image"], b["point"]
    col, row = START.pixels(START.principal_point)
    x0 = np.concatenate([np.zeros(3 * m), (b["poses"][:, :3] - middle).ravel(), (b["xyz"] - middle).ravel(), [size, col, row]])
    at = np.repeat(np.arange(2 * o), 12)
    columns = np.hstack([3 * i[:, None] + np.arange(3), 3 * m + 3 * i[:, None] + np.arange(3),
                         6 * m + 3 * j[:, None] + np.arange(3), np.tile(6 * m + 3 * n + np.arange(3), (o, 1))])
    columns = np.repeat(columns[:, None, :], 2, axis=1).ravel()

    def parts(x: np.ndarray) -> tuple[np.ndarray, ...]:
        turn = np.array([exp(w) for w in x[:3 * m].reshape(m, 3)])
        r = turn @ r0
        away = x[6 * m:6 * m + 3 * n].reshape(n, 3)[j] - x[3 * m:6 * m].reshape(m, 3)[i]
        cam = np.einsum("oij,oj->oi", r[i], away)
        return cam, r, x[-3:]

    def residuals(x: np.ndarray) -> np.ndarray:
        cam, _, (f, u, v) = parts(x)
        seen = np.column_stack([u - f * cam[:, 0] / cam[:, 2], v + f * cam[:, 1] / cam[:, 2]])
        return (b["pixel"] - seen).ravel()

    def derivatives(x: np.ndarray) -> Any:
        cam, r, (f, _, _) = parts(x)
        by_cam = np.zeros((o, 2, 3))
        by_cam[:, 0, 0], by_cam[:, 0, 2] = f / cam[:, 2], -f * cam[:, 0] / cam[:, 2] ** 2
        by_cam[:, 1, 1], by_cam[:, 1, 2] = -f / cam[:, 2], f * cam[:, 1] / cam[:, 2] ** 2
        cross = np.zeros((o, 3, 3))
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = cam[:, 2], -cam[:, 1], cam[:, 0]
        cross -= np.swapaxes(cross, 1, 2)
        w = x[:3 * m].reshape(m, 3)
        k = np.zeros((m, 3, 3))
        k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
        k -= np.swapaxes(k, 1, 2)
        left = np.eye(3) + k / 2 + k @ k / 6 + k @ k @ k / 24
        point = by_cam @ r[i]
        inner = np.zeros((o, 2, 3))
        inner[:, 0, 0], inner[:, 1, 0] = cam[:, 0] / cam[:, 2], -cam[:, 1] / cam[:, 2]
        inner[:, 0, 1] = inner[:, 1, 2] = -1.0
        values = np.concatenate([by_cam @ cross @ left[i], -point, point, inner], axis=2)
        return csr_matrix((values.ravel(), (at, columns)), shape=(2 * o, 6 * m + 3 * n + 3))

    rows: list[tuple[float, float]] = []
    t1, c1 = time.perf_counter(), time.process_time()

    def watched(x: np.ndarray) -> np.ndarray:
        v = residuals(x)
        rows.append((time.process_time() - c1, 0.5 * float(v @ v)))
        return v

    jacobian: Any = derivatives
    done = least_squares(watched, x0, jacobian, method="trf", tr_solver="lsmr", x_scale="jac", ftol=1e-8, xtol=1e-15,
                         gtol=1e-15, max_nfev=60)
    rows = [(t, min(c for _, c in rows[:k + 1])) for k, (t, _) in enumerate(rows)]
    return {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": float(done.cost),
            "iterations": int(done.nfev), "reached": _reached([*rows, (rows[-1][0], float(done.cost))])}


def run_pycolmap(b: dict[str, Any], threads: int, how: str, covariance: bool) -> dict[str, Any]:
    import pycolmap  # pyright: ignore[reportMissingImports]
    import pycolmap.pyceres as ceres  # pyright: ignore[reportMissingImports]

    pycolmap.logging.minloglevel = 2
    t0 = time.perf_counter()
    tuned = how != "defaults"
    middle = b["xyz"].mean(axis=0) if how == "tuned" else np.zeros(3)
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
    solver.minimizer_progress_to_stdout = True
    solver.logging_type = ceres.LoggingType.PER_MINIMIZER_ITERATION
    config = pycolmap.BundleAdjustmentConfig()
    for i in range(m):
        config.add_image(i + 1)
    if tuned:
        solver.function_tolerance = 1e-8
    else:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    t1, c1 = time.perf_counter(), time.process_time()
    done, rows = _progress(adjuster.solve)
    summary = done.ceres_summary
    wall, cpu = time.perf_counter() - t1, time.process_time() - c1
    out = {"build": t1 - t0, "solve": wall, "cpu": cpu, "cost": summary.final_cost,
           "iterations": summary.num_successful_steps + summary.num_unsuccessful_steps,
           "reached": _reached(rows) * cpu / wall}
    if covariance:
        t2, c2 = time.perf_counter(), time.process_time()
        wanted = pycolmap.BACovarianceOptions()
        wanted.params = pycolmap.BACovarianceOptionsParams.ALL
        done = pycolmap.estimate_ba_covariance(wanted, reconstruction, adjuster) is not None
        spent = (time.perf_counter() - t2, time.process_time() - c2) if done else (float("nan"),) * 2
        out |= {"covariance": spent[0], "covariance cpu": spent[1]}
    return out


def run_bal(path: str, tool: str, threads: int) -> dict[str, Any]:
    """A problem in the large by ours or by pycolmap (RADIAL for every image), to a relative fall of 1e-8 or 100 iterations."""
    t0 = time.perf_counter()
    if tool == "collinea":
        from solvers.adjustment import Options, iterate, solve
        from solvers.io import read_bal
        from solvers.orientation.bundle import BundleRequest, prepare_bundle
        from solvers.workflows_bundle import BAL

        start = prepare_bundle(read_bal(path), BundleRequest(**BAL))
        solve(start.problem, start.x0, Options(max_iterations=1))
        t1, c1 = time.perf_counter(), time.process_time()
        how = Options(max_iterations=100, max_trials=20, step_tolerance=1e-7, cost_tolerance=1e-8)
        rows = [(time.process_time() - c1, r.cost) for r in iterate(start.problem, start.x0, how)]
        return {"build": t1 - t0, "solve": time.perf_counter() - t1, "cpu": time.process_time() - c1, "cost": rows[-1][1],
                "iterations": len(rows) - 1, "reached": _reached(rows), "rows": rows}
    import pycolmap  # pyright: ignore[reportMissingImports]
    import pycolmap.pyceres as ceres  # pyright: ignore[reportMissingImports]

    words = Path(path).read_text().split()
    m, n, o = map(int, words[:3])
    seen = np.array(words[3:3 + 4 * o], float).reshape(o, 4)
    numbers = np.array(words[3 + 4 * o:], float)
    cameras, xyz = numbers[:9 * m].reshape(m, 9), numbers[9 * m:9 * m + 3 * n].reshape(n, 3)
    middle = xyz.mean(axis=0)
    turn = np.diag([1.0, -1.0, -1.0])
    reconstruction = pycolmap.Reconstruction()
    order = np.argsort(seen[:, 0], kind="stable")
    place = np.empty(o, int)
    begin = np.searchsorted(seen[order, 0], np.arange(m + 1))
    place[order] = np.arange(o) - np.repeat(begin[:-1], np.diff(begin))
    for i in range(m):
        camera = pycolmap.Camera(model="RADIAL", width=2000, height=2000,
                                 params=[cameras[i, 6], 0.0, 0.0, cameras[i, 7], cameras[i, 8]])
        camera.camera_id = i + 1
        reconstruction.add_camera_with_trivial_rig(camera)
        pixels = seen[order[begin[i]:begin[i + 1]], 2:] * [1, -1]
        r = turn @ exp(cameras[i, :3])
        image = pycolmap.Image(name=f"{i}", keypoints=pixels, camera_id=i + 1, image_id=i + 1)
        t = turn @ cameras[i, 3:6] + r @ middle
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(r), t))
    by_point = np.argsort(seen[:, 1], kind="stable")
    ends = np.searchsorted(seen[by_point, 1], np.arange(n + 1))
    for j in range(n):
        track = [pycolmap.TrackElement(int(seen[k, 0]) + 1, int(place[k])) for k in by_point[ends[j]:ends[j + 1]]]
        reconstruction.add_point3D(xyz[j] - middle, pycolmap.Track(track))
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations, solver.function_tolerance = threads, 100, 1e-8
    solver.minimizer_progress_to_stdout = True
    solver.logging_type = ceres.LoggingType.PER_MINIMIZER_ITERATION
    config = pycolmap.BundleAdjustmentConfig()
    for i in range(m):
        config.add_image(i + 1)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    t1, c1 = time.perf_counter(), time.process_time()
    done, rows = _progress(adjuster.solve)
    wall, cpu = time.perf_counter() - t1, time.process_time() - c1
    summary = done.ceres_summary
    whole = 0.0
    points = np.array([reconstruction.point3D(j + 1).xyz for j in range(n)])
    for i in range(m):
        rows_of = order[begin[i]:begin[i + 1]]
        world = reconstruction.image(i + 1).cam_from_world()
        cam = points[seen[rows_of, 1].astype(int)] @ world.rotation.matrix().T + world.translation
        f, _, _, k1, k2 = reconstruction.camera(i + 1).params
        at = cam[:, :2] / cam[:, 2:]
        r2 = (at**2).sum(axis=1)
        off = f * (1 + r2 * (k1 + r2 * k2))[:, None] * at - seen[rows_of, 2:] * [1, -1]
        whole += 0.5 * float((off**2).sum())
    return {"whole": whole, "build": t1 - t0, "solve": wall, "cpu": cpu, "cost": summary.final_cost,
            "iterations": summary.num_successful_steps + summary.num_unsuccessful_steps, "reached": _reached(rows) * cpu / wall,
            "rows": [(t * cpu / wall, c) for t, c in rows]}


def first_call(threads: int) -> None:
    """Seconds from the start of Python to the end of an adjustment: with nothing compiled yet, and of the next processes."""
    import tempfile

    code = ("import time; t = time.process_time(); from solvers.simulation import uav_block; "
            "from solvers.orientation.bundle import BundleRequest, prepare_bundle; from solvers.adjustment import solve; "
            "b = uav_block(1, strips=2, images=4, ties=200, fine=False).block; "
            "s = prepare_bundle(b, BundleRequest(free=('c', 'k1'), compiled=True)); t1 = time.process_time(); "
            "solve(s.problem, s.x0, s.options); t2 = time.process_time(); "
            "solve(s.problem, s.x0, s.options); t3 = time.process_time(); "
            "print(f'{t1 - t:.2f} {t2 - t1:.2f} {t3 - t2:.2f} {t2 - t1 - (t3 - t2):.2f}')")
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": str(threads)}
        print("CPU s: imports and start values, first adjustment, the same again, overhead of the first")
        for name in ("nothing compiled yet", "a later process", "a later process"):
            t = time.perf_counter()
            got = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment,
                                 cwd=Path(__file__).resolve().parents[1])
            print(f"{name:22s} {got.stdout.strip() or got.stderr[-200:]}  (wall {time.perf_counter() - t:.1f})", flush=True)


def compare_bal(args: argparse.Namespace, environment: dict[str, str]) -> None:
    """A problem in the large, ours and pycolmap, and when each reached the other's cost."""
    found = {}
    for tool in ("collinea", "pycolmap"):
        words = [sys.executable, __file__, "--bal", args.bal, "--threads", str(args.threads), "--run", tool]
        got = subprocess.run(words, capture_output=True, text=True, env=environment)
        lines = [line for line in got.stdout.splitlines() if line.startswith("RESULT ")]
        if not lines:
            print(f"{tool:18s} failed: {(got.stderr.strip().splitlines() or ['no word'])[-1][:120]}")
            continue
        r = found[tool] = json.loads(lines[0][7:])
        print(f"{tool:10s} cost {r['cost']:14.6f}, {r['iterations']:3d} iterations, build {r['build']:.2f}, "
              f"solve {r['solve']:.2f}, CPU {r['cpu']:.2f} s, peak {r['peak']:.0f} MB", flush=True)
    if len(found) == 2:
        print("pycolmap counts rays to points behind a camera as nothing; with them its solution costs "
              f"{found['pycolmap']['whole']:.6f}")
        print("CPU s an iteration: " + ", ".join(f"{t} {r['cpu'] / r['iterations']:.4f}" for t, r in found.items()))
        goal = max(r["cost"] for r in found.values()) * (1 + 1e-6)
        reached = {tool: next(t for t, c in r["rows"] if c <= goal) for tool, r in found.items()}
        print(f"to the larger of both costs: {', '.join(f'{tool} {t:.2f}' for tool, t in reached.items())} CPU s, ratio "
              f"{reached['pycolmap'] / reached['collinea']:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", type=int, default=[50, 100, 500])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--free", default="c,xp,yp")
    parser.add_argument("--covariance", action="store_true")
    parser.add_argument("--tools", default="collinea,traced,tuned,defaults")
    parser.add_argument("--utm", action="store_true", help="coordinates of a national grid, 679 km and 9,124 km from its origin")
    parser.add_argument("--bal", metavar="FILE", help="a problem in the large instead of blocks")
    parser.add_argument("--first-call", action="store_true", help="how long the first adjustment ever takes, and those after it")
    parser.add_argument("--limit", type=float, default=3600.0, help="seconds after which a tool is given up")
    parser.add_argument("--run", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        b = {} if args.bal else block(args.images[0])
        if args.utm:
            b["poses"][:, :3] += UTM
            b["xyz"] += UTM
        importlib.import_module({"collinea": "numba", "traced": "rerun", "gtsam": "gtsam", "scipy": "scipy.optimize"}.get(
            args.run, "pycolmap"))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if args.bal:
            done = run_bal(args.bal, args.run, args.threads)
        elif args.run in ("collinea", "traced"):
            done = run_ours(b, args.threads, tuple(args.free.split(",")), args.covariance, args.run == "traced")
        elif args.run in ("gtsam", "scipy"):
            done = (run_gtsam if args.run == "gtsam" else run_scipy)(b, args.threads)
        else:
            done = run_pycolmap(b, args.threads, args.run, args.covariance and args.run == "tuned")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print("RESULT", json.dumps(done | {"peak": peak, "above": peak - before}))
        return
    needs = {"tuned": "pycolmap", "uncentred": "pycolmap", "defaults": "pycolmap", "gtsam": "gtsam", "scipy": "scipy",
             "traced": "rerun"}
    tools = [t for t in args.tools.split(",") if t == "collinea" or importlib.util.find_spec(needs[t])]
    if missing := sorted(set(args.tools.split(",")) - set(tools)):
        print(f"not installed here: {', '.join(missing)}")
    environment = os.environ | {f"{name}_NUM_THREADS": str(args.threads) for name in ("OPENBLAS", "OMP", "MKL")}
    if args.first_call:
        first_call(args.threads)
        return
    if args.bal:
        compare_bal(args, environment)
        return
    for m in args.images:
        b = block(m)
        print(f"\n{m} images, {len(b['xyz'])} points, {len(b['image'])} observations, {args.threads} thread(s), "
              f"load {os.getloadavg()[0]:.1f}")
        print(f"{'':18s} {'cost':>16s} {'iterations':>10s} {'build s':>8s} {'solve s':>8s} {'CPU s':>8s} {'peak MB':>8s} "
              f"{'above MB':>8s} {'to 1e-6':>8s} "
              f"{'covariance s':>12s} {'CPU s':>8s}")
        first: dict[str, float] = {}
        for tool in tools:
            words = [sys.executable, __file__, str(m), "--threads", str(args.threads), "--free", args.free, "--run", tool,
                     *(["--covariance"] if args.covariance else []), *(["--utm"] if args.utm else [])]
            try:
                got = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=args.limit)
            except subprocess.TimeoutExpired:
                print(f"{tool:18s} given up after {args.limit:.0f} s", flush=True)
                continue
            lines = [line for line in got.stdout.splitlines() if line.startswith("RESULT ")]
            if not lines:
                print(f"{tool:18s} failed: {(got.stderr.strip().splitlines() or ['no word'])[-1][:120]}")
                continue
            r = json.loads(lines[0][7:])
            print(f"{tool:18s} {r['cost']:16.6f} {r['iterations']:10d} {r['build']:8.2f} {r['solve']:8.2f} {r['cpu']:8.2f} "
                  f"{r['peak']:8.0f} "
                  f"{r['above']:8.0f} {r['reached']:8.2f} "
                  f"{r.get('covariance', float('nan')):12.2f} {r.get('covariance cpu', float('nan')):8.2f}",
                  flush=True)
            if r.get("trace"):
                share = 100 * r["trace"] / r["cpu"]
                print(" " * 18, f"the rows themselves, written and drawn: {r['trace']:.3f} s of CPU, {share:.1f} %")
            if first:
                kinds = ("solve", "cpu", "peak", "above", "covariance cpu")
                print(" " * 18, "ratios to the first: " + ", ".join(f"{k} {r[k] / max(first[k], 1e-9):.2f}" for k in kinds
                                                                    if k in r and k in first), flush=True)
            first = first or r


if __name__ == "__main__":
    main()
