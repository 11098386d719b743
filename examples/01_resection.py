"""Perspective resection, step by step.

You will see: the iterations of the adjustment of the demo's first photo (no approximate value is given: row 0 is
found from the control alone), the exterior orientation with its standard errors and its true errors, and the largest
residuals. Then the same photo from the five points of one narrow cluster: far less certain, and honestly so.

    python examples/01_resection.py
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solvers import Block
from solvers.adjustment import Iteration, Trace, iterate
from solvers.geometry import LocalFrame
from solvers.io import read_project, read_truth
from solvers.orientation import Orientation, Request, conclude, prepare

DEMO = Path(__file__).resolve().parents[1] / "assets" / "demo"
NAMES = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")


def shown(rows: Iterator[Iteration], origin: np.ndarray) -> Iterator[Iteration]:
    """Prints each row of an adjustment as it comes and passes it on."""
    print(f"{'row':>4} {'sigma0':>12} {'step':>10}   {'X':>12} {'Y':>13} {'Z':>10}   m")
    for row in rows:
        x, y, z = row.x[:3] + origin
        step = "" if row.index == 0 else f"{row.step:.2g}"
        print(f"{row.index:4d} {row.sigma0:12.4f} {step:>10}   {x:12.3f} {y:13.3f} {z:10.3f}   {row.stop or ''}")
        yield row


def solve(block: Block, request: Request) -> Orientation:
    """Orients one image and prints the rows on the way."""
    start = prepare(block, request)
    origin = LocalFrame.around(block.points.xyz, block.crs, block.frame).origin
    rows = tuple(shown(iterate(start.problem, start.x0, start.options), origin))
    return conclude(start, Trace(rows, start.manifest))


def table(orientation: Orientation, truth: dict) -> None:
    """Prints an orientation beside its standard errors and its true errors."""
    found = orientation.to_json()
    true = truth["images"][orientation.image]
    print(f"{'':>10} {'value':>15} {'std. error':>11} {'true error':>11}")
    for name in NAMES:
        print(f"{name:>10} {found[name]:15.4f} {found['sigma'][name]:11.4f} {found[name] - true[name]:11.4f}")
    sigma0 = "none" if orientation.sigma0 is None else f"{orientation.sigma0:.3f}"
    print(f"sigma0 {sigma0}, {orientation.dof} degrees of freedom, rms {orientation.rms_px:.3f} px, stopped by: {found['stop']}")
    for warning in orientation.warnings:
        print(f"warning: {warning}")


def main() -> None:
    block, truth = read_project(DEMO), read_truth(DEMO) or {}
    image = block.images[0].name

    print(f"{image}, perspective model, all control points\n")
    everything = solve(block, Request(image))
    table(everything, truth)
    worst = np.argsort(-np.abs(everything.w).max(axis=1))[:3]
    for i in worst:
        col, row = everything.residuals[i]
        print(f"residual of {everything.points[i]}: {col:+.2f} {row:+.2f} px, standardized {np.abs(everything.w[i]).max():.1f}")

    cluster = tuple(p for p, g in zip(block.points.names, block.points.group, strict=True) if g == "cluster1")
    print(f"\n{image}, perspective model, cluster1 only ({', '.join(cluster)}: a field of 6 degrees)\n")
    table(solve(block, Request(image, points=cluster)), truth)


if __name__ == "__main__":
    main()
