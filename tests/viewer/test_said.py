"""How long the line over the tabs says what it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from viewer_app.acting import Action
from viewer_app.actions import (
    Brought,
    ChooseImage,
    ChoosePoint,
    Failed,
    Saved,
    Show,
    Solve,
    SwitchPoint,
    Tick,
    Undo,
    UseOnly,
    update,
)
from viewer_app.actions_points import EditPoint
from viewer_app.bundle_actions import BundleFailed, RunBundle
from viewer_app.desktop import OpenedTab, Type
from viewer_app.matching_actions import Pair
from viewer_app.mosaic_actions import MakeMosaic, Progressing
from viewer_app.photo_view import DrawnPhoto
from viewer_app.state import Photo, State, wanted

WRONG = UseOnly(("X?",))
PIXELS = np.zeros((2, 2, 3), np.uint8)


@pytest.fixture
def said(state: State) -> State:
    return update(state, WRONG)


def test_what_comes_by_itself_leaves_it(said: State) -> None:
    words, [job, *_] = said.message, wanted(said)
    assert words.startswith("No control point is called X?")
    for news in (Failed(job, "no"), Brought(Photo(Path("x"), PIXELS, PIXELS, (2, 2)), "left"), Tick(), Progressing("tile 3"),
                 BundleFailed(7, "no"), OpenedTab("side", "Compare"), DrawnPhoto(600.0, 1.0)):
        said = update(said, news)
        assert said.message == words, news
    assert update(said, Saved(said.block, "demo")).message == "Saved in demo."


DONE = (SwitchPoint("G01"), ChooseImage("right"), ChoosePoint("G02"), EditPoint("G01", "sX", "0.5"), Show("rays", False), Solve(),
        Type("Map file", "a"), MakeMosaic("both"), RunBundle(), Pair("left", "right"))


@pytest.mark.parametrize("done", DONE, ids=lambda a: type(a).__name__)
def test_what_a_person_does_takes_it_away(said: State, done: Action) -> None:
    assert update(said, done).message == ""


def test_what_does_nothing_leaves_it_and_what_is_refused_says_why(said: State) -> None:
    assert update(said, SwitchPoint("nobody")) is update(said, ChooseImage(said.image)) is said
    assert update(said, WRONG).message == said.message
    assert update(update(said, Undo()), Undo()).message == "Nothing to undo."
