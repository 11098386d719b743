"""Drive a viser or rerun page in a real headless Chromium: waits on state, never on time; nothing but loopback resolves.

    with viser_page(server.get_port()) as v:
        v.wait_nodes("/images/DSC1/perspective/camera")
        v.click_button("Solve")
        v.screenshot("out.png")

`ViserPage` leans on viser's own test hooks (window.__viser*), which are not API: viser is pinned for that reason.
"""

from __future__ import annotations

import base64
import contextlib
import io
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, sync_playwright

FLAGS = (
    "--headless=new",
    "--no-sandbox",  # containers have no user namespaces
    # WebGL 2 on the CPU takes all of these three
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    # a page in the background keeps its timers and frames
    "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows", "--disable-renderer-backgrounding",
    # no traffic of the browser's own
    "--disable-quic", "--disable-background-networking", "--disable-component-update", "--disable-default-apps",
    "--disable-domain-reliability", "--disable-client-side-phishing-detection", "--disable-sync", "--no-first-run",
    "--no-default-browser-check", "--mute-audio",
    # a page that needs the internet shows itself
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
)
UNCOVERED = """new MutationObserver(() => {
  for (const e of document.querySelectorAll('[role=alert]:not([data-closed])')) {
    if (!/software webgl/i.test(e.innerText)) continue;
    e.dataset.closed = '1';
    e.querySelector('button')?.click();
  }
}).observe(document, {childList: true, subtree: true});"""
"""Closes viser's notice about software rendering, which lies over the canvas, whenever it comes."""
BLIND = (
    "for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced', 'drawRangeElements'])"
    " WebGL2RenderingContext.prototype[name] = () => {};"
)
"""Gives a page a scene that is built, lit, picked and counted frame by frame, but whose pixels are not drawn."""
BLIND_FLAGS = ("--disable-gpu-compositing",)
PATIENCE = 60.0
"""How long a wait may take before it is given up, seconds: far more than it takes, for a machine may be busy."""
LOCAL = re.compile(r"^(data:|blob:|about:|file:|(https?|wss?)://(127\.0\.0\.1|localhost)[:/])")
REFUSED = re.compile(r"'((?:https?|wss?)://[^']+)'.*Content Security Policy")


def find_chromium() -> str | None:
    """The machine's Chromium, None where there is none."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def require_chromium() -> str:
    """The machine's Chromium. Without one the test is skipped, but fails where CI=true."""
    found = find_chromium()
    if found is None:
        why = "no Chromium on this machine (apt install chromium)"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(why)
        pytest.skip(why)
    return found


@dataclass
class Log:
    """What the page said and asked for: console (type, text), script errors, requested and answered addresses."""

    console: list[tuple[str, str]] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    answered: list[str] = field(default_factory=list)
    frames_received: int = 0
    bytes_received: int = 0

    @property
    def external(self) -> list[str]:
        """Requests that left the page for another machine (the resolver rules let none arrive)."""
        return [url for url in self.requests if not LOCAL.match(url)]

    @property
    def refused(self) -> list[str]:
        """Addresses the page's Content-Security-Policy refused before any request was made."""
        return sorted({m[1] for _, text in self.console if (m := REFUSED.search(text)) and not LOCAL.match(m[1])})

    def listen(self, page: Page) -> None:
        page.on("console", lambda m: self.console.append((m.type, m.text)))
        page.on("pageerror", lambda e: self.errors.append(str(e)))
        page.on("request", lambda r: self.requests.append(r.url))
        page.on("response", lambda r: self.answered.append(r.url))
        page.on("websocket", self._socket)

    def _socket(self, socket: Any) -> None:
        self.requests.append(socket.url)
        socket.on("framereceived", self._received)

    def _received(self, payload: bytes | str) -> None:
        self.frames_received += 1
        self.bytes_received += len(payload)


@contextlib.contextmanager
def chromium_page(url: str, *, size: tuple[int, int] = (1280, 800), drawn: bool = True) -> Iterator[tuple[Page, Log]]:
    """A page in a fresh, empty profile, `size` in CSS pixels; everything is closed at the end.

    drawn: whether the pixels of a scene are drawn too. Without a graphics card they cost most of the time; a test that looks at
    no pixel of the scene does without.
    """
    program, flags = require_chromium(), FLAGS if drawn else (*FLAGS, *BLIND_FLAGS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, headless=True, args=list(flags))
        try:
            context = browser.new_context(viewport={"width": size[0], "height": size[1]}, device_scale_factor=1,
                                          accept_downloads=True, reduced_motion="reduce")
            for script in (UNCOVERED,) if drawn else (UNCOVERED, BLIND):
                context.add_init_script(script)
            page = context.new_page()
            page.set_default_timeout(1000 * PATIENCE)
            log = Log()
            log.listen(page)
            page.goto(url)
            yield page, log
        finally:
            browser.close()


@contextlib.contextmanager
def lone_chromium(url: str, size: tuple[int, int]) -> Iterator[None]:
    """A page nobody drives and no developer tools listen to: they hand on every message as text, which takes far longer than the
    message itself. For measurements; what the page has to say it says to its server."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        flags = [*FLAGS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        program = subprocess.Popen([require_chromium(), *flags, url], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            program.terminate()
            program.wait()


@contextlib.contextmanager
def viser_page(
    port: int, *, query: str = "fixedDpr=1", size: tuple[int, int] = (1280, 800), drawn: bool = True
) -> Iterator[ViserPage]:
    """viser's page, connected. fixedDpr=1 turns off the adaptive resolution, which drops on a slow renderer."""
    with chromium_page(f"http://127.0.0.1:{port}/?{query}", size=size, drawn=drawn) as (page, log):
        viser = ViserPage(page, log)
        viser.wait_connected()
        yield viser


def wait_until(page: Page, predicate: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
    """Wait [s] for the Python side. Playwright must be pumped meanwhile, so never sleep in a loop."""
    deadline = time.monotonic() + timeout
    while not predicate():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {timeout} s for {what}")
        page.wait_for_timeout(10)


def ink(image: Image.Image, background: tuple[int, int, int] = (255, 255, 255)) -> float:
    """Share of the pixels that differ from the background, which shines through a canvas: proof that something was drawn."""
    over = Image.alpha_composite(Image.new("RGBA", image.size, (*background, 255)), image.convert("RGBA"))
    difference = np.abs(np.asarray(over.convert("RGB"), np.int16) - np.array(background, np.int16))
    return float((difference.sum(axis=2) > 24).mean())


class ViserPage:
    """A viser page: its scene, its camera and its panels. Times are seconds, positions viser's world coordinates."""

    def __init__(self, page: Page, log: Log) -> None:
        self.page = page
        self.log = log

    # -- waits

    def wait_connected(self, timeout: float = PATIENCE) -> None:
        self.page.wait_for_function("() => window.__viserMutable && window.__viserSceneTree && window.__viserTestpoints"
                                    " && window.__viserMutable.canvas && window.__viserMutable.camera", timeout=timeout * 1000)

    def wait_nodes(self, *names: str, timeout: float = PATIENCE) -> None:
        """Until the nodes are in the scene tree and mounted in three.js (labels never are)."""
        self.page.wait_for_function(
            """names => { const tree = window.__viserSceneTree?.getState?.(), nodes = window.__viserMutable?.nodeRefFromName;
                return tree && nodes && names.every(n => n in tree && nodes[n]); }""", arg=list(names), timeout=timeout * 1000)

    def wait_frames(self, n: int = 2, timeout: float = PATIENCE) -> None:
        """Until n more frames were drawn; drawing is on demand, so one is asked for."""
        start = self.page.evaluate("() => window.__viserTestpoints.rendererInfo.render.frame")
        self.page.wait_for_function("t => { window.__viserMutable.requestRender();"
                                    " return window.__viserTestpoints.rendererInfo.render.frame >= t; }", arg=start + n,
                                    timeout=timeout * 1000)

    def wait_still(self, tolerance: float = 0.0, timeout: float = PATIENCE) -> Image.Image:
        """The canvas once two pictures in a row agree: textures decoded, camera at rest."""
        deadline = time.monotonic() + timeout
        last = self.canvas()
        while time.monotonic() < deadline:
            self.wait_frames(2)
            now = self.canvas()
            if now.size == last.size and np.abs(np.asarray(now, np.int16) - np.asarray(last, np.int16)).mean() <= tolerance:
                return now
            last = now
        raise TimeoutError("the canvas never came to rest")

    def wait_until(self, predicate: Callable[[], Any], what: str, timeout: float = PATIENCE) -> None:
        wait_until(self.page, predicate, what, timeout)

    def box(self, of: Locator) -> dict[str, float]:
        """x, y, width and height of an element in the page; one that is being drawn anew has none for a moment."""
        found: list[Any] = []
        self.wait_until(lambda: found.append(of.bounding_box()) or found[-1], "the element's place")
        return found[-1]

    # -- pictures

    def dismiss_notifications(self) -> None:
        """Close what lies over the canvas, such as the offer of a file."""
        close = self.page.locator("[role=alert] .mantine-Notification-closeButton")  # other buttons hand files over

        def none_left() -> bool:
            if close.count():
                with contextlib.suppress(Exception):  # it may leave by itself, and it fades
                    close.first.click(timeout=1000)
            return not close.count()

        self.wait_until(none_left, "the notifications to leave")

    def screenshot(self, path: str | Path | None = None) -> Image.Image:
        return Image.open(io.BytesIO(self.page.screenshot(path=path))).convert("RGB")

    def canvas(self) -> Image.Image:
        """The WebGL canvas alone (RGBA), without the panels over it."""
        url = self.page.evaluate("() => window.__viserMutable.canvas.toDataURL('image/png')")
        return Image.open(io.BytesIO(base64.b64decode(url.split(",", 1)[1]))).convert("RGBA")

    # -- scene

    def project(self, point: Any) -> tuple[float, float]:
        """CSS pixels of the page at which a world point is drawn."""
        x, y = self.page.evaluate(
            """p => { const m = window.__viserMutable, cam = m.camera, root = m.nodeRefFromName[''];
                cam.updateMatrixWorld();
                const world = root ? root.matrixWorld.clone() : cam.matrixWorld.clone().identity();
                const v = cam.position.clone().set(p[0], p[1], p[2]).applyMatrix4(world).project(cam);
                const box = m.canvas.getBoundingClientRect();
                return [box.left + (v.x + 1) / 2 * box.width, box.top + (1 - v.y) / 2 * box.height]; }""",
            [float(c) for c in point])
        return x, y

    def pose(self, name: str) -> dict[str, Any] | None:
        """wxyz and position of a node relative to its parent, as the browser holds them."""
        return self.page.evaluate("n => { const p = window.__viserMutable.nodePoseData[n];"
                                  " return p ? {wxyz: p.wxyz, position: p.position} : null; }", name)

    def visible(self, name: str) -> bool | None:
        """The node's own visibility flag, None where there is no such node."""
        return self.page.evaluate("n => window.__viserSceneTree.getState()[n]?.visibility ?? null", name)

    def click_world(self, point: Any) -> None:
        """Click where a world point is drawn; the frame between is the one in which hovering is ray-cast."""
        self.click_at(*self.project(point))

    def click_at(self, x: float, y: float) -> None:
        self.page.mouse.move(x - 2, y - 2)
        self.page.mouse.move(x, y)
        self.wait_frames(1)
        self.page.mouse.down()
        self.page.mouse.up()

    # -- panels

    def row(self, label: str) -> Locator:
        """The row of a labelled input: viser's sliders and text boxes carry no accessible name."""
        exact = re.compile(rf"^\s*{re.escape(label)}\s*$")
        return self.page.locator("label", has_text=exact).first.locator("xpath=ancestor::div[2]")

    def click_button(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def open_tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name, exact=True).click()

    def set_slider(self, label: str, value: float) -> None:
        """Exactly, through the number box beside the slider."""
        self._type(self.row(label).get_by_role("textbox"), f"{value:g}")

    def nudge_slider(self, label: str, key: str, times: int = 1) -> None:
        """As a person with a keyboard: Home, End, ArrowLeft, ArrowRight."""
        thumb = self.row(label).get_by_role("slider")
        thumb.focus()
        for _ in range(times):
            thumb.press(key)

    def set_number(self, label: str, value: float) -> None:
        self._type(self.page.get_by_label(label, exact=True), f"{value:g}")

    def set_text(self, label: str, text: str) -> None:
        self._type(self.row(label).get_by_role("textbox"), text)

    def set_checkbox(self, label: str, on: bool) -> None:
        self.page.get_by_label(label, exact=True).set_checked(on)

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_label(label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def upload(self, button: str, path: str | Path) -> None:
        with self.page.expect_file_chooser() as chooser:
            self.click_button(button)
        chooser.value.set_files(path)

    def hotkey(self, key: str) -> None:
        """A key for the page; viser ignores keys while a form field has the focus."""
        self.page.evaluate("() => document.activeElement?.blur()")
        self.page.keyboard.press(key)

    @staticmethod
    def _type(box: Locator, text: str) -> None:
        box.fill(text)
        box.press("Enter")
