"""Bundle adjustment of the demo, and what its check points say.

You will see: the rows of the adjustment that orients all five photos together, each photo's standard errors beside those
of its own resection (together they know more), the errors at the check points beside their standard errors, and the same
block adjusted as a free network, whose standard errors depend on no datum.

    python examples/03_bundle.py
"""

from pathlib import Path

import numpy as np

from solvers.io import read_project
from solvers.orientation import adjust, resect

DEMO = Path(__file__).resolve().parents[1] / "assets" / "demo"


def main() -> None:
    block = read_project(DEMO)
    together = adjust(block)
    print(f"{'row':>4} {'sigma0':>12} {'step':>10}")
    for row in together.trace.rows:
        print(f"{row.index:4d} {row.sigma0:12.4f} {'' if row.index == 0 else f'{row.step:.2g}':>10}   {row.stop or ''}")

    print(f"\n{'standard errors of':<20} {'X, Y, Z alone [m]':>26} {'in the block [m]':>26}")
    for orientation in together.orientations:
        alone = resect(block, orientation.image)
        columns = (" ".join(f"{s:8.4f}" for s in o.sigma[:3]) for o in (alone, orientation))
        print(f"{orientation.image:<20} {next(columns)} {next(columns)}")

    print(f"\n{'check point':<12} {'error X, Y, Z [m]':>26} {'standard error [m]':>26}")
    for point in together.points:
        if point.role == "check":
            errors, sigmas = (" ".join(f"{v:8.4f}" for v in values) for values in (point.off, np.sqrt(np.diag(point.covariance))))
            print(f"{point.name:<12} {errors} {sigmas}")

    free = adjust(block, datum="free")
    print(f"\nfree network: sigma0 {free.sigma0:.3f} with redundancy {free.dof}, rms {free.rms_px:.3f} px; "
          f"by control: sigma0 {together.sigma0:.3f} with redundancy {together.dof}, rms {together.rms_px:.3f} px")


if __name__ == "__main__":
    main()
