"""From point to point: the next one is not measured and should be seen; where it is expected is drawn and looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solvers.block import Observations
from solvers.orientation import Orientation
from tests.viewer.conftest import make_block
from viewer_app.acting import update
from viewer_app.actions import Aim, ChoosePoint, Place, Solved
from viewer_app.bridge import Wire
from viewer_app.next_point import NextPoint, expected, missing
from viewer_app.panels.photo import TAB, photo_html
from viewer_app.photo_view import PhotoView, ZoomToMark, window
from viewer_app.sighting import where
from viewer_app.solving import solve
from viewer_app.state import State, wanted

WIRE = object.__new__(Wire)
WIRE.works = True
GONE = ("G02", "G06", "G11")


@pytest.fixture
def bare(state: State) -> State:
    """Some points are not measured in the left photo, which is not oriented."""
    of, names = state.block.observations, state.block.points.names
    keep = ~((of.image == 0) & np.isin(of.point, [names.index(n) for n in GONE]))
    left = Observations(of.image[keep], of.point[keep], of.pixel[keep], of.sigma[keep])
    return replace(state, work=replace(state.work, block=replace(state.block, observations=left)))


@pytest.fixture
def known(bare: State) -> State:
    """... and now it is."""
    job = wanted(bare)[0]
    *_, found = solve(job)
    assert isinstance(found, Orientation)
    return update(bare, Solved(job, found.trace, found))


def test_without_an_orientation_the_points_come_in_their_order_and_none_is_expected_anywhere(bare: State) -> None:
    came, state = [], bare
    for _ in (*missing(bare), "once more"):
        state = update(state, NextPoint())
        came.append(state.point)
        assert expected(state) is None and f"{state.point}: click" in state.message
    assert came == [*missing(bare), missing(bare)[0]] and set(GONE) < set(came) and came[:-1] == sorted(came[:-1])
    assert missing(update(bare, ChoosePoint("G06")))[-1] == "G06"


def test_where_an_oriented_photo_should_show_the_point_is_drawn_and_looked_at(known: State) -> None:
    state = update(known, NextPoint())
    at, (block, _) = expected(state), make_block()
    j = block.points.names.index("G02")
    true = block.observations.pixel[(block.observations.image == 0) & (block.observations.point == j)][0]
    assert state.point == "G02" and at is not None and np.linalg.norm(np.array(at) - true) < 10
    html = photo_html(state, WIRE)
    assert 'data-expected="G02"' in html and f'cx="{at[0] + 0.5:.2f}"' in html
    near = update(state, ZoomToMark())
    assert np.allclose(window(near).place(*at), 0.5, atol=1e-9)
    moved = update(near, NextPoint())
    assert moved.point == "G06" and moved.room(PhotoView).width == near.room(PhotoView).width
    there = expected(moved)
    assert there is not None and np.allclose(window(moved).place(*there), 0.5, atol=1e-9)


def test_a_mark_that_was_placed_says_how_to_go_on_until_all_are_measured(known: State) -> None:
    state = known
    for name in GONE:
        state = update(state, NextPoint())
        at = expected(state)
        assert state.point == name and at is not None
        state = update(update(state, Aim(*at)), Place())
        assert state.message == f"{name} is measured in left; N chooses the next point."
        assert expected(state) is None and "data-expected" not in photo_html(state, WIRE)
    done = update(state, NextPoint())
    assert done.message == "Every control and check point that left should show is measured in it." and done.point == GONE[-1]
    assert missing(done)  # those the photo does not show


def test_a_point_that_the_photo_should_not_show_is_passed_over(known: State) -> None:
    points = known.block.points
    xyz = points.xyz.copy()
    xyz[points.names.index("G02")] += [5000.0, 0.0, 0.0]
    state = replace(known, work=replace(known.work, block=replace(known.block, points=replace(points, xyz=xyz))))
    assert where(state, "left", "G02") is None and update(state, NextPoint()).point == "G06"
    away = replace(points, xyz=points.xyz + np.where(np.isin(points.names, GONE)[:, None], [5000.0, 0.0, 0.0], 0.0))
    none = replace(known, work=replace(known.work, block=replace(known.block, points=away)))
    assert "that left should show is measured" in update(none, NextPoint()).message


def test_a_click_and_a_key_ask_for_it(bare: State) -> None:
    assert TAB.heard["next-point"](bare, "") == NextPoint() and ("N", NextPoint()) in [(c.key, c.act) for c in TAB.commands]
    assert 'data-kind="next-point"' in photo_html(bare, WIRE)

