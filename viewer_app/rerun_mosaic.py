"""Mosaics as a rerun recording: every step of both registrations on the timeline "iteration", the pictures and the vectors, under
the entity paths of the scene (`/mosaic/<method>/outlines`, `/mosaic/<method>/tiles/<n>`, `/mosaic/drift/vectors` ...)."""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import theme
from .ground import points
from .mosaic_scene import scene
from .mosaic_state import METHODS, Mosaic
from .paint_rerun import TIMELINE
from .state import State
from .values import Label, Picture, PointCloud, Scene, Segments

if TYPE_CHECKING:
    import rerun as rr


def recorded(state: State) -> bytes:
    """The recording of all that the tab shows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mosaic.rrd"
        record_mosaic(path, state)
        return path.read_bytes()


def record_mosaic(path: Path, state: State) -> None:
    """Write it to a new file."""
    import rerun as rr
    import rerun.blueprint as rrb

    room = state.room(Mosaic)
    series = [rrb.TimeSeriesView(origin="/plots/mosaic", name="sigma0")]
    space = rrb.Spatial3DView(origin="/", name="Mosaic", contents=["/mosaic/**", "/points/**"],
                              background=theme.background(state.view.dark))  # fmt: skip
    about = rrb.TextDocumentView(origin="/about", name="About")
    views = rrb.Horizontal(space, rrb.Vertical(*series, about), column_shares=[3, 1])
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=2.0, play_state="following")
    panels = time, rrb.SelectionPanel(state="collapsed")
    identity = hashlib.sha256(b"".join(np.ascontiguousarray(m.registration.trace.last.x).tobytes()
                                       for m in room.made.values())).hexdigest()[:32]
    stream = rr.RecordingStream("collinea", recording_id=identity, send_properties=False)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    stream.save(path, default_blueprint=rrb.Blueprint(views, *panels, rrb.BlueprintPanel(state="collapsed"), auto_views=False))
    with stream:
        stream.send_recording_name(f"{state.block.name}: mosaic")
        stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("/about", rr.TextDocument(_about(state)), static=True)
        _log(stream, points(state), static=True)
        for method in METHODS:
            if method in room.made:
                _method(stream, state, room, method)


def _method(stream: rr.RecordingStream, state: State, room: Mosaic, method: str) -> None:
    """Every row of one registration; what belongs to the end alone stands still."""
    import rerun as rr

    made = room.made[method]
    only = replace(room, shown=method, opacity=1.0, row=None, outlines=True, thumbnails=False, drift=True, residuals=True)
    end = scene(state.with_room(only))
    moving = (f"/mosaic/{method}/outlines", f"/mosaic/{method}/box")
    _log(stream, {p: v for p, v in end.items() if not p.startswith(moving)}, static=True)
    for k, row in enumerate(made.registration.trace.rows):
        stream.set_time(TIMELINE, sequence=k)
        at = scene(state.with_room(replace(only, row=k, drift=False, residuals=False)))
        _log(stream, {p: v for p, v in at.items() if p.startswith(moving)}, static=False)
        if np.isfinite(row.sigma0):
            stream.log(f"/plots/mosaic/{method}/sigma0", rr.Scalars(float(row.sigma0)))


def _about(state: State) -> str:
    room = state.room(Mosaic)
    lines = [f"{state.block.name}: metres from {state.assets.frame.origin.tolist()}, crs {state.block.crs}"]
    for method, made in room.made.items():
        photos = len(made.registration.names)
        lines.append(f"{method}: {made.said['kind']}, {photos} photos, tie points {made.said['rms_px']:.3f} px rms")
    if room.layer is not None and room.layer.words:
        lines.append(room.layer.words)
    return "\n".join(lines)


def _log(stream: rr.RecordingStream, values: Scene, static: bool) -> None:
    for path, value in values.items():
        made = _archetype(value)
        if made is not None:
            stream.log(path, made, static=static)


def _archetype(value: Any) -> Any:
    import rerun as rr

    if isinstance(value, Segments):
        thick = rr.Radius.ui_points(value.thickness / 2)
        return rr.LineStrips3D(value.points.astype(np.float32), colors=value.colour, radii=thick)
    if isinstance(value, PointCloud):
        return rr.Points3D(value.points, colors=value.colours, radii=value.size / 2)
    if isinstance(value, Label):
        return rr.Points3D([value.position], labels=[value.text], colors=theme.INITIAL,
                           radii=rr.Radius.ui_points(0.5), show_labels=True)
    if isinstance(value, Picture):
        return _tile(value)
    return None


CELL = 8
"""Side [px] of the pieces a picture is cut into where it is not opaque: rerun draws what is transparent black."""


def _tile(picture: Picture) -> rr.Mesh3D | None:
    """A picture in space, without what is not to be seen of it; None where that is all."""
    import rerun as rr

    corners, quads = pieces(picture.rgba[..., 3] > 127)
    if not len(quads):
        return None
    u, v = corners[:, :1], corners[:, 1:]
    a, b, c, d = picture.corners
    at = (1 - u) * (1 - v) * a + u * (1 - v) * b + u * v * c + (1 - u) * v * d
    seen = np.where(picture.rgba[..., 3:] > 127, picture.rgba[..., :3], 255)
    return rr.Mesh3D(vertex_positions=at.astype(np.float32), triangle_indices=quads[:, [0, 2, 1, 0, 3, 2]].reshape(-1, 3),
                     vertex_texcoords=corners.astype(np.float32), albedo_texture=np.ascontiguousarray(seen, np.uint8))


def pieces(opaque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 2), 0..1 across and down, and quadrilaterals (m, 4) of them that cover what is opaque (h, w): one where all
    is, else those of a raster that are so by half."""
    h, w = opaque.shape
    x, y = (np.array([0, n]) if opaque.all() else np.append(np.arange(0, n, CELL), n) for n in (w, h))
    share = np.add.reduceat(np.add.reduceat(opaque.astype(float), y[:-1], 0), x[:-1], 1) / np.outer(np.diff(y), np.diff(x))
    row, col = np.nonzero(share >= 0.5)
    grid = np.stack(np.meshgrid(x / w, y / h), axis=-1).reshape(-1, 2)
    first = row * len(x) + col
    return grid, np.stack([first, first + 1, first + len(x) + 1, first + len(x)], axis=1)
