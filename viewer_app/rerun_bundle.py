"""A bundle as a rerun recording: all images, points and curves on the timeline "iteration", drawn in batches.

It begins with the adjustment and grows with every row (`Live`); at the end it is written anew with what the end is worth.
Entity paths: `/bundle/images` (frustums), `/bundle/points`, `/points/control`, `/points/check`, `/plots/bundle`,
`/log/bundle`, `/about`. Positions are metres in the block's local frame. Of a long trace only some rows are drawn.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.adjustment import SCALARS, Iteration, Trace
from solvers.block import Block
from solvers.geometry import LocalFrame

from . import theme
from .ground import nice
from .rerun_layout import APPLICATION, as_bytes, hide, part, unnamed
from .rerun_shown import BUNDLE, EVERYTHING, Shown
from .rerun_values import about
from .scene import CHI_95

if TYPE_CHECKING:
    from solvers.orientation import Adjusted

ROWS = 60
"""Rows of a trace that are drawn, at most; the first and the last are always."""
NAMED = 24
"""Known points up to which their names are shown, not only told where one points at them."""
DRAWN = 20000
"""Points that are drawn in every row, at most."""
SWOLLEN, PHOTOS = 300, 60
"""Ellipsoids of one kind, the largest, and photos with their residuals, the worst, at most."""


def record_bundle(path: str | Path, block: Block, adjusted: Adjusted, shown: Shown = EVERYTHING) -> None:
    """Write the recording of an adjusted block, atomically. shown: with what it opens."""
    import rerun as rr

    path, trace = Path(path), adjusted.trace
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    digest = hashlib.sha256(block.name.encode() + np.ascontiguousarray(trace.last.x).tobytes()).hexdigest()[:32]
    try:
        stream = rr.RecordingStream(APPLICATION, recording_id=digest, send_properties=False)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        scene = _Scene(stream, block, trace.manifest, trace.last.x)
        scene.look_at(worst_image(adjusted))
        stream.save(unfinished, default_blueprint=scene.blueprint(shown))
        with stream:
            stream.send_recording_name(block.name)
            scene.still()
            scene.end(adjusted)
            scene.worth(adjusted)
            scene.photos(adjusted)
            scene.rows(trace)
            scene.curves(trace)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def worst_image(adjusted: Adjusted) -> str:
    """Its image of the largest residuals, "" where there is none."""
    return max(adjusted.orientations, key=lambda o: o.rms_px).image if adjusted.orientations else ""


def bundle_layout(block: Block, manifest: Mapping[str, Any], x: np.ndarray, worst: str, shown: Shown) -> bytes:
    """How that recording is laid out from now on, for a page that has it open (`Served.lay_out`). x: of its last row; worst: the
    image whose residuals are shown, "" where there are none."""
    scene = _Scene(None, block, manifest, x)
    scene.look_at(worst)
    return as_bytes(scene.blueprint(shown))


def _quaternions(m: np.ndarray) -> np.ndarray:
    """(n, 4) x y z w of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(m).as_quat()


class Live:
    """The recording of an adjustment that is still going on: a row is in the file as soon as it is known."""

    def __init__(self, path: str | Path, block: Block, manifest: Mapping[str, Any], x0: np.ndarray) -> None:
        import rerun as rr

        self._stream = rr.RecordingStream(APPLICATION, recording_id=hashlib.sha256(f"{path}".encode()).hexdigest()[:32],
                                          send_properties=False)
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._scene = _Scene(self._stream, block, manifest, x0)
        self._stream.save(path, default_blueprint=self._scene.blueprint())
        self._stream.send_recording_name(block.name)  # not within `with`, which would end the stream
        self._scene.still()

    def row(self, row: Iteration) -> None:
        """Draw it and its figures; of a long adjustment only some rows."""
        if row.index < ROWS or row.index % 10 == 0 or row.stop:
            self._scene.row(row)
            self._scene.figures(row)
            self._stream.flush()

    def close(self) -> None:
        """The file is complete."""
        self._stream.flush()
        self._stream.disconnect()


class _Scene:
    """The block and its trace as rerun's values."""

    def __init__(self, stream: Any, block: Block, manifest: Mapping[str, Any], x: np.ndarray) -> None:
        self.stream, self.block, self.manifest, self.x = stream, block, manifest, x
        self.m, self.k, self.n = len(manifest["images"]), len(manifest["cameras"]), len(manifest["points"])
        self.frame = LocalFrame.around(np.asarray(manifest["origin"], float)[None], block.crs, block.frame)
        poses, points = self._parts(x)
        far = np.median(np.linalg.norm(poses[:, :3] - np.median(points, axis=0), axis=1)) if len(points) else 1.0
        size = max(float(far) / 10, 1e-4)
        self.worst = "/photos/**"
        self.chosen = np.linspace(0, self.n - 1, min(self.n, DRAWN)).astype(int)
        cameras = [block.camera_of(name) for name in manifest["images"]]
        half = np.array([np.array([c.width, c.height]) * c.pitch / 2 / c.c for c in cameras]).reshape(-1, 1, 2)
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half
        self.rays = np.concatenate([corners, np.full((self.m, 4, 1), -1.0)], axis=2) * size  # (m, 4, 3) photo axes

    def _parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a = 12 * self.m
        return x[:a].reshape(-1, 12), x[a + 10 * self.k:a + 10 * self.k + 3 * self.n].reshape(-1, 3)

    def look_at(self, image: str) -> None:
        """Its residuals are those shown; all where it is ""."""
        self.worst = f"/photos/{part(image)}/**" if image else "/photos/**"

    def blueprint(self, shown: Shown = EVERYTHING) -> Any:
        import rerun.blueprint as rrb

        poses, points = self._parts(self.x)
        seen = np.concatenate([points, poses[:, :3]])
        low, high = np.percentile(seen, [2, 98], axis=0)
        target, reach = (low + high) / 2, 1.2 * max(float(np.linalg.norm(high - low)), 1e-3)
        eye = rrb.EyeControls3D(position=target + reach * np.array([0.4, -0.65, 0.75]), look_target=target, eye_up=(0, 0, 1))
        hidden = hide(path for name, path in BUNDLE.items() if name in shown.hidden) | unnamed(shown)
        space = rrb.Spatial3DView(origin="/", name="Block", contents=["/bundle/**", "/points/**"],
                                  background=theme.background(shown.dark), eye_controls=eye, overrides=hidden)
        curves = rrb.TimeSeriesView(origin="/plots/bundle/log10", name="Convergence (log10)")
        photo = rrb.Spatial2DView(origin="/photos", name="Residuals in the worst photo", contents=self.worst)
        return rrb.Blueprint(
            rrb.Horizontal(space, rrb.Vertical(curves, rrb.Tabs(photo, rrb.TextLogView(origin="/log", name="Log"),
                                                                rrb.TextDocumentView(origin="/about", name="About"),
                                                                active_tab=0)), column_shares=[3, 2]),
            rrb.TimePanel(state="collapsed", timeline="iteration", fps=2.0, play_state="following"),
            rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed"), auto_views=False)

    def still(self) -> None:
        import rerun as rr

        log = partial(self.stream.log, static=True)
        log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log("/about", rr.TextDocument(about(self.block, self.frame), media_type=rr.MediaType.MARKDOWN))
        names = ["log10 cost", "log10 sigma0", "log10 step"]
        log("/plots/bundle/log10", rr.SeriesLines(names=names, widths=[2.0] * 3))

    def end(self, adjusted: Adjusted) -> None:
        """What holds for the end alone: known points, what they differ by, error ellipsoids, warnings."""
        import rerun as rr

        log = partial(self.stream.log, static=True)
        few = sum(p.role != "tie" for p in adjusted.points) <= NAMED
        for role, colour in (("control", theme.CONTROL), ("check", theme.CHECK)):
            of = [p for p in adjusted.points if p.role == role]
            if of:
                xyz = self.frame.to_local(np.array([p.xyz for p in of]))
                log(f"/points/{role}", rr.Points3D(xyz, colors=colour, radii=rr.Radius.ui_points(4), labels=[p.name for p in of],
                                                   show_labels=few))
        for warning in adjusted.warnings:
            log("/log/bundle/warnings", rr.TextLog(warning, level="WARN"))

    def worth(self, adjusted: Adjusted) -> None:
        """Vectors from given to adjusted known points, 95 % ellipsoids of images and points, exaggerated as the log says."""
        import rerun as rr

        self.stream.set_time("iteration", sequence=adjusted.trace.last.index)
        poses, points = self._parts(adjusted.trace.last.x)
        extent = float(np.ptp(np.percentile(np.concatenate([points, poses[:, :3]]), [2, 98], axis=0), axis=0).max())
        off = {p.name: p.off for p in adjusted.points if p.role != "tie" and np.isfinite(p.off).all()}
        longest = max((float(np.linalg.norm(v)) for v in off.values()), default=0.0)
        factor = nice(extent / 6 / longest) if longest > 0 else 1.0  # fixed control does not move
        for role, colour in (("control", theme.CONTROL), ("check", theme.RESIDUAL)):
            of = [k for k, p in enumerate(adjusted.points) if p.role == role and p.name in off]
            if of:
                v = np.array([off[adjusted.points[k].name] for k in of])
                self.stream.log(f"/bundle/vectors/{role}", rr.Arrows3D(origins=points[of] - v, vectors=factor * v, colors=colour))
        if not adjusted.trace.converged:
            self.stream.log("/log/bundle", rr.TextLog(f"vectors are drawn {factor:g} times their size; ellipsoids hold only for "
                                                      "the minimum, which was not reached"))
            return
        kinds = {"images": (poses[:, :3], np.array([o.covariance[:3, :3] for o in adjusted.orientations]), theme.PERSPECTIVE),
                 "points": (points, np.array([p.covariance for p in adjusted.points]).reshape(-1, 3, 3), theme.INITIAL)}
        largest = {k: np.sqrt(np.maximum(np.linalg.eigvalsh(q)[:, -1], 0)) for k, (_, q, _) in kinds.items()}
        usual = float(np.percentile(np.concatenate(list(largest.values())), 90))
        apart = max(10.0, 3 * self.m**0.5)
        swell = nice(extent / apart / (CHI_95 * usual)) if usual > 0 else 1.0
        few = f"; of {self.n} points only the {SWOLLEN} largest ellipsoids are drawn" if self.n > SWOLLEN else ""
        for name, (at, q, colour) in kinds.items():
            rows = np.argsort(-largest[name], kind="stable")[:SWOLLEN]
            values, axes = np.linalg.eigh(q[rows])
            axes[np.linalg.det(axes) < 0, :, 0] *= -1
            self.stream.log(f"/bundle/ellipsoids/{name}", rr.Ellipsoids3D(
                centers=at[rows], half_sizes=CHI_95 * swell * np.sqrt(np.maximum(values, 0)), quaternions=_quaternions(axes),
                colors=colour, line_radii=rr.Radius.ui_points(0.5)))
        self.stream.log("/log/bundle", rr.TextLog(f"95 % ellipsoids are drawn {swell:g} times, vectors {factor:g} times "
                                                  "their size" + few))

    def photos(self, adjusted: Adjusted) -> None:
        """Residuals of the images on their formats at the last row, the worst first, exaggerated."""
        import rerun as rr

        of, names = self.block.observations, self.block.points.names
        for o in sorted(adjusted.orientations, key=lambda o: -o.rms_px)[:PHOTOS]:
            camera = self.block.camera_of(o.image)
            index = {names[of.point[r]]: r for r in np.flatnonzero(of.image == self.block.image_index(o.image))}
            at = of.pixel[[index[p] for p in o.points]]
            factor = nice(camera.width / 12 / max(o.rms_px, 1e-6))
            path = f"/photos/{part(o.image)}"
            label = f"{o.image}: rms {o.rms_px:.2f} px, drawn {factor:g} times"
            box = rr.Boxes2D(mins=[[0, 0]], sizes=[[camera.width, camera.height]], colors=theme.INITIAL, labels=[label])
            log = partial(self.stream.log, static=True)  # of the last row, whichever is shown
            log(f"{path}/format", box)
            log(f"{path}/residuals", rr.Arrows2D(origins=at, vectors=factor * o.residuals, colors=theme.RESIDUAL))
            log(f"{path}/marks", rr.Points2D(at, colors=theme.CONTROL, labels=list(o.points), show_labels=False))

    def rows(self, trace: Trace) -> None:
        """Some rows of a trace, the first and the last among them."""
        count = len(trace)
        for row in np.unique(np.linspace(0, count - 1, min(count, ROWS)).astype(int)):
            self.row(trace.rows[row])

    def row(self, at: Iteration) -> None:
        """Images and points of a row, in two entities."""
        import rerun as rr

        poses, points = self._parts(at.x)
        self.stream.set_time("iteration", sequence=at.index)
        self.stream.log("/bundle/images", rr.LineStrips3D(self._frustums(poses), colors=theme.PERSPECTIVE,
                                                          radii=rr.Radius.ui_points(1)))
        dots = rr.Points3D(points[self.chosen], colors=theme.INITIAL, radii=rr.Radius.ui_points(1.5))
        self.stream.log("/bundle/points", dots)
        moved = "" if at.index == 0 else f", step {at.step:.2e}, damping {at.damping:.1e}, {at.trials} trials"
        self.stream.log("/log/bundle", rr.TextLog(f"row {at.index}: cost {at.cost:.6g}, sigma0 {at.sigma0:.4g}{moved}"
                                                  + (f", stopped by {at.stop}" if at.stop else "")))

    def figures(self, at: Iteration) -> None:
        """The scalars of a row."""
        import rerun as rr

        self.stream.set_time("iteration", sequence=at.index)
        for name in SCALARS:
            if np.isfinite(value := float(getattr(at, name))):
                self.stream.log(f"/plots/bundle/{name}", rr.Scalars(value))
        with np.errstate(all="ignore"):
            logs = np.log10([v if v > 0 else np.nan for v in (at.cost, at.sigma0, at.step)])
        self.stream.log("/plots/bundle/log10", rr.Scalars(logs))

    def _frustums(self, poses: np.ndarray) -> np.ndarray:
        """(m, 11, 3) one strip for each image: its format in front of the centre, and the four edges."""
        at = poses[:, None, :3] + self.rays @ poses[:, 3:].reshape(-1, 3, 3)
        return np.concatenate([at, poses[:, None, :3]], axis=1)[:, [0, 1, 4, 2, 1, 4, 0, 3, 4, 2, 3]].astype(np.float32)

    def curves(self, trace: Trace) -> None:
        import rerun as rr

        index = np.array([row.index for row in trace.rows])
        for name in SCALARS:
            values = trace.column(name).astype(float)
            known = np.isfinite(values)
            if known.any():
                self.stream.send_columns(f"/plots/bundle/{name}", [rr.TimeColumn("iteration", sequence=index[known])],
                                         rr.Scalars.columns(scalars=values[known]))
        falling = np.column_stack([trace.column(name).astype(float) for name in ("cost", "sigma0", "step")])
        with np.errstate(all="ignore"):
            logs = np.log10(np.where(falling > 0, falling, np.nan))
        when = [rr.TimeColumn("iteration", sequence=index)]
        self.stream.send_columns("/plots/bundle/log10", when, rr.Scalars.columns(scalars=logs))

