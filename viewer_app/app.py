"""Wiring and the one loop: event -> action -> update -> state -> scene -> painter. Only the loop changes the state."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import viser

from solvers import Unsupported

from .actions import Action, Say, Tick, update
from .actions_solve import Failed, Rows, Solved
from .bridge import Wire, controls, dress_labels, guard_values, is_local, open_server
from .desktop import Desktop, OpenedTab
from .eyes import Eyes
from .flying import Fly, asked_by
from .jobs import Jobs
from .keeping import Keeper, resume
from .loading import bring, open_project
from .paint_viser import Painter
from .palette import complete
from .panels.status import StatusLine
from .picking import pick
from .state import FEW, MODELS, State, wanted
from .tabs import Command, Desk, Panel, tabs, wanted_tasks, whole_scene
from .theme import accent
from .widths import NARROW, OVER, Widths

PICK_PIXELS = 12.0
"""How far from a point's middle a click still means it, pixels of the screen."""
LATENCIES = 200
PATIENCE = 0.04
"""How long a repaint waits for the chosen image's solutions, which then come in the same picture, seconds; anything else that
happens meanwhile is answered at once."""
OTHERS = 3.0
"""The same for other images' solutions, of which there may be thousands, times what the last repaint took; at most a second."""


class App:
    """A viewer on one project. port: where it answers; state: what it shows; settled(): whether nothing is left to solve.

    latencies: seconds from taking an action to having sent the scene it led to, newest last.
    """

    def __init__(self, folder: Path | str | State, *, host: str = "127.0.0.1", port: int = 0, token: str | None = None) -> None:
        if not is_local(host) and not token:
            raise Unsupported(f"host {host} would open the project to other machines; give a token as well (--token WORD)")
        opened = folder if isinstance(folder, State) else open_project(folder)
        self._state = resume(opened)
        self._keeper = Keeper(opened.assets.folder, opened.block, self._left_as)
        self._actions: queue.Queue[Action | Callable[[], None] | None] = queue.Queue()
        self.latencies: list[float] = []
        self.server = open_server(host, port, token)
        self.port = self.server.get_port()
        self.url = f"http://{host}:{self.port}/" + (f"?token={quote(token, safe='')}" if token else "")
        self._jobs = Jobs(self.emit)
        self._painter = Painter(self.server)
        self._panels: list[Panel] = []
        self._build()
        self._kept: tuple[Any, ...] = ()
        self._painting = 0.0
        self._closed, self._first = threading.Event(), threading.Event()
        self._paint()
        self._loop = threading.Thread(target=self._run, name="collinea-loop", daemon=True)
        self._reader = threading.Thread(target=self._read, name="collinea-reader", daemon=True)
        self._loop.start()
        self._reader.start()

    @property
    def state(self) -> State:
        return self._state

    def emit(self, action: Action) -> None:
        """Hand an action to the loop; from any thread."""
        self._actions.put(action)

    def settled(self) -> bool:
        """Whether every action was taken, everything read and nothing is left to solve."""
        return self._actions.unfinished_tasks == 0 and not self._reader.is_alive() and not wanted_tasks(self._state)

    def close(self) -> None:
        self._closed.set()
        self._first.set()
        self._actions.put(None)
        self._loop.join(timeout=10)
        self._reader.join(timeout=10)
        if self._eyes.view != self._state.room(Desktop).view:
            self._keeper.changed()
        self._keeper.close()
        self._jobs.close()
        for panel in self._panels:
            getattr(panel, "close", lambda: None)()
        self.server.stop()

    def __enter__(self) -> App:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the loop

    def _run(self) -> None:
        while not self._closed.is_set():
            taken = self._take()
            began = time.perf_counter()
            worked = self._apply(taken)
            while worked and (left := began + self._patience(taken) - time.perf_counter()) > 0:
                with suppress(queue.Empty):
                    more = self._actions.get(timeout=left)
                    worked = self._apply([more] if more is not None else [])
                    taken.append(more)
            if taken:
                start = time.perf_counter()
                self._paint()
                self._painting = time.perf_counter() - start
                self._keep()
                self.latencies = [*self.latencies, time.perf_counter() - began][-LATENCIES:]
            for _ in taken:
                self._actions.task_done()

    def _apply(self, taken: Sequence[Action | Callable[[], None]]) -> bool:
        """What the actions make of the state; one that fails is said. A function is called when all before it was taken.

        Gives whether all of them were about what is solved: then more of that may come soon.
        """
        worked = bool(taken)
        for action in taken:
            if not isinstance(action, Action):
                self._try("What a browser asked for", action)
                continue
            before = self._state
            try:
                self._state = update(self._state, action)
                if isinstance(action, Fly):
                    self._eyes.fly(action)
            except Exception as error:
                logging.getLogger("collinea").exception("%s", action)
                self._state = update(self._state, Say(f"{type(action).__name__} could not be done: {error}"))
            worked = worked and _solved_otherwise(before, self._state)
        return worked

    def _keep(self) -> None:
        """The session follows what people do; what the solver finds is no part of it."""
        state = self._state
        if state.saved is not None and state.saved is not self._keeper.disk:
            self._keeper.disk = state.saved
        marks = (
            state.work.block,
            state.work.off,
            state.work.settings,
            state.work.rooms,
            state.view,
            state.image,
            state.point,
            state.row,
            state.mark,
            state.spots,
            state.click,
            state.rooms,
            state.past,
            state.future,
            state.saved,
        )
        if len(marks) != len(self._kept) or any(a is not b for a, b in zip(marks, self._kept, strict=True)):
            if self._kept:
                self._keeper.changed()
            self._kept = marks

    def _patience(self, taken: Sequence[Any]) -> float:
        """Asks for what is missing; how long a repaint waits for it: little where the chosen image's own solutions are still to
        come, some times as long as the last one took where all that came are other images', else not at all."""
        self._try("The work to be done", lambda: self._jobs.want(wanted_tasks(self._state)))
        jobs = wanted(self._state)
        if any(job.image == self._state.image and job.model in MODELS for job in jobs):
            return PATIENCE
        many = bool(jobs) and len(self._state.block.images) > FEW
        others = many and all(isinstance(a, Rows | Solved | Failed) and a.job.image != self._state.image for a in taken)
        return min(OTHERS * self._painting, 1.0) if others else 0.0

    def _take(self) -> list[Any]:
        """All actions that wait; the clock's tick where it plays and nothing happens."""
        playing = self._state.playing
        try:
            first = self._actions.get(timeout=1 / self._state.speed if playing else None)
        except queue.Empty:
            self._actions.put(Tick())
            return []
        taken = [first]
        with suppress(queue.Empty):
            while True:
                taken.append(self._actions.get_nowait())
        return [a for a in taken if a is not None]

    def _paint(self) -> None:
        """Ask for what is missing, then show the state: scene and panels in one block; one that fails does not take the others
        with it."""
        state = self._state
        self._try("The work to be done", lambda: self._jobs.want(wanted_tasks(state)))
        jobs = wanted(state)
        if not any(job.image == state.image and job.model in MODELS for job in jobs):
            self._first.set()
        self._try("The view", lambda: self._eyes.follow(state, bool(jobs)))
        with self.server.atomic():
            self._try("The scene", lambda: self._painter.paint(whole_scene(state)))
            for panel in self._panels:
                self._try(f"The {type(panel).__name__}", partial(panel.draw, state))
            self._theme(state.view.dark)
            self._try("The width of the panels", lambda: self._widths.fit(state))
        self.server.flush()

    def _try(self, what: str, do: Callable[[], None]) -> None:
        """The loop lives on whatever fails: it is said."""
        try:
            do()
        except Exception as error:
            logging.getLogger("collinea").exception("%s", what)
            words = Say(f"{what} failed ({type(error).__name__}: {error}); Undo may help")
            if self._state.message != words.message:
                self.emit(words)

    def _read(self) -> None:
        """Terrain and photos, once the chosen image is solved: reading must not hold up what is looked for first."""
        self._first.wait()
        for action in bring(self._state):
            if self._closed.is_set():
                return
            self.emit(action)

    # -- wiring

    def _build(self) -> None:
        server, gui = self.server, self.server.gui
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        server.scene.configure_default_lights(cast_shadow=False)
        self._eyes = Eyes(server, lambda: self._state, self._actions.put, lambda: self._keeper.changed())
        self._dark: bool | None = None
        gui.set_panel_label("Collinea")
        self._wire = Wire(server, self._heard)
        dress_labels(server)
        self._widths = Widths(lambda client, place, width: self._wire.widen(client, self._places[place], width))
        self._desk = Desk(gui, server, self.emit, self._wire, lambda: self._state)
        self._tabs(gui)
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)
        clicked: Any = self._clicked  # viser takes coroutines here too
        server.scene.on_click()(clicked)

    def _tabs(self, gui: viser.GuiApi) -> None:
        """Every tab in its place, and every command in the palette."""
        self._panels.append(StatusLine(self._desk))
        side, below = gui.add_tab_group(), gui.add_panel()
        self._places = {"side": gui.main_panel, "below": below}
        tab_of: dict[str, str] = {}
        for tab in tabs():
            with (side if tab.place == "side" else below).add_tab(tab.name):
                self._panels.append(tab.make(self._desk))
            tab_of = {handle._impl.uuid: tab.name for handle in controls(gui)} | tab_of
            for command in tab.commands:
                self._command(gui, command)
        self.tab_of = tab_of
        complete(gui, {command.label for tab in tabs() for command in tab.commands}, self._wire, tab_of)
        guard_values(self.server, self._actions.put)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(NARROW)
        below.float(x=12, y=-12, width=OVER)

    def _command(self, gui: viser.GuiApi, command: Command) -> None:
        key: Any = command.key or None
        modifier: Any = command.modifier
        handle = gui.add_command(command.label, description=command.hint or None, hotkey=key, modifier=modifier)

        @handle.on_trigger
        async def _(event: Any) -> None:
            client = getattr(event, "client_id", None)
            if command.tab and client is not None and self._widths.shows(client, self._state) != command.tab:
                self._wire.open(client, [command.tab])
                return
            act = command.act
            if (action := act if isinstance(act, Action) else act(self._state)) is not None:
                self.emit(asked_by(action, client))

    def _sized(self, client_id: int | None, value: Any) -> None:
        """A browser says how large its canvas and its page are: widths and heights in 10,000 px."""
        if client_id is None or not (isinstance(value, tuple) and len(value) == 4 and min(value) >= 0.001):
            return
        width, height, page, _ = (1e4 * v for v in value)
        self._widths.sized(client_id, (width, height), page)
        self._eyes.sized(client_id, (width, height))

    def _came(self, client: viser.ClientHandle) -> None:
        self._eyes.came(client)
        self._wire.measure(client.client_id)
        room = self._state.room(Desktop)
        if opened := [name for name in (room.side, room.below) if name]:
            self._wire.open(client.client_id, opened)

    def _left_as(self) -> State:
        """The state with the view of who moved last, which is no part of it while people move."""
        return self._state.with_room(replace(self._state.room(Desktop), view=self._eyes.view))

    def _left(self, client: viser.ClientHandle) -> None:
        if self._closed.is_set():  # nobody comes any more
            return
        self._eyes.left(client.client_id)
        self._actions.put(lambda: self._widths.left(client.client_id))

    def _theme(self, dark: bool) -> None:
        if dark != self._dark:
            self._dark = dark
            self.server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, brand_color=accent(dark))

    def _heard(self, kind: str, value: Any, client: int | None = None) -> None:
        """What came through the wire; anyone who can open the page can send anything: the tabs check it again."""
        if kind == "sizes":
            self._actions.put(lambda: self._sized(client, value))
        if kind == "tab" and (tab := next((t for t in tabs() if t.name == value), None)) is not None:
            if tab.place == "below" and client is not None:
                self._actions.put(partial(self._widths.opened, client, tab.name))
            self.emit(OpenedTab(tab.place, tab.name))
        for tab in tabs():
            if (heard := tab.heard.get(kind)) is not None and (action := heard(self._state, value)) is not None:
                self.emit(asked_by(action, client))

    async def _clicked(self, event: viser.SceneClickEvent) -> None:
        camera = event.client.camera
        tolerance = PICK_PIXELS * camera.fov / max(camera.image_height, 1)
        ray = np.array(event.ray_origin), np.array(event.ray_direction), tolerance
        meanings = [*(tab.click for tab in tabs() if tab.click), pick]
        action = next((a for meant in meanings if (a := meant(self._state, *ray)) is not None), None)
        if action is not None:
            self.emit(asked_by(action, event.client.client_id))


def _solved_otherwise(before: State, after: State) -> bool:
    """Whether an action changed what is solved, or of which image it is shown."""
    old, new = before.work, after.work
    return old.solutions is not new.solutions or (old.revision, before.image) != (new.revision, after.image)


def run(
    folder: Path | str, *, host: str = "127.0.0.1", port: int = 0, open_browser: bool = True, token: str | None = None
) -> None:
    """Open a project in the browser and serve until interrupted (Ctrl+C). Raises BadProject, BadTable, Unsupported."""
    with App(folder, host=host, port=port, token=token) as app:
        taken = "" if port in (0, app.port) else f"port {port} is taken; "
        print(f"Collinea shows {app.state.block.name} at {app.url} ({taken}Ctrl+C ends it)", flush=True)
        if open_browser:
            import webbrowser

            webbrowser.open(app.url)
        with suppress(KeyboardInterrupt):
            threading.Event().wait()


__all__ = ["MODELS", "App", "run"]
