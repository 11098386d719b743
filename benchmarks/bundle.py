"""Bundle adjustment beside pycolmap (Ceres), gtsam and scipy: the same problems, from the same start to the same cost.

    python benchmarks/bundle.py [images ...] [--threads N] [--free c,xp,yp] [--covariance] [--utm] [--pairs N]
                                [--tools collinea,tuned,...]
    python benchmarks/bundle.py --bal problem-49-7776-pre.txt      # a problem in the large: f, k1, k2 of every image
    python benchmarks/bundle.py --long-range 100 500 2000          # both of our models on photos of 300 mm along a cliff
    python benchmarks/bundle.py --first-call                       # an empty cache of compiled code, then a new process

Every run is a process of its own. Blocks: double grids of near-vertical photos, 35 mm, 6000 x 4000 px, 120 m, noise 0.3 px, about
seven rays to a point; start off by 0.5 m and 0.5 degrees, c by 0.4 %. The camera has no distortion and c, xp, yp are adjusted, so
that our photo-to-ideal correction and pycolmap's SIMPLE_PINHOLE are the same model and the costs can be compared digit by digit;
with --free every freed parameter of ours is paid for in time, and the peer stays as it is.

Tools, where they are installed: collinea; traced (ours, every row written to the run and to a rerun recording); tuned (pycolmap,
centred coordinates, free gauge, function tolerance 1e-8); uncentred (the same, coordinates as they come: see --utm); defaults
(pycolmap as it comes); gtsam (Levenberg-Marquardt, its camera has two parameters more, fy and skew); scipy (trf, lsmr, analytic
sparse Jacobian). `to 1e-6`: CPU seconds until the cost is within a millionth of the tool's own end.
CPU seconds disturb least on a busy machine. `peak MB` is that of the whole process, `floor` its peak when the tool has
adjusted a block of 80 images and few points (Python, libraries, code), `above` what the block itself adds: reading it, the
problem, the solution; `own` the peak without the pages of program files, which all processes share and the system may drop.
The block comes from a file, and neither tool's process keeps it beside its own problem. After each block the ratios to the
first tool are printed. --pairs N: the same adjustment without and with a full trace, N times in turn in one process, medians.
--limit: seconds until a tool is given up.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.bundle_blocks import UTM, block, kept
from benchmarks.bundle_tools import run_bal, run_gtsam, run_long_range, run_ours, run_pairs, run_pycolmap, run_scipy


def first_call(threads: int) -> None:
    """Seconds from the start of Python to the end of an adjustment: with nothing compiled yet, and of the next processes."""
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
        r = called(["--bal", args.bal, "--threads", str(args.threads), "--run", tool], environment, args.limit)
        if isinstance(r, str):
            print(f"{tool:18s} {r}")
            continue
        found[tool] = r
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


def long_range(args: argparse.Namespace, environment: dict[str, str]) -> None:
    """Blocks of long focal length by both of our models."""
    print(f"{'images':>6s} {'points':>7s} {'observations':>12s} {'model':12s} {'sigma0':>8s} {'iterations':>10s} {'stop':>8s} "
          f"{'build s':>8s} {'solve s':>8s} {'CPU s':>8s} {'statistics s':>12s} {'CPU s':>8s} {'peak MB':>8s}")
    for m in args.images:
        for model in ("perspective", "orthogonal"):
            r = called([str(m), "--long-range", "--threads", str(args.threads), "--run", model], environment, args.limit)
            if isinstance(r, str):
                print(f"{m:6d} {model:12s} {r}", flush=True)
                continue
            print(f"{m:6d} {r['points']:7d} {r['observations']:12d} {model:12s} {r['sigma0']:8.4f} {r['iterations']:10d} "
                  f"{r['stop']:>8s} {r['build']:8.2f} {r['solve']:8.2f} {r['cpu']:8.2f} {r['statistics']:12.2f} "
                  f"{r['statistics cpu']:8.2f} {r['peak']:8.0f}", flush=True)


MODULES = {"tuned": "pycolmap", "uncentred": "pycolmap", "defaults": "pycolmap", "gtsam": "gtsam", "scipy": "scipy",
           "traced": "rerun"}
TINY, FEW = 80, 15
"""Images, and points for each, of the block that loads a tool: what its process takes then is the floor of all its blocks."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """One tool on one problem, in this process: loaded, and ours compiled, by a tiny block first."""
    free = tuple(args.free.split(","))

    def adjust(b: dict[str, Any]) -> dict[str, Any]:
        if args.run in ("collinea", "traced"):
            return run_ours(b, args.threads, free, args.covariance, args.run == "traced")
        if args.run in ("gtsam", "scipy"):
            return (run_gtsam if args.run == "gtsam" else run_scipy)(b, args.threads)
        return run_pycolmap(b, args.threads, args.run, args.covariance and args.run == "tuned")

    if args.long_range:
        return run_long_range(args.images[0], args.threads, args.run)
    if args.bal:
        return run_bal(args.bal, args.run, args.threads)
    folder = Path(args.blocks)
    adjust(kept(folder / f"{TINY}.npz"))
    if args.pairs:
        return {"pairs": run_pairs(kept(folder / f"{args.images[0]}.npz"), args.threads, free, args.pairs)}
    floor = _peak()
    done = adjust(kept(folder / f"{args.images[0]}.npz"))
    return done | {"floor": floor, "above": _peak() - floor, "own": _peak() - _status("RssFile")}


def _peak() -> float:
    """Largest memory of this process so far [MB]; the kernel's other count begins with that of the process it was forked from."""
    return _status("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _status(what: str) -> float:
    """A count of memory that Linux keeps for this process [MB], 0 on other systems."""
    status = Path("/proc/self/status")
    return int(status.read_text().split(f"{what}:")[1].split()[0]) / 1024 if status.exists() else 0.0


def called(words: list[str], environment: dict[str, str], limit: float) -> dict[str, Any] | str:
    """What a run in a process of its own says, or why it says nothing."""
    try:
        got = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, env=environment, timeout=limit)
    except subprocess.TimeoutExpired:
        return f"given up after {limit:.0f} s"
    lines = [line for line in got.stdout.splitlines() if line.startswith("RESULT ")]
    return json.loads(lines[0][7:]) if lines else f"failed: {(got.stderr.strip().splitlines() or ['no word'])[-1][:120]}"


def compare(m: int, tools: list[str], args: argparse.Namespace, environment: dict[str, str]) -> None:
    """One block by all tools, a line for each, and its ratios to the first."""
    words = ["--threads", str(args.threads), "--free", args.free, "--blocks", args.blocks,
             *(["--covariance"] if args.covariance else [])]
    print(f"{'':18s} {'cost':>16s} {'iterations':>10s} {'build s':>8s} {'solve s':>8s} {'CPU s':>8s} {'to 1e-6':>8s} "
          f"{'peak MB':>8s} {'floor':>8s} {'above':>8s} {'own':>8s} {'covariance s':>12s} {'CPU s':>8s}")
    first: dict[str, float] = {}
    for tool in tools:
        r = called([str(m), "--run", tool, *words], environment, args.limit)
        if isinstance(r, str):
            print(f"{tool:18s} {r}", flush=True)
            continue
        print(f"{tool:18s} {r['cost']:16.6f} {r['iterations']:10d} {r['build']:8.2f} {r['solve']:8.2f} {r['cpu']:8.2f} "
              f"{r['reached']:8.2f} {r['peak']:8.0f} {r['floor']:8.0f} {r['above']:8.0f} {r['own']:8.0f} "
              f"{r.get('covariance', float('nan')):12.2f} {r.get('covariance cpu', float('nan')):8.2f}", flush=True)
        if first:
            kinds = ("solve", "cpu", "covariance cpu", "peak", "above", "own")
            told = [f"{k} {r[k] / max(first[k], 1e-9):.2f}" for k in kinds if k in r and k in first]
            ours = [f"{k} {first[k] / max(r[k], 1e-9):.2f}" for k in ("peak", "above", "own")]
            print(" " * 18, f"ratios to the first: {', '.join(told)}; memory of the first: {', '.join(ours)}", flush=True)
        first = first or r
    if args.pairs:
        r = called([str(m), "--run", "collinea", "--pairs", str(args.pairs), *words], environment, args.limit)
        print(r if isinstance(r, str) else traced(r["pairs"]), flush=True)


def traced(pairs: list[tuple[float, float, float]]) -> str:
    """What a full trace costs, from pairs of adjustments without and with one."""
    plain, whole, alone = np.array(pairs).T
    share = 100 * (whole / plain - 1)
    return (f"full trace, {len(pairs)} pairs in turn: {np.median(plain):.3f} and {np.median(whole):.3f} CPU s, dearer by "
            f"{100 * (np.median(whole) / np.median(plain) - 1):+.1f} % (medians), single pairs {share.min():+.1f} to "
            f"{share.max():+.1f} %; writing and drawing the rows themselves {100 * np.median(alone / plain):.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="*", type=int, default=[50, 100, 500])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--free", default="c,xp,yp")
    parser.add_argument("--covariance", action="store_true")
    parser.add_argument("--tools", default="collinea,tuned,defaults")
    parser.add_argument("--pairs", type=int, default=0, help="pairs of adjustments without and with a full trace, in turn")
    parser.add_argument("--utm", action="store_true", help="coordinates of a national grid, 679 km and 9,124 km from its origin")
    parser.add_argument("--bal", metavar="FILE", help="a problem in the large instead of blocks")
    parser.add_argument("--long-range", action="store_true", help="blocks of long focal length, both of our models, no peer")
    parser.add_argument("--first-call", action="store_true", help="how long the first adjustment ever takes, and those after it")
    parser.add_argument("--limit", type=float, default=3600.0, help="seconds after which a tool is given up")
    parser.add_argument("--run", help=argparse.SUPPRESS)
    parser.add_argument("--blocks", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        print("RESULT", json.dumps(run(args) | {"peak": _peak()}))
        return
    tools = [t for t in args.tools.split(",") if t == "collinea" or importlib.util.find_spec(MODULES[t])]
    if missing := sorted(set(args.tools.split(",")) - set(tools)):
        print(f"not installed here: {', '.join(missing)}")
    environment = os.environ | {f"{name}_NUM_THREADS": str(args.threads) for name in ("OPENBLAS", "OMP", "MKL")}
    if args.long_range:
        long_range(args, environment)
        return
    if args.first_call:
        first_call(args.threads)
        return
    if args.bal:
        compare_bal(args, environment)
        return
    with tempfile.TemporaryDirectory() as args.blocks:
        for m in (TINY, *(m for m in args.images if m != TINY)):
            b = block(m, FEW) if m == TINY else block(m)
            if args.utm:
                b["poses"][:, :3] += UTM
                b["xyz"] += UTM
            np.savez(Path(args.blocks) / f"{m}.npz", **b)
            if m == TINY:
                continue
            print(f"\n{m} images, {len(b['xyz'])} points, {len(b['image'])} observations, {args.threads} thread(s), "
                  f"load {os.getloadavg()[0]:.1f}")
            del b
            compare(m, tools, args, environment)


if __name__ == "__main__":
    main()
