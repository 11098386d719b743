"""Tables as values: what can be edited and how, how rows sort, what a table says in words."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest

from tests.viewer.conftest import make_state
from tests.viewer.test_actions import solve_all
from viewer_app.acting import update
from viewer_app.actions import ChoosePoint, Step, Undo
from viewer_app.actions_points import EditPoint, Refused, SwitchRole
from viewer_app.flying import Fly, beside_panel, flight
from viewer_app.home import PANEL
from viewer_app.lists import COLUMNS, ShowRows, SortBy, as_csv, rows_of, sort_key
from viewer_app.panels.lists import _heard_edit, _heard_sort
from viewer_app.state import State, wanted


@pytest.fixture(scope="module")
def solved() -> State:
    return solve_all(make_state())


def names(state: State, table: str = "points") -> list[str]:
    return [r.name for r in rows_of(state, table)[0]]


def test_a_number_typed_is_an_edit_and_is_undone(solved: State) -> None:
    now = update(solved, EditPoint("G03", "Z", " 131,25 "))
    j = now.block.point_index("G03")
    assert now.block.points.xyz[j, 2] == 131.25 and now.point == "G03" and wanted(now)
    assert np.array_equal(np.delete(now.block.points.xyz, j, 0), np.delete(solved.block.points.xyz, j, 0))
    assert update(now, Undo()).block is solved.block


def test_a_standard_error_is_edited_and_emptied(solved: State) -> None:
    now = update(solved, EditPoint("G03", "sX", "0.005"))
    j = now.block.point_index("G03")
    assert now.block.points.sigma[j, 0] == 0.005
    assert np.isnan(update(now, EditPoint("G03", "sX", "")).block.points.sigma[j, 0])
    assert update(solved, EditPoint("G03", "sX", "")) is solved


@pytest.mark.parametrize(
    ("field", "text"),
    [("X", "abc"), ("X", ""), ("Z", "nan"), ("Y", "inf"), ("X", "1e300"), ("sX", "0"), ("sZ", "-1"), ("sY", "twelve"),
     ("sX", "1e-300"), ("sX", "9e-7"), ("sX", "1e9")],
)
def test_nonsense_is_a_sentence_and_no_edit(solved: State, field: str, text: str) -> None:
    now = update(solved, EditPoint("G03", field, text))
    assert now.work is solved.work and now.message.startswith(f"G03 {field}: ")
    assert now.room(Refused) != solved.room(Refused) != update(now, EditPoint("G03", field, text)).room(Refused)


def test_the_smallest_standard_error_there_may_be_is_taken(solved: State) -> None:
    now = update(solved, EditPoint("G03", "sX", "1e-6"))
    assert now.block.points.sigma[now.block.point_index("G03"), 0] == 1e-6 and now.room(Refused) == Refused()


@pytest.mark.parametrize(
    "action",
    [
        EditPoint("nobody", "X", "1"),
        EditPoint("G03", "role", "1"),
        SwitchRole("nobody"),
        SortBy("points", "nothing"),
        SortBy("nowhere", "name"),
    ],
)
def test_what_is_not_there_changes_nothing(solved: State, action: object) -> None:
    assert update(solved, action) is solved  # type: ignore[arg-type]


def test_control_becomes_check_and_back(solved: State) -> None:
    now = update(solved, SwitchRole("G03"))
    assert "G03" not in now.control() and now.block.points.role[now.block.point_index("G03")] == "check"
    assert update(now, SwitchRole("G03")).control() == solved.control()


def test_rows_sort_up_down_and_as_in_the_file(solved: State) -> None:
    first = names(solved)
    up = update(solved, SortBy("points", "Z"))
    z = [r.values["Z"] for r in rows_of(up, "points")[0]]
    assert z == sorted(z)
    down = update(up, SortBy("points", "Z"))
    assert names(down) == names(up)[::-1] and names(update(down, SortBy("points", "Z"))) == first
    by_residual = rows_of(update(solved, SortBy("points", "w")), "points")[0]
    known = [r.values["w"] for r in by_residual if r.values["w"] == r.values["w"]]
    assert known == sorted(known) and len(known) < len(by_residual)
    assert all(np.isnan(r.values["w"]) for r in by_residual[len(known) :])
    start = update(solved, Step("first"))  # standardized residuals are worked out at the end alone
    assert all(np.isnan(r.values["w"]) for r in rows_of(start, "points")[0])


def test_names_sort_as_people_count() -> None:
    assert sorted(["G10", "G2", "a1", "G1b"], key=sort_key) == ["a1", "G1b", "G2", "G10"]


def test_rows_are_found_by_a_part_or_a_pattern(solved: State) -> None:
    assert names(update(solved, ShowRows("g1*"))) == [n for n in names(solved) if n.startswith("G1")]
    assert names(update(solved, ShowRows("3"))) == ["G03", "G13"] and names(update(solved, ShowRows(""))) == names(solved)


def test_images_have_a_status_and_orientations_their_standard_errors(solved: State) -> None:
    images = {r.name: r.values for r in rows_of(solved, "images")[0]}
    assert images["left"]["status"] == "solved" and images["left"]["n"] > 10 and images["left"]["rms_p"] < 2
    fresh = make_state()
    assert {r.values["status"] for r in rows_of(fresh, "images")[0]} == {"waits"}
    orientation = rows_of(solved, "orientations")[0][0].values
    assert 0 < orientation["sX"] < 1 and abs(orientation["X"] - 500060.0) < 5


def test_a_table_is_csv(solved: State) -> None:
    text = as_csv(COLUMNS["points"], rows_of(solved, "points")[0])
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 16 and float(rows[2]["X [m]"]) == solved.block.points.xyz[2, 0] and rows[0]["sX [m]"] == ""


@pytest.mark.parametrize("value", ["", "[]", '["a"]', "[1,2,3]", '{"a":1}', (0.1, 0.2), "[" * 1500])
def test_a_damaged_message_means_nothing(solved: State, value: object) -> None:
    assert _heard_edit(solved, value) is None and _heard_sort(solved, value) is None


def test_a_message_of_the_table_is_an_edit(solved: State) -> None:
    assert _heard_edit(solved, json.dumps(["G01", "X", "1"])) == EditPoint("G01", "X", "1")


def test_a_flight_ends_near_what_was_asked_for(solved: State) -> None:
    position, look_at = np.array([0.0, -900.0, 500.0]), np.zeros(3)
    found = flight(solved, Fly("point", "G03"), position, look_at)
    assert found is not None
    xyz = solved.assets.frame.to_local(solved.block.points.xyz[[2]])[0]
    assert np.allclose(found[1], xyz) and np.linalg.norm(found[0] - xyz) < 200
    way = (found[0] - found[1]) / np.linalg.norm(found[0] - found[1])
    assert np.allclose(way, (position - look_at) / np.linalg.norm(position - look_at))
    for width, shift in ((868, PANEL / 2), (2150, 0.0), (600, 0.0)):  # a narrow page's panel would hide the middle
        to = beside_panel(*found, width, 800, 0.8)
        ahead = (to[1] - to[0]) / np.linalg.norm(to[1] - to[0])
        right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
        drawn = 400 / np.tan(0.4) * ((xyz - to[0]) @ right) / ((xyz - to[0]) @ ahead)
        assert abs(drawn - shift) < 1e-6 and np.allclose(to[0] - found[0], to[1] - found[1])
    image = flight(solved, Fly("image", "right"), position, look_at)
    assert image is not None and np.linalg.norm(image[1][:2] - [55, 25]) < 30
    assert flight(solved, Fly("image", "nobody"), position, look_at) is None
    every = flight(solved, Fly("points", ""), position, look_at)
    xyz = solved.assets.frame.to_local(solved.block.points.xyz)
    assert every is not None and np.allclose(every[1], np.nanmean(xyz, axis=0))
    assert np.linalg.norm(every[0] - every[1]) > np.linalg.norm(np.ptp(xyz, axis=0)) and every[0][2] > xyz[:, 2].max()
    assert update(solved, Fly("image", "right")).image == "right" and update(solved, Fly("point", "G03")).point == "G03"
    assert update(solved, ChoosePoint("G03")).point == "G03"
