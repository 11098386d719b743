"""The demo project's controlled mosaic over its height grid: targets lie where they are, to a part of a ground pixel."""

from pathlib import Path

import numpy as np

from solvers import Exterior
from solvers.adjustment import Trace
from solvers.geometry import Grid, LocalFrame
from solvers.io import demo_assets, photo_path, read_project, read_truth
from solvers.mosaic import Registration
from solvers.workflows_compose import ComposeRequest, compose_photos


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

    folder = Path(demo_assets())
    block, truth = read_project(folder), read_truth(folder)
    assert truth is not None
    points = np.array(list(truth["points"].values()))
    frame, names = LocalFrame.around(points, "local"), tuple(truth["images"])
    exteriors = []
    for t in truth["images"].values():
        omega, phi, kappa = (float(np.radians(t[a])) for a in ("omega_deg", "phi_deg", "kappa_deg"))
        exteriors.append(Exterior.from_angles(omega, phi, kappa, np.array([t["X"], t["Y"], t["Z"]]) - frame.origin))
    registration = Registration("exterior", "controlled", "simultaneous", names, tuple(block.camera_of(n) for n in names), None,
                                tuple(exteriors), np.zeros(3), frame, "m", np.zeros((5, 6, 6)), np.zeros(5), 0.0, Trace((), {}))
    out = tmp_path / "demo.tif"
    said = compose_photos(registration, {n: photo_path(folder, block, n) for n in names}, out,
                          ComposeRequest(surface=str(folder / "dem.tif"), blend="feather"))
    assert said["seam_rms"] < 0.5 and said["width"] * said["height"] > 2e6
    with rasterio.open(out) as data:
        rgba, gsd = data.read(), data.transform.a
        grid = Grid((data.height, data.width), tuple(data.transform)[:6])
    errors = []
    for point in points:
        at, k = grid.to_pixels(point[:2]), int(np.ceil(1.6 / gsd))
        col, row = np.round(at).astype(int)
        patch = rgba[:, max(row - k, 0):row + k + 1, max(col - k, 0):col + k + 1]
        if patch.shape[1:] == (2 * k + 1, 2 * k + 1) and (patch[3] == 255).all():
            start = at - np.array([col, row])
            errors.append(off_centre(patch[:3].mean(0).astype(np.float32), start, 1.1 / gsd) - start)
    assert len(errors) > 30
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02 and np.abs(errors).max() < 0.1  # px; half a pixel is asked for
