"""The tools of the bundle benchmark: each adjusts one block, from its start values to its end, and says what it took."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bundle_blocks import HEIGHT, PIXEL, START, WIDTH
from solvers.geometry import exp, to_opencv
from solvers.geometry.pose import Exterior


def prepared(b: dict[str, Any], threads: int, free: tuple[str, ...], camera: Any = START) -> tuple[Any, np.ndarray]:
    """Our problem and its start values; the analysis of the pattern belongs to it."""
    from solvers.orientation.bundle.compiled import Compiled
    from solvers.orientation.bundle.given import _sorted
    from solvers.orientation.bundle.network import Network
    from solvers.orientation.bundle.problem import Bundle

    n, m = len(b["xyz"]), len(b["poses"])
    order = _sorted(b["image"], b["point"], np.zeros(n, bool), n)
    place = np.argsort(order)
    rows = np.lexsort((b["image"], place[b["point"]]))
    middle = b["xyz"].mean(axis=0)
    net = Network(tuple(map(str, range(m))), ("camera",), (camera,), np.zeros(m, int), tuple(map(str, order)), b["image"][rows],
                  place[b["point"]][rows], b["pixel"][rows], np.ones(len(rows)), (free,), np.full((n, 3), np.nan),
                  np.zeros((n, 3)), n, (None,) * m)
    compiled = Compiled(net, threads)
    _ = compiled.pattern, compiled.lut
    poses = b["poses"].copy()
    poses[:, :3] -= middle
    return Bundle(net, None, compiled), net.pack(poses, camera.parameters[None], (b["xyz"] - middle)[order])


def _judged(made: Any, x: np.ndarray) -> None:
    """Covariances of all poses, the interior orientation and all points of a free network."""
    from dataclasses import replace

    from solvers.orientation.bundle.datum import Inner

    inner = Inner(np.arange(len(made.network.points)), made.network.split(x)[2].copy())
    held = replace(made, inner=inner)
    made.compiled.judge(x, held.prior_rows(x), inner, observations=False)


def _adjusted(made: Any, x: np.ndarray, watch: Any = None) -> tuple[dict[str, Any], np.ndarray]:
    """What an adjustment took, and where it ended; watch(row): what is done with every row."""
    from solvers.adjustment import Options, iterate

    rows, spent, last = [], 0.0, x
    t, c = time.perf_counter(), time.process_time()
    for row in iterate(made, x, Options(cost_tolerance=1e-8, step_tolerance=1e-7)):
        if watch is not None:
            before = time.process_time()
            watch(row)
            spent += time.process_time() - before
        rows.append((time.process_time() - c, row.cost))
        last = row.x
    return {"solve": time.perf_counter() - t, "cpu": time.process_time() - c, "cost": rows[-1][1], "iterations": len(rows) - 1,
            "reached": _reached(rows), "trace": spent}, last


def run_ours(b: dict[str, Any], threads: int, free: tuple[str, ...], covariance: bool, traced: bool) -> dict[str, Any]:
    t = time.perf_counter()
    made, x = prepared(b, threads, free)
    b.clear()
    watch = _watch(made, x) if traced else None
    build = time.perf_counter() - t
    out, last = _adjusted(made, x, watch)
    if covariance:
        t, c = time.perf_counter(), time.process_time()
        _judged(made, last)
        out |= {"covariance": time.perf_counter() - t, "covariance cpu": time.process_time() - c}
    return out | {"build": build}


def run_long_range(m: int, threads: int, model: str, free: tuple[str, ...] = ("c",)) -> dict[str, Any]:
    """A free network of narrow fields by one of our models, from its start to its statistics."""
    from dataclasses import replace

    from benchmarks.bundle_blocks import LONG, long_range
    from solvers.adjustment import iterate
    from solvers.orientation.bundle.datum import Inner
    from solvers.orientation.bundle.orthogonal import orthogonal
    from solvers.orientation.bundle.orthogonal_start import BUNDLE, FIXED_POINT
    from solvers.orientation.bundle.orthogonal_statistics import orthogonal_statistics
    from solvers.orientation.bundle.statistics import statistics

    for size in (min(m, 70), m):  # what is compiled is compiled by a small one
        made, x = prepared(long_range(size), threads, free, replace(LONG, c=LONG.c * 1.001))
        made = replace(made, inner=Inner(np.arange(len(made.network.points)), made.network.split(x)[2].copy()))
        t, c = time.perf_counter(), time.process_time()
        if model == "orthogonal":
            made = orthogonal(made.network, made, x, False, dense=False)
        build = time.perf_counter() - t
        t, c = time.perf_counter(), time.process_time()
        rows = list(iterate(made, x, FIXED_POINT if model == "orthogonal" else BUNDLE))
        out = {"build": build, "solve": time.perf_counter() - t, "cpu": time.process_time() - c, "iterations": len(rows) - 1,
               "sigma0": rows[-1].sigma0, "stop": rows[-1].stop, "points": len(made.network.points),
               "observations": len(made.network.image)}
        t, c = time.perf_counter(), time.process_time()
        (orthogonal_statistics if model == "orthogonal" else statistics)(made, rows[-1].x)
        out |= {"statistics": time.perf_counter() - t, "statistics cpu": time.process_time() - c}
    return out


def run_pairs(b: dict[str, Any], threads: int, free: tuple[str, ...], pairs: int) -> list[tuple[float, float, float]]:
    """CPU seconds of the same adjustment without and with its trace, one after the other in turn, and of the trace alone."""
    made, x = prepared(b, threads, free)
    b.clear()
    found = []
    for k in range(pairs):
        each: dict[bool, dict[str, Any]] = {}
        for traced in (k % 2 == 0, k % 2 == 1):
            each[traced] = _adjusted(made, x, _watch(made, x) if traced else None)[0]
        found.append((each[False]["cpu"], each[True]["cpu"], each[True]["trace"]))
    return found


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
    images = b["image"] + 1
    for j, xyz in enumerate(b["xyz"] - middle):
        rows = slice(ends[j], ends[j + 1])
        track = [pycolmap.TrackElement(*at) for at in zip(images[rows].tolist(), place[rows].tolist(), strict=True)]
        reconstruction.add_point3D(xyz, pycolmap.Track(track))
    b.clear()
    del images, place, order
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
