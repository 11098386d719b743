"""Least squares matching, step by step.

You will see: a control point's window of one demo photo found in another, first by correlation, then by least squares
matching row after row; then all the points of both photos at once, with their standard errors, beside where the truth of
the simulation puts them.

    python examples/04_matching.py
"""

from pathlib import Path

import numpy as np

from solvers.io import read_photo, read_project
from solvers.matching import match_lsm, match_stepped

DEMO = Path(__file__).resolve().parents[1] / "assets" / "demo"
REDUCED = 4
"""The demo's photos are a quarter of the full format."""


def pairs(first: str, second: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(n, 2) pixels of the points measured in both photos, in the reduced photos."""
    block = read_project(DEMO)
    of = block.observations
    at = {(block.images[i].name, block.points.names[p]): px for i, p, px in zip(of.image, of.point, of.pixel, strict=True)}
    names = [p for p in block.points.names if (first, p) in at and (second, p) in at]
    both = np.array([[at[first, p], at[second, p]] for p in names])
    a, b = np.swapaxes((both + 0.5) / REDUCED - 0.5, 0, 1)
    return a, b, names


def main() -> None:
    first, second = "DSC00229", "DSC00230"
    a, b = (read_photo(DEMO / "images" / f"{n}.jpg") for n in (first, second))
    at, true, names = pairs(first, second)
    k = names.index("G07")
    near = np.round(true[k] + np.array([5.0, -4.0]))

    one = match_stepped(a, b, at[k], near)
    print(f"G07 by correlation, started {np.hypot(*(near - true[k])):.1f} px off: score {one.ncc.score[0]:.3f}, "
          f"{np.hypot(*(one.ncc.pixel[0] - true[k])):.3f} px from the measurement\n")
    print(f"{'row':>4} {'col':>10} {'row':>10} {'correlation':>12} {'step':>9}")
    for row in one.rows:
        patches = one.patches(row.index)
        score = f"{patches.score:.4f}" if patches else ""
        print(f"{row.index:4d} {row.x[0]:10.4f} {row.x[3]:10.4f} {score:>12} "
              f"{'' if row.index == 0 else f'{row.step:.1g}':>9}   {row.stop or ''}")

    many = match_lsm(a, b, at, true + np.random.default_rng(1).uniform(-0.5, 0.5, true.shape), window=21)
    good = many.status == 0
    off = many.pixel[good] - true[good]
    print(f"\n{good.sum()} of {len(at)} points matched at once; standard errors {np.median(many.sigma[good]):.3f} px (median), "
          f"differences to the rings' measured centres {np.sqrt((off**2).mean()):.3f} px rms (both have errors)")


if __name__ == "__main__":
    main()
