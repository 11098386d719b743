"""One viewer on a copy of the demo and one real browser for the tests of a module; helpers that wait on state."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from tests.browser import PATIENCE, ViserPage, require_chromium, viser_page
from viewer_app.actions import Action, Show
from viewer_app.app import App
from viewer_app.paint_viser import frustum_pose

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"
HEAVY = ("terrain", "labels", "photos", "ellipsoids")
"""What costs a renderer without a GPU most."""
COARSE = 0.5
"""Pixels of the scene per pixel of the page, where nobody looks at them: a renderer without a GPU is quicker so."""
Session = tuple[App, ViserPage]
COUNT = count(1)


@contextlib.contextmanager
def demo_session(folder: Path, size: tuple[int, int] = (1150, 680), light: bool = True) -> Iterator[Session]:
    """The demo, settled, in a browser; light: without what costs a renderer most."""
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with viewed(folder, size, HEAVY if light else (), COARSE if light else 1.0) as made:
        yield made


@contextlib.contextmanager
def viewed(
    folder: Path, size: tuple[int, int] = (1150, 760), hidden: Sequence[str] = (), dpr: float = COARSE
) -> Iterator[Session]:
    """A project, settled, in a browser; what is hidden is never drawn. dpr: pixels of the scene per pixel of the page."""
    require_chromium()
    with App(folder) as app:
        for name in hidden:
            app.emit(Show(name, False))
        with viser_page(app.port, query=f"fixedDpr={dpr:g}", size=size) as v:
            settle(app, v)
            v.dismiss_notifications()
            yield app, v


def settle(app: App, v: ViserPage) -> None:
    """Until every action that was emitted is taken, nothing is left to solve, and the page shows what follows from it.

    Clicks and keys are on their way for a while: wait for what they must bring about (`until`), not for this.
    """
    v.wait_until(app.settled, "the viewer to settle", 200)
    number = next(COUNT)
    app._wire.run(f"window.collineaShown = {number}")  # messages keep their order
    app.server.flush()
    v.page.wait_for_function("n => window.collineaShown >= n", arg=number)
    v.page.evaluate("() => new Promise(done => setTimeout(() => setTimeout(done)))")


def act(app: App, v: ViserPage, *actions: Action) -> None:
    """Take actions, and wait until all that follows from them is there and shown."""
    for action in actions:
        app.emit(action)
    settle(app, v)


def until(app: App, v: ViserPage, predicate: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
    """Until something that was not so when a key, click or drag was given is so, and all that follows from it is shown."""
    v.wait_until(predicate, what, timeout)
    settle(app, v)


def camera_path(app: App, model: str = "perspective", image: str | None = None) -> str:
    return f"/images/{image or app.state.image}/{model}/camera"


def has_pose(app: App, v: ViserPage, path: str) -> bool:
    """Whether the browser shows a frustum where the state has it."""
    _, _, image, model, _ = path.split("/")
    exterior, shown = app.state.exterior(model, image), v.pose(path)
    if exterior is None or shown is None:
        return False
    wxyz, position = frustum_pose(exterior)
    return bool(np.allclose(shown["position"], position, atol=1e-3) and abs(abs(np.dot(shown["wxyz"], wxyz)) - 1) < 1e-6)
