"""The Matching tab without a browser: what clicks mean, what is predicted and found, verdicts and undo, colours, work."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solvers.orientation import Plane
from solvers.workflows_conjugate import by_orientation, by_ties
from tests.viewer.conftest import make_state
from tests.viewer.photo_project import conjugate, make_project
from tests.viewer.test_actions import solve_all
from viewer_app.actions import Redo, Undo, update
from viewer_app.kept import by_identity
from viewer_app.loading import bring, open_project
from viewer_app.matching_actions import (
    Accept,
    Click,
    ColourTies,
    LookAt,
    Matched,
    MatchPoint,
    MatchRow,
    Pair,
    Propose,
    Reject,
    Start,
    Tune,
    Zoom,
    chosen,
    heard,
    sees_in,
)
from viewer_app.matching_scene import RAYS, scene, tie_colours
from viewer_app.matching_state import Matching
from viewer_app.matching_tasks import tasks
from viewer_app.matching_work import adjust_work, features_of, ties_work
from viewer_app.pyramid import Pyramid
from viewer_app.sighting import view_of, where
from viewer_app.state import State

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"


def opened(folder: Path) -> State:
    state = open_project(folder)
    for action in bring(state):
        state = update(state, action)
    return state


def done(state: State) -> State:
    """The state once everything that is wanted was done."""
    while wanted := tasks(state):
        for value in wanted[0].call(*wanted[0].arguments):
            state = update(state, wanted[0].arrive(value))
    return state


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> State:
    return opened(make_project(tmp_path_factory.mktemp("wall") / "p"))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> State:
    folder = tmp_path_factory.mktemp("demo") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    return solve_all(opened(folder))


def room(state: State) -> Matching:
    return state.room(Matching)


def test_a_click_is_predicted_by_features_and_found(wall: State) -> None:
    state = done(update(wall, Click("left", 300.0, 240.0)))
    found = room(state).current
    assert found is not None and found.ok and found.guess is not None and found.guess.how == "features"
    assert found.pixel is not None and found.sigma is not None
    assert np.abs(found.pixel - conjugate("two", np.array([300.0, 240.0]))).max() < 0.05 and found.sigma.max() < 0.05
    assert room(state).row == room(state).last_row > 0
    stepped = update(state, MatchRow(0))
    assert room(stepped).row == 0 and room(update(state, MatchRow(10**9))).row == room(state).last_row
    assert features_of.cache_info().currsize >= 1


def test_accepting_measures_both_photos_and_undo_takes_both_back(wall: State) -> None:
    found = done(update(wall, Click("left", 320.0, 200.0)))
    state = update(found, Accept())
    of = state.block.observations
    assert state.block.points.names == ("m1",) and state.block.points.role == ("tie",) and len(of) == 2
    assert of.pixel[0] == pytest.approx([320, 200]) and np.abs(of.pixel[1] - conjugate("two", of.pixel[0])).max() < 0.05
    assert 0.2 <= of.sigma[1] < 0.25  # a match's own sigma never enters a bundle alone
    assert room(state).current is None and len(update(state, Undo()).block.observations) == 0
    assert len(update(update(state, Undo()), Redo()).block.observations) == 2
    assert update(state, Accept()).block is state.block
    rejected = update(found, Reject())
    assert rejected.block is wall.block and room(rejected).current is None
    again = update(done(update(state, Click("left", 150.0, 300.0))), Accept())
    assert again.block.points.names == ("m1", "m2")


def test_earlier_ties_predict_the_next(wall: State) -> None:
    state = wall
    for col, row in ((200.0, 150.0), (420.0, 160.0), (310.0, 330.0)):
        state = update(done(update(state, Click("left", col, row))), Accept())
    found = room(done(update(state, Click("left", 330.0, 220.0)))).current
    assert found is not None and found.ok and found.guess is not None and found.guess.how == "3 earlier ties"
    assert np.abs(found.guess.place - conjugate("two", np.array([330.0, 220.0]))).max() < 0.3


def test_a_click_beside_a_measured_point_takes_that_point(wall: State) -> None:
    state = update(done(update(wall, Click("left", 320.0, 200.0))), Accept())
    state = update(update(state, Pair("right", "three")), LookAt("left", 320, 200, 200))
    again = done(update(state, Click("left", 321.5, 201.0)))
    assert room(again).point == "m1" and room(again).at == (320.0, 200.0)
    accepted = update(again, Accept())
    assert accepted.block.points.names == ("m1",) and len(accepted.block.observations) == 3
    assert np.abs(accepted.block.observations.pixel[2] - conjugate("three", np.array([320.0, 200.0]))).max() < 0.05


def test_a_click_on_the_right_corrects_the_prediction(wall: State) -> None:
    at = np.array([300.0, 240.0])
    truth = conjugate("two", at)
    state = update(done(update(wall, Click("left", *at))), Click("right", truth[0] + 5, truth[1] - 4))
    found = room(done(state)).current
    assert found is not None and found.guess is not None and found.guess.how == "your click"
    assert found.pixel is not None and np.abs(found.pixel - truth).max() < 0.05
    far = room(done(update(done(update(wall, Click("left", *at))), Click("right", 40.0, 400.0)))).current
    assert far is not None and not far.ok and far.why


def test_a_control_point_proposes_itself_where_orientation_says(demo: State) -> None:
    block, of = demo.block, demo.block.observations
    j = next(j for j in range(len(block.points)) if block.points.role[j] == "control" and (of.point == j).sum() >= 3)
    name = block.points.names[j]
    rows = np.flatnonzero(of.point == j)
    first = block.images[of.image[rows[0]]].name
    keep = np.setdiff1d(np.arange(len(of)), rows[1:])
    less = replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep], sigma=of.sigma[keep])
    state = replace(demo, work=replace(demo.work, block=replace(block, observations=less)))
    state = update(update(state, Pair("left", first)), MatchPoint(name))
    assert room(state).at is not None
    state = done(update(state, Propose()))
    assert len(room(state).found) >= len(rows) - 1
    measured = {block.images[of.image[r]].name: of.pixel[r] for r in rows[1:]}
    for found in room(state).found:
        assert found.ok and found.guess is not None and found.guess.how == "orientation and coordinates"
        assert found.pixel is not None and np.abs(found.pixel - measured[found.ask.second]).max() < 2.0  # half a pixel of noise
    accepted = update(state, Accept(all=True))
    assert len(accepted.block.observations) == len(less) + len(room(state).found)
    assert accepted.work.revision != state.work.revision  # control: everything is solved anew
    assert update(accepted, Undo()).block is state.block


def test_a_new_point_is_predicted_by_orientation_and_terrain(demo: State) -> None:
    state = update(demo, Pair("left", "DSC00229"))
    found = room(done(update(state, Click("left", 3000.0, 1750.0)))).current
    assert found is not None and found.ok and found.guess is not None and found.guess.how == "orientation"
    assert found.pixel is not None and np.linalg.norm(found.pixel - found.guess.place) < 4


def test_orientations_as_given_are_believed_as_far_as_they_say(demo: State) -> None:
    """1.5 degrees and 2 m of the demo's priors are 290 px; once solved, a place is predicted to a few pixels."""
    bare, at = replace(demo, work=replace(demo.work, solutions={})), np.array([3000.0, 1750.0])
    ground = Plane(float(demo.block.points.xyz[:, 2].mean()))
    found = []
    for state in (demo, bare):
        first, second = (view_of(state, name) for name in ("DSC00229", "DSC00230"))
        assert first is not None and second is not None
        found.append(by_orientation(first, second, at, ground, demo.assets.frame))
    solved, given = found
    assert solved is not None and solved.reach == 4 and given is not None and 500 < given.reach < 900


def test_what_a_browser_may_send() -> None:
    assert heard("left|click|3|4.5") == Click("left", 3, 4.5) and heard("right|zoom|0") == Zoom("right", 0)
    assert heard("left|look|1|2|300") == LookAt("left", 1, 2, 300)
    for word in ("", "|", "left", "left|", "up|click|1|2", "left|click|1", "left|click|nan|1", "left|look|inf|0|1", "found|x",
                 "found|-1", "left|zoom|1e999", "left|click|1|2|3", "found|" + "9" * 50, "left|drop|1"):
        assert heard(word) is None


def test_nothing_that_is_said_breaks_the_state(wall: State) -> None:
    state = wall
    for action in (Click("left", 1e9, 0), Click("up", 1, 1), Click("right", 5, 5), LookAt("left", 1e30, -1e30, 1e-9),
                   LookAt("left", float("nan"), 0, 1), Zoom("right", -1), Pair("left", "nobody"), Pair("up", "one"),
                   MatchPoint("nobody"), Tune("window", 8), Tune("window", float("inf")), Tune("nobody", 1), Accept(), Reject(),
                   ColourTies("mood"), Start("war"), MatchRow(-5), Propose()):
        state = update(state, action)
        m = room(state)
        assert (m.first, m.second, m.window, m.task) == ("one", "two", 21, "") and m.found == ()
    look = room(state).looks["left"]
    assert 0 <= look.col < 640 and 0 <= look.row < 480 and 0 < look.across < 2000
    assert room(update(state, Pair("left", "two"))).second == "one"  # they change places


def test_refusals_name_the_reason(wall: State) -> None:
    found = room(done(update(wall, Click("left", 2.0, 2.0)))).current
    assert found is not None and not found.ok and ("leaves" in found.why or "nothing tells" in found.why)
    alone = replace(wall, assets=replace(wall.assets, photos={k: v for k, v in wall.assets.photos.items() if k != "two"}))
    found = room(done(update(alone, Click("left", 300.0, 200.0)))).current
    assert found is not None and "no photo" in found.why


def test_tie_points_are_found_placed_and_coloured(wall: State) -> None:
    assert wall.assets.folder is not None
    *words, last = ties_work(wall.block, wall.assets.folder, 1)
    assert isinstance(last, tuple) and all(isinstance(w, str) for w in words) and "tie points found" in last[1]
    state = replace(wall, work=replace(wall.work, block=last[0]))
    rays = np.bincount(last[0].observations.point)
    assert len(rays) > 30 and tie_colours(state) == {j: RAYS[int(n)] for j, n in enumerate(rays)}
    assert tie_colours(update(state, ColourTies("none"))) == {}


def test_the_bundle_of_the_tab_places_points_in_the_scene(state: State) -> None:
    *words, network = adjust_work(state.block, state.assets.frame)
    assert words and not isinstance(network, str) and "rms" in network.words
    assert set(network.exteriors) == {"left", "right"}
    for name, exterior in network.exteriors.items():
        assert np.linalg.norm(exterior.centre - state.assets.truth[name].centre) < 1.0
    roles = tuple("tie" if r == "check" else r for r in state.block.points.role)
    block = replace(state.block, points=replace(state.block.points, role=roles))
    ties = replace(state, work=replace(state.work, block=block))
    *_, network = adjust_work(block, state.assets.frame)
    assert not isinstance(network, str)
    shown = scene(ties.with_room(Matching(network=network, colour="residual")))
    cloud: Any = shown["/ties/points"]
    count = sum(name in network.names for name, role in zip(block.points.names, roles, strict=True) if role == "tie")
    assert count >= 2 and cloud.points.shape == (count, 3) and cloud.colours.shape == (count, 3)


def test_late_results_are_dropped(wall: State) -> None:
    asked = update(wall, Click("left", 300.0, 240.0))
    task = tasks(asked)[0]
    (value,) = task.call(*task.arguments)
    moved = update(asked, Click("left", 200.0, 240.0))
    assert room(update(moved, Matched(value))).found == ()


def test_prediction_from_ties_is_exact_for_affinities() -> None:
    rng = np.random.default_rng(5)
    a = rng.uniform(0, 500, (12, 2))
    b = np.array([conjugate("three", p) for p in a])
    for count in (2, 3, 12):
        guess = by_ties(a[:count], b[:count], np.array([250.0, 250.0]))
        assert guess is not None
        off = np.linalg.norm(guess.place - conjugate("three", np.array([250.0, 250.0])))
        assert off < (1e-6 if count >= 3 else guess.reach)
    assert by_ties(a[:0], b[:0], np.zeros(2)) is None
    line = np.array([[0.0, 0], [100, 0], [200, 0], [300, 0]])
    assert by_ties(line, line + np.array([5, 7]), np.array([50.0, 20])).place == pytest.approx([55, 27])  # type: ignore[union-attr]


def test_a_pyramid_gives_what_there_is_and_reads_what_is_wanted(wall: State) -> None:
    import threading

    came = threading.Event()
    pyramid = Pyramid(came.set)
    photo = wall.assets.photos["one"]
    piece = pyramid.look(photo, (0.25, 0.25, 0.5, 0.5), 640)
    small = replace(photo, pane=photo.pane[::4, ::4])
    first = pyramid.look(small, (0.25, 0.25, 0.5, 0.5), 640)
    assert first.pixels.shape[1] < 60 and came.wait(20)
    second = pyramid.look(small, (0.25, 0.25, 0.5, 0.5), 640)
    assert second.pixels.shape == (120, 160, 3) == piece.pixels.shape and second.box == (0.25, 0.25, 0.5, 0.5)
    assert np.array_equal(second.pixels, photo.pane[120:240, 160:320])
    assert pyramid.look(photo, (2.0, 2.0, 3.0, 3.0), 640).pixels.shape == (1, 1, 3)
    pyramid.close()


def test_results_are_remembered_by_identity() -> None:
    calls: list[int] = []

    @by_identity(2)
    def double(values: list[int], word: str) -> int:
        calls.append(1)
        return 2 * sum(values)

    one, two = [1], [1]
    assert double(one, "a") == double(one, "a") == 2 and len(calls) == 1
    assert double(two, "a") == 2 and double(one, "b") == 2 and len(calls) == 3


def test_the_chosen_image_and_its_neighbour_come_first() -> None:
    state = make_state()
    m = chosen(state)
    assert (m.first, m.second) == ("left", "right")
    of = state.block.observations
    name = state.block.points.names[of.point[0]]
    assert sees_in(state.block, "left", name) is not None and where(state, "left", name) is None  # not oriented yet
