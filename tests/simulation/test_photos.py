"""Rendered photos: targets are where the truth projects them."""

from pathlib import Path

import numpy as np
import pytest

from solvers.cameras import Interior, project
from solvers.errors import BadProject
from solvers.geometry import Exterior
from solvers.io.project import read_project, read_truth
from solvers.simulation import simulate
from solvers.simulation.render import RING, photograph
from solvers.simulation.scene import pose

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"


def centroid(photo: np.ndarray, near: np.ndarray, reach: float, ring: bool) -> np.ndarray:
    """Weighted centre (2,) col, row of what is not dark within `reach` px; NaN where a white `ring` is wanted and missing."""
    rows, cols = np.mgrid[:photo.shape[0], :photo.shape[1]]
    bright, radius = photo.mean(axis=-1) - 28.0, np.hypot(cols - near[0], rows - near[1]) / reach
    weight = bright * (radius < 1)
    seen = bright[(radius > 0.6) & (radius < 0.75)].mean() > 1.5 * abs(bright[(radius > 0.93) & (radius < 1.05)].mean())
    return np.array([(weight * cols).sum(), (weight * rows).sum()]) / weight.sum() if seen or not ring else np.full(2, np.nan)


def offsets(photo: np.ndarray, camera: Interior, exterior: Exterior, points: np.ndarray, reach_m: float = 0.95,
            ring: bool = True) -> np.ndarray:
    """Found minus expected centres (n, 2) [px of the photo] of the targets at those points (m, 3) whose board is in the photo."""
    reduction = camera.width // photo.shape[1]
    pixels = project(camera, exterior, points)
    found = []
    for point, pixel in zip(points, pixels, strict=True):
        if not camera.inside(pixel, -80):
            continue
        expected = (pixel + 0.5) / reduction - 0.5
        reach = reach_m * camera.c / camera.pitch[0] / float(np.linalg.norm(point - exterior.centre)) / reduction
        corner = np.floor(expected - reach - 2).astype(int)
        window = photo[corner[1]:corner[1] + int(2 * reach) + 6, corner[0]:corner[0] + int(2 * reach) + 6]
        found.append(centroid(window, expected - corner, reach, ring) + corner - expected)
    return np.array(found)


@pytest.mark.parametrize("image", ["DSC00229", "DSC00231", "DSC00233"])
def test_demo_photos_show_the_targets_where_the_truth_projects_them(image: str):
    from PIL import Image

    block, truth = read_project(DEMO), read_truth(DEMO)
    assert truth is not None
    photo = np.asarray(Image.open(DEMO / "images" / f"{image}.jpg"), float)
    camera, t = block.camera_of(image), truth["images"][image]
    assert photo.shape == (camera.height // 4, camera.width // 4, 3)
    exterior = pose(t["omega_deg"], t["phi_deg"], t["kappa_deg"], np.array([t["X"], t["Y"], t["Z"]]))
    off = offsets(photo, camera, exterior, np.array([truth["points"][n] for n in block.points.names]))
    assert len(off) >= 25
    assert np.abs(off).max() < 0.1
    mirrored = offsets(photo[::-1], camera, exterior, np.array([truth["points"][n] for n in block.points.names]))
    assert np.isnan(mirrored).mean() > 0.5


def test_on_plain_ground_the_photo_shows_the_targets_and_nothing_else():
    scene = simulate("uav_cluster", 4, noise=0.0)
    image, terrain = scene.block.images[1].name, scene.terrain
    assert terrain is not None
    camera, exterior = scene.block.camera_of(image), scene.exteriors[image]
    ground = np.full((480, 480, 3), 28, np.uint8)
    photo = photograph(camera, exterior, terrain, ground, 1.0, scene.xyz, reduction=8).astype(float)
    off = offsets(photo, camera, exterior, scene.xyz, reach_m=1.6, ring=False)
    assert len(off) > 30 and np.abs(off).max() < 0.05
    distance = np.linalg.norm(scene.xyz - exterior.centre, axis=1)
    metres = distance[camera.inside(project(camera, exterior, scene.xyz))] * camera.pitch[0] / camera.c * 8
    area = np.pi * (RING[0] ** 2 + RING[2] ** 2 - RING[1] ** 2) / metres**2
    assert ((photo.mean(axis=-1) - 28) / (248.7 - 28)).sum() == pytest.approx(area.sum(), rel=0.05)


def test_rendering_refuses_a_reduction_that_does_not_divide_the_format():
    scene = simulate("uav_cluster", 0)
    assert scene.terrain is not None
    image, ground = scene.block.images[0].name, np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(BadProject, match="reduction 7 does not divide"):
        photograph(scene.block.camera_of(image), scene.exteriors[image], scene.terrain, ground, 60.0, scene.xyz, 7)


def test_a_painted_photo_has_colour_texture_and_shadows():
    scene = simulate("uav_cluster", 0, fine=False)
    assert scene.render is not None
    photo = scene.render(scene.block.images[0].name, 20)
    assert photo.shape == (200, 300, 3) and photo.dtype == np.uint8
    assert photo.std(axis=(0, 1)).min() > 12 and np.median(photo[..., 1]) > np.median(photo[..., 2])
