"""How tabs plug in: all are found, their actions are handled, their own values survive undo as they should."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from viewer_app.acting import HANDLERS, Action, edit_room, handles, update
from viewer_app.actions import Cancel, Redo, SwitchPoint, Undo
from viewer_app.state import State, wanted
from viewer_app.tabs import tabs, wanted_tasks, whole_scene


@dataclass(frozen=True)
class Counter:
    count: int = 0


@dataclass(frozen=True)
class Count(Action):
    pass


@dataclass(frozen=True)
class Unheard(Action):
    pass


@handles(Count)
def count(state: State, action: Count) -> State:
    return edit_room(state, Counter(state.work.room(Counter).count + 1))


def test_every_tab_is_found_once_and_in_order() -> None:
    names = [tab.name for tab in tabs()]
    assert len(set(names)) == len(names) and {"Orientation", "Compare", "Project", "Iterations", "Photo", "Scene"} <= set(names)
    assert names.index("Orientation") < names.index("Compare") < names.index("Project") < names.index("Iterations")


def test_no_two_commands_share_a_key_and_no_two_tabs_a_message() -> None:
    keys = [(c.modifier, c.key.lower()) for tab in tabs() for c in tab.commands if c.key]
    labels = [c.label for tab in tabs() for c in tab.commands]
    kinds = [kind for tab in tabs() for kind in tab.heard]
    assert len(set(keys)) == len(keys) and len(set(labels)) == len(labels) and len(set(kinds)) == len(kinds)


def kinds_of(kind: type) -> set[type]:
    return {k for sub in kind.__subclasses__() for k in (sub, *kinds_of(sub))}


def test_every_action_is_handled() -> None:
    ours = {kind for kind in kinds_of(Action) if kind.__module__.startswith("viewer_app.")}
    assert len(ours) > 30 and {kind for kind in ours if not kind.__subclasses__()} <= set(HANDLERS)


def test_an_action_nobody_handles_is_an_error(state: State) -> None:
    with pytest.raises(TypeError, match="Unheard"):
        update(state, Unheard())


def test_a_kind_is_handled_once() -> None:
    with pytest.raises(TypeError, match="twice"):
        handles(Count)(lambda state, action: state)
    assert HANDLERS[Count] is count


def test_a_tabs_own_edit_is_undone_without_solving_again(state: State) -> None:
    held = update(state, SwitchPoint("G02"))
    now = update(update(held, Count()), Count())
    assert now.work.room(Counter) == Counter(2) and now.work.revision == held.work.revision
    back = update(now, Undo())
    assert back.work.room(Counter) == Counter(1) and update(back, Redo()).work.room(Counter) == Counter(2)
    assert update(update(back, Undo()), Undo()).work is state.work


def test_a_tabs_own_value_is_its_default_until_it_is_changed(state: State) -> None:
    assert state.room(Counter) == Counter() and state.with_room(Counter(5)).room(Counter) == Counter(5)


def test_the_orientations_are_among_the_work_wanted(state: State) -> None:
    assert [t.key for t in wanted_tasks(state)][: len(wanted(state))] == [j.key for j in wanted(state)]
    assert not [t for t in wanted_tasks(update(state, Cancel())) if t.key in {j.key for j in wanted(state)}]


def test_the_whole_scene_holds_the_ground(state: State) -> None:
    assert "/ground/grid" in whole_scene(state)
