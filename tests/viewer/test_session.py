"""The session: a state comes back identical from its JSON, undo and redo included; a damaged or foreign one does no harm."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.viewer.sessions import DEMO
from tests.viewer.test_actions import solve_all
from viewer_app.acting import update
from viewer_app.actions import (
    Aim,
    ChooseImage,
    ChoosePoint,
    Clicking,
    Place,
    Plot,
    Redo,
    Set,
    Show,
    Speed,
    Step,
    SwitchPoint,
    Undo,
)
from viewer_app.actions_points import EditPoint, SwitchRole
from viewer_app.bundle_actions import FollowBundle, FreeParameter, HoldBundle, RunBundle, SetBundle, StopBundle
from viewer_app.bundle_state import Bundle
from viewer_app.bundle_tasks import tasks as bundle_tasks
from viewer_app.desktop import Desktop, SizePanel, SizePhoto
from viewer_app.epochs import Epochs
from viewer_app.figures import ELEMENTS, ChooseFigure, Figure
from viewer_app.keeping import NAME, Keeper, resume
from viewer_app.kept_run import KeepRun, KeptRun, kept_of
from viewer_app.lists import SortBy, Tables
from viewer_app.loading import open_project
from viewer_app.looking import Looking, Opacity
from viewer_app.matching_actions import Click, LookAt, Pair, Propose, Tune
from viewer_app.matching_state import Found, Matching
from viewer_app.matching_state import Look as Look2
from viewer_app.mosaic_actions import Choose, Look, MakeMosaic
from viewer_app.mosaic_state import METHODS, Ask, Mosaic
from viewer_app.mosaic_tasks import tasks as mosaic_tasks
from viewer_app.panels.figures import elements_html
from viewer_app.photo_view import PhotoView, ZoomPhoto, window
from viewer_app.session import fingerprint, from_json, to_json
from viewer_app.session_rooms import KEPT_ROOMS
from viewer_app.state import State, Work

EDITS = (
    EditPoint("G03", "Z", "7.25"),
    SwitchRole("G04"),
    SwitchPoint("G02"),
    Set("robust", True),
    EditPoint("G05", "sX", "0.001"),
    ChoosePoint("G06"),
    Aim(100.25, 200.75),
    Place(),
    SwitchPoint("G07"),
    Show("rays", False),
    Show("vectors", 123.5),
    Speed(7.5),
    SortBy("points", "Z"),
    Clicking("monoplot"),
    SizePanel("very wide"),
    SizePhoto("small"),
    Plot(50.0, 60.0),
    FreeParameter("c"),
    Undo(),
    ChoosePoint("G08"),
    Step("first"),
)


def opened(folder: Path) -> State:
    return open_project(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("session") / "demo"
    shutil.copytree(DEMO, made, ignore=shutil.ignore_patterns("runs"))
    return made


@pytest.fixture(scope="module")
def edited(folder: Path) -> State:
    state = opened(folder)
    other = state.block.images[-1].name
    for action in (ChooseImage(other), *EDITS):
        state = update(state, action)
    return replace(state, follow=False)


def same_work(a: Work, b: Work) -> bool:
    p, q, o, r = a.block.points, b.block.points, a.block.observations, b.block.observations
    arrays = ((p.xyz, q.xyz), (p.sigma, q.sigma), (o.image, r.image), (o.point, r.point), (o.pixel, r.pixel), (o.sigma, r.sigma))
    equal = all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in arrays)
    said = [(w.block.points.names, w.block.points.role, w.block.points.group, w.off, w.settings, w.aside) for w in (a, b)]
    return equal and said[0] == said[1]


def same(a: State, b: State) -> bool:
    names = ("image", "view", "point", "row", "follow", "speed", "mark", "click", "spots")
    choices = all(getattr(a, n) == getattr(b, n) for n in names)
    if (len(a.past), len(a.future)) != (len(b.past), len(b.future)):
        return False
    works = [(a.work, b.work), *zip(a.past, b.past, strict=True), *zip(a.future, b.future, strict=True)]
    rooms = all(a.room(kind) == b.room(kind) for kind in (Tables, Desktop))
    return choices and rooms and all(same_work(x, y) for x, y in works)


def test_a_state_comes_back_identical(folder: Path, edited: State) -> None:
    fresh = opened(folder)
    text = json.dumps(to_json(edited, fresh.block), allow_nan=False)
    back = from_json(fresh, json.loads(text))
    assert len(edited.past) == 8 and len(edited.future) == 1 and same(back, edited) and not same(back, fresh)
    one, two = back, edited
    for _ in range(3):
        one, two = update(one, Undo()), update(two, Undo())
        assert same(one, two) and one.room(Bundle).options == two.room(Bundle).options
    assert not one.spots and edited.spots
    assert same(update(back, Undo()), update(edited, Undo())) and same(update(back, Redo()), update(edited, Redo()))
    assert len({w.revision for w in (back.work, *back.past, *back.future)}) == 10 and back.next_revision > back.work.revision


def test_a_hundred_edits_are_undone_after_a_restart(folder: Path) -> None:
    fresh = opened(folder)
    state = fresh
    for i in range(120):
        state = update(state, EditPoint("G03", "Z", f"{i}"))
    back = from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block))))
    for _ in range(120):
        back = update(back, Undo())
    assert np.array_equal(back.block.points.xyz, fresh.block.points.xyz) and update(back, Undo()).message == "Nothing to undo."


def test_the_session_is_found_beside_the_project(folder: Path, edited: State) -> None:
    keeper = Keeper(folder, opened(folder).block, lambda: edited)
    keeper.changed()
    keeper.close()
    assert same(resume(opened(folder)), edited)
    (folder / NAME).unlink()
    assert same(resume(opened(folder)), opened(folder))


def test_half_a_character_in_a_session_keeps_no_browser_out(folder: Path, edited: State) -> None:
    """JSON can say one; no message to a page can."""
    said = to_json(edited, opened(folder).block)
    said["rooms"]["Desktop"]["typed"] = {"Map file": "\ud800"}
    (folder / NAME).write_text(json.dumps(said), encoding="utf-8")
    assert same(resume(opened(folder)), opened(folder))
    (folder / NAME).unlink()


def test_edits_are_left_out_where_the_files_have_changed(folder: Path, edited: State) -> None:
    fresh = opened(folder)
    said = to_json(edited, fresh.block)
    moved = update(fresh, EditPoint("G01", "X", "5.0"))
    changed = replace(fresh, work=Work(moved.block))
    assert fingerprint(moved.block) != fingerprint(fresh.block)
    back = from_json(changed, said)
    assert back.block is moved.block and back.view == edited.view and back.image == edited.image
    assert "have changed" in back.message


CHOSEN = (
    ZoomPhoto(6.0, 0.3, 0.4),
    Pair("left", "DSC00229"),
    Pair("right", "DSC00233"),
    LookAt("left", 2500.0, 1200.0, 900.0),
    Tune("threshold", 0.7),
    SetBundle("datum", "both"),
    FreeParameter("c"),
    Choose("kind", "uncontrolled"),
    MakeMosaic("both"),
    Look("shown", "fade"),
    Look("swipe", 0.25),
    Opacity(0.3),
)


def test_what_the_tabs_show_comes_back_and_what_they_made_is_asked_for_again(folder: Path) -> None:
    fresh = opened(folder)
    state = fresh
    for action in CHOSEN:
        state = update(state, action)
    back = from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block))))
    a, b = state.room(Mosaic), back.room(Mosaic)
    assert (a.ask, a.wanted, a.shown, a.swipe) == (b.ask, b.wanted, b.shown, b.swipe) and set(b.wanted) == set(METHODS)
    assert {t.key for t in mosaic_tasks(back)} == {t.key for t in mosaic_tasks(state)} != set()
    assert window(back) == window(state) != window(fresh) and back.room(Looking) == state.room(Looking)
    m, n = state.room(Matching), back.room(Matching)
    assert (m.first, m.second, m.looks, m.threshold) == (n.first, n.second, n.looks, n.threshold) and m.looks
    assert back.room(Bundle).options == state.room(Bundle).options and not bundle_tasks(back)
    run = update(state, RunBundle())
    again = from_json(fresh, json.loads(json.dumps(to_json(run, fresh.block))))
    assert len(bundle_tasks(again)) == 1 and again.room(Bundle).asked == run.room(Bundle).asked


MADE_AGAIN = {
    KeptRun: {"solutions"},  # compared row by row below
    Matching: {"serial", "asked", "found", "shown", "row", "task", "progress", "network", "read", "message"},
    Bundle: {"held", "task", "serial", "base", "upto", "rows", "layout", "block", "asked", "result", "progress", "error", "run",
             "worst", "opened", "then_open"},
    Mosaic: {"made", "layer", "busy", "progress", "message", "wrote", "written"},
    Epochs: {"compared", "said"},
    Looking: {"image"},  # nobody begins inside a photo
    PhotoView: {"ready", "sharp"},  # the pyramid is there; every browser says how wide it draws
}
"""Fields of the tabs' own values that a session does not hold: what work makes, and what was said last."""
KEPT_OTHERWISE = {"follow", "work", "past", "future", "rooms"}
NOT_KEPT = {"assets", "playing", "held", "message", "next_revision", "saved"}


def test_every_field_of_the_state_is_kept_or_said_to_be_made_again(folder: Path) -> None:
    """A field that somebody adds and forgets to keep fails here; each that is kept differs from its default and comes back."""
    fresh = opened(folder)
    assert {f.name for f in fields(State)} - NOT_KEPT - KEPT_OTHERWISE <= set(to_json(fresh, fresh.block))
    chosen: dict[type, Any] = {
        Tables: Tables({"points": ("Z", True)}, "G0"),
        PhotoView: PhotoView(fresh.image, 120.0, 80.0, 900.0, 512.0),
        Looking: Looking("", 0.3),
        Desktop: Desktop("Compare", "Scene", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "wide", "small", {"Map file": "maps/a.tif"}),
        Figure: Figure(ELEMENTS),
        KeptRun: KeptRun(fresh.image, {"perspective": solve_all(fresh).work.solutions[fresh.image, "perspective"]}),
        Matching: Matching("DSC00231", "DSC00230", {"left": Look2(10.0, 20.0, 300.0)}, "G02", (30.0, 40.0), (50.0, 60.0), 31, 8,
                           0.8, colour="residual"),
        Bundle: Bundle("orthogonal", "frozen", "both", ("c", "k1"), "danish", "dlt", ("c",), "DSC*", "auto", colour="none",
                       vectors=20.0, ellipsoid=50.0, draw_points=False, draw_vectors=False, draw_ellipsoids=False,
                       draw_rays=False, alone=False),
        Mosaic: Mosaic(Ask("sequential", "uncontrolled", "plane", "fitted plane", 0.25, "none", True, True),
                       {"sequential": Ask("sequential")}, {}, "sequential", 0.2, 0.4, 3, False, False, False, False, 20.0,
                       "measure", ((1.0, 2.0),), None, "maps/a.tif", False, conjugate=("DSC00231", 3.0, 4.0)),
        Epochs: Epochs(None, 0, 50.0, False),
    }
    state = replace(fresh, rooms=chosen)
    back = from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block), allow_nan=False)))
    assert set(chosen) == {kind for kind, *_ in KEPT_ROOMS.values()}
    for kind, value in chosen.items():
        for field in fields(kind):
            if field.name in MADE_AGAIN.get(kind, ()) or (kind, field.name) == (Epochs, "epoch"):
                continue
            said = getattr(value, field.name)
            assert said != getattr(kind(), field.name), f"{kind.__name__}.{field.name} is at its default here"
            assert getattr(back.room(kind), field.name) == said, f"{kind.__name__}.{field.name}"
    assert back.room(Mosaic).busy == ("layer|maps/a.tif",) and not back.room(Matching).asked


def test_a_match_in_view_and_tie_points_placed_are_asked_for_again(folder: Path) -> None:
    fresh = opened(folder)
    state = update(update(update(fresh, Pair("left", "DSC00231")), LookAt("left", 2500.0, 1200.0, 900.0)), Tune("window", 31))
    state = update(update(state, Click("left", 2510.0, 1210.0)), Propose())
    asked = state.room(Matching).asked
    state = state.with_room(replace(state.room(Matching), asked=asked[:1], found=tuple(Found(a, error="-") for a in asked[1:])))
    state = state.with_room(replace(state.room(Matching), task="adjust"))
    back = from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block)))).room(Matching)
    assert len(asked) > 2 and back.at == (2510.0, 1210.0) and back.task == "adjust"
    assert {replace(a, serial=0) for a in back.asked} == {replace(a, serial=0) for a in asked}


def test_the_run_kept_beside_and_the_figure_come_back(folder: Path) -> None:
    fresh = opened(folder)
    state = update(update(solve_all(fresh), KeepRun()), ChooseFigure(ELEMENTS))
    text = json.dumps(to_json(state, fresh.block), allow_nan=False)
    back = from_json(fresh, json.loads(text))
    one, two = kept_of(state), kept_of(back)
    assert back.room(Figure) == Figure(ELEMENTS) and set(one) == set(two) == {"perspective", "orthogonal"}
    for model, solution in one.items():
        rows = two[model].rows
        assert len(rows) == len(solution.rows) > 2
        for a, b in zip(solution.rows, rows, strict=True):
            assert repr(replace(a, x=None)) == repr(replace(b, x=None)) and (a.x == b.x).all()  # type: ignore[arg-type]
    assert elements_html(back, lambda *_: "").count("perspective kept") > 6
    for words in ({"image": "nobody"}, {"solutions": {"perspective": [[[1.0], [], 1, None]]}}, {"solutions": 3}):
        said = json.loads(text)
        said["rooms"]["KeptRun"] |= words
        assert not kept_of(from_json(fresh, said)) and from_json(fresh, said).room(Figure) == Figure(ELEMENTS)


def bundled(state: State) -> State:
    """The state when its bundle's work is at its end."""
    (task,) = bundle_tasks(state)
    for value in task.call(*task.arguments):
        state = update(state, task.arrive(value))
    return state


def test_a_stopped_bundle_is_found_at_its_row_after_a_restart(folder: Path) -> None:
    fresh = opened(folder)
    running = update(fresh, RunBundle())
    (task,) = bundle_tasks(running)
    for value in task.call(*task.arguments):
        running = update(running, task.arrive(value))
        if running.room(Bundle).steps == 2:
            break
    for state in (running, stopped := update(running, StopBundle())):
        back = from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block))))
        assert back.room(Bundle).upto == (2 if state is stopped else None)
    a, b = stopped.room(Bundle), bundled(back).room(Bundle)
    assert len(a.rows) == len(b.rows) == 3 and all((r.x == s.x).all() for r, s in zip(a.rows, b.rows, strict=True))
    assert a.progress == b.progress != "" and b.result is None and not b.task
    on = update(bundled(back), RunBundle(on=True)).room(Bundle)
    assert on.upto is None and on.base == 2
    refused = update(stopped, HoldBundle())  # a sentence of another kind is no reason to forget it
    whole = bundled(update(refused, RunBundle()))
    for state, row in ((refused, 2), (whole, None), (update(whole, FollowBundle()), None)):
        assert to_json(state, fresh.block)["rooms"]["Bundle"]["stopped"] == row
    assert refused.room(Bundle).error and to_json(whole, fresh.block)["rooms"]["Bundle"]["adjusted"] is True


def test_the_row_of_a_bundle_waits_for_the_bundle(folder: Path) -> None:
    """After a restart the orientations are there before the bundle's rows are."""
    fresh = opened(folder)
    state = replace(update(fresh, RunBundle()), row=7, follow=False)
    back = solve_all(from_json(fresh, json.loads(json.dumps(to_json(state, fresh.block)))))
    assert back.room(Bundle).coming and back.row == 7 > back.last_row


def damaged(said: Any, rng: np.random.Generator) -> Any:
    """The same with one thing in it replaced."""
    if isinstance(said, dict) and said and rng.random() < 0.9:
        key = list(said)[rng.integers(len(said))]
        return {**said, key: damaged(said[key], rng)}
    if isinstance(said, list) and said and rng.random() < 0.9:
        at = int(rng.integers(len(said)))
        return [*said[:at], damaged(said[at], rng), *said[at + 1 :]]
    return [None, -1, 1e308, "x", [], {}, True, [[1]], "../../etc/passwd"][rng.integers(9)]


def test_a_damaged_session_opens_the_project_all_the_same(folder: Path, edited: State) -> None:
    fresh, rng = opened(folder), np.random.default_rng(5)
    chosen = update(update(solve_all(edited), KeepRun()), ChooseFigure(ELEMENTS))
    for action in CHOSEN:
        chosen = update(chosen, action)
    said = json.loads(json.dumps(to_json(chosen, fresh.block)))
    for _ in range(600):
        back = from_json(fresh, damaged(said, rng))
        block = back.block
        names = block.points.names
        assert block.camera_of(back.image) and back.point in (None, *names) and back.work.off <= set(names)
        assert len(block.points.xyz) == len(block.points.names) == len(block.points.role) and 0 <= back.view.vectors <= 1e5
        assert (block.observations.image < len(block.images)).all() and back.row >= 0


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": 99}', "[" * 100000, "null"])
def test_a_file_that_is_no_session_is_left_alone(folder: Path, text: str) -> None:
    (folder / NAME).write_text(text, encoding="utf-8")
    assert same(resume(opened(folder)), opened(folder))
    (folder / NAME).unlink()
