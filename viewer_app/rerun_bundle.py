"""A bundle as a rerun recording: all images, points and curves on the timeline "iteration", drawn in batches.

Entity paths: `/bundle/images` (frustums), `/bundle/points`, `/points/control`, `/points/check`, `/plots/bundle`,
`/log/bundle`, `/about`. Positions are metres in the block's local frame. Of a long trace only some rows are drawn.
"""

from __future__ import annotations

import hashlib
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.adjustment import SCALARS, Trace
from solvers.block import Block
from solvers.geometry import LocalFrame

from . import theme
from .rerun_values import about

if TYPE_CHECKING:
    from solvers.orientation import Adjusted

ROWS = 60
"""Rows of a trace that are drawn, at most; the first and the last are always."""
DRAWN = 20000
"""Points that are drawn in every row, at most."""


def record_bundle(path: str | Path, block: Block, adjusted: Adjusted) -> None:
    """Write the recording of an adjusted block, atomically."""
    import rerun as rr

    path, trace = Path(path), adjusted.trace
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    digest = hashlib.sha256(block.name.encode() + np.ascontiguousarray(trace.last.x).tobytes()).hexdigest()[:32]
    try:
        stream = rr.RecordingStream("collinea", recording_id=digest, send_properties=False)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        scene = _Scene(stream, block, adjusted)
        stream.save(unfinished, default_blueprint=scene.blueprint())
        with stream:
            stream.send_recording_name(block.name)
            scene.still()
            scene.rows()
            scene.curves()
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


class _Scene:
    """The block and its trace as rerun's values."""

    def __init__(self, stream: Any, block: Block, adjusted: Adjusted) -> None:
        self.stream, self.block, self.adjusted, self.trace = stream, block, adjusted, adjusted.trace
        manifest = self.trace.manifest
        self.m, self.k, self.n = len(manifest["images"]), len(manifest["cameras"]), len(manifest["points"])
        self.frame = LocalFrame.around(np.asarray(manifest["origin"], float)[None], block.crs, block.frame)
        centres, points = self._parts(self.trace, -1)[0][:, :3], self._parts(self.trace, -1)[1]
        far = np.median(np.linalg.norm(centres - np.median(points, axis=0), axis=1)) if len(points) else 1.0
        self.size = max(float(far) / 10, 1e-4)
        self.chosen = np.linspace(0, self.n - 1, min(self.n, DRAWN)).astype(int)

    def _parts(self, trace: Trace, row: int) -> tuple[np.ndarray, np.ndarray]:
        x = trace.rows[row].x
        a = 12 * self.m
        return x[:a].reshape(-1, 12), x[a + 10 * self.k:].reshape(-1, 3)[:self.n]

    def blueprint(self) -> Any:
        import rerun.blueprint as rrb

        poses, points = self._parts(self.trace, -1)
        seen = np.concatenate([points, poses[:, :3]])
        low, high = np.percentile(seen, [2, 98], axis=0)
        target, reach = (low + high) / 2, 1.2 * max(float(np.linalg.norm(high - low)), 1e-3)
        eye = rrb.EyeControls3D(position=target + reach * np.array([0.4, -0.65, 0.75]), look_target=target, eye_up=(0, 0, 1))
        space = rrb.Spatial3DView(origin="/", name="Block", contents=["/bundle/**", "/points/**"],
                                  background=theme.BACKGROUND_LIGHT, eye_controls=eye)
        curves = rrb.TimeSeriesView(origin="/plots/bundle/log10", name="Convergence (log10)")
        return rrb.Blueprint(
            rrb.Horizontal(space, rrb.Vertical(curves, rrb.TextLogView(origin="/log", name="Log"),
                                               rrb.TextDocumentView(origin="/about", name="About")), column_shares=[2, 1]),
            rrb.TimePanel(state="collapsed", timeline="iteration", fps=2.0, play_state="paused"),
            rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"), auto_views=False)

    def still(self) -> None:
        import rerun as rr

        log = partial(self.stream.log, static=True)
        log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log("/about", rr.TextDocument(about(self.block, self.frame), media_type=rr.MediaType.MARKDOWN))
        for role, colour in (("control", theme.CONTROL), ("check", theme.CHECK)):
            of = [p for p in self.adjusted.points if p.role == role]
            if of:
                xyz = self.frame.to_local(np.array([p.xyz for p in of]))
                log(f"/points/{role}", rr.Points3D(xyz, colors=colour, radii=rr.Radius.ui_points(4), labels=[p.name for p in of],
                                                   show_labels=len(of) <= 60))
        for warning in self.adjusted.warnings:
            log("/log/bundle/warnings", rr.TextLog(warning, level="WARN"))

    def rows(self) -> None:
        import rerun as rr

        count = len(self.trace)
        for row in np.unique(np.linspace(0, count - 1, min(count, ROWS)).astype(int)):
            poses, points = self._parts(self.trace, row)
            at = self.trace.rows[row]
            self.stream.set_time("iteration", sequence=at.index)
            self.stream.log("/bundle/images", rr.LineStrips3D(self._frustums(poses), colors=theme.PERSPECTIVE,
                                                              radii=rr.Radius.ui_points(1)))
            dots = rr.Points3D(points[self.chosen], colors=theme.INITIAL, radii=rr.Radius.ui_points(1.5))
            self.stream.log("/bundle/points", dots)
            moved = "" if at.index == 0 else f", step {at.step:.2e}, damping {at.damping:.1e}, {at.trials} trials"
            self.stream.log("/log/bundle", rr.TextLog(f"row {at.index}: cost {at.cost:.6g}, sigma0 {at.sigma0:.4g}{moved}"
                                                      + (f", stopped by {at.stop}" if at.stop else "")))

    def _frustums(self, poses: np.ndarray) -> list[np.ndarray]:
        """One strip for each image: its format in front of the centre, and the four edges."""
        out = []
        for i, row in enumerate(poses):
            camera = self.block.camera_of(self.trace.manifest["images"][i])
            half = np.array([camera.width, camera.height]) * camera.pitch / 2 / camera.c
            corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half
            rays = np.column_stack([corners, -np.ones(4)]) * self.size
            at = row[:3] + rays @ row[3:].reshape(3, 3)
            c = row[:3]
            out.append(np.array([at[0], at[1], c, at[2], at[1], c, at[0], at[3], c, at[2], at[3]]))
        return out

    def curves(self) -> None:
        import rerun as rr

        index = np.array([row.index for row in self.trace.rows])
        for name in SCALARS:
            values = self.trace.column(name).astype(float)
            known = np.isfinite(values)
            if known.any():
                self.stream.send_columns(f"/plots/bundle/{name}", [rr.TimeColumn("iteration", sequence=index[known])],
                                         rr.Scalars.columns(scalars=values[known]))
        falling = np.column_stack([self.trace.column(name).astype(float) for name in ("cost", "sigma0", "step")])
        with np.errstate(all="ignore"):
            logs = np.log10(np.where(falling > 0, falling, np.nan))
        names = ["log10 cost", "log10 sigma0", "log10 step"]
        self.stream.log("/plots/bundle/log10", rr.SeriesLines(names=names, widths=[2.0] * 3), static=True)
        when = [rr.TimeColumn("iteration", sequence=index)]
        self.stream.send_columns("/plots/bundle/log10", when, rr.Scalars.columns(scalars=logs))

