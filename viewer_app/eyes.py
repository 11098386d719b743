"""From where every browser looks: the first view beside the panels, flights, and the way through a photo."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import viser

from .acting import Action
from .actions import Say
from .bundle_state import Bundle
from .desktop import Desktop
from .flying import Fly, beside_panel, flight, sees_mosaic
from .home import home, home_beside
from .looking import looked_through
from .matching_state import Matching, Network
from .mosaic_state import Mosaic
from .overlay import view_through
from .state import State

STARTS = 20
"""Places where browsers began, or were put, that are remembered."""
FARTHEST = 1e12
"""Farthest a browser may look from or to, m."""


class Look(NamedTuple):
    """position, at, up: (3,) [m, local]; fov: vertical [rad]; aspect: width over height."""

    position: np.ndarray
    at: np.ndarray
    up: np.ndarray
    fov: float
    aspect: float


def look_of(camera: viser.CameraHandle) -> Look | None:
    """How a browser looks, read once; None where nobody can look so: it says it itself, and anyone can say anything."""
    try:
        position, at, up = (np.array(v, float).reshape(3) for v in (camera.position, camera.look_at, camera.up_direction))
        look = Look(position, at, up, float(camera.fov), camera.image_width / max(camera.image_height, 1))
        numbers = np.array([*position, *at, *up, look.fov, look.aspect])
    except (TypeError, ValueError):
        return None
    return look if (np.abs(numbers) < FARTHEST).all() and 0 < look.fov < np.pi else None


def turn(
    client: viser.ClientHandle, position: np.ndarray, at: np.ndarray, up: np.ndarray | None = None, fov: float | None = None
) -> None:
    """Let a browser look from a position (3,) at a point (3,) [m, local]. Nothing happens where that is no view, or where the
    browser says an impossible one of its own in the same moment."""
    if not (np.abs(np.concatenate([position, at])) < FARTHEST).all():  # a point may have been given any coordinates
        return
    camera = client.camera
    with suppress(LookupError, TypeError, ValueError), client.atomic():
        if up is not None:
            camera.up_direction = up
        camera.position, camera.look_at = position, at
        if fov is not None:
            camera.fov = fov


class Eyes:
    """Where all browsers look. Its methods are called by the loop; what browsers say of their cameras comes from other threads.

    view: position and point looked at (6 numbers) of who moved last, () where nobody has; canvases: width and height of each
    browser's scene [px]; homes: where each was put.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        state: Callable[[], State],
        put: Callable[[Action | Callable[[], None]], None],
        changed: Callable[[], None],
    ) -> None:
        self._server, self._state, self._put, self._changed = server, state, put, changed
        self.view = state().room(Desktop).view
        self.canvases: dict[int, tuple[float, float]] = {}
        self.homes: dict[int, list[np.ndarray]] = {}
        self._framed: dict[int, tuple[float, float]] = {}  # for which canvas
        self._taken: set[int] = set()  # browsers that have begun where they were told to
        self._viewed = 0.0
        self._before: dict[int, Look] = {}
        self._home: tuple[np.ndarray, np.ndarray, float] | None = None
        self._starts: list[np.ndarray] = []
        self._given: list[tuple[float, ...]] = []  # kept views with which browsers began
        self._opens = True  # until everything was solved once, what is found widens the first view
        self._oriented = self._adjusted = False
        self._placed: Network | None = None
        self._made: frozenset[str] | None = None
        server.initial_camera.fov = np.radians(45)
        self._look()

    # -- what there is to see

    def follow(self, state: State, busy: bool) -> None:
        """What was placed, made or adjusted since is looked at; busy: whether more is being solved."""
        network = state.room(Matching).network
        if not self._oriented and any(s.orientation for s in state.work.solutions.values()):
            self._oriented = self._opens = True  # the first camera of a project that had none is looked at
        made, adjusted = frozenset(state.room(Mosaic).made), state.room(Bundle).result is not None
        found = self._placed is not network or self._made != made or self._adjusted != adjusted
        if self._opens or found:
            new, self._placed, self._made, self._adjusted = made - (self._made or made), network, made, adjusted
            self._look()
            if new:
                self._look_at_mosaic()
            self._opens = busy

    def _look(self) -> None:
        """Look at all there is; who has moved already keeps the own view."""
        old, (position, at, far) = self._home, home(self._state())
        if old is not None and np.linalg.norm(position - old[0]) < 0.02 * np.linalg.norm(position - at):
            return
        self._home = position, at, far
        self._starts = [*self._starts[-STARTS:], position]
        camera = self._server.initial_camera
        camera.far, camera.near = far, far / 20000
        self._begin()
        for client in self._server.get_clients().values():
            self.frame(client)

    def _begin(self) -> None:
        """Whoever comes begins where the last one looked, or at home. From any thread."""
        if self._home is None:
            return
        camera, view = self._server.initial_camera, self.view
        camera.position, camera.look_at = (np.array(view[:3]), np.array(view[3:])) if view else self._home[:2]
        if view:
            self._given = [*self._given[-STARTS:], view]

    def _look_at_mosaic(self) -> None:
        """A mosaic was made: who has moved and sees nothing of it is taken there, or told where others look too."""
        clients, state = self._server.get_clients(), self._state()
        for number, client in clients.items():
            look = look_of(client.camera)
            if look is None or self._unmoved(number, look.position) or looked_through(state):
                continue
            if sees_mosaic(state, look.position, look.at, look.fov, look.aspect):
                continue
            said = Say("The mosaic lies out of view: H shows all there is")
            self._put(Fly("home", "", number) if len(clients) == 1 else said)

    # -- the first view

    def frame(self, client: viser.ClientHandle) -> None:
        """Show a browser all there is beside the panels that lie over its canvas, unless it has moved: it stands neither where it
        was put last nor where browsers begin."""
        if (look := look_of(client.camera)) is not None and self._unmoved(client.client_id, look.position):
            self._show_all(client, look)

    def _show_all(self, client: viser.ClientHandle, look: Look) -> None:
        if (size := self.canvases.get(client.client_id)) is None:
            return
        self._framed[client.client_id] = size
        position, at = home_beside(self._state(), *size, look.fov)
        self.homes[client.client_id] = [*self.homes.get(client.client_id, [])[-STARTS:], position]
        turn(client, position, at)

    def _unmoved(self, client_id: int, position: np.ndarray) -> bool:
        known = np.array([*self._starts, *self.homes.get(client_id, [])])
        return bool((np.abs(known - position) < 1e-3 + 1e-3 * np.abs(known)).all(axis=1).any())

    def sized(self, client_id: int, size: tuple[float, float]) -> None:
        """A browser says how large its canvas is, px."""
        self.canvases[client_id] = size
        if (client := self._server.get_clients().get(client_id)) is not None:
            self.frame(client)

    # -- browsers come, look around and leave

    def came(self, client: viser.ClientHandle) -> None:
        """A page has a camera of its own until it has taken ours."""
        number = client.client_id

        async def looks(camera: viser.CameraHandle) -> None:
            look = look_of(camera)
            if look is None:
                return
            if self._unmoved(number, look.position):
                self._taken.add(number)
                if self._framed.get(number) != self.canvases.get(number):
                    self._put(lambda: self.frame(client))
                return
            if number in self._taken:
                self._looked(number, look)
            elif any(np.allclose((*look.position, *look.at), view, rtol=1e-3, atol=1e-3) for view in self._given):
                self._taken.add(number)  # it looks as the last one did

        client.camera.on_update(looks)
        self._put(lambda: self.frame(client))

    def _looked(self, number: int, look: Look) -> None:
        """Keep from where somebody looks, but not through which photo."""
        if looked_through(self._state()) or number in self._before:
            return
        here = tuple(map(float, (*look.position, *look.at)))
        if self.view and np.allclose(here, self.view, rtol=1e-6, atol=1e-3):
            return  # a page says where it is when its size changes too
        self.view = here
        if time.monotonic() - self._viewed > 0.5:
            self._viewed = time.monotonic()
            self._begin()
            self._changed()

    def left(self, number: int) -> None:
        for known in (self.canvases, self.homes, self._framed, self._before):
            known.pop(number, None)
        self._taken.discard(number)
        self._begin()

    # -- flights

    def fly(self, action: Fly) -> None:
        """Turn the view of the browser that asked."""
        for number, client in self._server.get_clients().items():
            look = look_of(client.camera)
            if look is None or (action.client not in (None, number) and action.what != "back"):
                continue
            if action.what == "home":
                self.view = ()
                self._begin()
                self._show_all(client, look)
            elif action.what == "through":
                if (to := view_through(self._state(), action.name, look.aspect)) is not None:
                    self._before.setdefault(number, look)
                    turn(client, *to)
            elif action.what == "back":
                if (before := self._before.pop(number, None)) is not None:
                    turn(client, *before[:4])
            elif (to := flight(self._state(), action, look.position, look.at)) is not None:
                size = self.canvases.get(number)
                turn(client, *(to if size is None else beside_panel(*to, *size, look.fov)))
