"""Resection of single images beside other tools, in one run: speed, accuracy, degenerate cases, UTM, coverage.

    python benchmarks/resection.py [--quick]

The others (cv2, poselib, pycolmap) are used when they are installed and said to be absent when not. Speeds are counted in CPU
seconds of one thread, as poses per core second, which a busy machine disturbs least; wall clock on all cores is printed beside.
Scenes: 35 mm, 6000 x 4000 px, 300 m high, relief 0-30 m, tilt sd 3 degrees, noise 0.3 px.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from solvers import Block, Image, Interior, Observations, Points
from solvers.orientation import resect, resect_orthogonal
from solvers.orientation.batch import Status, resect_many

NOISE = 0.3
FLIP = np.array([1.0, -1.0, -1.0])[:, None]  # photo frame <-> camera frame of the others (y down, z forward)
OFFSET = np.array([3.0, -4.0, 3.0])  # m, error of a given start
UTM = np.array([679421.0, 9123785.0, 100.0])


def camera(c: float = 35.0) -> Interior:
    return Interior(c, pixel_mm=0.00392, width=6000, height=4000)


CAMERA = camera()
Adapter = Callable[[SimpleNamespace], tuple[np.ndarray, np.ndarray]]


def turn(axis: int, angle: float) -> np.ndarray:
    c, s, i, j = np.cos(angle), np.sin(angle), (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


def scene(rng, n, h=300.0, relief=30.0, tilt=3.0, c=35.0, attitude=None, rows=(0.03, 0.97)) -> SimpleNamespace:
    """One image with truth: X (n, 3), uv (n, 2), M, C, interior."""
    k = camera(c)
    while True:
        om, ph = attitude if attitude else np.deg2rad(rng.normal(0, tilt, 2))
        M = (turn(0, om) @ turn(1, ph) @ turn(2, rng.uniform(-np.pi, np.pi))).T
        C = np.array([rng.uniform(-50, 50), rng.uniform(-50, 50), h])
        uv = np.stack([rng.uniform(0.03, 0.97, n) * k.width, rng.uniform(*rows, n) * k.height], 1)
        d = np.c_[k.ideal(uv), np.full(n, -c)] @ M
        if np.all(d[:, 2] < -0.05 * c):
            break
    Z = rng.uniform(0, relief, n) if relief else np.zeros(n)
    X = C + ((Z - C[2]) / d[:, 2])[:, None] * d
    return SimpleNamespace(X=X, uv=uv + rng.normal(0, NOISE, uv.shape), M=M, C=C, k=k)


def anyhow(rng, p: SimpleNamespace) -> SimpleNamespace:
    """The same image with the world turned at random: any attitude."""
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    return SimpleNamespace(X=p.X @ Q, uv=p.uv, M=p.M @ Q, C=p.C @ Q, k=p.k)


def jacobian(p) -> np.ndarray:
    """(2n, 6) d pixel / d (centre, left rotation vector) at the truth."""
    P = (p.X - p.C) @ p.M.T
    f = p.k.c / p.k.pitch[0]
    x, y, z = P.T
    du = np.stack([-f / z, 0 * z, f * x / z**2], 1)
    dv = np.stack([0 * z, -f / z, f * y / z**2], 1)
    return np.concatenate([np.c_[-d @ p.M, np.cross(P, d)] for d in (du, dv)])


def bound(p) -> float:
    """Cramer-Rao standard deviation of the position, m."""
    J = jacobian(p)
    return float(np.sqrt(max(np.trace(NOISE**2 * np.linalg.pinv(J.T @ J)[:3, :3]), 1e-12)))


def many(images, **options):
    return resect_many(images[0].k, np.array([p.X for p in images]), np.array([p.uv for p in images]), sigma_px=NOISE, **options)


# --- the others: p -> (M, C), photo frame -----------------------------------------------------------------------------------


def peers() -> tuple[dict[str, Adapter], dict[str, Adapter]]:
    """(tools, tools that give a covariance); absent packages are named."""
    tools: dict[str, Adapter] = {}
    with_covariance: dict[str, Adapter] = {}
    try:
        import cv2

        cv2.setNumThreads(1)
        K = {}

        def matrix(k):
            f = k.c / k.pitch[0]
            return K.setdefault(k.c, np.array([[f, 0, (k.width - 1) / 2], [0, f, (k.height - 1) / 2], [0, 0, 1.0]]))

        def solver(flag, refine=False):
            def fn(p):
                ok, r, t = cv2.solvePnP(p.X, p.uv, matrix(p.k), None, flags=flag)
                if not ok:
                    raise RuntimeError("ok is False")
                if refine:
                    r, t = cv2.solvePnPRefineLM(p.X, p.uv, matrix(p.k), None, r, t)
                R = cv2.Rodrigues(r)[0]
                return FLIP * R, -R.T @ t[:, 0]

            return fn

        tools["cv2 SQPNP"] = solver(cv2.SOLVEPNP_SQPNP)
        tools["cv2 SQPNP + LM"] = solver(cv2.SOLVEPNP_SQPNP, True)
        tools["cv2 ITERATIVE"] = solver(cv2.SOLVEPNP_ITERATIVE)
        tools["cv2 EPNP"] = solver(cv2.SOLVEPNP_EPNP)
    except ImportError:
        print("cv2 is absent")
    try:
        import poselib  # pyright: ignore[reportMissingImports]

        def pinhole(k):
            params = [k.c / k.pitch[0], (k.width - 1) / 2, (k.height - 1) / 2]
            return {"model": "SIMPLE_PINHOLE", "width": k.width, "height": k.height, "params": params}

        def estimate(p):
            few = {"max_reproj_error": 3.0, "min_iterations": 10, "max_iterations": 1000}
            pose, _ = poselib.estimate_absolute_pose(p.uv, p.X, pinhole(p.k), few, {"loss_type": "TRIVIAL"})
            return FLIP * pose.R, -pose.R.T @ pose.t

        def polish(p):  # start given: the truth, 2 degrees and 6 m off
            start = poselib.CameraPose()
            R0 = turn(0, 0.03) @ turn(1, -0.02) @ (FLIP * p.M)
            start.R, start.t = R0, -R0 @ (p.C + OFFSET)
            pose, _ = poselib.refine_absolute_pose(p.uv, p.X, start, pinhole(p.k), {"loss_type": "TRIVIAL"})
            return FLIP * pose.R, -pose.R.T @ pose.t

        tools["poselib estimate"] = estimate
        tools["poselib refine (start given)"] = polish
    except ImportError:
        print("poselib is absent")
    try:
        import pycolmap  # pyright: ignore[reportMissingImports]

        pycolmap.logging.minloglevel = 3
        options, plain = pycolmap.AbsolutePoseEstimationOptions(), pycolmap.AbsolutePoseRefinementOptions()
        options.ransac.max_error, options.ransac.min_num_trials = 3.0, 10
        plain.loss_function_scale, plain.gradient_tolerance = 1e3, 1e-8
        cameras = {}

        def colmap_camera(k):
            if k.c not in cameras:
                params = [k.c / k.pitch[0], (k.width - 1) / 2, (k.height - 1) / 2]
                cameras[k.c] = pycolmap.Camera(model="SIMPLE_PINHOLE", width=k.width, height=k.height, params=params)
            return cameras[k.c]

        def result(o):
            if o is None:
                raise RuntimeError("None")
            R = o["cam_from_world"].rotation.matrix()
            return FLIP * R, -R.T @ o["cam_from_world"].translation

        def full(covariance):
            return lambda p: result(
                pycolmap.estimate_and_refine_absolute_pose(p.uv, p.X, colmap_camera(p.k), options, plain, covariance)
            )

        def from_start(p):
            R0 = turn(0, 0.03) @ turn(1, -0.02) @ (FLIP * p.M)
            T = pycolmap.Rigid3d(pycolmap.Rotation3d(R0), -R0 @ (p.C + OFFSET))
            use = np.ones(len(p.X), bool)
            o = pycolmap.refine_absolute_pose(T, p.uv, p.X, use, colmap_camera(p.k), plain, True)
            if o is None:
                raise RuntimeError("None")
            return result(o)

        tools["pycolmap estimate + refine"] = full(False)
        with_covariance["pycolmap estimate + refine + cov"] = full(True)
        with_covariance["pycolmap refine + cov (start given)"] = from_start
    except ImportError:
        print("pycolmap is absent")
    return {**tools, **with_covariance}, with_covariance


def ours(p) -> tuple[np.ndarray, np.ndarray]:
    r = many([p])
    if not Status(r.status[0]).has_pose:
        raise RuntimeError(Status(r.status[0]).words)
    return r.rotation[0], r.centre[0]


# --- what is measured -------------------------------------------------------------------------------------------------------


def cpu_rate(work: Callable[[], object], count: int, repeat: int) -> float:
    """Poses per CPU second, best of `repeat`."""
    best = np.inf
    for _ in range(repeat):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return count / best


def loop(fn: Adapter, images) -> None:
    for p in images:
        try:
            fn(p)
        except Exception:
            continue


def wall_rate(work: Callable[[], object], count: int, repeat: int) -> float:
    best = np.inf
    for _ in range(repeat):
        start = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - start)
    return count / best


def speed(tools, with_covariance, count: int) -> None:
    for label, images in scenes(count).items():
        X, uv = np.array([p.X for p in images]), np.array([p.uv for p in images])
        print(f"\n## Throughput, {count} x 12 points, {label}\n{'':38s} per CPU s   wall, 2 threads")
        rates = {}
        some = images[: max(500, count // 5)]
        for name, fn in tools.items():
            few = some[:400] if "pycolmap" in name else some
            loop(fn, few[:20])
            halves = few[::2], few[1::2]
            with ThreadPoolExecutor(2) as pool:
                wall = wall_rate(lambda h=halves, f=fn, e=pool: list(e.map(lambda part: loop(f, part), h)), len(few), 2)
            rates[name] = cpu_rate(lambda f=fn, i=few: loop(f, i), len(few), 3)
            print(f"{name:38s} {rates[name]:10.0f} {wall:12.0f}", flush=True)
        for model in ("perspective", "orthogonal"):
            call = partial(resect_many, CAMERA, X, uv, model, sigma_px=NOISE)
            one, wall = cpu_rate(partial(call, threads=1), count, 10), wall_rate(call, count, 10)
            print(f"{'collinea ' + model + ' + cov':38s} {one:10.0f} {wall:12.0f}", flush=True)
            if rates and model == "perspective":
                fastest = max(rates, key=lambda k: rates[k])
                print(f"{'':38s} {one / rates[fastest]:.1f} times {fastest}")
                if with_covariance:
                    fastest = max(with_covariance, key=lambda k: rates[k])
                    print(f"{'':38s} {one / rates[fastest]:.1f} times {fastest}")


def scenes(count: int) -> dict[str, list[SimpleNamespace]]:
    rng = np.random.default_rng(7)
    near = [scene(rng, 12) for _ in range(count)]
    return {"near nadir": near, "random attitudes": [anyhow(rng, p) for p in near]}


def accuracy(tools, trials: int) -> None:
    print(f"\n## Accuracy, {trials} images: rms position error / Cramer-Rao (failures: above 10 sigma, or refused)")
    for n in (4, 6, 12, 33, 200):
        rng = np.random.default_rng(100 + n)
        images = [anyhow(rng, scene(rng, n)) for _ in range(trials)]
        sd = np.array([bound(p) for p in images])
        print(f"\nn = {n}, Cramer-Rao median {np.median(sd):.4f} m {'us per call':>29s} {'rms/CR':>8s} {'failed':>7s}")
        for name, fn in {**tools, "collinea (single call)": ours}.items():
            error = np.full(trials, np.nan)
            start = time.process_time()
            for i, p in enumerate(images):
                try:
                    error[i] = np.linalg.norm(fn(p)[1] - p.C)
                except Exception:
                    continue
            line(name, 1e6 * (time.process_time() - start) / trials, error / sd)
        start = time.process_time()
        r = many(images, threads=1)
        spent = time.process_time() - start
        error = np.linalg.norm(r.centre - np.array([p.C for p in images]), axis=1)
        line("collinea (batch)", 1e6 * spent / trials, error / sd)


def line(name: str, us: float, z: np.ndarray) -> None:
    good = np.isfinite(z) & (z < 10)
    rms = np.sqrt(np.mean(z[good] ** 2)) if good.any() else np.nan
    print(f"{name:44s} {us:10.1f} {rms:8.4f} {100 * (1 - good.mean()):6.1f}%", flush=True)


def statistics(count: int) -> None:
    """Failures and coverage of the 95 % ellipsoids (6 parameters, chi-square 12.592)."""
    print(f"\n## {count} images each: status, failures (status OK and beyond 10 sigma), truth inside the 95 % ellipsoid")
    for label, options in {
        "12 points": {"n": 12}, "12 points, flat": {"n": 12, "relief": 0.0}, "6 points": {"n": 6}, "4 points": {"n": 4},
        "4 points, flat": {"n": 4, "relief": 0.0},
    }.items():  # fmt: skip
        rng = np.random.default_rng(11)
        images = [anyhow(rng, scene(rng, **options)) for _ in range(count)]
        for model in ("perspective", "orthogonal"):
            r = many(images, model=model)
            ok = r.status == Status.OK
            M, C = np.array([p.M for p in images])[ok], np.array([p.C for p in images])[ok]
            D = np.einsum("bij,bkj->bik", M, r.rotation[ok])
            d = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], 1)
            e = np.concatenate([C - r.centre[ok], d], 1)
            m2 = np.einsum("bi,bi->b", e, np.linalg.solve(r.covariance[ok], e[..., None])[..., 0])
            far = int(np.sum(m2 > 100.0))
            names = dict(Counter(Status(s).name for s in r.status))
            print(f"{label:16s} {model:12s} failures {far:3d}  inside {100 * np.mean(m2 < 12.592):6.2f} %  {names}", flush=True)


def utm(tools, count: int) -> None:
    print("\n## UTM against local coordinates, 12 points: largest difference of the centre, m (failures: above 10 sigma at UTM)")
    rng = np.random.default_rng(5)
    images = [scene(rng, 12) for _ in range(count)]
    for name, fn in {**tools, "collinea": ours}.items():
        difference, failed = 0.0, 0
        for p in images:
            q = SimpleNamespace(**{**vars(p), "X": p.X + UTM, "C": p.C + UTM})
            try:
                a, b = fn(p)[1], fn(q)[1] - UTM
                difference = max(difference, float(np.linalg.norm(a - b)))
                failed += not np.linalg.norm(b - p.C) < 10 * bound(p)
            except Exception:
                failed += 1
        print(f"{name:38s} {difference:12.3g}   failed {100 * failed / count:5.1f}%", flush=True)


def line_of_points(rng, n: int, spread: float):
    p = scene(rng, n, relief=0.0)
    X = np.array([5.0, 8.0, 3.0]) + np.linspace(-1, 1, n)[:, None] * [60.0, 35.0, 4.0] + spread * rng.normal(size=(n, 3))
    p.X = X + p.C * [1, 1, 0]
    P = (p.X - p.C) @ p.M.T
    p.uv = p.k.measured(-p.k.c * P[:, :2] / P[:, 2:]) + rng.normal(0, NOISE, (n, 2))
    return p


def moved(rng, change) -> SimpleNamespace:
    p = scene(rng, 12)
    change(p)
    return p


def _repeat(p, times):
    p.X, p.uv = np.repeat(p.X, times, 0), np.repeat(p.uv, times, 0)
    return p


def _set(array, index, value):
    array[index] = value


NARROW = 3000 * 0.00392 / np.tan(np.deg2rad(3.0))
DEGENERATE: dict[str, Callable] = {
    "coplanar": lambda g: scene(g, 12, relief=0.0),
    "collinear": lambda g: line_of_points(g, 12, 0.0),
    "near-collinear (1 m)": lambda g: line_of_points(g, 12, 1.0),
    "3 points": lambda g: scene(g, 3),
    "12 = 3 points x 4": lambda g: _repeat(scene(g, 3), 4),
    "all one point": lambda g: _repeat(scene(g, 1), 12),
    "NaN in a pixel": lambda g: moved(g, lambda p: _set(p.uv, (3, 0), np.nan)),
    "NaN in a ground point": lambda g: moved(g, lambda p: _set(p.X, (3, 2), np.nan)),
    "1 outlier of 250 px": lambda g: moved(g, lambda p: _set(p.uv, 3, p.uv[3] + [200, -150])),
    "4 outliers": lambda g: moved(g, lambda p: _set(p.uv, slice(4), p.uv[:4] + g.uniform(-800, 800, (4, 2)))),
    "2 swapped points": lambda g: moved(g, lambda p: _set(p.uv, [2, 7], p.uv[[7, 2]])),
    "field of view 6 degrees": lambda g: scene(g, 12, h=2000.0, c=NARROW),
    "field of view 6 degrees, flat": lambda g: scene(g, 12, h=2000.0, c=NARROW, relief=0.0),
    "oblique 60 degrees": lambda g: scene(g, 12, attitude=(np.deg2rad(60), 0.0), rows=(0.3, 0.95)),
}


def degenerate(tools) -> None:
    print("\n## Degenerate cases, 20 images each: right / wrong without a word / refused or flagged")
    for label, make in DEGENERATE.items():
        print(f"\n{label}")
        for name, fn in tools.items():
            count = Counter()
            for trial in range(20):
                p = make(np.random.default_rng(1000 + trial))
                try:
                    error = np.linalg.norm(fn(p)[1] - p.C)
                    count["right" if error < 10 * bound(p) else "wrong" if np.isfinite(error) else "NaN"] += 1
                except Exception:
                    count["refused"] += 1
            print(f"  {name:38s} {dict(count)}", flush=True)
        count, words = Counter(), Counter()
        for trial in range(20):
            p = make(np.random.default_rng(1000 + trial))
            r = many([p])
            code = Status(r.status[0])
            right = code.has_pose and np.linalg.norm(r.centre[0] - p.C) < 10 * bound(p)
            among = code == Status.AMBIGUOUS and min(np.linalg.norm(r.solutions(0).centre - p.C, axis=1)) < 10 * bound(p)
            kind = "right" if right else "truth among the solutions" if among else "flagged" if code != Status.OK else "WRONG"
            count[kind] += 1
            words[code.name] += 1
        print(f"  {'collinea':38s} {dict(count)}  status {dict(words)}", flush=True)


def block_of(p: SimpleNamespace) -> Block:
    """One image as a project has it, every point control."""
    n = len(p.X)
    return Block("site", "local", {"camera": p.k}, (Image("a", "camera"),),
                 Points(tuple(f"P{i}" for i in range(n)), p.X, np.full((n, 3), 0.002), ("control",) * n),
                 Observations(np.zeros(n, int), np.arange(n), p.uv, np.full(n, NOISE)))


def single(count: int) -> None:
    print("\n## One image of 33 points, trace, statistics and warnings included: milliseconds of CPU, median and least")
    narrow = {"h": 2000.0, "c": NARROW}
    cases = {"relief 30 m": {}, "relief 1 m": {"relief": 1.0}, "flat": {"relief": 0.0}, "6 degrees, relief 30 m": narrow,
             "6 degrees, flat": {**narrow, "relief": 0.0},
             "oblique 60 degrees": {"attitude": (np.deg2rad(60), 0.0), "rows": (0.3, 0.95)}}
    for label, options in cases.items():
        block = block_of(scene(np.random.default_rng(3), 33, **options))
        for solve in (resect, resect_orthogonal):
            solve(block, "a")
            spent = []
            for _ in range(count):
                start = time.process_time()
                solve(block, "a")
                spent.append(1e3 * (time.process_time() - start))
            print(f"{label:24s} {solve.__name__:18s} {np.median(spent):6.2f} {min(spent):6.2f}", flush=True)


FIRST = """
import time, sys
sys.path.insert(0, {root!r})
import numpy as np
from solvers import Block, Image, Interior, Observations, Points
from solvers.orientation import resect, resect_orthogonal
from solvers.orientation.batch import resect_many
k = Interior(35.0, pixel_mm=0.00392, width=6000, height=4000)
g = np.random.default_rng(0)
t, c = time.perf_counter(), time.process_time()
resect_many(k, g.uniform(-100, 100, (2, 12, 3)), g.uniform(0, 4000, (2, 12, 2)))
print(f"{{time.perf_counter() - t:.2f}} s ({{time.process_time() - c:.2f}} s of CPU)")
"""


def first_use() -> None:
    print("\n## First call of a process")
    code = FIRST.format(root=str(Path(__file__).resolve().parents[1]))
    with tempfile.TemporaryDirectory() as folder:
        for label in ("compiling", "from the cache"):
            env = {**os.environ, "NUMBA_CACHE_DIR": folder}
            done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
            print(f"{label:16s} {done.stdout.strip()}", flush=True)


def main() -> None:
    quick = "--quick" in sys.argv
    tools, with_covariance = peers()
    many([scene(np.random.default_rng(0), 12)])  # compile
    many([scene(np.random.default_rng(0), 12)], model="orthogonal")
    speed(tools, with_covariance, 2000 if quick else 10000)
    accuracy(tools, 100 if quick else 500)
    statistics(2000 if quick else 10000)
    utm(tools, 50 if quick else 200)
    degenerate(tools)
    single(20 if quick else 60)
    first_use()


if __name__ == "__main__":
    main()
