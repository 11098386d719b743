"""Makes the demo project: python assets/make_demo.py [FOLDER]  (default: assets/demo, replaced). About half a minute of CPU."""

import shutil
import sys
from pathlib import Path

from solvers.workflows import simulate_project

SEED = 22

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "demo"
    if len(sys.argv) == 1:
        shutil.rmtree(folder, ignore_errors=True)
    simulate_project("uav_cluster", folder, seed=SEED, quality=90)
    size = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file())
    print(f"{folder}: {size / 1e6:.1f} MB")
