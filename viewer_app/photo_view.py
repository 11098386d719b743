"""What part of the chosen photo the pane shows, pure: zoom, pan and the one transform between pane and photo pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from solvers.io.pyramid import build_pyramid, pyramid_path, read_window, resampled

from .acting import Action, Report, handles
from .actions import Say
from .sighting import sees, where
from .state import Photo, State
from .tasks import Task

PANE_WIDTH = 406.0
"""Width of the pane, pixels of the page, until a browser tells its own."""
CLOSEST = 8.0
"""Photo pixels that are seen across the pane at the closest."""
LARGE = 4e6
"""Photos of more pixels than this get a pyramid."""
PREPARING = "preparing the photo for zooming"
SENT, MOST = 1200, 2600
"""Longer side of a picture that is sent, pixels: for a small pane, and at most."""
STEP = 200
"""By how much it grows with the pane."""


@dataclass(frozen=True)
class PhotoView:
    """left, top: corner of the window in photo pixels from the outer corner; width: across it, 0 shows the whole photo.

    image: the photo it belongs to. pane: width of the pane in the browser that drew or zoomed it last. sharp: pixels of the
    screen across the widest pane there was.
    """

    image: str = ""
    left: float = 0.0
    top: float = 0.0
    width: float = 0.0
    pane: float = PANE_WIDTH
    sharp: float = PANE_WIDTH
    ready: tuple[str, ...] = ()  # photos whose pyramid is there


@dataclass(frozen=True)
class ZoomPhoto(Action):
    """Times closer (more than 1) or farther, around the place (u, v), 0..1, of the pane."""

    times: float
    u: float = 0.5
    v: float = 0.5
    pane: float | None = None


@dataclass(frozen=True)
class DrawnPhoto(Report):
    """A browser drew the pane so many pixels of the page wide, each of them `dense` pixels of its screen."""

    pane: float
    dense: float = 1.0


@dataclass(frozen=True)
class PanPhoto(Action):
    """By shares of the pane."""

    u: float
    v: float


@dataclass(frozen=True)
class ShowWhole(Action):
    pass


@dataclass(frozen=True)
class ZoomToMark(Action):
    """One photo pixel as eight of the page: around the mark, where the chosen point is or should be, or the middle."""


@dataclass(frozen=True)
class PyramidReady(Report):
    image: str


@dataclass(frozen=True)
class Window:
    """left, top, width, height in photo pixels from the photo's outer corner; the pane shows exactly this."""

    left: float
    top: float
    width: float
    height: float

    def pixel(self, u: float, v: float) -> tuple[float, float]:
        """Pixel (0, 0 = centre of the top-left one) at a place (u, v), 0..1, of the pane."""
        return self.left + u * self.width - 0.5, self.top + v * self.height - 0.5

    def place(self, col: float, row: float) -> tuple[float, float]:
        """The inverse of `pixel`."""
        return (col + 0.5 - self.left) / self.width, (row + 0.5 - self.top) / self.height


def window(state: State) -> Window:
    """What the pane shows of the chosen photo."""
    camera, view = state.block.camera_of(state.image), state.room(PhotoView)
    if view.image != state.image or view.width <= 0:
        return Window(0.0, 0.0, float(camera.width), float(camera.height))
    return Window(view.left, view.top, view.width, view.width * camera.height / camera.width)


def percent(state: State) -> float:
    """Pixels of the page per photo pixel, in per cent."""
    return 100 * state.room(PhotoView).pane / window(state).width


def around(state: State, col: float, row: float, width: float) -> State:
    """The pane so many photo pixels wide, a pixel in its middle, as far as the photo reaches."""
    camera = state.block.camera_of(state.image)
    height = width * camera.height / camera.width
    return _looking(state, col + 0.5 - width / 2, row + 0.5 - height / 2, width)


def _looking(state: State, left: float, top: float, width: float) -> State:
    """The window put within the photo."""
    camera, view = state.block.camera_of(state.image), state.room(PhotoView)
    if not all(math.isfinite(v) for v in (left, top, width)):
        return state
    width = min(max(width, CLOSEST), float(camera.width))
    height = width * camera.height / camera.width
    if width >= camera.width:
        return state.with_room(replace(view, image=state.image, left=0.0, top=0.0, width=0.0))
    left, top = min(max(left, 0.0), camera.width - width), min(max(top, 0.0), camera.height - height)
    return state.with_room(replace(view, image=state.image, left=left, top=top, width=width))


@handles(ZoomPhoto)
def _zoom(state: State, action: ZoomPhoto) -> State:
    if not state.block.images or not (math.isfinite(action.times) and 0.01 <= action.times <= 100):
        return state
    if action.pane is not None and 50 <= action.pane <= 10_000:
        state = state.with_room(replace(state.room(PhotoView), pane=float(action.pane)))
    shown = window(state)
    width = min(max(shown.width / action.times, CLOSEST), float(state.block.camera_of(state.image).width))
    share = 1 - width / shown.width
    return _looking(state, shown.left + action.u * shown.width * share, shown.top + action.v * shown.height * share, width)


@handles(DrawnPhoto)
def _drawn(state: State, action: DrawnPhoto) -> State:
    view = state.room(PhotoView)
    if not (50 <= action.pane <= 10_000 and 0.1 <= action.dense <= 10):
        return state
    return state.with_room(replace(view, pane=float(action.pane), sharp=max(view.sharp, action.pane * action.dense)))


@handles(PanPhoto)
def _pan(state: State, action: PanPhoto) -> State:
    if not state.block.images:
        return state
    shown = window(state)
    return _looking(state, shown.left + action.u * shown.width, shown.top + action.v * shown.height, shown.width)


@handles(ShowWhole)
def _whole(state: State, action: ShowWhole) -> State:
    return _looking(state, 0.0, 0.0, 1e9) if state.block.images else state


@handles(ZoomToMark)
def _to_mark(state: State, action: ZoomToMark) -> State:
    if not state.block.images:
        return state
    camera = state.block.camera_of(state.image)
    at = (camera.width - 1) / 2, (camera.height - 1) / 2
    if state.mark is not None:
        at = state.mark.col, state.mark.row
    elif state.point is not None:
        at = sees(state, state.image, state.point) or where(state, state.image, state.point) or at
    return around(state, *at, state.room(PhotoView).pane / 8)


@handles(PyramidReady)
def _ready(state: State, action: PyramidReady) -> State:
    view = state.room(PhotoView)
    if action.image in view.ready:
        return state
    said = "" if PREPARING in state.message else state.message
    return replace(state.with_room(replace(view, ready=(*view.ready, action.image))), message=said)


def tasks(state: State) -> tuple[Task, ...]:
    """The pyramid of the chosen photo, where it is large, or larger than its small picture and looked at closely, and there is
    none yet."""
    photo, folder = state.assets.photos.get(state.image), state.assets.folder
    if photo is None or folder is None:
        return ()
    small = photo.size[0] <= photo.pane.shape[1] or not (_zoomed(state) or _wanted(state) > TOLERATED * max(photo.pane.shape))
    if photo.size[0] * photo.size[1] < LARGE and small:
        return ()
    if state.image in state.room(PhotoView).ready:
        return ()
    key = "pyramid", str(photo.path), state.image
    return (
        Task(key, make, (photo.path, cache(folder)), partial(_arrive, state.image), Say, f"{state.image}: the pyramid", "photo"),
    )


def make(path: Path, folder: Path) -> Iterator[float]:
    """Build the pyramid of a photo; in the worker."""
    target = pyramid_path(path, folder)
    if target.exists():
        yield 1.0
        return
    yield from build_pyramid(path, target)


def _arrive(image: str, share: float) -> Action:
    return PyramidReady(image) if share >= 1.0 else Say(f"{image}: {PREPARING}, {100 * share:.0f} %")


def cache(folder: Path) -> Path:
    return folder / "runs" / ".thumbnails"


Cut = tuple[Photo, Path | None, tuple[int, int], Window, int]
TOLERATED = 1.05
"""By how much the small picture may be enlarged before the photo itself is asked."""


def cut(state: State, photo: Photo) -> Cut | None:
    """What `picture` needs to know of the state; None while the whole photo is shown and its small picture will do."""
    camera, path, wanted = state.block.camera_of(state.image), pyramid(state, photo), _wanted(state)
    if not _zoomed(state) and (path is None or wanted <= TOLERATED * max(photo.pane.shape)):
        return None
    return photo, path, (camera.width, camera.height), window(state), min(max(wanted, SENT), MOST)


def _zoomed(state: State) -> bool:
    return window(state).width < state.block.camera_of(state.image).width


def _wanted(state: State) -> int:
    """Longer side of the picture that the widest pane shows pixel by pixel, in steps."""
    camera = state.block.camera_of(state.image)
    longer = state.room(PhotoView).sharp * max(1.0, camera.height / camera.width)
    return STEP * math.ceil(longer / STEP - 1e-6)


def pyramid(state: State, photo: Photo) -> Path | None:
    """The photo's pyramid once it is there."""
    folder = state.assets.folder
    return pyramid_path(photo.path, cache(folder)) if folder is not None and state.image in state.room(PhotoView).ready else None


def picture(photo: Photo, path: Path | None, full: tuple[int, int], shown: Window, sent: int) -> np.ndarray:
    """What the pane shows of the photo, uint8 (h, w, 3): from its pyramid, or coarser from the small picture. sent: its longer
    side at most, pixels."""
    size = photo.size if path is not None else (photo.pane.shape[1], photo.pane.shape[0])
    fx, fy = size[0] / full[0], size[1] / full[1]
    left, top, width, height = shown.left * fx, shown.top * fy, shown.width * fx, shown.height * fy
    grow = max(1.0, min(64.0, sent / max(width, height)))  # enlarged by whole squares, so that pixels stay pixels
    if path is not None:
        if grow > 1:
            x0, y0 = math.floor(left), math.floor(top)
            x1, y1 = min(math.ceil(left + width), size[0]), min(math.ceil(top + height), size[1])
            area = read_window(path, x0, y0, x1 - x0, y1 - y0, sent)
            box = left - x0, top - y0, left + width - x0, top + height - y0
            return resampled(area, box, (width * grow, height * grow))
        return read_window(path, left, top, width, height, sent)
    return resampled(photo.pane, (left, top, left + width, top + height), (width * grow, height * grow))
