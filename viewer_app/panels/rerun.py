"""One button opens the run in rerun's own viewer, in a panel beside the scene; recorded and served on demand."""

from __future__ import annotations

import logging
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import viser

from ..actions import Action, Say
from ..bridge import is_local
from ..rerun_shown import EVERYTHING, Shown
from ..state import MODELS, State
from .widgets import MUTED, QUIET, esc

if TYPE_CHECKING:
    from ..rerun_server import Served


Lay = Callable[[Shown], bytes]
"""The blueprint by which a recording shows what the scene does."""
SOON = 0.3
"""Seconds after which it does: who switches one layer often switches another."""


class RerunPanel:
    """Records the solutions there are and opens the recording, which follows the scene in what it shows; a second press records
    anew. shown: what such a recording has of the scene."""

    def __init__(
        self,
        server: viser.ViserServer,
        emit: Callable[[Action], None],
        state: Callable[[], State],
        shown: Callable[[State], Shown],
        name: str,
    ) -> None:
        self._server, self._gui, self._emit, self._state, self._of = server, server.gui, emit, state, shown
        self._folder = tempfile.TemporaryDirectory(prefix="collinea-")
        self._lock = threading.Lock()
        self._count = 0
        self._serving: Served | None = None
        self._lay: Lay | None = None
        self._shown = EVERYTHING
        self._waiting = False
        self._panel: Any = None
        self._html: Any = None
        self._close = f"Close {name}"
        close = self._gui.add_command(self._close, description="Close the panel with rerun's viewer.")
        close.on_trigger(lambda _: self._hide())  # type: ignore[attr-defined]

    def open(self, client: viser.ClientHandle | None = None) -> None:
        """Record what is solved, and open it."""
        self._open(self._record)

    def show(self, recording: Path, lay: Lay) -> None:
        """Open a recording there is, without waiting for it."""
        work = (lambda: (recording, lay),)
        threading.Thread(target=self._open, args=work, name="collinea-rerun", daemon=True).start()

    def follow(self, state: State) -> None:
        """An open recording shows from now on what the scene does, in the colours with which it was opened."""
        if self._html is not None and not self._waiting and self._now(state) != self._shown:
            self._waiting = True
            timer = threading.Timer(SOON, self._lay_out)
            timer.daemon = True
            timer.start()

    def _now(self, state: State) -> Shown:
        return replace(self._of(state), dark=self._shown.dark)

    def _lay_out(self) -> None:
        with self._lock:
            self._waiting = False
            now = self._now(self._state())
            if self._html is None or self._serving is None or self._lay is None or now == self._shown:
                return
            self._shown = now
            try:
                self._serving.lay_out(self._lay(now))
            except Exception:  # the recording stays as it was
                logging.getLogger("collinea").exception("rerun")

    def _open(self, made: Callable[[], tuple[Path, Lay] | None]) -> None:
        """made: the recording and how it follows, None where there is nothing to record."""
        from ..rerun_server import serve

        with self._lock:
            now = self._of(self._state())
            try:
                found = made()
                if found is None:
                    self._emit(Say("There is no solution to show in rerun yet; solve an image first."))
                    return
                recording, lay = found
                laid = lay(now)  # it may have been recorded while something else was shown
                serving = serve(recording, follows=True)
            except Exception as error:
                logging.getLogger("collinea").exception("rerun")
                self._emit(Say(f"The run could not be opened in rerun: {error}"))
                return
            if self._serving is not None:
                self._serving.close()
            self._serving, self._lay, self._shown = serving, lay, now
            serving.lay_out(laid)
            self._show(serving.url)
        self.follow(self._state())

    def _record(self) -> tuple[Path, Lay] | None:
        from ..paint_rerun import layout, record

        state = self._state()
        block, now = state.block, self._of(state)
        done = [s.orientation for i in block.images for m in MODELS if (s := state.solution(m, i.name)) and s.orientation]
        if not done:
            return None
        done.sort(key=lambda o: o.image != state.image)
        self._count += 1
        path = Path(self._folder.name) / f"recording-{self._count}.rrd"
        photos = {name: photo.pane for name, photo in state.assets.photos.items()}
        record(path, block, done, photos, _truth(state), now)
        return path, lambda other: layout(block, done, other)

    def _show(self, url: str) -> None:
        url += f"&theme={'dark' if self._shown.dark else 'light'}"
        if self._panel is None:
            self._panel = self._gui.add_panel()
            with self._panel.add_tab("rerun"):
                self._html = self._gui.add_html("")
            self._panel.dock_left()
            self._panel.set_width(width_beside([c.camera.image_width for c in self._server.get_clients().values()]))
            with self._panel.add_tab("Close"):
                close = self._gui.add_button(self._close, hint="Close the panel with rerun's viewer.", color=QUIET)
                close.on_click(lambda _: self._hide())
        self._html.content = (
            f'<iframe title="rerun" src="{esc(url)}" style="width:100%;height:calc(100vh - 112px);border:0"></iframe>'
            f'<div style="padding:2px 12px;font-size:12px"><a href="{esc(url)}" target="_blank" rel="noreferrer">'
            f"Open in a tab of its own</a>{self._elsewhere()}</div>"
        )

    def _elsewhere(self) -> str:
        """Words for who looks from another machine, where the panel stays empty."""
        if is_local(self._server.get_host()):
            return ""
        return f" <span {MUTED}>Seen only on the machine that serves Collinea; elsewhere save the .rrd in Export.</span>"

    def _hide(self) -> None:
        with self._lock:
            if self._panel is not None:
                self._panel.remove()
                self._panel = self._html = self._lay = None

    def close(self) -> None:
        with self._lock:
            if self._serving is not None:
                self._serving.close()
                self._serving = None
            self._folder.cleanup()


def width_beside(canvases: Sequence[int]) -> int:
    """Width [px] of the panel beside canvases so wide: less than half of the narrowest, where there is room for it."""
    return int(min(max(0.45 * min(canvases, default=0), 520), 1000))


def _truth(state: State) -> dict[str, Any]:
    from solvers.io import read_truth

    return (read_truth(state.assets.folder) if state.assets.folder else None) or {}
