"""The tab Export: the offline replay, the recording, a picture, tables, the mosaic, the scene, and the project as one file."""

from __future__ import annotations

import logging
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import viser

from solvers import BadProject, PhotogrammetryError

from .. import export, share
from ..actions import Say
from ..mosaic_actions import WriteMosaic
from ..mosaic_state import Mosaic
from ..picture_words import finished
from ..state import State
from ..tabs import Desk, Tab, whole_scene
from .widgets import BOX, MUTED, QUIET, Html, esc

PICTURE = (2160, 3840)
"""Height and width of the picture, pixels: 4K."""
MOSAIC, LARGEST = "mosaic.tif", 2**30
"""The mosaic's file in the project's folder; bytes of it handed to a browser at most."""
TERMINAL = (
    "collinea export PROJECT --html replay.html --rrd run.rrd --png scene.png --csv tables --glb scene.glb --ply scene.ply "
    "--tif mosaic.tif --zip project.zip"
)


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
            "Picture as PNG": ("png", "The scene as you see it, with its legend, 3840 × 2160 pixels.", self._picture),
            "Tables as CSV": (
                "tables.zip",
                "Points, images, observations, orientations, residuals, iterations, bundle; metres, degrees, pixels.",
                lambda _: share.tables_zip(desk.state()),
            ),
            "Scene as GLB": (
                "glb",
                "What is shown as binary glTF, in metres from the scene's origin.",
                lambda _: export.glb(whole_scene(desk.state()), export.where(desk.state())),
            ),
            "Scene as PLY": (
                "ply",
                "Terrain, planes and frustums as one coloured mesh, in metres from the scene's origin.",
                lambda _: export.ply(whole_scene(desk.state()), export.where(desk.state())),
            ),
            "Project as ZIP": (
                "zip",
                "The project as saved, all its photos and this session, in one file.",
                lambda _: self._project(),
            ),
        }
        for label, (kind, hint, make) in ways.items():
            button = desk.gui.add_button(label, hint=hint, color=QUIET)
            button.on_click(lambda event, label=label, kind=kind, make=make: self._hand(event.client, label, kind, make))
        mosaic = desk.gui.add_button(
            "Mosaic as GeoTIFF", color=QUIET, hint="The mosaic at full resolution; written into the project, then handed over."
        )
        mosaic.on_click(lambda event: self._write(event.client))
        self._asked: tuple[viser.ClientHandle, int] | None = None
        self._note = Html(desk.gui)

    def _write(self, client: viser.ClientHandle | None) -> None:
        """Ask for the mosaic's file; `draw` hands it over once it is written."""
        if client is not None:
            self._asked = client, self._desk.state().room(Mosaic).written
            self._desk.emit(WriteMosaic(MOSAIC))

    def _hand(
        self, client: viser.ClientHandle | None, label: str, kind: str, make: Callable[[viser.ClientHandle], bytes]
    ) -> None:
        if client is None:
            return
        try:
            data = make(client)
        except (PhotogrammetryError, OSError, TimeoutError, RuntimeError) as error:  # RuntimeError: the browser has gone
            self._desk.emit(Say(f"{label}: {error}"))
            return
        except Exception as error:
            logging.getLogger("collinea").exception("%s", label)
            self._desk.emit(Say(f"{label} could not be made ({type(error).__name__}: {error}); see the terminal"))
            return
        client.send_file_download(f"{file_name(self._desk.state())}.{kind}", data)

    def _picture(self, client: viser.ClientHandle) -> bytes:
        """The scene from where this browser looks, PNG."""
        return finished(client.get_render(*PICTURE, transport_format="png", timeout=60), self._desk.state())

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
        room, folder = state.room(Mosaic), state.assets.folder
        busy = any(b.startswith("write|") for b in room.busy)
        going = f"<div>{esc(room.progress or 'Writing the mosaic')} …</div>" if busy and self._asked else ""
        said = f"<div>{esc(room.message)}</div>" if self._asked and not busy else ""
        self._note.set(f"<div {BOX}>{going}{said}<div {MUTED}>From a terminal: {esc(TERMINAL)}</div></div>")
        if self._asked is not None and folder is not None and room.written > self._asked[1] and not busy:
            client, _ = self._asked
            self._asked = None
            threading.Thread(target=self._give, args=(client, folder / MOSAIC), name="collinea-mosaic", daemon=True).start()

    def _give(self, client: viser.ClientHandle, file: Path) -> None:
        if file.stat().st_size > LARGEST:
            self._desk.emit(Say(f"The mosaic is too large for a browser; it lies in the project: {file}"))
        else:
            client.send_file_download(f"{file_name(self._desk.state())}.tif", file.read_bytes())


def file_name(state: State) -> str:
    """The project's name with letters that any system takes."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in state.block.name)[:80] or "project"


TAB = Tab("Export", SharePanel, order=95)
