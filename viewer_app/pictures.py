"""The scene as a PNG without anybody at the screen: the machine's own Chromium draws it, unseen, on loopback."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from solvers import Unsupported

from .bridge import dress_labels, open_server
from .home import home, home_alone
from .paint_viser import Painter
from .picture_words import finished
from .state import State
from .tabs import whole_scene

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run", "--no-default-browser-check", "--mute-audio", "--window-size=1280,720",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
SIZE = (2160, 3840)
"""Height and width [px]: 4K."""
FOV = np.radians(45)
VIEW, LEGEND = (1280, 720), 480
"""Width and height of the picture for the first view, and of its part under the words, pixels of the page."""
PATIENCE = 120.0
"""Seconds until the browser must have shown itself, and until its picture must stand still."""


def scene_png(state: State, size: tuple[int, int] = SIZE) -> bytes:
    """The scene from its first view, PNG with title and legend. Raises Unsupported where there is no Chromium."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise Unsupported("a picture needs Chromium or Chrome, and none was found; install one (apt install chromium)")
    server = open_server()
    try:
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        dress_labels(server)
        server.scene.configure_default_lights(cast_shadow=False)
        server.gui.configure_theme(dark_mode=state.view.dark)
        camera = server.initial_camera
        (camera.position, camera.look_at), camera.far = home_alone(state, *VIEW, FOV, LEGEND), home(state)[2]
        camera.near, camera.fov = camera.far / 20000, FOV
        Painter(server).paint(whole_scene(state))
        server.flush()
        with _browser(program, f"http://127.0.0.1:{server.get_port()}/?fixedDpr=1"):
            return finished(_still(_client(server), size), state)
    finally:
        server.stop()


@contextmanager
def _browser(program: str, url: str) -> Iterator[None]:
    """Chromium on a page, with a profile of its own that is deleted again."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *FLAGS, f"--user-data-dir={profile}", "--remote-debugging-port=0", url]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _client(server: Any) -> Any:
    """The browser once it is there. Raises Unsupported."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if clients := server.get_clients():
            return next(iter(clients.values()))
        time.sleep(0.05)
    raise Unsupported(f"Chromium did not show the scene within {PATIENCE:.0f} s; is it able to start on this machine?")


def _still(client: Any, size: tuple[int, int]) -> np.ndarray:
    """The picture (h, w, 4) once nothing comes any more: small ones first, until two agree. Raises Unsupported."""
    end, before = time.monotonic() + PATIENCE, None
    while time.monotonic() < end:
        now = client.get_render(180, 320, transport_format="png", timeout=PATIENCE)
        if before is not None and np.array_equal(now, before) and now[..., 3].any():
            return client.get_render(*size, transport_format="png", timeout=PATIENCE)
        before = now
        time.sleep(0.3)
    raise Unsupported(f"the picture did not come to rest within {PATIENCE:.0f} s; try again when the machine is less busy")
