"""The orthogonal projection model beside the perspective one.

You will see: the orthogonal resection of each of the demo's five clusters of about 6 degrees, beside the perspective
one from the same points: the errors of the two against the truth, and the standard errors that predict them. The two
suffer alike in so narrow a field. Last, the single pass of the papers, which takes an approximate orientation (here
the onboard one, good to 1.5 degrees), transforms the image coordinates once and keeps part of its error.

    python examples/02_orthogonal.py
"""

from pathlib import Path

import numpy as np

from solvers.adjustment import Trace, iterate
from solvers.io import read_project, read_truth
from solvers.orientation import Orientation, Request, conclude, orient, prepare

DEMO = Path(__file__).resolve().parents[1] / "assets" / "demo"
NAMES = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")


def line(what: str, orientation: Orientation, truth: dict) -> None:
    """Prints the true errors of an orientation and its predicted tilt error."""
    found, true = orientation.to_json(), truth["images"][orientation.image]
    errors = " ".join(f"{found[n] - true[n]:8.3f}" for n in NAMES)
    tilt = float(np.degrees(np.hypot(*orientation.sigma[3:5])))
    print(f"{what:<24} {errors}   {tilt:9.3f} {orientation.rms_px:8.3f}")


def main() -> None:
    block, truth = read_project(DEMO), read_truth(DEMO) or {}
    image = block.images[0].name
    clusters = sorted({g for g in block.points.group if g})
    members = {c: tuple(p for p, g in zip(block.points.names, block.points.group, strict=True) if g == c) for c in clusters}

    print(f"{image}, orthogonal model, cluster1: the re-transformation repeated until it stands still\n")
    start = prepare(block, Request(image, "orthogonal", points=members["cluster1"]))
    rows = tuple(iterate(start.problem, start.x0, start.options))
    for row in rows:
        step = "" if row.index == 0 else f"{row.step:.2g}"
        print(f"row {row.index:3d}   sigma0 {row.sigma0:12.5f}   step {step:>9}   {row.stop or ''}")
    first = conclude(start, Trace(rows, start.manifest))

    heads = " ".join(f"{h:>8}" for h in ("X m", "Y m", "Z m", "omega", "phi", "kappa"))
    print(f"\n{'errors against the truth':<24} {heads}   {'tilt sd':>9} {'rms px':>8}")
    for c, points in members.items():
        line(f"{c} perspective", orient(block, Request(image, "perspective", points=points)), truth)
        line(f"{c} orthogonal", first if c == "cluster1" else orient(block, Request(image, "orthogonal", points=points)), truth)
    line("cluster1 one pass", orient(block, Request(image, "orthogonal", points=members["cluster1"], one_pass=True)), truth)
    line("all 33, perspective", orient(block, Request(image, "perspective")), truth)


if __name__ == "__main__":
    main()
