"""The Epochs tab: what its scene shows of a comparison, its actions, and the page in a real browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solvers import BadProject
from solvers.cli import main
from solvers.workflows_monitoring import read_comparison
from tests.viewer.sessions import until, viewed
from viewer_app import theme
from viewer_app.acting import update
from viewer_app.app import App
from viewer_app.epochs import DrawEllipsoids, Epochs, Exaggerate, GoToEpoch, ShowComparison, exaggeration, reopened, scene
from viewer_app.loading import open_project
from viewer_app.panels.epochs import displacements
from viewer_app.state import State
from viewer_app.values import Ellipsoid, Label, PointCloud, Segments

MOVED = {"7", "18", "26", "33"}


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("epochs") / "wall"
    assert main(["simulate", "cliff_epochs", "-o", str(folder), "--seed", "2", "--quiet"]) == 0
    assert main(["compare", *(str(folder / f"epoch{k}") for k in (1, 2, 3)), "--quiet"]) == 0
    return folder


@pytest.fixture
def compared(wall: Path) -> State:
    state = open_project(wall / "epoch3")
    return update(state, reopened(state))


def test_a_comparison_is_read_and_its_last_epoch_shown(compared: State, wall: Path) -> None:
    room = compared.room(Epochs)
    assert room.compared is not None and room.epoch == room.last == 2 and room.shown is not None
    assert {n for n, m in zip(room.shown.names, room.shown.moved, strict=True) if m} == MOVED
    none = open_project(wall / "epoch1")
    assert "no comparison" in update(none, reopened(none)).room(Epochs).said and scene(none) == {}


def test_vectors_and_ellipsoids_are_exaggerated_alike(compared: State) -> None:
    found, shown, factor = scene(compared), compared.room(Epochs).shown, exaggeration(compared)
    assert shown is not None and factor > 50
    moved, cloud = found["/epochs/vectors/moved"], found["/epochs/points"]
    assert isinstance(moved, Segments) and isinstance(cloud, PointCloud) and moved.colour == theme.RESIDUAL
    assert len(moved.points) == 4 and len(cloud.points) == 40
    lengths = np.linalg.norm(moved.points[:, 1] - moved.points[:, 0], axis=1) / factor
    assert lengths == pytest.approx(0.006, abs=0.001)
    i = shown.names.index("18")
    ball = found["/epochs/ellipsoids/18"]
    assert isinstance(ball, Ellipsoid) and np.linalg.det(ball.axes) == pytest.approx(1)
    np.testing.assert_allclose(ball.radii, factor * shown.axes[i])
    label, scale = found["/epochs/labels/18"], found["/epochs/scale/label"]
    assert isinstance(label, Label) and label.text.startswith("18: ")
    assert isinstance(scale, Label) and f"{factor:g} times" in scale.text
    bar = found["/epochs/scale/bar"]
    assert isinstance(bar, Segments)
    millimetres = float(scale.text.split()[0])
    assert np.linalg.norm(bar.points[0, 1] - bar.points[0, 0]) == pytest.approx(factor * millimetres / 1e3)


def test_the_slider_goes_over_the_epochs_and_stays_within(compared: State) -> None:
    first = update(compared, GoToEpoch(0))
    assert set(scene(first)) == {"/epochs/points"}
    assert update(first, GoToEpoch(-1, relative=True)) is first
    second = update(first, GoToEpoch(1, relative=True))
    moved = scene(second)["/epochs/vectors/moved"]
    assert isinstance(moved, Segments)
    assert np.linalg.norm(np.diff(moved.points, axis=1)[:, 0], axis=1) / exaggeration(second) == pytest.approx(0.003, abs=0.001)
    assert update(second, GoToEpoch(99)).room(Epochs).epoch == 2
    plain = update(update(second, DrawEllipsoids(False)), Exaggerate(100.0))
    assert exaggeration(plain) == 100 and not any("ellipsoids" in p for p in scene(plain))
    assert update(plain, Exaggerate(-1.0)) is plain and update(plain, ShowComparison(None, "x")).room(Epochs).epoch == 0


def test_the_table_begins_with_what_moved(compared: State) -> None:
    shown = compared.room(Epochs).shown
    assert shown is not None
    text = displacements(replace_names(shown))
    assert "<script>" not in text and text.index("moved</td>") < text.index("&lt;script&gt;")


def replace_names(shown):
    names = tuple("<script>" if n == "1" else n for n in shown.names)
    return shown._replace(names=names)


def test_a_damaged_run_is_said(wall: Path, compared: State) -> None:
    found = read_comparison(wall / "epoch3")
    assert found is not None
    text = (found.run / "result.json").read_text()
    try:
        (found.run / "result.json").write_text(text[: len(text) // 2])
        with pytest.raises(BadProject, match="damaged"):
            read_comparison(wall / "epoch3")
        assert "damaged" in update(compared, reopened(compared)).room(Epochs).said
    finally:
        (found.run / "result.json").write_text(text)


@pytest.mark.browser
@pytest.mark.timeout(300)
def test_the_page_shows_epochs(wall: Path) -> None:
    with viewed(wall / "epoch3", (1280, 800)) as (app, v):
        v.open_tab("Epochs")
        v.click_button("Show the latest comparison")
        v.wait_nodes("/epochs/vectors/moved", "/epochs/ellipsoids/18")
        v.page.get_by_text("4 of 40 points moved").wait_for()
        assert v.page.get_by_role("table", name="Displacements").locator("tbody tr").count() == 40
        v.choose("Exaggeration [times]", "100")
        v.set_checkbox("Ellipsoids (95 %)", False)
        until(app, v, lambda: not app.state.room(Epochs).ellipsoids, "the box")
        v.page.get_by_text("drawn 100 times").wait_for()
        nodes = "() => Object.keys(window.__viserSceneTree.getState()).filter(n => n.startsWith('/epochs/ellipsoids/')).length"
        v.wait_until(lambda: v.page.evaluate(nodes) == 0, "no ellipsoids")
        v.nudge_slider("Epoch", "Home")
        until(app, v, lambda: app.state.room(Epochs).epoch == 0, "the slider")
        v.page.get_by_text("the first epoch, 40 points").wait_for()
        v.nudge_slider("Epoch", "ArrowRight")
        until(app, v, lambda: app.state.room(Epochs).epoch == 1, "the slider")
        assert v.log.errors == [] and v.log.external == []
    with App(wall / "epoch3") as again:  # and everything is found as it was left
        room = again.state.room(Epochs)
        assert room.compared is not None and (room.epoch, room.exaggeration, room.ellipsoids) == (1, 100.0, False)
