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
from viewer_app.desktop import Desktop
from viewer_app.paint_viser import frustum_pose
from viewer_app.panels.share import file_name
from viewer_app.photo_view import PhotoView
from viewer_app.widths import EDGE, photo_width

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"
HEAVY = ("terrain", "labels", "photos", "ellipsoids")
"""What costs a renderer without a GPU most."""
POINTS_ONLY = (*HEAVY, "rays", "bundle", "residuals", "perspective", "orthogonal", "truth", "initial", "georeferenced", "printed")
"""What is hidden where the points alone are looked at."""
COARSE = 0.5
"""Pixels of the scene per pixel of the page where none is drawn."""
Session = tuple[App, ViserPage]
COUNT = count(1)


@contextlib.contextmanager
def demo_session(folder: Path, size: tuple[int, int] = (1150, 680), drawn: bool = False) -> Iterator[Session]:
    """The demo, settled, in a browser."""
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with viewed(folder, size, () if drawn else HEAVY, drawn) as made:
        yield made


@contextlib.contextmanager
def viewed(
    folder: Path, size: tuple[int, int] = (1150, 760), hidden: Sequence[str] = (), drawn: bool = False
) -> Iterator[Session]:
    """A project, settled, in a browser; what is hidden is in no scene. drawn: for tests that look at the pixels of the scene."""
    require_chromium()
    with App(folder) as app:
        for name in hidden:
            app.emit(Show(name, False))
        with viser_page(app.port, query=f"fixedDpr={1 if drawn else COARSE:g}", size=size, drawn=drawn) as v:
            settle(app, v)
            try:
                v.wait_until(lambda: framed(app, v), "the view beside the panels")
            except TimeoutError as error:
                eyes, cameras = app._eyes, [c.camera for c in app.server.get_clients().values()]
                error.add_note(f"{eyes.canvases} {eyes.homes} {[(c.position, c.image_width, c.image_height) for c in cameras]}")
                error.add_note(str(v.page.evaluate("() => [innerWidth, window.__viserMutable.canvas.outerHTML]")))
                raise
            yield app, v


def framed(app: App, v: ViserPage) -> bool:
    """Whether the panels are docked and the first view is that of the canvas beside them."""
    size = v.page.evaluate("() => [window.__viserMutable.canvas.clientWidth, window.__viserMutable.canvas.clientHeight]")
    eyes = app._eyes
    here = [eyes.homes[n] for n, known in eyes.canvases.items() if np.allclose(known, size, atol=0.5) and n in eyes.homes]
    width = v.page.evaluate("() => window.innerWidth")
    return size[0] < width and bool(here) and camera_arrived(app, v)


def canvas_width(v: ViserPage) -> int:
    """What the main panel leaves of the page's width; a few pixels beside it are the panel's edge."""
    return v.page.evaluate("() => window.__viserMutable.canvas.clientWidth")


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


def keys_work(v: ViserPage) -> None:
    """Until a page that was just opened has its panels, and with them its keys."""
    v.page.get_by_role("tab", name="Project", exact=True).wait_for()
    v.page.evaluate("() => new Promise(done => requestAnimationFrame(() => setTimeout(() => setTimeout(done))))")


def act(app: App, v: ViserPage, *actions: Action) -> None:
    """Take actions, and wait until all that follows from them is there and shown."""
    for action in actions:
        app.emit(action)
    settle(app, v)


def until(app: App, v: ViserPage, predicate: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
    """Until something that was not so when a key, click or drag was given is so, and all that follows from it is shown."""
    v.wait_until(predicate, what, timeout)
    settle(app, v)


def photo_drawn(app: App, v: ViserPage) -> None:
    """Until the viewer knows how wide the browser draws the photo, and that is as wide as it should be."""

    def known() -> bool:
        canvas = v.page.evaluate("() => [window.__viserMutable.canvas.clientWidth, window.__viserMutable.canvas.clientHeight]")
        wanted = photo_width(app.state.room(Desktop).photo, canvas, 1.5) - EDGE
        width = v.box(v.page.get_by_role("img", name="Photo "))["width"]
        return abs(width - wanted) < 2 and abs(app.state.room(PhotoView).pane - width) < 0.01

    until(app, v, known, "the photo to be drawn")


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


def camera_arrived(app: App, v: ViserPage) -> bool:
    """Whether the server knows where the browser's camera is now."""
    here, canvas = v.page.evaluate(
        """() => { const m = window.__viserMutable, p = m.camera.position.clone();
            p.applyMatrix4(m.nodeRefFromName[''].matrixWorld.clone().invert());
            return [[p.x, p.y, p.z], [m.canvas.width, m.canvas.height]]; }""")
    camera = next(iter(app.server.get_clients().values())).camera
    same_size = np.allclose([camera.image_width, camera.image_height], canvas, atol=1.5)
    if not same_size:
        v.page.evaluate("() => window.__viserMutable.sendCamera()")  # a page whose resolution alone changes does not say so
    return bool(np.allclose(here, camera.position, atol=1e-3 * max(1.0, np.abs(here).max())) and same_size)


def expected_pixels(app: App, v: ViserPage) -> np.ndarray:
    """(n, 2) canvas pixels of the control points by our own projection, from the camera the browser reports."""
    v.wait_until(lambda: camera_arrived(app, v), "the browser's camera")
    camera = next(iter(app.server.get_clients().values())).camera
    w, x, y, z = camera.wxyz
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    points = app.state.block.points
    xyz = app.state.assets.frame.to_local(points.xyz[np.array(points.role) == "control"])
    seen = (xyz - camera.position) @ axes  # x right, y down, z forward
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    return seen[:, :2] / seen[:, 2:] * focal + np.array([camera.image_width, camera.image_height]) / 2


def downloaded(app: App, v: ViserPage, button: str, kind: str) -> bytes:
    """The file that a button of the Export tab hands over; kind: how its name ends."""
    v.open_tab("Export")
    v.click_button(button)
    link = v.page.locator(f"a[download='{file_name(app.state)}.{kind}']")  # that of an earlier file may still be there
    link.wait_for(timeout=120_000)
    with v.page.expect_download() as download:
        link.click()
    v.dismiss_notifications()
    return Path(download.value.path()).read_bytes()
