"""Thousands of images: few nodes, the same poses as one by one, little work asked for at once."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import viser
from viser import transforms as tf

from benchmarks.viewer import many_cameras
from solvers.io import write_project
from solvers.legend import CONTROL, INITIAL, css
from solvers.simulation import large_block
from tests.viewer.test_security import pages
from viewer_app.actions import ChoosePoint
from viewer_app.app import App
from viewer_app.bridge import controls
from viewer_app.export import glb
from viewer_app.lists import MOST, rows_of
from viewer_app.loading import open_project
from viewer_app.paint_viser import _frusta_poses, _quaternions, frustum_pose
from viewer_app.panels.pair import MOST as PAIR_MOST
from viewer_app.scene import MANY
from viewer_app.state import AHEAD, MODELS, Solution, State, control_seen, measured, wanted
from viewer_app.tabs import whole_scene
from viewer_app.values import Frusta, Frustum, Label, frusta_corners, frustum_corners


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> State:
    folder = tmp_path_factory.mktemp("large")
    write_project(large_block(0, images=400, points=2).block, folder)
    return open_project(folder)


def test_two_thousand_images_are_a_few_nodes() -> None:
    scene = whole_scene(many_cameras(2000))
    batches = [v for v in scene.values() if isinstance(v, Frusta)]
    assert len(batches) == 2 and all(len(b.centres) == 1999 for b in batches)
    cameras = [path for path, value in scene.items() if isinstance(value, Frusta | Frustum) or path.endswith("camera")]
    assert len(cameras) <= 10 and "/images/I00000/perspective/camera" in scene


def test_a_batch_stands_as_single_frustums_do() -> None:
    state = many_cameras(MANY + 1)
    batch = whole_scene(state)["/images/perspective"]
    assert isinstance(batch, Frusta)
    wxyz, centres = _frusta_poses(batch)
    for k in range(MANY):
        exterior = state.exterior("perspective", f"I{k + 1:05d}")
        assert exterior is not None
        one, at = frustum_pose(exterior)
        assert np.allclose(at, centres[k], atol=1e-3) and abs(abs(one @ wxyz[k]) - 1) < 1e-6
        x, y = batch.half[k]
        single = Frustum(exterior, 2 * np.arctan(y), x / y, batch.depth, batch.colour)
        assert np.allclose(frustum_corners(single), frusta_corners(batch)[k])


def test_quaternions_of_any_rotation() -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(500, 4))
    half_turns = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]], float)
    q = np.concatenate([q, half_turns])
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    found = _quaternions(np.array([tf.SO3(v).as_matrix() for v in q]))
    assert np.allclose(np.abs((found * q).sum(axis=1)), 1, atol=1e-12)


def test_little_is_wanted_at_once_and_all_in_the_end() -> None:
    state = many_cameras(500)
    jobs = wanted(state)
    assert len(jobs) <= AHEAD and {j.model for j in jobs} >= {"advice"} - set(MODELS)
    assert sum(measured(state.block).values()) == len(state.block.observations)


def test_of_many_images_those_without_control_are_not_tried_until_they_are_chosen(block: State) -> None:
    state = block
    control = {n for n, r in zip(state.block.points.names, state.block.points.role, strict=True) if r == "control"}
    bare = [i.name for i in state.block.images if len(control & set(control_seen(state.block, i.name))) < 3]
    assert 0 < len(bare) < len(state.block.images) - 10
    solved = Solution(state.work.revision, error="x")
    tried: set[str] = set()
    while jobs := wanted(state):
        tried |= {j.image for j in jobs}
        state = replace(state, work=replace(state.work, solutions={**state.work.solutions, **{j.key[:2]: solved for j in jobs}}))
    assert tried == {i.name for i in state.block.images} - set(bare) | {state.image}
    other = next(name for name in bare if name != state.image)
    assert next(r for r in rows_of(state, "images")[0] if r.name == other).values["status"] == "no solution"
    assert {j.image for j in wanted(replace(state, image=other))} == {other}


def test_of_many_names_those_of_the_chosen_image_come_first_then_such_as_are_far_apart(
    block: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    def names(state: State) -> dict[str, Label]:
        return {v.text: v for p, v in whole_scene(state).items() if isinstance(v, Label) and p.startswith("/points/names/")}

    known = {n for n, r in zip(block.block.points.names, block.block.points.role, strict=True) if r != "tie"}
    seen = {block.block.points.names[block.block.observations.point[k]] for k in block.block.seen_in(block.image)} & known
    every = names(block)
    assert set(every) == known and 0 < len(seen) < len(known)  # the page makes them room
    assert {n for n, v in every.items() if v.size > 0.8} == seen
    monkeypatch.setattr("viewer_app.ground.NAMES", len(seen) + 6)
    few = names(replace(block, point=(silent := min(known - seen))))
    assert len(few) == len(seen) + 6 and set(few) > seen | {silent} and few[silent].size == 1.0
    at = np.array([v.position[:2] for n, v in few.items() if n not in seen and n != silent])
    apart = np.linalg.norm(at[:, None] - at[None], axis=2) + np.diag(np.full(len(at), np.inf))
    assert apart.min() > 0.15 * np.ptp([v.position[:2] for v in every.values()], axis=0).max()



def test_tables_of_many_images_show_the_first() -> None:
    rows, count = rows_of(many_cameras(1000), "images")
    assert len(rows) == MOST and count == 1000


def test_many_cameras_are_exported() -> None:
    import io

    state = many_cameras(MANY + 5)
    loaded: Any = trimesh.load(io.BytesIO(glb(whole_scene(state))), file_type="glb")
    assert "/images/perspective" in loaded.graph.nodes


def test_many_tie_points_are_in_no_list_and_few_on_a_photo(tmp_path: Path) -> None:
    write_project(large_block(0, images=12, points=1500).block, tmp_path)
    state = open_project(tmp_path)
    image, tie = max(measured(state.block).items(), key=lambda found: found[1])[0], state.block.points.names[-1]
    with App(replace(state, image=image)) as app:
        while not app.settled():
            time.sleep(0.01)
        app.emit(ChoosePoint(tie))
        app._actions.join()
        offered = [tuple(h.options) for h in controls(app.server.gui) if isinstance(h, viser.GuiDropdownHandle)]
        html = [page for page in pages(app.server.gui) if "collinea-photo" in page]
    assert sum(map(len, offered)) < 500 and any(tie in options for options in offered)
    grey = f'stroke="{css(INITIAL)}"'
    assert measured(state.block)[image] > 1000 and len(html) == 1 and 100 < html[0].count(grey) <= PAIR_MOST
    assert html[0].count(f'stroke="{css(CONTROL)}"') == len(control_seen(state.block, image))
