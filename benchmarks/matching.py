"""Least squares matching beside other area matchers, on real photos warped with known truth: accuracy, honesty, speed.

    python benchmarks/matching.py [DATA]        DATA, or COLLINEA_DATA, or ../shared/data: holds uav_brighton8 and uav_strip5

One run, one thread, CPU time per point (best of the photos), images prepared once and not counted, for all methods alike.
Peers: OpenCV's matchTemplate with a parabola, findTransformECC (affine, filter 5 and 1) and calcOpticalFlowPyrLK.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from solvers.matching import match_lsm, match_ncc, prepare

HALF, PER_PHOTO, SCALE, LENS = 10, 150, 4, 0.5
CASES = {  # turn deg, scale, shear, gain, offset, noise (grey values)
    "shift, noise-free": (0, 0, 0, 0, 0, 0),
    "shift, noise 2": (0, 0, 0, 0, 0, 2),
    "3 deg, 3 %, gain 10 %, noise 2": (3, 0.03, 0.02, 0.1, 10, 2),
    "10 deg, 10 %, gain 20 %, noise 3": (10, 0.10, 0.05, 0.2, 20, 3),
}


def scene(path: Path) -> np.ndarray:
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grey is not None, path
    return cv2.GaussianBlur(grey.astype(np.float32), (0, 0), LENS * SCALE)


def photograph(fine: np.ndarray, warp: np.ndarray, shape: tuple[int, int], steps: int = 6) -> np.ndarray:
    """Pixels averaged over steps x steps samples; exact bilinear sampling of the four times finer, already blurred scene."""
    row, col = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    total = np.zeros(shape, np.float32)
    for a in (np.arange(steps) + 0.5) / steps - 0.5:
        for b in (np.arange(steps) + 0.5) / steps - 0.5:
            x = warp[0, 0] * (col + a) + warp[0, 1] * (row + b) + warp[0, 2]
            y = warp[1, 0] * (col + a) + warp[1, 1] * (row + b) + warp[1, 2]
            place = [(SCALE * v + (SCALE - 1) / 2).astype(np.float32) for v in (x, y)]
            total += cv2.remap(fine, place[0], place[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / steps**2


def random_warp(rng: np.random.Generator, shape: tuple[int, int], turn: float, scale: float, shear: float) -> np.ndarray:
    a, s, k = np.radians(rng.uniform(-turn, turn)), 1 + rng.uniform(-scale, scale), rng.uniform(-shear, shear)
    matrix = s * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ np.array([[1, k], [0, 1]])
    return about_centre(matrix, shape, rng)


def digital(image: np.ndarray, rng: np.random.Generator, gain: float, offset: float, noise: float) -> np.ndarray:
    lit = image * (1 + rng.uniform(-gain, gain)) + rng.uniform(-offset, offset)
    return np.clip(np.round(lit + rng.normal(0, 1, image.shape) * noise), 0, 255).astype(np.uint8)


class Pair:
    """One photo and its warped twin with the true conjugate points."""

    def __init__(self, fine: np.ndarray, rng: np.random.Generator, case: tuple, matrix: np.ndarray | None = None):
        turn, scale, shear, gain, offset, noise = case
        shape = (fine.shape[0] // SCALE, fine.shape[1] // SCALE)
        fine = fine[: shape[0] * SCALE, : shape[1] * SCALE]
        self.exact = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
        warp = random_warp(rng, shape, turn, scale, shear) if matrix is None else about_centre(matrix, shape, rng)
        self.left = digital(self.exact, rng, 0, 0, noise)
        self.right = digital(photograph(fine, warp, shape), rng, gain, offset, noise)
        at = np.round(cv2.goodFeaturesToTrack(self.left, 3 * PER_PHOTO, 0.01, 8)[:, 0]).astype(float)
        self.shape = np.linalg.inv(warp[:, :2])
        truth = (at - warp[:, 2]) @ self.shape.T
        size = np.array(shape[::-1])
        inside = ((truth > 45) & (truth < size - 45) & (at > 45) & (at < size - 45)).all(1)
        self.at, self.truth, self.noise = at[inside][:PER_PHOTO], truth[inside][:PER_PHOTO], noise
        self.photos = prepare(self.left), prepare(self.right)

    def bound(self) -> np.ndarray:
        """(N, 2) Cramer-Rao variances of the conjugate point: exact image, eight parameters, both photos' noise and rounding."""
        spline, slope, value = prepare(self.exact, 0.0).coefficients, np.array([-0.5, 0, 0.5]), np.array([1, 4, 1]) / 6
        c, r = (cv2.sepFilter2D(spline, cv2.CV_64F, a, b) for a, b in ((slope, value), (value, slope)))
        v, u = (a.ravel() for a in np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1])
        out = []
        for x, y in self.at.astype(int):
            w = np.s_[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
            gx, gy, g = c[w].ravel(), r[w].ravel(), self.exact[w].ravel()
            j = np.stack([gx, gx * u, gx * v, gy, gy * u, gy * v, np.ones_like(gx), g], 1)
            q = np.linalg.inv(j.T @ j)[np.ix_([0, 3], [0, 3])]
            out.append(np.diag(self.shape @ q @ self.shape.T) * 2 * (self.noise**2 + 1 / 12))
        return np.array(out)


def ncc_parabola(p: Pair, start: np.ndarray, search: int = 10) -> tuple[np.ndarray, np.ndarray]:
    def top(a: float, b: float, c: float) -> float:
        return 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c else 0.0

    out, ok = np.full((len(start), 2), np.nan), np.zeros(len(start), bool)
    for i, ((tx, ty), (sx, sy)) in enumerate(zip(p.at.astype(int), np.round(start).astype(int), strict=True)):
        x0, y0 = max(sx - HALF - search, 0), max(sy - HALF - search, 0)
        patch = p.right[y0 : sy + HALF + search + 1, x0 : sx + HALF + search + 1]
        table = cv2.matchTemplate(patch, p.left[ty - HALF : ty + HALF + 1, tx - HALF : tx + HALF + 1], cv2.TM_CCOEFF_NORMED)
        _, score, _, (x, y) = cv2.minMaxLoc(table)
        if 0 < x < table.shape[1] - 1 and 0 < y < table.shape[0] - 1:
            dx, dy = top(*table[y, x - 1 : x + 2]), top(*table[y - 1 : y + 2, x])
            out[i], ok[i] = (x + dx + x0 + HALF, y + dy + y0 + HALF), score > 0.5
    return out, ok


def ecc(p: Pair, start: np.ndarray, blur: int) -> tuple[np.ndarray, np.ndarray]:
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-6)
    out, ok, reach = np.full((len(start), 2), np.nan), np.zeros(len(start), bool), HALF + 12
    for i, ((tx, ty), (sx, sy)) in enumerate(zip(p.at.astype(int), np.round(start).astype(int), strict=True)):
        x0, y0 = sx - reach, sy - reach
        if x0 < 0 or y0 < 0:
            continue
        warp = np.array([[1, 0, reach - HALF], [0, 1, reach - HALF]], np.float32)
        patch = p.right[y0 : sy + reach + 1, x0 : sx + reach + 1]
        template = p.left[ty - HALF : ty + HALF + 1, tx - HALF : tx + HALF + 1]
        try:
            everywhere = np.full(patch.shape, 255, np.uint8)
            score, warp = cv2.findTransformECC(template, patch, warp, cv2.MOTION_AFFINE, stop, everywhere, blur)
        except cv2.error:
            continue
        out[i], ok[i] = warp @ [HALF, HALF, 1] + [x0, y0], score > 0.5
    return out, ok


def klt(p: Pair, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    q, found, _ = cv2.calcOpticalFlowPyrLK(
        p.left, p.right, p.at.astype(np.float32)[:, None], start.astype(np.float32)[:, None].copy(), winSize=(21, 21), maxLevel=0,
        criteria=(3, 50, 0.001), flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    return q[:, 0].astype(float), found[:, 0] > 0


def lsm(p: Pair, start: np.ndarray, **how) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r = match_lsm(*p.photos, p.at, start, 2 * HALF + 1, **how)
    return r.pixel, r.ok, r.sigma


def ncc(p: Pair, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r = match_ncc(*p.photos, p.at, start, 2 * HALF + 1)
    return r.pixel, r.ok


METHODS = {
    "match_lsm": lsm,
    "match_ncc + match_lsm": lambda p, s: lsm(p, s, search=10),
    "match_ncc": ncc,
    "NCC + parabola": ncc_parabola,
    "ECC affine, filter 5": lambda p, s: ecc(p, s, 5),
    "ECC affine, filter 1": lambda p, s: ecc(p, s, 1),
    "KLT 21 px": klt,
}


def around(truth: np.ndarray, distance: float, seed: int = 5) -> np.ndarray:
    turn = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(truth))
    return truth + distance * np.stack([np.cos(turn), np.sin(turn)], 1)


def accuracy(scenes: list[np.ndarray]) -> None:
    for name, case in CASES.items():
        rng = np.random.default_rng(1)
        pairs = [Pair(s, rng, case) for s in scenes]
        bound = np.concatenate([p.bound() for p in pairs])
        print(f"\n{name}: {len(bound)} points, Cramer-Rao bound {np.sqrt(bound.mean()):.4f} px")
        heads = ("ok %", "rms px", "/ ours", "/ CRB", "sd/rms", "us/point", "/ ours")
        print(f"{'method':24s}" + "".join(f"{head:>9s}" for head in heads))
        first: tuple[float, float] | None = None
        for label, method in METHODS.items():
            error, ok, sigma, best = [], [], [], np.inf
            for p in pairs:
                start = around(p.truth, 0.5)
                answer = method(p, start)  # warm
                for _ in range(3):
                    clock = time.process_time()
                    answer = method(p, start)
                    best = min(best, (time.process_time() - clock) / len(start) * 1e6)
                error.append(answer[0] - p.truth)
                ok.append(answer[1] & (np.linalg.norm(error[-1], axis=1) < 1))
                sigma.append(answer[2] if len(answer) == 3 else np.full_like(error[-1], np.nan))
            e, o, s = np.concatenate(error), np.concatenate(ok), np.concatenate(sigma)
            rms = float(np.sqrt((e[o] ** 2).mean()))
            first = first or (rms, best)
            told = float(np.sqrt((s[o] ** 2).mean())) / rms
            over = rms / float(np.sqrt(bound[o].mean()))
            print(f"{label:24s}{100 * o.mean():9.1f}{rms:9.4f}{rms / first[0]:9.2f}{over:9.2f}{told:9.2f}{best:9.1f}"
                  f"{best / first[1]:9.2f}", flush=True)


def noise_levels(scenes: list[np.ndarray]) -> None:
    print("\nnoise, both photos, 3 deg and 3 %: rms over bound, reported over actual, untrimmed")
    for noise in (1, 2, 4):
        rng = np.random.default_rng(11)
        pairs = [Pair(s, rng, (3, 0.03, 0.02, 0, 0, noise)) for s in scenes]
        found = [lsm(p, p.truth + 0.1) for p in pairs]
        e = np.concatenate([(f[0] - p.truth)[f[1]] for f, p in zip(found, pairs, strict=True)])
        s = np.concatenate([f[2][f[1]] for f in found])
        b = np.concatenate([p.bound()[f[1]] for f, p in zip(found, pairs, strict=True)])
        rms = np.sqrt((e**2).mean())
        over, told = rms / np.sqrt(b.mean()), np.sqrt((s**2).mean()) / rms
        print(f"noise {noise}: rms {rms:.4f} px, / CRB {over:.3f}, sd / rms {told:.3f}, "
              f"rms of error / sd {np.sqrt((e**2 / s**2).mean()):.3f}", flush=True)


def pull_in(scenes: list[np.ndarray]) -> None:
    rng = np.random.default_rng(2)
    pairs = [Pair(s, rng, (2, 0.02, 0.01, 0.1, 10, 2)) for s in scenes]
    steps = (0.5, 1, 2, 4, 6, 8, 10)
    print("\n% within 0.3 px of the truth, by the error of the start in px\n" + " " * 24, *[f"{v:6}" for v in steps])
    for label, search in (("match_lsm", 0), ("match_ncc + match_lsm", 12)):
        rates = []
        for distance in steps:
            hits = [np.linalg.norm(lsm(p, around(p.truth, distance), search=search)[0] - p.truth, axis=1) < 0.3 for p in pairs]
            rates.append(100 * np.concatenate(hits).mean())
        print(f"{label:24s}", *[f"{v:6.1f}" for v in rates], flush=True)
    print("\n% within 0.3 px, affine given to 2 %, start 5 px off: turn deg, scale")
    for turn, scale in ((45, 1.0), (90, 1.4), (180, 0.7), (120, 1.2)):
        hits, wrong, count = 0, 0, 0
        for fine in scenes[:3]:
            a = np.radians(turn)
            matrix = scale * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
            p = Pair(fine, np.random.default_rng(3), (0, 0, 0, 0.1, 10, 2), matrix)
            pixel, ok, _ = lsm(p, around(p.truth, 5), search=8, shape=p.shape @ np.array([[1.02, 0.02], [-0.02, 0.98]]))
            far = np.linalg.norm(pixel - p.truth, axis=1)
            hits, wrong, count = hits + (far < 0.3).sum(), wrong + (ok & (far > 1)).sum(), count + len(far)
        print(f"  {turn:4d} {scale:4.1f}: {100 * hits / count:.1f} of {count}, confidently wrong {wrong}", flush=True)


def about_centre(matrix: np.ndarray, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    centre = np.array(shape[::-1]) / 2
    return np.column_stack([matrix, centre - matrix @ centre + rng.uniform(-3, 3, 2)])


def main() -> None:
    default = os.environ.get("COLLINEA_DATA", Path(__file__).parents[1] / "../shared/data")
    data = Path(sys.argv[1] if len(sys.argv) > 1 else default)
    photos = sorted(data.glob("uav_brighton8/*.JPG"))[::3] + sorted(data.glob("uav_strip5/*.JPG"))[::2]
    if not photos:
        sys.exit(f"no photos under {data}: give the folder that holds uav_brighton8 and uav_strip5")
    cv2.setNumThreads(1)
    scenes = [scene(p) for p in photos]
    clock = time.process_time()
    ready = prepare(np.zeros((2000, 3000), np.uint8))
    print(f"OpenCV {cv2.__version__}, {len(scenes)} photos, window {2 * HALF + 1} px; preparing (smoothing and B-spline) "
          f"{ready.coefficients.size / 1e6 / (time.process_time() - clock):.0f} Mpx/s")
    accuracy(scenes)
    noise_levels(scenes)
    pull_in(scenes)


if __name__ == "__main__":
    main()
