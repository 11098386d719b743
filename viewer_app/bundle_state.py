"""The bundle of all images as the viewer holds it: what to adjust, the rows so far, what is shown of them; pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from solvers import Block, Exterior, Interior
from solvers.adjustment import Iteration
from solvers.adjustment.losses import LOSSES
from solvers.cameras import PARAMETERS, project
from solvers.geometry import LocalFrame

from .acting import Action, follow, handles
from .kept import by_identity
from .state import MODELS, Assets, State

DATUMS = ("control", "prior", "both", "free")
STARTS = ("auto", "resection", "dlt", "affine", "relative", "prior")
TRANSFORMS = ("iterated", "frozen")
SHUTTERS = ("none", "auto", "translation", "rotation")
LEAST_SQUARES = "none"
ROBUST = (LEAST_SQUARES, *LOSSES)
COLOURED = ("residual", "number of rays", "none")
FACTORS = tuple(float(f * 10**k) for k in range(6) for f in (1, 2, 5))
"""Exaggerations to choose from; 0 fits the longest into the site."""
LIVE = 30_000
"""Observations up to which residuals are those of the row shown; beyond, those of the last row."""


@dataclass(frozen=True, eq=False)
class Layout:
    """How the x of a row is read. camera_of (m,): of every image; turn (3, 3), shift (3,): from the bundle's axes to the
    scene's, x' = turn x + shift."""

    images: tuple[str, ...]
    cameras: tuple[str, ...]
    interiors: tuple[Interior, ...]
    camera_of: np.ndarray
    points: tuple[str, ...]
    manifest: Mapping[str, Any]
    turn: np.ndarray
    shift: np.ndarray

    def poses(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres (m, 3) m and matrices (m, 3, 3), object to photo axes, in the scene's frame."""
        rows = x[: 12 * len(self.images)].reshape(-1, 12)
        return rows[:, :3] @ self.turn.T + self.shift, rows[:, 3:].reshape(-1, 3, 3) @ self.turn.T

    def places(self, x: np.ndarray) -> np.ndarray:
        """Object points (n, 3) m in the scene's frame."""
        return _places(self, x)

    def interiors_at(self, x: np.ndarray) -> tuple[Interior, ...]:
        first = 12 * len(self.images)
        rows = x[first : first + 10 * len(self.cameras)].reshape(-1, 10)
        return tuple(replace(i, **dict(zip(PARAMETERS, map(float, row), strict=True)))
                     for i, row in zip(self.interiors, rows, strict=True))


@by_identity(4)
def _places(layout: Layout, x: np.ndarray) -> np.ndarray:
    first = 12 * len(layout.images) + 10 * len(layout.cameras)
    own = x[first : first + 3 * len(layout.points)].reshape(-1, 3)
    if np.array_equal(layout.turn, np.eye(3)):
        return own + layout.shift
    return np.einsum("nj,ij->ni", own, layout.turn) + layout.shift  # BLAS would wake threads for so little


@dataclass(frozen=True, eq=False)
class Judged:
    """What the end of a bundle is worth, as arrays. In the scene's frame: image_covariance (m, 3, 3) of the centres, covariance
    (n, 3, 3) of the points, off (n, 3) adjusted minus given. Of the images: values (m, 6) X Y Z [m] omega phi kappa [degrees] of
    the project, exterior (m, 6, 6) their covariance (m, rad), seen (m,), rms (m,) px, sigma0 (m,). Of the observations (o,), by
    image and point of the layout: pixel, v, w, redundancy (o, 2), used. Of the points: w (n, 3), rays, roles.
    """

    values: np.ndarray
    exterior: np.ndarray
    image_covariance: np.ndarray
    seen: np.ndarray
    rms: np.ndarray
    image_sigma0: np.ndarray
    image: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    v: np.ndarray
    w: np.ndarray
    redundancy: np.ndarray
    used: np.ndarray
    roles: tuple[str, ...]
    xyz: np.ndarray
    covariance: np.ndarray
    off: np.ndarray
    point_w: np.ndarray
    rays: np.ndarray
    interiors: tuple[Interior, ...]
    freed: tuple[tuple[str, str], ...]
    interior_covariance: np.ndarray
    sigma0: float | None
    dof: int
    rms_px: float
    converged: bool
    groups: Mapping[str, tuple[float | None, float]]
    control_rms: np.ndarray | None
    check_rms: np.ndarray | None
    suspects: tuple[Mapping[str, Any], ...]
    warnings: tuple[str, ...]
    joint: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Held:
    """A bundle set aside, to be seen beside another: what was asked, how its rows are read, its last row and its worth."""

    asked: tuple[Any, ...]
    layout: Layout
    row: Iteration
    result: Judged
    steps: int


@dataclass(frozen=True, eq=False)
class Bundle:
    """What to adjust, and what came of it. per_image: of `free`, what every image has for itself; images: names or patterns of
    those that take part, nothing for all; held: another bundle to compare with. task: "run", "keep", "follow" or nothing;
    serial: number of the run; base: row from which it goes on; block: as it was adjusted. vectors, ellipsoid: exaggerations,
    0 to fit; alone: drawn in place of the images oriented one by one. run: where it was kept; opened: how often rerun was asked
    for."""

    model: str = MODELS[0]
    transform: str = TRANSFORMS[0]
    datum: str = DATUMS[0]
    free: tuple[str, ...] = ()
    loss: str = LEAST_SQUARES
    start: str = STARTS[0]
    per_image: tuple[str, ...] = ()
    images: str = ""
    shutter: str = SHUTTERS[0]
    held: Held | None = None
    task: str = ""
    serial: int = 0
    base: int = 0
    rows: tuple[Iteration, ...] = ()
    layout: Layout | None = None
    block: Block | None = None
    asked: tuple[Any, ...] = ()
    result: Judged | None = None
    progress: str = ""
    error: str = ""
    colour: str = COLOURED[0]
    vectors: float = 0.0
    ellipsoid: float = 0.0
    draw_points: bool = True
    draw_vectors: bool = True
    draw_ellipsoids: bool = True
    draw_rays: bool = True
    alone: bool = True
    run: str = ""
    opened: int = 0
    then_open: bool = False

    @property
    def steps(self) -> int:
        """Rows after the first: the transport steps through them."""
        return max(len(self.rows) - 1, 0)

    @property
    def coming(self) -> bool:
        """Whether more rows may come: the place on the slider waits for them."""
        return self.task in ("run", "follow")

    @property
    def leads(self) -> bool:
        """Whether it is drawn, and stepped through, in place of the images oriented one by one."""
        return self.alone and bool(self.rows) and self.layout is not None

    @property
    def options(self) -> tuple[Any, ...]:
        return (self.model, self.transform, self.datum, self.free, self.loss, self.start, self.per_image, self.images.strip(),
                self.shutter)

    def at(self, row: int) -> Iteration | None:
        """The row shown at a position of the transport: the last one where the bundle has fewer."""
        return self.rows[min(max(row, 0), len(self.rows) - 1)] if self.rows else None


CHOSEN = ("model", "transform", "datum", "free", "loss", "start", "per_image", "images", "shutter", "colour", "vectors",
          "ellipsoid", "draw_points", "draw_vectors", "draw_ellipsoids", "draw_rays", "alone")
"""What a session keeps: the choices, not what came of them."""


def bundle_choices(room: Bundle) -> dict[str, Any]:
    """As JSON."""
    return {name: list(getattr(room, name)) if name in LISTS else getattr(room, name) for name in CHOSEN}


def bundle_of_choices(said: Mapping[str, Any]) -> Bundle:
    """Raises ValueError where a choice is none."""
    room = Bundle()
    for name in CHOSEN:
        value = said.get(name, getattr(room, name))
        if name in LISTS:
            value = tuple(p for p in PARAMETERS if p in value)
        elif not _allowed(name, value):
            raise ValueError(f"{name} {value!r}")
        room = replace(room, **{name: value})
    return room


LISTS = ("free", "per_image")
LONGEST = 4000
"""Characters of names and patterns of images."""


def _allowed(name: str, value: Any) -> bool:
    if name == "images":
        return isinstance(value, str) and len(value) <= LONGEST
    if name in CHOICES:
        return value in CHOICES[name]
    if name in ("vectors", "ellipsoid"):
        return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= FACTORS[-1]
    return name in CHOSEN and name not in LISTS and isinstance(value, bool)


CHOICES: dict[str, tuple[str, ...]] = {"model": MODELS, "transform": TRANSFORMS, "datum": DATUMS, "loss": ROBUST, "start": STARTS,
                                         "colour": COLOURED, "shutter": SHUTTERS}


@dataclass(frozen=True)
class SetBundle(Action):
    """One field of what to adjust or to draw."""

    name: str
    value: Any


@dataclass(frozen=True)
class FreeParameter(Action):
    """An interior parameter becomes free or fixed; "all" and "none" mean every one."""

    name: str
    free: bool = True


@dataclass(frozen=True)
class OfEveryImage(Action):
    """A free interior parameter is one of every image by itself, or one of the camera."""

    name: str
    own: bool = True


@dataclass(frozen=True)
class HoldBundle(Action):
    """Set the bundle aside, to see the next one beside it; without `on`, put away what is held."""

    on: bool = True


@dataclass(frozen=True)
class FollowBundle(Action):
    """Show the rows of the project's latest run while they are made, or as they were."""


@dataclass(frozen=True)
class RunBundle(Action):
    """Adjust; with `on` go on from the row shown."""

    on: bool = False


@dataclass(frozen=True)
class StopBundle(Action):
    """Stop; the rows so far stay."""


@dataclass(frozen=True)
class KeepBundle(Action):
    """Leave it in the project as a run, with its recording; open: show that in rerun."""

    open: bool = False


@dataclass(frozen=True, eq=False)
class BundleCame(Action):
    """Something of the run `serial`: words, how rows are read, a row, what the end is worth, or where it was kept."""

    serial: int
    what: str | Layout | Iteration | Judged | Kept | Ended


@dataclass(frozen=True)
class Kept:
    run: str


@dataclass(frozen=True)
class Ended:
    """There is nothing more to come."""

    said: str


@dataclass(frozen=True)
class BundleFailed(Action):
    serial: int
    why: str


@handles(SetBundle)
def _set(state: State, action: SetBundle) -> State:
    room, name, value = state.room(Bundle), action.name, action.value
    if not _allowed(name, value) or getattr(room, name) == value:
        return state
    return follow(state.with_room(replace(room, **{name: value})))


@handles(FreeParameter)
def _free(state: State, action: FreeParameter) -> State:
    room = state.room(Bundle)
    if action.name in ("all", "none"):
        free = PARAMETERS if action.name == "all" else ()
    elif action.name in PARAMETERS:
        free = tuple(p for p in PARAMETERS if (action.free if p == action.name else p in room.free))
    else:
        return state
    return state.with_room(replace(room, free=free)) if free != room.free else state


@handles(OfEveryImage)
def _of_every_image(state: State, action: OfEveryImage) -> State:
    room = state.room(Bundle)
    if action.name not in PARAMETERS:
        return state
    own = tuple(p for p in PARAMETERS if (action.own if p == action.name else p in room.per_image))
    free = tuple(p for p in PARAMETERS if p in room.free or p in own)
    return state.with_room(replace(room, per_image=own, free=free)) if (own, free) != (room.per_image, room.free) else state


@handles(HoldBundle)
def _hold(state: State, action: HoldBundle) -> State:
    room = state.room(Bundle)
    if not action.on:
        return state.with_room(replace(room, held=None)) if room.held else state
    if room.result is None or room.layout is None:
        return state.with_room(replace(room, error="There is no finished bundle to set aside; run one first."))
    held = Held(room.asked, room.layout, room.rows[-1], room.result, room.steps)
    return state.with_room(replace(room, held=held, error=""))


@handles(FollowBundle)
def _follow(state: State, action: FollowBundle) -> State:
    room = state.room(Bundle)
    if room.task:
        return state
    if state.assets.folder is None:
        return state.with_room(replace(room, error="This project has no folder, so no run to follow."))
    room = replace(room, base=0, rows=(), layout=None, block=state.block, asked=(*room.options, state.work.off), opened=0,
                   task="follow", serial=room.serial + 1, result=None, progress="Looking for a run …", error="", run="")
    return follow(replace(state, follow=True, playing=False).with_room(room))


def taking_part(block: Block, said: str) -> tuple[str, ...] | None:
    """Names of the images that names or patterns (DSC0023*, separated by commas or blanks) mean, None for all."""
    words = said.replace(",", " ").split()
    return tuple(i.name for i in block.images if any(fnmatchcase(i.name, w) for w in words)) if words else None


@handles(RunBundle)
def _run(state: State, action: RunBundle) -> State:
    room = state.room(Bundle)
    taken = taking_part(state.block, room.images)
    if taken is not None and len(taken) < 2 and not action.on:
        return state.with_room(replace(room, error=f"'{room.images.strip()}' means {len(taken)} image(s); a bundle takes two or "
                                       "more."))
    if not action.on:
        room = replace(room, base=0, rows=(), layout=None, block=state.block, asked=(*room.options, state.work.off), opened=0)
    elif not room.rows:
        return state.with_room(replace(room, error="There is no row to go on from; run the bundle first."))
    else:
        base = min(state.row, len(room.rows) - 1)
        room = replace(room, base=base, rows=room.rows[: base + 1])
    room = replace(room, task="run", serial=room.serial + 1, result=None, progress="Looking for a start …", error="", run="")
    return follow(replace(state, follow=True, playing=False).with_room(room))


@handles(StopBundle)
def _stop(state: State, action: StopBundle) -> State:
    room = state.room(Bundle)
    if not room.task:
        return state
    said = f"Stopped; row {room.steps} is kept, without standard errors." if room.rows else "Stopped before the first row."
    return state.with_room(replace(room, task="", progress=said if room.task != "keep" else "", then_open=False))


@handles(KeepBundle)
def _keep(state: State, action: KeepBundle) -> State:
    room = state.room(Bundle)
    if room.task:
        return state
    if room.run:
        return state.with_room(replace(room, opened=room.opened + 1)) if action.open else state
    why = ("There is no bundle yet; run it first." if not room.rows else
           "This project has no folder to keep a run in; save it as a project first." if state.assets.folder is None else "")
    if why:
        return state.with_room(replace(room, error=why))
    said = "Writing the run …"
    return state.with_room(replace(room, task="keep", serial=room.serial + 1, progress=said, error="", then_open=action.open))


@handles(BundleCame)
def _came(state: State, action: BundleCame) -> State:
    room, what = state.room(Bundle), action.what
    if action.serial != room.serial or not room.task:
        return state
    if isinstance(what, str):
        room = replace(room, progress=what)
    elif isinstance(what, Layout):
        room = replace(room, layout=what)
        if room.task == "follow":  # it may begin anew
            room = replace(room, rows=(), asked=(*asked_of(what.manifest), state.work.off))
    elif isinstance(what, Iteration):
        if what.index == 0 and room.rows:
            return state  # it goes on from a row that is there already
        row = replace(what, index=room.base + what.index)
        room = replace(room, rows=(*room.rows, row), progress=f"Iteration {row.index}, σ0 {row.sigma0:.4g}")
    elif isinstance(what, Judged):
        room = replace(room, result=what, task="", progress="")
    elif isinstance(what, Ended):
        room = replace(room, task="", progress=what.said)
    else:
        room = replace(room, run=what.run, task="", progress="", opened=room.opened + room.then_open, then_open=False)
    return follow(state.with_room(room))


@handles(BundleFailed)
def _failed(state: State, action: BundleFailed) -> State:
    room = state.room(Bundle)
    if action.serial != room.serial:
        return state
    return state.with_room(replace(room, task="", progress="", error=action.why, then_open=False))


def asked_of(manifest: Mapping[str, Any]) -> tuple[Any, ...]:
    """The choices, as `Bundle.options`, behind a run's manifest."""
    said = manifest["request"]
    free, own = said["free"], said["per_image"]
    names = {n for names in free.values() for n in names} if isinstance(free, Mapping) else set(free)
    free = tuple(p for p in PARAMETERS if p in names)
    per_image = free if own is True else tuple(p for p in PARAMETERS if p in (own or ()))
    return (said["model"], said["transform"], said["datum"], free, said["loss"] or LEAST_SQUARES, said["start"], per_image,
            " ".join(said["images"] or ()), said["rolling_shutter"])


# -- what a row says ----------------------------------------------------------------------------------------------------------


def layout_of(manifest: Mapping[str, Any], interiors: tuple[Interior, ...], frame: LocalFrame) -> Layout:
    """How the rows of a bundle's trace are read, for a scene in `frame`. interiors: of its cameras, as they were given."""
    own = LocalFrame.around(np.asarray(manifest["origin"], float)[None], manifest["crs"], manifest["frame"])
    at = frame.to_local(own.to_map(np.concatenate([np.zeros((1, 3)), 1000 * np.eye(3)])))
    u, _, vt = np.linalg.svd((at[1:] - at[0]).T / 1000)
    return Layout(
        tuple(manifest["images"]), tuple(manifest["cameras"]), interiors,
        np.array(manifest["camera_of"], int), tuple(manifest["points"]), manifest,
        np.eye(3) if own.cartesian else u @ vt, at[0])


@by_identity(4)
def _images(layout: Layout) -> Mapping[str, int]:
    return {name: k for k, name in enumerate(layout.images)}


@by_identity(4)
def _points(layout: Layout) -> Mapping[str, int]:
    return {name: k for k, name in enumerate(layout.points)}


def image_number(room: Bundle, name: str) -> int | None:
    """Position of an image in the bundle, None where it is not in it."""
    return None if room.layout is None else _images(room.layout).get(name)


def point_number(room: Bundle, name: str) -> int | None:
    return None if room.layout is None else _points(room.layout).get(name)


def exterior(state: State, name: str) -> Exterior | None:
    """Where the bundle has an image at the row shown, in the scene's frame."""
    room = state.room(Bundle)
    k, row = image_number(room, name), room.at(state.row)
    if room.layout is None or k is None or row is None:
        return None
    centres, matrices = room.layout.poses(row.x)
    return Exterior(matrices[k], centres[k])


def place(state: State, name: str) -> np.ndarray | None:
    """Where the bundle has a point (3,) at the row shown, in the scene's frame."""
    room = state.room(Bundle)
    k, row = point_number(room, name), room.at(state.row)
    return None if room.layout is None or k is None or row is None else room.layout.places(row.x)[k]


@by_identity(2)
def inner_places(layout: Layout, row: Iteration) -> np.ndarray:
    """Where the points (k, 3) are, without the outermost."""
    xyz = layout.places(row.x)
    low, high = np.percentile(xyz, [1, 99], axis=0) if len(xyz) else (0, 0)
    return xyz[((xyz >= low) & (xyz <= high)).all(axis=1)]


@by_identity(2)
def inner_extent(layout: Layout, row: Iteration) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) of those."""
    xyz = inner_places(layout, row)
    return (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else (np.full(3, -10.0), np.full(3, 10.0))


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals (o, 2) px, observed minus projected, of observations by image and point of the layout, at pixel (o, 2).

    live: they are those of the row shown.
    """

    image: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    v: np.ndarray
    live: bool = True


def misfit(state: State) -> Misfit | None:
    """The residuals at the row shown, of large blocks those of the last row; None before there is anything."""
    room = state.room(Bundle)
    row = room.at(state.row)
    if row is None or room.layout is None or room.block is None:
        return None
    if len(room.block.observations) <= LIVE:
        return _misfit(room.layout, room.block, row)
    if room.result is None:
        return None
    return last_misfit(room.result)


@by_identity(2)
def last_misfit(result: Judged) -> Misfit:
    """The residuals of the last row."""
    return Misfit(result.image, result.point, result.pixel, result.v, False)


@by_identity(2)
def _observed(layout: Layout, block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations that take part, by the numbers of the layout and sorted by image: image, point (o,), pixel (o, 2)."""
    images, points, of = _images(layout), _points(layout), block.observations
    image = np.array([images.get(i.name, -1) for i in block.images], int)[of.image]
    point = np.array([points.get(n, -1) for n in block.points.names], int)[of.point]
    rows = np.flatnonzero((image >= 0) & (point >= 0) & np.isfinite(of.pixel).all(axis=1))
    rows = rows[np.argsort(image[rows], kind="stable")]
    return image[rows], point[rows], of.pixel[rows]


@by_identity(8)
def _misfit(layout: Layout, block: Block, row: Iteration) -> Misfit:
    image, point, pixel = _observed(layout, block)
    centres, matrices = layout.poses(row.x)
    places, interiors = layout.places(row.x), layout.interiors_at(row.x)
    ends, v = np.searchsorted(image, np.arange(len(layout.images) + 1)), np.full_like(pixel, np.nan)
    for i in range(len(layout.images)):
        rows = slice(ends[i], ends[i + 1])
        v[rows] = pixel[rows] - project(interiors[layout.camera_of[i]], Exterior(matrices[i], centres[i]), places[point[rows]])
    return Misfit(image, point, pixel, v)


@by_identity(8)
def point_rms(layout: Layout, of: Misfit) -> np.ndarray:
    """Root mean square residual (n,) px of every point, NaN where none is known."""
    square = (of.v**2).sum(axis=1)
    good = np.isfinite(square)
    n = len(layout.points)
    count = np.bincount(of.point[good], minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.bincount(of.point[good], square[good], n) / np.where(count > 0, count, np.nan))


@by_identity(4)
def ray_counts(layout: Layout, block: Block) -> np.ndarray:
    """Images (n,) that see every point."""
    return np.bincount(_observed(layout, block)[1], minlength=len(layout.points))


@by_identity(4)
def given_places(layout: Layout, block: Block, assets: Assets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Control points (a,) and check points (b,) by the numbers of the layout, and given coordinates (n, 3) m, NaN elsewhere."""
    index = _points(layout)
    xyz = np.full((len(layout.points), 3), np.nan)
    rows = np.array([index.get(n, -1) for n in block.points.names], int)
    here = np.flatnonzero(rows >= 0)
    xyz[rows[here]] = assets.frame.to_local(block.points.xyz[here])
    roles = np.array(block.points.role)
    known = np.isfinite(block.points.xyz).all(axis=1) & (rows >= 0)
    return rows[known & (roles == "control")], rows[known & (roles == "check")], xyz
