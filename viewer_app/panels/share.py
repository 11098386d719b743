"""The tab Export: the offline replay, the recording, a picture, tables, and the project as one file."""

from __future__ import annotations

import io
import logging
import tempfile
from collections.abc import Callable
from pathlib import Path

import viser

from solvers import BadProject, PhotogrammetryError

from .. import share
from ..actions import Say
from ..state import State
from ..tabs import Desk, Tab
from .widgets import BOX, MUTED, Html

PICTURE = (2160, 3840)
"""Height and width of the picture, pixels: 4K."""


class SharePanel:
    """One button per way out; each hands a file to the browser that asked."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        ways: dict[str, tuple[str, str, Callable[[viser.ClientHandle], bytes]]] = {
            "Replay as HTML": (
                "html",
                "One page that plays the adjustment of the chosen image, without a server or network.",
                lambda _: share.replay_html(desk.state()).encode("utf-8"),
            ),
            "Recording as RRD": ("rrd", "Every solution for rerun's viewer, with its timeline.", lambda _: self._recording()),
            "Picture as PNG": ("png", "The scene as you see it, 3840 × 2160 pixels.", picture),
            "Tables as CSV": (
                "tables.zip",
                "Points, images and orientations; metres, degrees, pixels.",
                lambda _: share.tables_zip(desk.state()),
            ),
            "Project as ZIP": ("zip", "The project folder as saved, photos included, in one file.", lambda _: self._project()),
        }
        for label, (kind, hint, make) in ways.items():
            button = desk.gui.add_button(label, hint=hint, color="gray")
            button.on_click(lambda event, label=label, kind=kind, make=make: self._hand(event.client, label, kind, make))
        self._note = Html(desk.gui)
        self._note.set(
            f"<div {BOX}><div {MUTED}>The same from a terminal: collinea export PROJECT --html replay.html</div></div>"
        )

    def _hand(
        self, client: viser.ClientHandle | None, label: str, kind: str, make: Callable[[viser.ClientHandle], bytes]
    ) -> None:
        if client is None:
            return
        try:
            data = make(client)
        except (PhotogrammetryError, OSError, TimeoutError, RuntimeError) as error:
            logging.getLogger("collinea").exception("%s", label)
            self._desk.emit(Say(f"{label}: {error}"))
            return
        client.send_file_download(f"{file_name(self._desk.state())}.{kind}", data)

    def _recording(self) -> bytes:
        with tempfile.TemporaryDirectory(prefix="collinea-") as folder:
            path = Path(folder) / "recording.rrd"
            share.recording(self._desk.state(), path)
            return path.read_bytes()

    def _project(self) -> bytes:
        folder = self._desk.state().assets.folder
        if folder is None:
            raise BadProject("this project has no folder; open one with collinea view PROJECT")
        return share.project_zip(folder)

    def draw(self, state: State) -> None:
        """Nothing here depends on the state."""


def picture(client: viser.ClientHandle) -> bytes:
    """The scene from where this browser looks, PNG."""
    from PIL import Image

    pixels = client.get_render(*PICTURE, transport_format="png", timeout=60)
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def file_name(state: State) -> str:
    """The project's name with letters that any system takes."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in state.block.name)[:80] or "project"


TAB = Tab("Export", SharePanel, order=95)
