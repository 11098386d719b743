"""The viewer's whole truth as one frozen value; panels and painters only draw it."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from solvers import Block, Exterior
from solvers.adjustment import Iteration
from solvers.block import ROLES, Points
from solvers.geometry import LocalFrame, Surface
from solvers.orientation import Advice, Orientation

from .kept import by_identity

MODELS = ("perspective", "orthogonal")
ONE_PASS, PRINTED, WITH_PRIOR = "one pass", "as printed", "with prior"
"""What the chosen image's prior allows as well: one orthogonal pass through it, the same in the papers' own printed form
(neither re-centred nor by depth), and the perspective adjustment that observes it."""
COMPARED = (*MODELS, ONE_PASS, PRINTED, WITH_PRIOR)
ADVICE = "advice"
"""The job that says which of the models to believe."""
PRIORS = ("none", "initial", "weighted")
FORMS = ("depth", "printed")
HISTORY = 200
"""Edits that can be undone."""
Room = TypeVar("Room")
"""A tab's own value: a frozen dataclass whose fields all have defaults."""


@dataclass(frozen=True, eq=False)
class Photo:
    """A photo as the viewer holds it, never the photo itself: small pictures (h, w, 3) uint8 for scene and photo pane.

    size: of the file [px], which may be the camera's format reduced by a whole factor.
    """

    path: Path
    thumbnail: np.ndarray
    pane: np.ndarray
    size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Terrain:
    """Surface of the ground in the local frame: vertices (n, 3) m, faces (k, 3), colours (n, 3) uint8."""

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray


@dataclass(frozen=True, eq=False)
class Assets:
    """What a project brings and no edit changes. truth: local exterior orientations of a simulation."""

    folder: Path | None
    frame: LocalFrame
    photos: Mapping[str, Photo] = field(default_factory=dict)
    terrain: Terrain | None = None
    level: float | None = None  # height of a flat ground, local frame
    surface: Surface | None = None  # of the project, in map coordinates
    truth: Mapping[str, Exterior] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """How images are oriented; the words of the command line."""

    robust: bool = False
    prior: Literal["none", "initial", "weighted"] = "none"
    one_pass: bool = False
    form: Literal["depth", "printed"] = "depth"
    recentre: bool = True


@dataclass(frozen=True, eq=False)
class Solution:
    """One image by one model: the rows so far; the orientation when it is done; or one sentence why there is none."""

    revision: int
    rows: tuple[Iteration, ...] = ()
    manifest: Mapping[str, Any] = field(default_factory=dict)
    orientation: Orientation | None = None
    advice: Advice | None = None
    error: str = ""

    @property
    def done(self) -> bool:
        return self.orientation is not None or self.advice is not None or bool(self.error)

    def row(self, index: int) -> Iteration | None:
        """The row shown at a position of the slider: its own last row when it ended earlier."""
        return self.rows[min(index, len(self.rows) - 1)] if self.rows else None


@dataclass(frozen=True, eq=False)
class Work:
    """What edits change and undo brings back. off: points switched off. A solution is fresh when its revision is this one.

    rooms: values of tabs that are edited with the rest, by their type. aside: of a step of undo that changes nothing of all this
    but a choice beside it, the choice's name and value (`acting.undone`).
    """

    block: Block
    off: frozenset[str] = frozenset()
    settings: Settings = Settings()
    revision: int = 0
    solutions: Mapping[tuple[str, str], Solution] = field(default_factory=dict)
    rooms: Mapping[type, Any] = field(default_factory=dict)
    aside: tuple[str, Any] | None = None

    def room(self, kind: type[Room]) -> Room:
        """A tab's own edited value; its defaults before anything was said."""
        return self.rooms.get(kind) or kind()


@dataclass(frozen=True)
class View:
    """What is shown and how much exaggerated; no edit, so undo leaves it alone."""

    dark: bool = False
    terrain: bool = True
    labels: bool = True
    photos: bool = True
    perspective: bool = True
    orthogonal: bool = True
    initial: bool = True
    georeferenced: bool = True
    truth: bool = True
    printed: bool = True  # one pass through the prior as the papers print it
    compared: bool = False  # the other solutions with the prior, and every difference
    rays: bool = True
    bundle: bool = True  # parallel bundle and average plane of the orthogonal solution
    residuals: bool = True
    ellipsoids: bool = True
    vectors: float = 200.0  # exaggeration of residual vectors on the ground
    photo_vectors: float = 50.0  # the same on the photo
    ellipsoid: float = 0.0  # exaggeration of the error ellipsoids, 0 until the first solution tells what suits


@dataclass(frozen=True)
class Spot:
    """A place asked for its ground coordinates: pixel of the full photo."""

    image: str
    col: float
    row: float


@dataclass(frozen=True)
class Mark:
    """A measurement being made: pixel of the full photo (0, 0 = centre of the top-left pixel)."""

    point: str
    col: float
    row: float


@dataclass(frozen=True, eq=False)
class State:
    """Everything. row: position of the iteration slider; follow: it stays at the last row when solutions change."""

    work: Work
    assets: Assets
    image: str
    view: View = View()
    point: str | None = None
    row: int = 0
    follow: bool = True
    playing: bool = False
    speed: float = 2.0  # rows per second
    mark: Mark | None = None
    click: Literal["measure", "monoplot"] = "measure"  # what a click on the photo does
    spots: tuple[Spot, ...] = ()
    held: int | None = None  # revision at which solving was cancelled
    message: str = ""
    next_revision: int = 1
    past: tuple[Work, ...] = ()
    future: tuple[Work, ...] = ()
    rooms: Mapping[type, Any] = field(default_factory=dict)  # values of tabs that no undo touches, by their type
    saved: Block | None = None  # as last written to the project's files, None as opened

    def room(self, kind: type[Room]) -> Room:
        """A tab's own value; its defaults before anything was said."""
        return self.rooms.get(kind) or kind()

    def with_room(self, value: Any) -> State:
        """The state with a tab's own value changed; what undo should bring back goes through `acting.edit_room` instead."""
        return replace(self, rooms={**self.rooms, type(value): value})

    @property
    def block(self) -> Block:
        return self.work.block

    def solution(self, model: str, image: str | None = None) -> Solution | None:
        """The solution of an image (the chosen one) by a model, None before its first row."""
        return self.work.solutions.get((image or self.image, model))

    @property
    def last_row(self) -> int:
        """Last position of the slider: that of the longest of the chosen image's traces that are shown and of those of the tabs
        (`steps`), of which one may lead: then it alone is stepped through."""
        leading = [room.steps for room in self.rooms.values() if getattr(room, "leads", False)]
        if leading:
            return max(leading)
        models = COMPARED if self.view.compared else MODELS
        own = max((len(s.rows) - 1 for m in models if (s := self.solution(m)) and s.rows), default=0)
        rooms = self.rooms.values()
        beside = (room.steps_of(self.image) for room in rooms if hasattr(room, "steps_of"))
        return max([own, *(getattr(room, "steps", 0) for room in rooms), *beside])

    @property
    def shown_row(self) -> int:
        """Position of the slider within what there is: the wish, `row`, may wait for rows to come."""
        return min(self.row, self.last_row)

    def row_of(self, solution: Solution, image: str | None = None) -> int:
        """Number of a solution's row that is shown: its last at the slider's end, where it ended earlier, and of other images."""
        last = len(solution.rows) - 1
        return min(self.row, last) if image in (None, self.image) and self.row < self.last_row else last

    def exterior(self, model: str, image: str | None = None) -> Exterior | None:
        """Local exterior orientation at the row shown, None where there is none."""
        solution = self.solution(model, image)
        row = solution.rows[self.row_of(solution, image)] if solution and solution.rows else None
        return Exterior.from_vector(row.x) if row is not None else None

    def control(self) -> tuple[str, ...]:
        """Names of the control points that are switched on."""
        points = self.block.points
        names = (points.names[j] for j in by_role(points)["control"])
        return tuple(n for n in names if n not in self.work.off)


@by_identity(4)
def by_role(points: Points) -> dict[str, np.ndarray]:
    """Rows of the points of each role; "named": of control and check points together, in their order."""
    role = np.array(points.role, str)
    rows = {kind: np.flatnonzero(role == kind) for kind in ROLES}
    return {**rows, "named": np.flatnonzero(role != "tie")}


def listed(points: Points, chosen: str | None) -> tuple[str, ...]:
    """Names to choose from: control and check points, and the chosen one; of tie points there may be a million."""
    named = tuple(points.names[j] for j in by_role(points)["named"].tolist())
    return named if not chosen or chosen in named else (*named, chosen)


@dataclass(frozen=True, eq=False)
class Job:
    """One image to be oriented by one model, or to be advised on."""

    image: str
    model: str
    revision: int
    block: Block
    points: tuple[str, ...]
    settings: Settings

    @property
    def key(self) -> tuple[str, str, int]:
        return self.image, self.model, self.revision


def wanted(state: State) -> tuple[Job, ...]:
    """What has still to be solved, the chosen image first; nothing after a cancel, until the next edit."""
    work = state.work
    if state.held == work.revision:
        return ()
    todo = islice(((i, m) for i, m in _todo(state) if not fresh(work, i, m)), AHEAD)
    seen: dict[str, tuple[str, ...]] = {}
    jobs = []
    for image, model in todo:
        if image not in seen:
            seen[image] = tuple(n for n in control_seen(work.block, image) if n not in work.off)
        jobs.append(Job(image, model, work.revision, work.block, seen[image], work.settings))
    return tuple(jobs)


AHEAD = 40
"""Jobs listed at most: there may be thousands of images."""


def _todo(state: State) -> Iterator[tuple[str, str]]:
    """Every image and model that may be solved, the chosen image first with what its prior allows and its advice."""
    counts = measured(state.block)
    if counts.get(state.image):
        for model in (*MODELS, *prior_models(state.block, state.image), ADVICE):
            yield state.image, model
    able = _able(state.work)
    for image, count in counts.items():
        if count and image != state.image:
            for model in MODELS:
                if image in able or (image, model) in state.work.solutions:
                    yield image, model


FEW = 100
"""Images up to which every one of them is tried, so that it says itself what it lacks."""


def hopeful(work: Work, image: str) -> bool:
    """Whether an image sees the three control points without which nothing can be solved; of few images, all are."""
    return image in _able(work)


def _able(work: Work) -> Container[str]:
    return measured(work.block) if len(work.block.images) <= FEW else _hopeful(work.block, work.off)


@by_identity(4)
def _hopeful(block: Block, off: frozenset[str]) -> frozenset[str]:
    on = np.zeros(len(block.points), bool)
    on[[j for j in by_role(block.points)["control"].tolist() if block.points.names[j] not in off]] = True
    of = block.observations
    counts = np.bincount(of.image[on[of.point]], minlength=len(block.images)).tolist()
    return frozenset(image.name for image, count in zip(block.images, counts, strict=True) if count >= 3)


def fresh(work: Work, image: str, model: str) -> bool:
    """Whether an image is solved as things are now."""
    solution = work.solutions.get((image, model))
    return solution is not None and solution.revision == work.revision and solution.done


@by_identity(4)
def measured(block: Block) -> Mapping[str, int]:
    """How many points are measured in each image."""
    counts = np.bincount(block.observations.image, minlength=len(block.images)).tolist()
    return {image.name: count for image, count in zip(block.images, counts, strict=True)}


@by_identity(4)
def _rows_by_image(block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the observations sorted by image, and where each image begins (n + 1,)."""
    order = np.argsort(block.observations.image, kind="stable")
    return order, np.searchsorted(block.observations.image[order], np.arange(len(block.images) + 1))


@by_identity(4)
def _index_of_images(block: Block) -> Mapping[str, int]:
    return {image.name: k for k, image in enumerate(block.images)}


def control_seen(block: Block, image: str) -> tuple[str, ...]:
    """Names of the control points measured in an image, in file order."""
    order, begin = _rows_by_image(block)
    k = _index_of_images(block)[image]
    points = block.observations.point[order[begin[k] : begin[k + 1]]].tolist()
    return tuple(block.points.names[j] for j in points if block.points.role[j] == "control")


def prior_models(block: Block, image: str) -> tuple[str, ...]:
    """Which of the solutions that need it an image's prior allows."""
    prior = block.images[block.image_index(image)].prior
    if prior is None or prior.centre is None or prior.angles is None:
        return ()
    return (ONE_PASS, PRINTED) if prior.sigma_m is None and prior.sigma_rad is None else (ONE_PASS, PRINTED, WITH_PRIOR)
