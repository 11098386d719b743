"""The pictures of the viewer in README and docs, from the real viewer on the demo in Chromium:
`python docs/make_animation.py [FOLDER]`.

converging.webp: the adjustment row by row; viewer-1280.png and viewer-2560.png: the viewer as it opens; bundle-1280.png and
viewer-mosaic.png: the tabs Bundle and Mosaic with what they made.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

from tests.browser import ViserPage, viser_page  # noqa: E402
from viewer_app.actions import Action, GoTo, Show  # noqa: E402
from viewer_app.app import App  # noqa: E402
from viewer_app.bundle_actions import RunBundle  # noqa: E402
from viewer_app.figures import ELEMENTS, RESIDUALS, ChooseFigure  # noqa: E402
from viewer_app.flying import Fly  # noqa: E402
from viewer_app.mosaic_actions import MakeMosaic  # noqa: E402

SIZE, HOLD, END = (1280, 800), 700, 3000
"""Pixels of the page; how long a row is shown and how long the last one, milliseconds."""
WIDTH = 960
QUIET = "[role=alert] { display: none !important }"
"""Without the notice that nothing but the processor draws."""
LARGEST = 2_000_000
BEFORE_MOSAIC = ("perspective", "orthogonal", "rays", "bundle", "terrain")
"""What would hide the mosaic."""


def ready(app: App, v: ViserPage) -> None:
    """Until the browser shows what the state says, and has faded in: three pictures in a row agree."""
    v.wait_until(app.settled, "the viewer", 200)
    last, alike = None, 0
    for _ in range(60):
        v.wait_frames(2, timeout=120)
        v.page.wait_for_timeout(1000)  # labels and fonts come after the frame
        now = v.screenshot().tobytes()
        alike = alike + 1 if now == last else 0
        last = now
        if alike == 2:
            return
    raise SystemExit("the page never comes to rest")


def still(app: App, size: tuple[int, int], path: Path, tab: str = "", *then: Action) -> None:
    with viser_page(app.port, size=size) as v:
        v.page.add_style_tag(content=QUIET)
        if tab:
            v.open_tab(tab)
        ready(app, v)
        for action in then:
            app.emit(action)
            ready(app, v)
        v.screenshot(path)


def converging(app: App, path: Path) -> None:
    """Every row of the chosen image's own adjustments as one frame of an animation. The slider ends where they end."""
    with viser_page(app.port, size=SIZE) as v:
        v.page.add_style_tag(content=QUIET)
        last = max(len(s.rows) for m in ("perspective", "orthogonal") if (s := app.state.solution(m))) - 1
        frames = []
        for row in range(last + 1):
            app.emit(GoTo(row))
            ready(app, v)
            frames.append(v.screenshot().resize((WIDTH, WIDTH * SIZE[1] // SIZE[0]), Image.Resampling.LANCZOS))
    times = [HOLD * 2, *[HOLD] * (len(frames) - 2), END]
    for quality in (88, 75, 60, 40):
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=quality, method=5)
        if path.stat().st_size < LARGEST:
            return
    raise SystemExit(f"{path} is larger than {LARGEST} bytes")


def demo() -> Path:
    """A copy of the demo project."""
    folder = Path(tempfile.mkdtemp()) / "demo"
    shutil.copytree(DOCS.parent / "assets" / "demo", folder, ignore=shutil.ignore_patterns("runs"))
    return folder


def tabs(out: Path) -> None:
    """The tabs Bundle and Mosaic, each in a viewer of its own."""
    with App(demo()) as app:
        app.emit(RunBundle())
        still(app, SIZE, out / "bundle-1280.png", "Bundle")
    with App(demo()) as app:
        for name in BEFORE_MOSAIC:
            app.emit(Show(name, False))
        app.emit(MakeMosaic("both"))
        still(app, SIZE, out / "viewer-mosaic.png", "Mosaic", Fly("mosaic", ""))


def main(out: Path = DOCS) -> None:
    with App(demo()) as app:
        still(app, SIZE, out / "viewer-1280.png")
        app.emit(ChooseFigure(ELEMENTS))
        converging(app, out / "converging.webp")
        app.emit(ChooseFigure(RESIDUALS))
        app.emit(Show("dark", True))
        still(app, (2560, 1440), out / "viewer-2560.png")
    tabs(out)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
