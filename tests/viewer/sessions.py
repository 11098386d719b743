"""One viewer on a copy of the demo and one real browser for the tests of a module; helpers that wait on state."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.browser import ViserPage, require_chromium, viser_page
from viewer_app.actions import Show
from viewer_app.app import App
from viewer_app.paint_viser import frustum_pose

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"
HEAVY = ("terrain", "labels", "photos", "ellipsoids")
"""What costs a renderer without a GPU most."""
Session = tuple[App, ViserPage]


@contextlib.contextmanager
def demo_session(folder: Path, size: tuple[int, int] = (1150, 680), light: bool = True) -> Iterator[Session]:
    """The demo, settled, in a browser; light: without what costs a renderer most."""
    require_chromium()
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with App(folder) as app, viser_page(app.port, size=size) as v:
        v.page.set_default_timeout(60_000)
        settle(app, v)
        v.dismiss_notifications()
        for name in HEAVY if light else ():
            app.emit(Show(name, False))
        settle(app, v)
        yield app, v


def settle(app: App, v: ViserPage) -> None:
    v.wait_until(app.settled, "the viewer to settle", 200)


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
