"""What the Matching tab wants done now, pure: matches asked for, the long work that was started."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solvers import Block
from solvers.execution import cores
from solvers.geometry import LocalFrame, Surface
from solvers.orientation import Plane
from solvers.workflows_conjugate import common_points

from .acting import Action
from .kept import by_identity
from .matching_actions import Matched, Placed, Tied, Working
from .matching_state import Ask, Found, Matching, Network
from .matching_work import Setting, Sight, adjust_work, match_work, ties_work
from .sighting import view_of
from .spots import ground_of
from .state import State
from .tasks import Task


def tasks(state: State) -> tuple[Task, ...]:
    """Matches first, in the order asked."""
    m = state.room(Matching)
    found = [_match(state, ask) for ask in m.asked]
    block = state.block
    if m.task == "ties" and state.assets.folder is not None:
        found.append(
            Task(
                ("ties", m.serial),
                ties_work,
                (block, state.assets.folder, cores()),
                lambda value: _tied(block, value),
                _stopped,
                "the search for tie points",
                "ties",
            )
        )
    if m.task == "adjust":
        found.append(
            Task(
                ("adjust", m.serial),
                adjust_work,
                (block, state.assets.frame),
                lambda value: _placed(block, value),
                _stopped,
                "the bundle of the tie points",
                "ties",
            )
        )
    return tuple(found)


def _match(state: State, ask: Ask) -> Task:
    return Task(
        ("match", ask.serial),
        _match_or_say,
        (ask, *_setting(state, ask)),
        Matched,
        lambda why: Matched(Found(ask, error=why)),
        "the match",
    )


def _match_or_say(ask: Ask, setting: Setting | None, why: str) -> Any:
    if setting is None:
        yield Found(ask, error=why)
    else:
        yield from match_work(ask, setting)


def _setting(state: State, ask: Ask) -> tuple[Setting | None, str]:
    """What the match may be predicted from; None and why, where a photo is missing."""
    photos = state.assets.photos
    missing = [name for name in (ask.first, ask.second) if name not in photos]
    if missing:
        return None, f"{missing[0]} has no photo that can be read (or it is still being read)"
    xyz, sigma, block = None, 0.0, state.block
    if ask.point in block.points.names:
        j = block.point_index(ask.point or "")
        if np.isfinite(block.points.xyz[j]).all():
            xyz = state.assets.frame.to_local(block.points.xyz[j])
            sigma = float(np.nan_to_num(block.points.sigma[j], nan=max(block.control_m)).max())
    first, second = (_sight(state, name) for name in (ask.first, ask.second))
    a, b, _ = common_points(block, ask.first, ask.second)
    return Setting(first, second, (a, b), _ground(state), state.assets.frame, xyz, sigma), ""


def _sight(state: State, image: str) -> Sight:
    camera, photo = state.block.camera_of(image), state.assets.photos[image]
    return Sight(Path(photo.path), photo.size, (camera.width, camera.height), view_of(state, image))


def _ground(state: State) -> Plane | Surface | None:
    """The project's heights, else those of the points: a level plane as uncertain as they differ; None where nobody knows any."""
    known = state.block.points.xyz[np.isfinite(state.block.points.xyz).all(axis=1), 2]
    if state.assets.surface is not None or state.block.surface.get("z") is not None or len(known):
        return ground_of(state.work, state.assets)
    network = state.room(Matching).network
    return None if network is None or not len(network.xyz) else _plane(network, state.assets.frame)


@by_identity(2)
def _plane(network: Network, frame: LocalFrame) -> Plane:
    heights = frame.to_map(network.xyz)[:, 2]
    middle = float(np.median(heights))
    return Plane(middle, float(1.4826 * np.median(np.abs(heights - middle))))


def _tied(before: Block, value: str | tuple[Block, str]) -> Action:
    return Working("ties", value) if isinstance(value, str) else Tied(before, *value)


def _placed(block: Block, value: str | Network) -> Action:
    return Working("adjust", value) if isinstance(value, str) else Placed(replace(value, block=block))


def _stopped(why: str) -> Action:
    return Working("", why)
