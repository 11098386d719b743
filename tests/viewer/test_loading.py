"""From a project folder to the first state: terrain, photos reduced by a factor, and what may be missing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import BadProject
from solvers.io import write_project
from tests.viewer.conftest import make_block, make_state
from viewer_app.actions import Brought, Say, update
from viewer_app.loading import bring, crop, open_project, photo
from viewer_app.panels.photo import HALF, magnified
from viewer_app.scene import scene
from viewer_app.state import Mark, Photo

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"


def test_the_demo_brings_terrain_photos_and_truth(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    state = open_project(folder)
    for action in bring(state):
        assert isinstance(action, Brought)
        state = update(state, action)
    assert set(state.assets.photos) == {i.name for i in state.block.images} == set(state.assets.truth)
    terrain = state.assets.terrain
    assert terrain is not None and terrain.faces.max() < len(terrain.vertices)
    a, b, c = (terrain.vertices[terrain.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()  # seen from above
    xyz = state.assets.frame.to_local(state.block.points.xyz)
    near = terrain.vertices[np.argmin(np.linalg.norm(terrain.vertices[None, :, :2] - xyz[:, None, :2], axis=-1), axis=1)]
    assert np.abs(near[:, 2] - xyz[:, 2]).max() < 3.0
    for p in state.assets.photos.values():
        assert max(p.pane.shape) <= 1100 and max(p.thumbnail.shape) <= 480 and p.thumbnail.dtype == np.uint8


def test_measurements_without_photos_open(tmp_path: Path) -> None:
    block, _ = make_block()
    write_project(block, tmp_path / "bare")
    state = open_project(tmp_path / "bare")
    assert list(bring(state)) == [] and "/points/control" in scene(state)


def test_a_missing_photo_or_surface_is_said_and_left_out(tmp_path: Path) -> None:
    block, _ = make_block()
    images = (replace(block.images[0], file="images/none.jpg"), block.images[1])
    write_project(replace(block, images=images, surface={"file": "none.tif"}), tmp_path / "bare")
    said = list(bring(open_project(tmp_path / "bare")))
    assert [type(a) for a in said] == [Say, Say] and "none.tif" in said[0].message and "none.jpg" in said[1].message  # type: ignore[union-attr]


def test_a_folder_without_a_project_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadProject):
        open_project(tmp_path)


def test_the_magnifier_shows_the_pixel_that_is_marked(picture: Path) -> None:
    """A file of 1000 x 667 stands for a format of 6000 x 4000: full = (file + 0.5) * factor - 0.5."""
    from PIL import Image as Picture

    whole = np.asarray(Picture.open(picture))
    shown = Photo(picture, whole, whole, (1000, 667))
    for file in ((500, 300), (255, 256), (3, 660)):
        full = (np.array(file) + 0.5) * [6, 4000 / 667] - 0.5
        pixels, x, y = crop(shown, (6000, 4000), float(full[0]), float(full[1]), HALF)
        assert pixels.shape == (2 * HALF + 1, 2 * HALF + 1, 3)
        assert np.allclose([x, y], HALF) and np.array_equal(pixels[round(y), round(x)], whole[file[1], file[0]])


def test_a_place_in_the_magnifier_is_the_same_pixel_of_the_photo(picture: Path) -> None:
    state = make_state(picture)
    shown = state.assets.photos["left"]
    marked = replace(state, mark=Mark("G01", 3001.3, 2000.7))
    _, x, y = crop(shown, (6000, 4000), 3001.3, 2000.7, HALF)
    side = 2 * HALF + 1
    assert np.allclose(magnified(marked, shown, (x + 0.5) / side, (y + 0.5) / side), (3001.3, 2000.7), atol=1e-9)


def test_photo_raises_where_there_is_none(tmp_path: Path) -> None:
    block, _ = make_block()
    with pytest.raises(BadProject, match="no photo"):
        photo(tmp_path, block, "left")
