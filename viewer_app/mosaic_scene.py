"""Mosaics to be seen: tiles on their plane, outlines of every step, drift, known points, measured places, the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solvers.mosaic import Registration, measure
from solvers.mosaic.measured import Measured

from . import theme
from .bars import bar, corner, said
from .ground import nice, site, symbol_size
from .kept import by_identity
from .mosaic_fade import faded
from .mosaic_place import scale_of, to_scene
from .mosaic_state import EXAGGERATIONS, METHODS, Layer, Made, Mosaic, Tile
from .state import State
from .values import Label, Picture, Scene, Segments

COLOURS = {"simultaneous": theme.PERSPECTIVE, "sequential": theme.ORTHOGONAL}
"""Outlines and tables tell the two registrations apart by these."""
MOST_THUMBNAILS = 40
"""Photos shown warped at a step, at most; of more the outlines alone."""
THUMB = 128
"""px of the longer side of a warped photo."""


class Drift(NamedTuple):
    """Corners of photos that both registrations hold: names (n,), at (n, 4, 2) in the simultaneous one, off: sequential minus
    that [unit]."""

    names: tuple[str, ...]
    at: np.ndarray
    off: np.ndarray

    @property
    def lengths(self) -> np.ndarray:
        """(n,) rms of the corners' distances."""
        return np.sqrt((self.off**2).sum(axis=2).mean(axis=1))


def scene(state: State) -> Scene:
    """All that the tab adds."""
    room, found = state.room(Mosaic), Scene()
    if not room.made:
        return found
    found |= _layer(state, room)
    at_end = room.shown_row == room.last_row
    found |= _tiles(state, room) if at_end else {}
    made = room.current
    if made is None:
        return found
    found |= _outlines(state, room, made)
    if not at_end and room.thumbnails:
        found |= _thumbnails(state, made, room.shown_row)
    if room.drift and at_end:
        found |= _drift(state, room)
    if room.residuals and at_end:
        found |= _residuals(state, room, made)
    return found | _places(state, room, made)


# -- pictures -----------------------------------------------------------------------------------------------------------------


def _tiles(state: State, room: Mosaic) -> Scene:
    both = all(m in room.made for m in METHODS)
    shown = {m: made for m, made in room.made.items() if m == room.method or (room.shown not in METHODS and both)}
    if room.opacity <= 0:
        return {}
    if room.shown == "fade" and both:
        under, over = (tuple(p for t in shown[m].tiles.values() if (p := _picture(state, shown[m], t, 1.0, 0.0, None)))
                       for m in METHODS)
        return {"/mosaic/faded": faded(under, over, round(room.swipe, 2), room.opacity)} if under or over else {}
    found = Scene()
    for method, made in shown.items():
        line, lift = None, 0.0
        if room.shown == "swipe" and both:
            line = _line(room, (0.0, room.swipe) if method == "sequential" else (room.swipe, 1.0))
            lift = round(_level(state, shown["simultaneous"]) - _level(state, made), 4)
        for tile in made.tiles.values():
            value = _picture(state, made, tile, room.opacity, lift, line)
            if value is not None:
                found[f"/mosaic/{method}/tiles/{tile.number}"] = value
    return found


def _level(state: State, made: Made) -> float:
    """Height of a mosaic's tiles in the scene, 0 before there are any: two that are compared lie equally high."""
    heights = [to_scene(state, made, t.corners)[:, 2].mean() for t in made.tiles.values()]
    return float(np.mean(heights)) if heights else 0.0


def _hair(state: State) -> float:
    """Height [m] by which one mosaic lies over another, so that the two do not fight for the same place."""
    low, high = site(state)
    return 5e-4 * float((high - low)[:2].max())


def _line(room: Mosaic, part: tuple[float, float]) -> tuple[float, float]:
    """West and east bounds of what is shown, local X of the registrations, from shares of the width of both."""
    x = np.concatenate([t.corners[:, 0] for m in room.made.values() for t in m.tiles.values()] or [np.zeros(1)])
    low, high = float(x.min()), float(x.max())
    ends = [low + p * (high - low) for p in part]
    return (ends[0] if part[0] > 0 else -np.inf), (ends[1] if part[1] < 1 else np.inf)


def _picture(
    state: State, made: Made, tile: Tile, opacity: float, lift: float, line: tuple[float, float] | None
) -> Picture | None:
    cut = (0, tile.rgba.shape[1])
    if line is not None:
        west, east = tile.corners[0, 0], tile.corners[1, 0]
        share = np.clip((np.array(line) - west) / (east - west), 0, 1)
        first, last = np.round(share * tile.rgba.shape[1]).astype(int)
        cut = int(first), int(last)
        if cut[1] <= cut[0]:
            return None
    frame = state.assets.frame
    return _placed(
        tile, made, cut[0], cut[1], opacity, lift, frame, None if made.registration.unit == "m" else state.block, _Holder(state)
    )


class _Holder:
    """A state that takes no part in telling results apart."""

    def __init__(self, state: State) -> None:
        self.state = state


_KEPT: dict[tuple[object, ...], tuple[tuple[object, ...], Picture]] = {}


def _placed(
    tile: Tile, made: Made, first: int, last: int, opacity: float, lift: float, frame: object, block: object, holder: _Holder
) -> Picture:
    """The picture of a tile; kept, so that one that has not changed is the same value and nothing is sent."""
    key = (id(tile), id(made.registration), first, last, opacity, lift, id(frame), id(block))
    if key not in _KEPT:
        while len(_KEPT) > 2000:
            _KEPT.pop(next(iter(_KEPT)))
        c, width = to_scene(holder.state, made, tile.corners), tile.rgba.shape[1]
        a, b = first / width, last / width
        corners = np.array(
            [c[0] + a * (c[1] - c[0]), c[0] + b * (c[1] - c[0]), c[3] + b * (c[2] - c[3]), c[3] + a * (c[2] - c[3])]
        )
        rgba = tile.rgba if (first, last) == (0, width) else np.ascontiguousarray(tile.rgba[:, first:last])
        _KEPT[key] = (tile, made.registration, frame, block), Picture(corners + np.array([0, 0, lift]), rgba, opacity)
    return _KEPT[key][1]


def _layer(state: State, room: Mosaic) -> Scene:
    layer, made = room.layer, room.current
    if layer is None or layer.tile is None or made is None or not room.layer_shown or made.registration.unit != "m":
        return {}
    found: Scene = {
        "/mosaic/layer/picture": _placed(
            layer.tile, made, 0, layer.tile.rgba.shape[1], 1.0, -2 * _hair(state), state.assets.frame, None, _Holder(state)
        )
    }
    if not len(layer.off):
        return found
    at = to_scene(state, made, _on_plane(made.registration, layer.at))
    end = to_scene(state, made, _on_plane(made.registration, layer.at + layer.off))
    factor = _factor(room, np.linalg.norm(layer.off, axis=1), state)
    up = np.array([0, 0, 2 * _hair(state)])
    found["/mosaic/layer/offsets"] = Segments(np.stack([at, at + factor * (end - at)], axis=1) + up, theme.RESIDUAL, 2.5)
    return found | _scale(state, made, factor, "layer", f"{layer.name} minus mosaic")


def _on_plane(r: Registration, xy: np.ndarray) -> np.ndarray:
    from solvers.mosaic import Ground, MosaicPlane

    return Ground(r.frame, MosaicPlane(*map(float, r.plane))).local(xy)


# -- lines --------------------------------------------------------------------------------------------------------------------


@by_identity(64)
def outlines(r: Registration, row: int) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and corners (n, 4, 2) of the photos' outlines at a row of the trace, laid on the final mosaic by a similarity where
    the row was computed in another datum; photos not placed yet are left out."""
    names = tuple(r.trace.manifest["images"])
    h = r.trace.rows[row].x.reshape(-1, 3, 3)[: len(names)]
    corners = np.asarray(r.trace.manifest["corners"], float)
    placed = np.flatnonzero(np.isfinite(h).all(axis=(1, 2)))
    out = []
    for k in placed:
        p = np.c_[corners[k], np.ones(4)] @ np.linalg.inv(h[k]).T
        out.append(np.where(p[:, 2:] > 0, p[:, :2] / np.where(p[:, 2:] > 0, p[:, 2:], 1), np.nan))
    at = np.array(out).reshape(-1, 4, 2)
    return tuple(names[k] for k in placed), at if r.method == "sequential" else _laid(r, [names[k] for k in placed], at)


def _laid(r: Registration, names: list[str], at: np.ndarray) -> np.ndarray:
    """Outlines on the final mosaic: as they are where they are near it, else by the similarity that fits the photos' middles."""
    final = {n: r.footprint(k) for k, n in enumerate(r.names)}
    both = [k for k, n in enumerate(names) if n in final and np.isfinite(at[k]).all() and np.isfinite(final[n]).all()]
    if len(both) < 2:
        return at
    a, b = at[both].reshape(-1, 2), np.concatenate([final[names[k]] for k in both])
    if np.median(np.linalg.norm(a - b, axis=1)) < 0.3 * np.linalg.norm(np.ptp(b, axis=0)):
        return at
    za, zb = a @ [1, 1j], b @ [1, 1j]
    ma, mb = za.mean(), zb.mean()
    s = np.vdot(za - ma, zb - mb) / np.vdot(za - ma, za - ma)
    z = s * (at @ [1, 1j] - ma) + mb
    return np.stack([z.real, z.imag], axis=-1)


def _lifted(r: Registration, xy: np.ndarray) -> np.ndarray:
    return np.concatenate([xy, r.heights(xy)[..., None]], axis=-1)


def _outlines(state: State, room: Mosaic, made: Made) -> Scene:
    r, found = made.registration, Scene()
    _, at = outlines(r, room.shown_row)
    at = at[np.isfinite(at).all(axis=(1, 2))]
    up = np.array([0, 0, 1.5 * _hair(state)])
    if room.outlines and len(at):
        ring = to_scene(state, made, _lifted(r, at))
        lines = np.stack([ring, np.roll(ring, -1, axis=1)], axis=2).reshape(-1, 2, 3) + up
        found[f"/mosaic/{made.ask.method}/outlines"] = Segments(lines, COLOURS[made.ask.method], 2.0)
    if len(at) and room.shown_row < room.last_row:
        low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
        box = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
        ring = to_scene(state, made, _lifted(r, box)) + up
        found[f"/mosaic/{made.ask.method}/box"] = Segments(
            np.stack([ring, np.roll(ring, -1, axis=0)], axis=1), theme.foreground(state.view.dark), 2.5
        )
        words = f"{high[0] - low[0]:.4g} x {high[1] - low[1]:.4g} {r.unit}, {len(at)} photos"
        found[f"/mosaic/{made.ask.method}/box_label"] = Label(words, ring[3] + up, 0.9, "center-center")
    return found


def _thumbnails(state: State, made: Made, row: int) -> Scene:
    """The photos warped as the row says, where they are few."""
    names, at = outlines(made.registration, row)
    found = Scene()
    if len(names) > MOST_THUMBNAILS:
        return found
    for n, name in enumerate(names):
        photo = state.assets.photos.get(name)
        if photo is None or not np.isfinite(at[n]).all():
            continue
        warped = _warped(photo.thumbnail, at[n].tobytes())
        if warped is None:
            continue
        rgba, box = warped
        corners = to_scene(state, made, _lifted(made.registration, box))
        up = np.array([0, 0, _hair(state) * n / max(len(names), 1)])
        found[f"/mosaic/{made.ask.method}/photos/{name.replace('/', '_')}"] = Picture(corners + up, rgba, 1.0)
    return found


@by_identity(160)
def _warped(thumbnail: np.ndarray, corners: bytes) -> tuple[np.ndarray, np.ndarray] | None:
    """A photo on a raster along its first edge, (h, w, 4) uint8, and the raster's corners (4, 2); its own corners come as bytes.

    Along the photo, since a browser shows nothing of what lies under a transparent part: slivers are left of it at most.
    """
    import cv2

    ring = np.frombuffer(corners).reshape(4, 2)
    edge = ring[1] - ring[0]
    right = edge / max(float(np.linalg.norm(edge)), 1e-300)
    axes = np.array([right, [right[1], -right[0]]])  # rightwards and downwards on the raster
    own = (ring - ring[0]) @ axes.T
    low, high = own.min(axis=0), own.max(axis=0)
    scale = THUMB / max(float((high - low).max()), 1e-300)
    if not np.isfinite(scale) or not edge.any():
        return None
    width, height = (max(int(np.ceil(v)), 2) for v in (high - low) * scale)
    h, w = thumbnail.shape[:2]
    to = (own - low) * scale - 0.5
    mine = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]], np.float32)
    m = cv2.getPerspectiveTransform(mine, to.astype(np.float32))
    full = np.dstack([thumbnail, np.full((h, w), 255, np.uint8)])
    rgba = cv2.warpPerspective(full, m, (width, height), flags=cv2.INTER_AREA, borderValue=(0, 0, 0, 0))
    box = low + np.array([[0, 0], [width, 0], [width, height], [0, height]]) / scale
    return rgba, ring[0] + box @ axes


# -- what differs -------------------------------------------------------------------------------------------------------------


def drift(room: Mosaic) -> Drift | None:
    """How the two registrations differ, None where one of them is missing or they have no datum in common."""
    if not all(m in room.made for m in METHODS):
        return None
    return _between(room.made["simultaneous"].registration, room.made["sequential"].registration)


@by_identity(4)
def _between(sure: Registration, other: Registration) -> Drift | None:
    if sure.unit != other.unit or not np.array_equal(sure.frame.origin, other.frame.origin):
        return None
    index = {n: k for k, n in enumerate(other.names)}
    names, at, off = [], [], []
    for k, n in enumerate(sure.names):
        if n in index:
            a, b = sure.footprint(k), other.footprint(index[n])
            if np.isfinite(a).all() and np.isfinite(b).all():
                names.append(n)
                at.append(a)
                off.append(b - a)
    return Drift(tuple(names), np.array(at), np.array(off)) if names else None


def _factor(room: Mosaic, lengths: np.ndarray, state: State, scale: float = 1.0) -> float:
    """The exaggeration that is drawn: the one chosen, or what makes the longest vector a twelfth of the site."""
    if room.exaggeration > 0:
        return room.exaggeration
    longest = float(np.nanmax(lengths, initial=0.0)) * scale
    low, high = site(state)
    return min(nice(max(float((high - low)[:2].max()) / 12 / longest, 1.0)), EXAGGERATIONS[-1]) if longest > 0 else 1.0


def _drift(state: State, room: Mosaic) -> Scene:
    found, made = drift(room), room.made.get("simultaneous")
    if found is None or made is None:
        return {}
    factor = _factor(room, np.linalg.norm(found.off, axis=2), state, scale_of(state, made))
    at = found.at.reshape(-1, 2)
    start = to_scene(state, made, _lifted(made.registration, at))
    end = to_scene(state, made, _lifted(made.registration, at + factor * found.off.reshape(-1, 2)))
    up = np.array([0, 0, 3 * _hair(state)])
    out: Scene = {"/mosaic/drift/vectors": Segments(np.stack([start, end], axis=1) + up, theme.ORTHOGONAL, 3.0)}
    return out | _scale(state, made, factor, "drift", "drift")


def _residuals(state: State, room: Mosaic, made: Made) -> Scene:
    points = made.points
    if not len(points.off):
        return {}
    factor = _factor(room, np.linalg.norm(points.off, axis=1), state)
    found = Scene()
    for role, colour in (("control", theme.CONTROL), ("check", theme.CHECK)):
        which = np.array([r == role for r in points.roles])
        if which.any():
            xyz = points.xyz[which].copy()  # those below the plane on it, so that it hides none of them
            xyz[:, 2] = np.maximum(xyz[:, 2], made.registration.heights(xyz[:, :2]))
            end = xyz + factor * np.c_[points.off[which], np.zeros(int(which.sum()))]
            lines = np.stack([to_scene(state, made, xyz), to_scene(state, made, end)], axis=1)
            found[f"/mosaic/residuals/{role}"] = Segments(
                lines + np.array([0, 0, 3 * _hair(state)]), theme.RESIDUAL if role == "control" else colour, 3.5
            )
    return found | _scale(state, made, factor, "residuals", "mosaic minus points")


def bars(state: State) -> Scene:
    """Those of the vectors that are drawn."""
    room, made = state.room(Mosaic), state.room(Mosaic).current
    if made is None or not bars_drawn(state):
        return Scene()
    every = (_drift(state, room) if room.drift else Scene()) | (_residuals(state, room, made) if room.residuals else Scene())
    return {path: value for path, value in every.items() if path.startswith("/mosaic/scale/")}


def bars_drawn(state: State) -> int:
    """How many bars the mosaic's vectors have."""
    room = state.room(Mosaic)
    made = room.current
    if made is None or room.shown_row != room.last_row:
        return 0
    return bool(room.drift and drift(room) is not None) + bool(room.residuals and len(made.points.off))


def _scale(state: State, made: Made, factor: float, name: str, what: str) -> Scene:
    """A bar as long as a round residual, and its words: the drift's comes first, that of the map last."""
    drifts = bool(state.room(Mosaic).drift and drift(state.room(Mosaic)) is not None)
    line = {"drift": 1, "residuals": 1 + drifts}.get(name, 1 + bars_drawn(state) + 2)
    unit, per = made.registration.unit, scale_of(state, made)
    length = nice(max(corner(state)[1] / 8 / factor / per, 1e-9))
    words = said(length) if unit == "m" else f"{length:g} {unit}"
    return bar(state, f"/mosaic/scale/{name}", line, factor * length * per, f"{words}: {what} × {factor:g}")


# -- measuring ----------------------------------------------------------------------------------------------------------------


@by_identity(16)
def _measured(r: Registration, places: bytes) -> Measured:
    return measure(r, np.frombuffer(places).reshape(-1, 2))


def measured(room: Mosaic) -> Measured | None:
    """What the places measured say, None without any."""
    made = room.current
    return None if made is None or not room.places else _measured(made.registration, np.array(room.places, float).tobytes())


def _places(state: State, room: Mosaic, made: Made) -> Scene:
    found, size, ink = Scene(), 0.6 * symbol_size(state), theme.foreground(state.view.dark)
    up = np.array([0, 0, 4 * _hair(state)])
    if room.places:
        at = to_scene(state, made, _lifted(made.registration, np.array(room.places))) + up
        cross = np.array([[[-size, 0, 0], [size, 0, 0]], [[0, -size, 0], [0, size, 0]]])
        lines = (at[:, None, None] + cross[None]).reshape(-1, 2, 3)
        if len(at) > 1:
            lines = np.concatenate([lines, np.stack([at[:-1], at[1:]], axis=1)])
        if len(at) > 2:
            lines = np.concatenate([lines, [[at[-1], at[0]]]])
        found["/mosaic/measured/lines"] = Segments(lines, ink, 3.0)
        for n, p in enumerate(at):
            found[f"/mosaic/measured/{n + 1}"] = Label(str(n + 1), p + np.array([size, size, 0]), 0.9)
    if room.conjugate is not None:
        p = to_scene(state, made, _lifted(made.registration, np.array(room.conjugate[1:]))) + up
        turn = 2 * np.pi * np.arange(25) / 24
        ring = p + size * np.stack([np.cos(turn), np.sin(turn), np.zeros(25)], axis=1)
        found["/mosaic/conjugate"] = Segments(np.stack([ring[:-1], ring[1:]], axis=1), theme.RESIDUAL, 3.5)
    return found


def clicked(state: State, origin: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
    """X, Y [unit of the registration] where a ray meets the plane of the mosaic shown; None where it does not, or off the
    mosaic."""
    made = state.room(Mosaic).current
    if made is None or not made.registration.names:
        return None
    r = made.registration
    corners = np.concatenate([r.footprint(k) for k in range(len(r.names))])
    corners = corners[np.isfinite(corners).all(axis=1)]
    low, high = corners.min(axis=0), corners.max(axis=0)
    frame = np.array([low, [high[0], low[1]], [low[0], high[1]]])
    o, u, v = to_scene(state, made, _lifted(r, frame))
    m = np.stack([u - o, v - o, -np.asarray(direction, float)], axis=1)
    if abs(np.linalg.det(m)) < 1e-12:
        return None
    a, b, t = np.linalg.solve(m, np.asarray(origin, float) - o)
    if not (t > 0 and -0.02 <= a <= 1.02 and -0.02 <= b <= 1.02):
        return None
    x, y = low + np.array([a, b]) * (high - low)
    return float(x), float(y)


__all__ = ["COLOURS", "Drift", "Layer", "clicked", "drift", "measured", "outlines", "scene"]
