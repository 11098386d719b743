"""The bundle of all images as the viewer holds it: what to adjust, the rows so far, what is shown of them; pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

from solvers import Block
from solvers.adjustment import Iteration
from solvers.adjustment.losses import LOSSES
from solvers.cameras import PARAMETERS

from .bundle_values import Judged, Layout
from .state import MODELS

DATUMS = ("control", "prior", "both", "free")
STARTS = ("auto", "resection", "dlt", "affine", "relative", "prior")
TRANSFORMS = ("iterated", "frozen")
SHUTTERS = ("none", "auto", "translation", "rotation")
LEAST_SQUARES = "none"
ROBUST = (LEAST_SQUARES, *LOSSES)
COLOURED = ("residual", "number of rays", "none")
FACTORS = tuple(float(f"{f}e{k}") for k in range(-3, 6) for f in (1, 2, 5))
"""Exaggerations to choose from, below 1 what is drawn smaller than it is; 0 fits the longest into the site."""


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
    serial: number of the run; base: row from which it goes on; upto: row where it is to stop, or was stopped, None for the end;
    block: as it was adjusted. vectors, ellipsoid: exaggerations, 0 to fit; alone: drawn in place of the images oriented one by
    one. run: where it was kept; worst: its image of the largest residuals; opened: how often rerun was asked for."""

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
    upto: int | None = None
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
    worst: str = ""
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
        elif not allowed(name, value):
            raise ValueError(f"{name} {value!r}")
        room = replace(room, **{name: value})
    return room


LISTS = ("free", "per_image")
LONGEST = 4000
"""Characters of names and patterns of images."""


def allowed(name: str, value: Any) -> bool:
    """Whether a field of the choices takes a value."""
    if name == "images":
        return isinstance(value, str) and len(value) <= LONGEST
    if name in CHOICES:
        return value in CHOICES[name]
    if name in ("vectors", "ellipsoid"):
        return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 <= value <= FACTORS[-1]
    return name in CHOSEN and name not in LISTS and isinstance(value, bool)


CHOICES: dict[str, tuple[str, ...]] = {"model": MODELS, "transform": TRANSFORMS, "datum": DATUMS, "loss": ROBUST, "start": STARTS,
                                         "colour": COLOURED, "shutter": SHUTTERS}


def taking_part(block: Block, said: str) -> tuple[str, ...] | None:
    """Names of the images that names or patterns (DSC0023*, separated by commas or blanks) mean, None for all."""
    words = said.replace(",", " ").split()
    return tuple(i.name for i in block.images if any(fnmatchcase(i.name, w) for w in words)) if words else None


def asked_of(manifest: Mapping[str, Any]) -> tuple[Any, ...]:
    """The choices, as `Bundle.options`, behind a run's manifest."""
    said = manifest["request"]
    free, own = said["free"], said["per_image"]
    names = {n for names in free.values() for n in names} if isinstance(free, Mapping) else set(free)
    free = tuple(p for p in PARAMETERS if p in names)
    per_image = free if own is True else tuple(p for p in PARAMETERS if p in (own or ()))
    return (said["model"], said["transform"], said["datum"], free, said["loss"] or LEAST_SQUARES, said["start"], per_image,
            " ".join(said["images"] or ()), said["rolling_shutter"])
