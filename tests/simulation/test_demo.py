"""The demo project in assets/ is what the simulation makes."""

from pathlib import Path

import numpy as np
import pytest
import rasterio

from solvers.io.project import write_project
from solvers.simulation import simulate

ASSETS = Path(__file__).resolve().parents[2] / "assets"
SEED = 22  # of assets/make_demo.py


def test_the_demo_tables_are_made_again_byte_for_byte(tmp_path: Path):
    scene = simulate("uav_cluster", SEED)
    write_project(scene.block, tmp_path, truth=scene.truth)
    for name in ("project.toml", "points.csv", "observations.csv", "truth.json"):
        assert (tmp_path / name).read_bytes() == (ASSETS / "demo" / name).read_bytes(), name


def test_the_demo_terrain_is_that_of_the_simulation():
    terrain = simulate("uav_cluster", SEED).terrain
    assert terrain is not None
    with rasterio.open(ASSETS / "demo" / "dem.tif") as data:
        assert np.array_equal(data.read(1), terrain.heights)
        assert data.xy(0, 0) == pytest.approx((terrain.west, terrain.north), abs=1e-6)
        assert data.res == pytest.approx((terrain.cell, terrain.cell))


def test_assets_stay_small():
    assert sum(f.stat().st_size for f in ASSETS.rglob("*") if f.is_file()) < 8e6
