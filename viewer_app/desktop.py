"""How the page was left: which tabs were open, and from where one looked; so that it is found again. Nothing of it is an edit."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .acting import Action, handles
from .state import State


@dataclass(frozen=True)
class Desktop:
    """side, below: names of the tabs opened last in the main panel and in that over the scene, "" for the first. view: position
    and point looked at (6,) m, local frame, of who moved last; () before anybody did."""

    side: str = ""
    below: str = ""
    view: tuple[float, ...] = ()


@dataclass(frozen=True)
class OpenedTab(Action):
    """Somebody opened a tab of a place, "side" or "below"."""

    place: str
    name: str


@handles(OpenedTab)
def _opened(state: State, action: OpenedTab) -> State:
    room = state.room(Desktop)
    if action.place not in ("side", "below") or getattr(room, action.place) == action.name:
        return state
    return state.with_room(replace(room, **{action.place: action.name}))
