"""A run as a rerun recording: everything the adjustment saw, on the timeline "iteration".

Entity paths are those of the scene (`/images/<name>/<model>/camera`, `.../rays`, `/points/control`); beside them stand
`/images/<name>/photo` (measured and projected points, photo pixels), `/plots`, `/normal`, `/log` and `/about`.
A trace that ended earlier keeps its last row. Positions are metres in the block's local frame.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.adjustment import SCALARS
from solvers.block import Block
from solvers.geometry import Exterior, LocalFrame
from solvers.orientation.result import Orientation

from . import theme
from .ground import nice
from .replay import ELEMENTS, Replay
from .rerun_layout import APPLICATION, as_bytes, blueprint, part
from .rerun_server import open_log, serve
from .rerun_shown import EVERYTHING, Shown
from .rerun_values import about, drawn, pinhole, pose, sentence, shade

if TYPE_CHECKING:
    import rerun as rr

__all__ = ["TIMELINE", "layout", "open_log", "record", "serve"]

TIMELINE = "iteration"
LOGARITHMIC = ("cost", "sigma0", "step")
NAMED = 40
"""Known points up to which their names are shown, not only told where one points at them."""
KINDS = {"control": theme.CONTROL, "check": theme.CHECK, "off": theme.INITIAL}
JPEG_QUALITY = 85
STAMP = 256
"""Longer side (px) of the photo in an image plane in space, at most; not compressed, so that it is there at once."""
RESIDUAL_SHARE = 0.08
"""Length of the longest residual vector on a photo, as a share of its width, that the exaggeration aims at."""


def record(path: str | Path, block: Block, orientations: Sequence[Orientation], photos: Mapping[str, np.ndarray],
           truth: Mapping[str, Any] | None = None, shown: Shown = EVERYTHING) -> None:
    """Write the recording of a run, atomically.

    photos: small pictures uint8 (h, w, 3) by image name, of any size; images without one are drawn without.
    truth: what `solvers.io.read_truth` gives back. shown: with what it opens.
    """
    import rerun as rr

    path = Path(path)
    frame, replays, site = _told(block, orientations)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        stream = rr.RecordingStream(APPLICATION, recording_id=_identity(block, replays), send_properties=False)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        stream.save(unfinished, default_blueprint=blueprint(replays, site, shown))
        with stream:  # leaving it writes the end of the file
            stream.send_recording_name(block.name)
            painter = _Painter(stream, block, frame, _depth(replays, site), shown)
            painter.still(orientations, photos, truth or {})
            stream.flush()  # what stands still comes first in the file, so that a slow browser shows it first
            for replay, orientation in zip(replays, orientations, strict=True):
                painter.trace(replay, orientation)
            for image in dict.fromkeys(r.image for r in replays):
                painter.residuals([r for r in replays if r.image == image])
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def layout(block: Block, orientations: Sequence[Orientation], shown: Shown) -> bytes:
    """How that recording is laid out from now on, for a page that has it open (`Served.lay_out`)."""
    _, replays, site = _told(block, orientations)
    return as_bytes(blueprint(replays, site, shown))


def _told(block: Block, orientations: Sequence[Orientation]) -> tuple[LocalFrame, list[Replay], np.ndarray]:
    """The frame, the runs in it, and where the known points are (n, 3) m."""
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame)
    site = frame.to_local(block.points.xyz)
    return frame, [Replay.of(o.trace, block, frame) for o in orientations], site[np.isfinite(site).all(axis=1)]


class _Painter:
    """Values to rerun's archetypes. depth [m]: where image planes are drawn."""

    def __init__(self, stream: rr.RecordingStream, block: Block, frame: LocalFrame, depth: float, shown: Shown) -> None:
        self.stream, self.block, self.frame, self.depth, self.shown = stream, block, frame, depth, shown

    # -- what does not move

    def still(self, orientations: Sequence[Orientation], photos: Mapping[str, np.ndarray], truth: Mapping[str, Any]) -> None:
        import rerun as rr

        self._static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._static("/about", rr.TextDocument(about(self.block, self.frame), media_type=rr.MediaType.MARKDOWN))
        self._points()
        shown = {o.image: [p for p in orientations if p.image == o.image] for o in orientations}
        for name, of in shown.items():
            self._photo(name, [o.model for o in of], photos.get(name))
            self._camera(f"/images/{part(name)}/initial/camera", name, of[0].initial, theme.INITIAL, 0.8)
            prior = self.block.images[self.block.image_index(name)].prior
            if prior is not None and prior.centre is not None and prior.angles is not None:
                given = Exterior.from_angles(*prior.angles, centre=self.frame.to_local(prior.centre))
                self._camera(f"/images/{part(name)}/georeferenced/camera", name, given, theme.GEOREFERENCED, 0.7)
            true = truth.get("images", {}).get(name)
            if true is not None:
                angles = np.radians([true["omega_deg"], true["phi_deg"], true["kappa_deg"]])
                centre = self.frame.to_local(np.array([true["X"], true["Y"], true["Z"]]))
                known = Exterior.from_angles(*angles, centre=centre)
                self._camera(f"/images/{part(name)}/truth/camera", name, known, theme.foreground(self.shown.dark), 0.6)

    def _points(self) -> None:
        import rerun as rr

        points = self.block.points
        xyz, role = self.frame.to_local(points.xyz), np.array(points.role)
        for kind, colour in (("control", theme.CONTROL), ("check", theme.CHECK)):
            rows = np.flatnonzero((role == kind) & np.isfinite(xyz).all(axis=1))
            if len(rows):
                labels = [points.names[j] for j in rows]
                self._static(f"/points/{kind}", rr.Points3D(xyz[rows], colors=colour, radii=rr.Radius.ui_points(4), labels=labels,
                                                            show_labels=len(rows) <= NAMED))

    def _photo(self, name: str, models: list[str], photo: np.ndarray | None) -> None:
        """The photo under its measurements, in pixels of the full format, and in the image planes of its cameras."""
        import rerun as rr

        camera, stamp = self.block.camera_of(name), None
        if photo is not None:
            picture = rr.Image(np.ascontiguousarray(photo)).compress(jpeg_quality=JPEG_QUALITY)
            enlarge = rr.Transform3D(scale=[camera.width / photo.shape[1], camera.height / photo.shape[0], 1.0])
            self._static(f"/images/{part(name)}/photo/picture", picture, enlarge)
            skip = -(-max(photo.shape[:2]) // STAMP)
            stamp = np.ascontiguousarray(photo[skip // 2::skip, skip // 2::skip])
        for model in models:
            path = f"/images/{part(name)}/{model}/camera"
            shown = [rr.Image(stamp)] if stamp is not None and model == models[0] else []
            self._static(path, pinhole(camera, theme.MODELS[model], self.depth, stamp), rr.TransformAxes3D(0.0), *shown)

    def _camera(self, path: str, name: str, exterior: Exterior, colour: theme.Colour, size: float) -> None:
        import rerun as rr

        lens = pinhole(self.block.camera_of(name), colour, size * self.depth)
        self._static(path, lens, pose(exterior), rr.TransformAxes3D(0.0))  # without axes: the frustum says it all

    # -- what the rows change

    def trace(self, replay: Replay, orientation: Orientation) -> None:
        import rerun as rr

        image = f"/images/{part(replay.image)}"
        where, colour = f"{part(replay.image)}/{replay.model}", theme.MODELS[replay.model]
        thin, dot = rr.Radius.ui_points(0.6), rr.Radius.ui_points(2.5)
        kinds = [KINDS[kind] for kind in replay.kinds]
        self._static(f"{image}/photo/observed", rr.Points2D(drawn(replay.pixels), colors=kinds, radii=rr.Radius.ui_points(4),
                                                            labels=replay.names, show_labels=False))
        for row in replay.rows:
            self._at(row.index)
            projected = rr.Points2D(drawn(replay.projected(row)), colors=colour, radii=dot)
            normal = rr.Tensor(replay.normal(row), dim_names=["row", "column"], value_range=[-1, 1])
            self.stream.log(f"{image}/{replay.model}/camera", pose(replay.exterior(row)))
            self.stream.log(f"{image}/{replay.model}/rays", rr.LineStrips3D(replay.rays(row), colors=(*colour, 130), radii=thin))
            self.stream.log(f"{image}/photo/{replay.model}/projected", projected)
            self.stream.log(f"/normal/{where}", normal)
            level = "WARN" if row.stop in ("diverged", "max_iterations") else "INFO"
            self.stream.log(f"/log/{where}", rr.TextLog(sentence(replay, row), level=level, color=colour))
        for warning in orientation.warnings:
            self.stream.log(f"/log/{where}", rr.TextLog(f"{replay.image}, {replay.model}: {warning}", level="WARN", color=colour))
        self._series(replay, f"/plots/{where}", colour)

    def _series(self, replay: Replay, path: str, colour: theme.Colour) -> None:
        """Each scalar as it is in the trace; to be drawn, the decimal logarithm of those that fall by powers of ten, and the
        elements minus their final values. Few entities: a browser takes them in one by one."""
        import rerun as rr

        index = np.array([row.index for row in replay.rows])
        for name in SCALARS:
            values = np.array([getattr(row, name) for row in replay.rows], float)
            known = np.isfinite(values)
            self._columns(f"{path}/{name}", index[known], values[known])
        falling = np.array([[getattr(row, name) for name in LOGARITHMIC] for row in replay.rows], float)
        elements = np.array([replay.to_final(row) for row in replay.rows])
        logarithms = np.log10(np.where(falling > 0, falling, np.nan))
        for group, names, values in (("log10", [f"log10 {n}" for n in LOGARITHMIC], logarithms),
                                     ("position", [f"{n} [m]" for n in ELEMENTS[:3]], elements[:, :3]),
                                     ("attitude", [f"{n} [deg]" for n in ELEMENTS[3:]], elements[:, 3:])):
            names, shades = [f"{replay.model} {name}" for name in names], [shade(colour, i, 3) for i in range(3)]
            self._static(f"{path}/{group}", rr.SeriesLines(names=names, colors=shades, widths=[2.0] * 3))
            self._columns(f"{path}/{group}", index, values)

    def _columns(self, path: str, index: np.ndarray, values: np.ndarray) -> None:
        """values (rows,) or (rows, k)."""
        import rerun as rr

        if len(index):
            self.stream.send_columns(path, [rr.TimeColumn(TIMELINE, sequence=index)], rr.Scalars.columns(scalars=values))

    def residuals(self, replays: Sequence[Replay]) -> None:
        """Residual vectors of all models on one photo, in every row equally exaggerated, the factor written above the photo."""
        import rerun as rr

        image, width, thin = f"/images/{part(replays[0].image)}/photo", replays[0].camera.width, rr.Radius.ui_points(1)
        for index in range(max(len(r.rows) for r in replays)):
            self._at(index)
            found = [(r, r.projected(r.row(index))) for r in replays]
            longest = max((float(np.nanmax(np.linalg.norm(r.pixels - p, axis=1), initial=0.0)) for r, p in found), default=0.0)
            factor = nice(RESIDUAL_SHARE * width / max(longest, 1e-9 * width))
            for r, p in found:
                seen = np.isfinite(p).all(axis=1)
                ends = p + factor * (r.pixels - p)
                vectors = drawn(np.stack([p, ends], axis=1)[seen])
                strips = rr.LineStrips2D(vectors, colors=theme.MODELS[r.model], radii=thin)
                self.stream.log(f"{image}/{r.model}/residuals", strips)
            words, above = f"residuals × {factor:g}, the longest {longest:.3g} px", [[0.5 * width, -0.03 * width]]
            self.stream.log(f"{image}/scale", rr.Points2D(above, labels=[words], colors=theme.RESIDUAL, show_labels=True))

    def _static(self, path: str, *values: Any) -> None:
        self.stream.log(path, *values, static=True)

    def _at(self, index: int) -> None:
        self.stream.set_time(TIMELINE, sequence=index)


def _depth(replays: Sequence[Replay], site: np.ndarray) -> float:
    """Depth (m) of image planes: a seventh of the way to the ground."""
    if not replays:
        return 1.0
    far = np.median([np.linalg.norm(r.exterior(r.rows[-1]).centre - site.mean(axis=0)) for r in replays])
    return max(float(far) / 7, 1e-3)


def _identity(block: Block, replays: Sequence[Replay]) -> str:
    """The same run has the same identity, another run another."""
    digest = hashlib.sha256(block.name.encode())
    for replay in replays:
        digest.update(f"{replay.image}|{replay.model}|{replay.names}".encode())
        for row in replay.rows:
            digest.update(np.ascontiguousarray(row.x).tobytes())
    return digest.hexdigest()[:32]
