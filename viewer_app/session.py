"""The whole state as JSON and back, pure: what was chosen, shown and edited, and every edit that can be undone.

Edits are kept as differences from the project on disk, whose content the session names; where the files have changed meanwhile
the edits are left out and a sentence says so. Solutions, bundle and mosaics are not kept: they are made again, to the same
numbers; of a bundle that was gone on with, all rows in one go.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from solvers import Block
from solvers.block import ROLES, Observations, Points

from .acting import update
from .actions import Clicking, Set, Show, Speed
from .actions_measure import SPOTS
from .session_rooms import aside_of, aside_to_json, asked_again, rooms_of, rooms_to_json
from .state import HISTORY, Mark, Settings, Spot, State, View, Work

VERSION = 1
LARGEST = 20_000
"""Differences kept at most, rows of points and observations; beyond them older edits are not kept."""


def fingerprint(block: Block) -> str:
    """Changes when the project's points, observations or images do."""
    digest = hashlib.sha256(repr((block.points.names, block.points.role, [i.name for i in block.images])).encode())
    for array in (
        block.points.xyz,
        block.points.sigma,
        block.observations.image,
        block.observations.point,
        block.observations.pixel,
        block.observations.sigma,
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def to_json(state: State, disk: Block) -> dict[str, Any]:
    """The session of a state. disk: the block as the project's files hold it."""
    works, room = [], LARGEST
    for work in (state.work, *state.past[::-1], *state.future[::-1]):
        said = _work_to_json(work, disk)
        room -= said.pop("rows")
        works.append(said if room >= 0 else None)
    past, future = works[1 : 1 + len(state.past)][::-1], works[1 + len(state.past) :][::-1]
    return {
        "version": VERSION,
        "disk": fingerprint(disk),
        "image": state.image,
        "point": state.point,
        "row": state.row,
        "follow": state.follow,
        "speed": state.speed,
        "click": state.click,
        "view": asdict(state.view),
        "mark": None if state.mark is None else asdict(state.mark),
        "spots": [asdict(s) for s in state.spots],
        "work": works[0],
        "past": _unbroken(past[::-1])[::-1],
        "future": _unbroken(future[::-1])[::-1],
        "rooms": rooms_to_json(state.rooms),
    }


def _unbroken(works: list[Any]) -> list[Any]:
    """Nearest first, up to the first that is not kept."""
    return works[: works.index(None)] if None in works else works


def from_json(state: State, said: Any) -> State:
    """A freshly opened state as the session left it; anything in it that does not hold is left out. Raises nothing."""
    try:
        if not isinstance(said, dict) or said.get("version") != VERSION:
            return state
        same = said["disk"] == fingerprint(state.block)
        state = _choices(state, said)
        if not same:
            edited = said["work"] is not None and (said["work"]["points"] or said["work"]["observations"] or said["past"])
            words = "The project's files have changed since; the unsaved edits of the last session were left out."
            return replace(state, message=words) if edited else state
        count = state.next_revision
        work = _work(said["work"], state.work, count)
        past = tuple(_work(w, state.work, count + 1 + i) for i, w in enumerate(said["past"][-HISTORY:]))
        count += 1 + len(past)
        future = tuple(_work(w, state.work, count + i) for i, w in enumerate(said["future"][-HISTORY:]))
        state = replace(state, work=work, past=past, future=future, next_revision=count + len(future))
        state = asked_again(state, said["rooms"])
        return replace(_marks(state, said), row=max(int(said["row"]), 0), follow=bool(said["follow"]))
    except Exception as error:  # a file somebody wrote by hand must not keep the viewer from opening
        return replace(state, message=f"The last session could not be taken up ({type(error).__name__}: {error}).")


def _choices(state: State, said: Mapping[str, Any]) -> State:
    """What is chosen and shown; each by the action that checks it."""
    for field in fields(View):
        if field.name in said["view"]:
            state = update(state, Show(field.name, said["view"][field.name]))
    state = update(update(state, Speed(float(said["speed"]))), Clicking(said["click"]))
    if any(i.name == said["image"] for i in state.block.images):
        state = replace(state, image=said["image"])
    return replace(state, rooms={**state.rooms, **rooms_of(said["rooms"])})


def _marks(state: State, said: Mapping[str, Any]) -> State:
    images = {i.name for i in state.block.images}
    spots = tuple(Spot(s["image"], float(s["col"]), float(s["row"])) for s in said["spots"] if s["image"] in images)[:SPOTS]
    point = said["point"] if said["point"] in state.block.points.names else None
    mark = said["mark"]
    kept_mark = Mark(mark["point"], float(mark["col"]), float(mark["row"])) if mark and mark["point"] == point else None
    return replace(state, spots=spots, point=point, mark=kept_mark)


def _work_to_json(work: Work, disk: Block) -> dict[str, Any]:
    points, of = work.block.points, work.block.observations
    moved = _changed(points, disk.points, ("xyz", "sigma", "role", "names"), len(points), len(disk.points))
    seen = _changed(of, disk.observations, ("image", "point", "pixel", "sigma"), len(of), len(disk.observations))
    groups = points.group or ("",) * len(points)

    def point(j: int) -> list[Any]:
        return [j, points.names[j], points.role[j], _numbers(points.xyz[j]), _numbers(points.sigma[j]), groups[j]]

    def observation(r: int) -> list[Any]:
        return [r, int(of.image[r]), int(of.point[r]), _numbers(of.pixel[r]), *_numbers([of.sigma[r]])]

    return {
        "rows": len(moved) + len(seen),
        "off": sorted(work.off),
        "settings": asdict(work.settings),
        "rooms": rooms_to_json(work.rooms),
        "points": [point(j) for j in moved],
        "observations": [observation(r) for r in seen],
        "lengths": [len(points), len(of)],
        "aside": None if work.aside is None else aside_to_json(*work.aside),
    }


def _changed(now: Any, then: Any, names: tuple[str, ...], length: int, before: int) -> list[int]:
    """Rows of a table that are not as they were, and those that came after."""
    if now is then:
        return []
    common = min(length, before)
    differ = np.zeros(common, bool)
    for name in names:
        a, b = (np.asarray(getattr(t, name))[:common] for t in (now, then))
        unequal = (a != b) & ~((a != a) & (b != b)) if a.dtype.kind == "f" else a != b
        differ |= unequal if unequal.ndim == 1 else unequal.any(axis=1)
    return [*np.flatnonzero(differ).tolist(), *range(common, length)]


def _numbers(values: Any) -> list[float | None]:
    return [None if v != v else float(v) for v in values]


def _array(values: Any) -> np.ndarray:
    return np.array([np.nan if v is None else float(v) for v in values])


def _work(said: Mapping[str, Any], disk: Work, revision: int) -> Work:
    """A work from its differences. Raises where they do not fit."""
    block = disk.block
    n, m = said["lengths"]
    points, observations = block.points, block.observations
    if said["points"] or n != len(points):
        points = _points(points, said["points"], n)
    if said["observations"] or m != len(observations):
        observations = _observations(observations, said["observations"], m, n, len(block.images))
    if points is not block.points or observations is not block.observations:
        block = replace(block, points=points, observations=observations)
    settings = Settings()
    probe = State(Work(block), None, "")  # type: ignore[arg-type]
    for name, value in said["settings"].items():
        probe = update(probe, Set(name, value))
    settings = probe.work.settings
    off = frozenset(said["off"]) & set(points.names)
    aside = said.get("aside")
    return Work(block, off, settings, revision, {}, rooms_of(said["rooms"]), None if aside is None else aside_of(aside, block))


def _points(points: Points, said: list[Any], n: int) -> Points:
    if n - len(points) > len(said) or n < 0:
        raise ValueError("points are missing")
    names, role = list(points.names[:n]), list(points.role[:n])
    group = list((points.group or ("",) * len(points))[:n])
    xyz, sigma = points.xyz[:n].copy(), points.sigma[:n].copy()
    for j, name, as_role, at, error, cluster in said:
        if as_role not in ROLES or not isinstance(name, str):
            raise ValueError("a point's role")
        if j == len(names):
            names, role, group = [*names, name], [*role, as_role], [*group, str(cluster)]
            xyz, sigma = np.vstack([xyz, _array(at)]), np.vstack([sigma, _array(error)])
        else:
            names[j], role[j], group[j], xyz[j], sigma[j] = name, as_role, str(cluster), _array(at), _array(error)
    return Points(tuple(names), xyz, sigma, tuple(role), tuple(group) if points.group or any(group) else ())


def _observations(of: Observations, said: list[Any], m: int, points: int, images: int) -> Observations:
    if m - len(of) > len(said) or m < 0:
        raise ValueError("observations are missing")
    image, point, pixel, sigma = of.image[:m].copy(), of.point[:m].copy(), of.pixel[:m].reshape(-1, 2).copy(), of.sigma[:m].copy()
    for r, i, j, at, error in said:
        if not (0 <= i < images and 0 <= j < points):
            raise ValueError("an observation of nothing")
        if r == len(image):
            image, point = np.append(image, i), np.append(point, j)
            pixel, sigma = np.vstack([pixel, _array(at)]), np.append(sigma, _array([error]))
        else:
            image[r], point[r], pixel[r], sigma[r] = i, j, _array(at), _array([error])[0]
    return Observations(image, point, pixel, sigma)
