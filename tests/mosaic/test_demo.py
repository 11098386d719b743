"""The demo project's controlled mosaic, registered by its control points, over its height grid: targets lie where they are, to a
part of a ground pixel."""

import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from solvers.cli import main
from solvers.geometry import Grid
from solvers.io import demo_assets, read_truth
from solvers.workflows_report import report_project


def off_centre(patch: np.ndarray, start: np.ndarray, reach: float) -> np.ndarray:
    """(2,) col, row in a patch (odd side) about which it looks most like itself turned by half a turn: a ring's middle."""
    import cv2
    from scipy.optimize import minimize

    k = patch.shape[0] // 2
    col, row = np.meshgrid(np.arange(-k, k + 1), np.arange(-k, k + 1))

    def unlike(at: np.ndarray) -> float:
        turned = cv2.remap(patch, (k + 2 * at[0] - col).astype(np.float32), (k + 2 * at[1] - row).astype(np.float32),
                           cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        inside = np.hypot(col - at[0], row - at[1]) < reach
        return float(((turned - patch)[inside] ** 2).mean())

    simplex = np.array([start, start + np.array([0.4, 0]), start + np.array([0, 0.4])])
    return minimize(unlike, start, method="Nelder-Mead", options={"xatol": 1e-3, "initial_simplex": simplex}).x


def test_targets_lie_where_they_are(tmp_path):
    import rasterio

    folder, out = tmp_path / "demo", tmp_path / "demo.tif"
    shutil.copytree(demo_assets(), folder, ignore=shutil.ignore_patterns("runs"))
    assert main(["mosaic", str(folder), "-o", str(out), "--surface", str(folder / "dem.tif"), "--workers", "1", "--quiet",
                 "--json", str(tmp_path / "m.json")]) == 0
    said, truth = json.loads((tmp_path / "m.json").read_text()), read_truth(folder)
    assert said["kind"] == "controlled" and all(i["used"] for i in said["images"]) and truth is not None
    assert said["check_rms_m"] < said["gsd"] / 2 and said["seconds"]["register"] > 0
    assert said["seam_rms"] < 0.5 and said["width"] * said["height"] > 2e6
    stages = json.loads((Path(said["run"]) / "trace-registration.json").read_text())["stages"]
    assert stages[-1]["stage"] == "bundle"
    with rasterio.open(out) as data:
        rgba, gsd = data.read(), data.transform.a
        grid = Grid((data.height, data.width), tuple(data.transform)[:6])
    with Image.open(Path(said["run"]) / "mosaic.png") as small:
        shrunk, preview = rgba.shape[2] / small.width, np.asarray(small)
    assert max(preview.shape) == 900 and shrunk > 1
    seen = preview[..., 3] == 255
    rows, cols = (np.argwhere(seen) * shrunk + shrunk / 2).astype(int).T
    assert seen.mean() > 0.3 and np.abs(preview[seen][:, :3].mean(0) - rgba[:3, rows, cols].mean(1)).max() < 2
    report_project(folder, tmp_path / "r.html")
    assert "The mosaic, reduced" in (tmp_path / "r.html").read_text(encoding="utf-8")
    errors = []
    for point in np.array(list(truth["points"].values())):
        at, k = grid.to_pixels(point[:2]), int(np.ceil(1.6 / gsd))
        col, row = np.round(at).astype(int)
        patch = rgba[:, max(row - k, 0):row + k + 1, max(col - k, 0):col + k + 1]
        if patch.shape[1:] == (2 * k + 1, 2 * k + 1) and (patch[3] == 255).all():
            start = at - np.array([col, row])
            errors.append(off_centre(patch[:3].mean(0).astype(np.float32), start, 1.1 / gsd) - start)
    assert len(errors) > 30
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05 and np.abs(errors).max() < 0.2  # px; half a pixel is asked for
