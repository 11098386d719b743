"""Mosaics of real photos: held out tie points, recorded yaw, photos that do not belong, orthophotos of neighbours."""

import json
import shutil
from dataclasses import replace
from itertools import combinations, product

import cv2
import numpy as np
import pytest

from solvers import Exterior, Interior
from solvers.cli import main
from solvers.geometry import Grid
from solvers.io import read_photo, read_surface
from solvers.mosaic import orthorectify


def mosaic(folder, tmp_path, *options):
    code = main(["mosaic", str(folder), "-o", str(tmp_path / "m.tif"), "--json", str(tmp_path / "m.json"), "--quiet",
                 "--workers", "1", *options])
    return code, json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "count"), [("uav_brighton8", 8), ("uav_strip5", 5)])
def test_held_out_ties_fit(data, tmp_path, name, count):
    folder = tmp_path / name
    folder.mkdir()
    for f in (data / name).iterdir():
        if f.suffix.lower() == ".jpg":
            shutil.copy(f, folder)
    if count == 8:  # a photo of another flight among them
        shutil.copy(next((data / "uav_strip5").glob("*.JPG")), folder / "stranger.jpg")
    code, done = mosaic(folder, tmp_path)
    assert [i["name"] for i in done["images"] if not i["used"]] == (["stranger"] if count == 8 else [])
    assert code == (1 if count == 8 else 0)
    assert done["kind"] == "semicontrolled" and done["check_ties"]["count"] > 100
    if count == 8:
        turned = {h["image"] for h in done["headings"] if abs(h["correction_deg"]) > 160}
        assert turned == {f"DJI_002{k}" for k in (4, 5, 6, 7)}
        assert any("reversed" in w for w in done["warnings"])
    assert done["check_ties"]["median_px"] <= 1.5


def test_orthophotos_of_neighbours_agree_over_their_height_grid(data):
    """All six pairs of four aerial photos, within 0.3 cell of their DEM: windows that both show whole, by phase correlation."""
    folder, gsd = data / "ortho_ngi", 10.0
    rows = [line.split() for line in (folder / "camera_pos_ori.txt").read_text().splitlines()]
    camera = Interior(120.0, pixel_mm=0.144, width=640, height=1152)
    surface = read_surface(folder / "dem.tif", (-60454, -3735692, -52606, -3723500))
    surface = replace(surface, grid=replace(surface.grid, crs="local"))
    grid = Grid((1219, 784), (gsd, 0.0, -60454.0, 0.0, -gsd, -3723500.0))
    made, counts = [], []
    for name, *numbers in rows:
        x, y, z, omega, phi, kappa = map(float, numbers)
        pose = Exterior.from_angles(*np.radians([omega, phi, kappa]), centre=np.array([x, y, z]))
        made.append(orthorectify(read_photo(folder / f"{name}.tif"), camera, pose, surface, grid)[:2])
    for (a, seen_a), (b, seen_b) in combinations(made, 2):
        off = []
        for top, left in product(range(0, 1155, 40), range(0, 720, 40)):
            part = slice(top, top + 64), slice(left, left + 64)
            if (seen_a[part] & seen_b[part]).all():
                first, second = (np.ascontiguousarray(v[part][..., 0]) for v in (a, b))
                (right, down), _ = cv2.phaseCorrelate(first, second, cv2.createHanningWindow((64, 64), cv2.CV_32F))
                off.append(float(np.hypot(right, down)) * gsd)
        counts.append(len(off))
        assert np.median(off) < 0.3 * 24 and np.percentile(off, 90) < 0.3 * 24
    assert min(counts) >= 2 and sum(counts) > 60
