"""The Matching tab's long work, done in another process: a match, tie points of all photos, the bundle that places them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from solvers import Block, PhotogrammetryError
from solvers.adjustment import Iteration, Trace, iterate
from solvers.geometry import LocalFrame, Surface
from solvers.matching import Shared, match_stepped, shared
from solvers.orientation import Plane
from solvers.workflows_conjugate import Guess, View, by_orientation, by_point, by_ties

from .following import followed
from .matching_state import Ask, Found, Network

FAR = 60.0
"""px, the farthest that is searched around a prediction."""
ROOM = 24
"""px around what a match reads: reach of the spline's filter and of the window's move."""


@dataclass(frozen=True, eq=False)
class Sight:
    """One of the two photos: its file with its size, the camera's format, and how it is oriented, where that is known."""

    path: Path
    size: tuple[int, int]
    format: tuple[int, int]
    view: View | None

    @property
    def factor(self) -> np.ndarray:
        """(2,) full pixels per file pixel."""
        return np.array(self.format, float) / self.size

    def to_file(self, pixel: np.ndarray) -> np.ndarray:
        return (np.asarray(pixel, float) + 0.5) / self.factor - 0.5


@dataclass(frozen=True, eq=False)
class Setting:
    """What a match may be predicted from. ties: (n, 2) px in both photos; xyz (3,) m local with its sigma, of a known point."""

    first: Sight
    second: Sight
    ties: tuple[np.ndarray, np.ndarray]
    ground: Plane | Surface | None
    frame: LocalFrame
    xyz: np.ndarray | None = None
    sigma: float = 0.0


def match_work(ask: Ask, setting: Setting) -> Iterator[Found]:
    """The match asked for: from one prediction after the other until one leads to it; else the most promising refusal."""
    refused: Found | None = None
    for guess in guesses(ask, setting):
        found = _match(ask, setting, guess)
        if found.ok:
            yield found
            return
        refused = found if refused is None or _promise(found) > _promise(refused) else refused
    yield refused or Found(ask, error=f"nothing tells where {ask.second} shows it: click about there in the right photo")


def _promise(found: Found) -> float:
    """Of a match that was refused: the correlation that it came to, which tells which prediction was nearest."""
    return -2.0 if found.stepped is None else float(np.nan_to_num(found.stepped.lsm.score[0], nan=-1.0))


def guesses(ask: Ask, setting: Setting) -> Iterator[Guess]:
    """Predictions, the most trusted first; features only where the others failed."""
    at, known = np.array(ask.at), list(_known(np.array(ask.at), setting))
    if ask.start is not None:
        shape = known[0].shape if known else np.eye(2)
        if not known and (common := _features(setting)) is not None:
            shape = _by_features(common, at, setting).shape
        yield Guess(np.array(ask.start), shape, 15.0, "your click")
        return
    yield from known
    if (common := _features(setting)) is not None:
        guess = _by_features(common, at, setting)
        inside = (guess.place > -0.5) & (guess.place < np.array(setting.second.format) - 0.5)
        if inside.all():
            yield guess


def _known(at: np.ndarray, s: Setting) -> Iterator[Guess]:
    found = []
    if s.first.view is not None and s.second.view is not None:
        if s.xyz is not None:
            found.append(by_point(s.first.view, s.second.view, s.xyz, at, s.sigma))
        elif s.ground is not None:
            found.append(by_orientation(s.first.view, s.second.view, at, s.ground, s.frame))
    found.append(by_ties(*s.ties, at))
    yield from sorted((g for g in found if g is not None and g.reach <= FAR), key=lambda g: g.reach)


def _features(setting: Setting) -> Shared | None:
    return features_of(setting.first.path, setting.second.path)


@lru_cache(maxsize=8)
def features_of(first: Path, second: Path) -> Shared | None:
    """What two photos share by their features, in pixels of their files; kept, for it takes a second or two."""
    from solvers.io.photos import read_photo

    return shared(read_photo(first), read_photo(second))


def _by_features(common: Shared, at: np.ndarray, s: Setting) -> Guess:
    place, shape, reach = common.predict(s.first.to_file(at))
    factor = s.second.factor
    shape = factor[:, None] * shape / s.first.factor
    return Guess((place + 0.5) * factor - 0.5, shape, 4.0 + reach * float(factor.max()), "features")


def _match(ask: Ask, s: Setting, guess: Guess) -> Found:
    shape = guess.shape * s.first.factor / s.second.factor[:, None]  # of file offsets
    at, start = s.first.to_file(np.array(ask.at)), s.second.to_file(guess.place)
    search = ask.search or int(np.clip(np.ceil(guess.reach / s.second.factor.min()), 4, FAR))
    half = ask.window // 2
    wide = [half * max(1.0, float(np.abs(m).sum(axis=1).max())) for m in (np.linalg.inv(shape), shape)]
    try:
        template, origin = _window(s.first, at, wide[0] + ROOM)
        target, corner = _window(s.second, start, wide[1] + search + ROOM)
        stepped = match_stepped(
            template, target, at - origin, start - corner, ask.window, search, threshold=ask.threshold, shape=shape
        )
    except (PhotogrammetryError, OSError) as error:
        return Found(ask, guess, error=str(error))
    return Found(ask, guess, stepped, corner, s.second.factor)


def _window(sight: Sight, at: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Values around a file pixel, as far as the photo goes, and (2,) the first of them."""
    from solvers.io.photos import photo_values

    low = np.maximum(np.floor(at - reach), 0).astype(int)
    high = np.minimum(np.ceil(at + reach) + 1, sight.size).astype(int)
    low, high = np.minimum(low, np.array(sight.size) - 2), np.maximum(high, low + 2)
    return photo_values(sight.path, *low, *(high - low)), low.astype(float)


# -- all photos ---------------------------------------------------------------------------------------------------------------


def ties_work(block: Block, folder: Path, workers: int) -> Iterator[str | tuple[Block, str]]:
    """Words on how far the search for tie points is; last the block with them, and words on what was found."""
    from solvers.workflows_matching import ties_of_block

    for value in followed(lambda report: ties_of_block(block, folder, workers=workers, report=report), "Tie points"):
        if isinstance(value, str):
            yield value
            continue
        new, ties = value
        rays = int((ties.rays >= 3).sum())
        failed = "".join(f"; {name}: {why}" for name, why in ties.failed.items())
        yield new, f"{len(ties.points)} tie points found, {rays} of them in three photos and more{failed}."


def adjust_work(block: Block, frame: LocalFrame) -> Iterator[str | Network]:
    """Words on every iteration of a bundle of all that is measured; last where it places the tie points."""
    from solvers.orientation.bundle import BundleRequest, conclude_bundle, prepare_bundle

    yield "Bundle: looking for a start"
    datum = _datum(block)
    start = prepare_bundle(block, BundleRequest(datum=datum, rolling_shutter="auto"))  # type: ignore[arg-type]
    rows: list[Iteration] = []
    began = time.monotonic()
    for row in iterate(start.problem, start.x0, start.options):
        rows.append(row)
        left = (time.monotonic() - began) / max(row.index, 1) * (start.options.max_iterations - row.index)
        yield f"Bundle: iteration {row.index}, sigma0 {row.sigma0:.3f}" + (f", at most {left:.0f} s left" if row.index else "")
    done = conclude_bundle(start, Trace(tuple(rows), start.manifest))
    exteriors = {o.image: replace(o.exterior, centre=frame.to_local(o.exterior.centre)) for o in done.orientations}
    square: dict[str, list[float]] = {}
    for o in done.orientations:
        for name, v in zip(o.points, o.residuals, strict=True):
            square.setdefault(name, []).append(float(v @ v))
    points = [p for p in done.points if np.isfinite(p.xyz).all()]
    more = "".join(f" {w[:1].upper()}{w[1:]}." for w in done.warnings[:1])
    words = (
        f"Bundle ({datum}): {len(done.orientations)} photos, {len(points)} points, rms {done.rms_px:.2f} px"
        f"{'' if done.trace.converged else ', NOT converged'}.{more}"
    )
    yield Network(
        tuple(p.name for p in points),
        frame.to_local(np.array([p.xyz for p in points]).reshape(-1, 3)),
        np.array([np.sqrt(np.mean(square.get(p.name, [np.nan]))) for p in points]),
        exteriors,
        words,
        block,
    )


def _datum(block: Block) -> str:
    """Control where there is enough, else none: onboard positions begin a free network, which settles in few iterations; held by
    metres and measured to tenths of a pixel it would take many."""
    control = np.array([r == "control" for r in block.points.role], bool) & np.isfinite(block.points.xyz).all(axis=1)
    return "control" if control[np.unique(block.observations.point)].sum() >= 3 else "free"
