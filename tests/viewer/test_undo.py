"""Undo takes back every edit, a hundred steps deep, and every kind of action is known either to edit or to edit nothing."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solvers import Points
from viewer_app.acting import CHOICES, HANDLERS, UNDONE, Action, update
from viewer_app.actions import (
    Aim,
    ForgetSpots,
    Place,
    Plot,
    Redo,
    Set,
    SwitchPoint,
    Undo,
    Unmark,
    UseBox,
    UseOnly,
    UsePoints,
)
from viewer_app.actions_points import FIELDS, EditPoint, SwitchRole
from viewer_app.bundle_actions import FreeParameter, OfEveryImage, SetBundle
from viewer_app.bundle_state import Bundle
from viewer_app.matching_actions import Accept, Matched, Placed, Sharper, Start, Tied, Tune, Working
from viewer_app.mosaic_actions import Choose, ClickMosaic, ForgetPlaces, TiesFound
from viewer_app.mosaic_state import Mosaic
from viewer_app.state import State
from viewer_app.tabs import tabs

EDITS: dict[str, tuple[Action, ...]] = {
    "a point is switched": (SwitchPoint("G02"),),
    "a cluster is used": (UsePoints("group B"),),
    "points are used by name": (UseOnly(("G0*",)),),
    "points are used by rectangle": (UseBox(0, 0, 3000, 4000),),
    **{f"the setting {n}": (Set(n, v),) for n, v in (("robust", True), ("prior", "initial"), ("one_pass", True),
                                                      ("form", "printed"), ("recentre", False))},
    **{f"{field} is typed": (EditPoint("G03", field, "7.25"),) for field in FIELDS},
    "control becomes check": (SwitchRole("G04"),),
    "a mark is placed": (Aim(100.25, 200.75, "G06"), Place()),
    "tie points are found": (Start("ties"), Tied),  # type: ignore[dict-item]
    "a mosaic finds tie points": (TiesFound,),  # type: ignore[dict-item]
    "places measured are forgotten": (ForgetPlaces(),),
    "a place is plotted": (Plot(50.0, 60.0),),
    "places plotted are forgotten": (Plot(50.0, 60.0), ForgetSpots()),
    "a bundle's model": (SetBundle("model", "orthogonal"),),
    "a bundle's datum": (SetBundle("datum", "both"),),
    "a bundle's images": (SetBundle("images", "left"),),
    "a parameter is freed": (FreeParameter("c"),),
    "a parameter of every image": (OfEveryImage("xp"),),
    "a mosaic's blend": (Choose("blend", "none"),),
    "a mosaic's ground pixel": (Choose("gsd", 0.25),),
    "how matches are made": (Tune("threshold", 0.8),),
}
"""Actions, the last of which is the edit; a class stands for the action with the block that it brings."""
ELSEWHERE = {Accept, ClickMosaic}
"""Edits that need photos: tests/viewer/test_matching_state.py and test_mosaic_tab.py undo them."""
BESIDE = {Matched, Working, Placed, Sharper}
"""Handled beside an edit, and none themselves."""


def begun(state: State) -> State:
    """With something to forget."""
    return state.with_room(replace(state.room(Mosaic), places=((1.0, 2.0), (3.0, 4.0))))


def made(state: State, kind: Any) -> Action:
    """An action; a class brings a block with a further tie point."""
    if isinstance(kind, Action):
        return kind
    points = state.block.points
    more = Points((*points.names, f"T{len(points)}"), np.vstack([points.xyz, [[0.0, 0.0, 0.0]]]),
                  np.vstack([points.sigma, [[np.nan] * 3]]), (*points.role, "tie"), (*points.group, ""))
    return kind(state.block, replace(state.block, points=more), "found")


def done(state: State, actions: tuple[Action, ...]) -> State:
    for action in actions:
        state = update(state, made(state, action))
    return state


def content(state: State) -> tuple[Any, ...]:
    """All that undo answers for, comparable."""
    p, o = state.block.points, state.block.observations
    arrays = [np.nan_to_num(a, nan=-9.0).tolist() for a in (p.xyz, p.sigma, o.image, o.point, o.pixel, o.sigma)]
    return p.names, p.role, state.work.off, state.work.settings, arrays, {n: get(state) for n, (get, _) in CHOICES.items()}


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_is_taken_back_and_made_again(state: State, name: str) -> None:
    actions = EDITS[name]
    before = done(begun(state), actions[:-1])
    after = done(before, actions[-1:])
    assert content(after) != content(before) and len(after.past) == len(before.past) + 1 and not after.future
    back = update(after, Undo())
    assert content(back) == content(before)
    assert content(update(back, Redo())) == content(after)


def test_a_hundred_edits_of_every_kind_are_taken_back_one_by_one(state: State) -> None:
    now, seen = begun(state), []
    values = np.linspace(0.3, 0.9, 61).tolist()
    for n in range(170):
        kinds = (SwitchPoint(state.block.points.names[n % 16]), EditPoint("G03", "Z", f"{n}"), Plot(50.0 + n, 60.0),
                 Tune("threshold", values[n % 61]), FreeParameter("c", n % 2 == 0), Choose("gsd", 0.1 + n))
        later = update(now, kinds[n % len(kinds)])
        if later is not now and len(later.past) > len(now.past):
            seen.append(content(now))
            now = later
    last = content(now)
    assert len(seen) >= 140
    for before in reversed(seen):
        now = update(now, Undo())
        assert content(now) == before
    assert update(now, Undo()).message == "Nothing to undo."
    for _ in seen:
        now = update(now, Redo())
    assert content(now) == last and update(now, Redo()).message == "Nothing to redo."


def test_a_choice_taken_back_solves_nothing_anew(state: State) -> None:
    after = update(state, FreeParameter("k1"))
    back = update(after, Undo())
    assert after.room(Bundle).free == ("k1",) and back.room(Bundle).free == ()
    assert after.work is back.work is state.work and back.next_revision == state.next_revision


def test_no_kind_of_edit_is_forgotten_here() -> None:
    """What a handler edits with `edit`, or says to be `undone`, stands in the list above."""
    tabs()
    kinds = {k for k in HANDLERS if k.__module__.startswith("viewer_app.")}
    editing = {k for k in kinds if re.search(r"\bedit(_room)?\(", inspect.getsource(HANDLERS[k]))} | set(UNDONE)
    listed = {a if isinstance(a, type) else type(a) for actions in EDITS.values() for a in (actions[-1],)}
    assert editing - BESIDE - {Aim, Unmark} == listed | ELSEWHERE and len(listed) >= 15
