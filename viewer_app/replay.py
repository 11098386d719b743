"""What a resection saw at each of its rows, recomputed from the parameters of the row; pure, in the local frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solvers.adjustment import Iteration, Linear, Trace
from solvers.block import Block
from solvers.cameras import PARAMETERS, Interior, project, project_derivatives
from solvers.geometry import Exterior, LocalFrame, angle_derivatives

ELEMENTS = ("X", "Y", "Z", "omega", "phi", "kappa")
"""Exterior orientation as people read it: m and degrees."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One image by one model. names, kinds (n,): "control" takes part, "check" and "off" are shown beside it; xyz (n, 3) m;
    pixels (n, 2). Of the m control points, which come first: sigma_px (m,) px and sigma_m (m, 3) m, a priori.
    """

    image: str
    model: str
    rows: tuple[Iteration, ...]
    columns: tuple[str, ...]
    camera: Interior
    names: tuple[str, ...]
    kinds: tuple[str, ...]
    xyz: np.ndarray
    pixels: np.ndarray
    sigma_px: np.ndarray
    sigma_m: np.ndarray

    @classmethod
    def of(cls, trace: Trace, block: Block, frame: LocalFrame) -> Replay:
        """From a trace and the block it belongs to, whose other points in the same image are shown beside the control."""
        manifest, of, points = trace.manifest, block.observations, block.points
        image, used = str(manifest["image"]), tuple(manifest["points"])
        rows = block.seen_in(image, ("control", "check"))
        others = np.array([name not in used for name in points.names], bool) & np.asarray(np.isfinite(points.xyz).all(axis=1))
        rows = rows[others[of.point[rows]]]
        beside = of.point[rows]
        return cls(
            image=image, model=str(manifest["model"]), rows=trace.rows, columns=tuple(manifest["columns"]),
            camera=Interior(**manifest["camera"]), names=(*used, *(points.names[j] for j in beside)),
            kinds=(*("control" for _ in used), *("check" if points.role[j] == "check" else "off" for j in beside)),
            xyz=np.concatenate([np.reshape(manifest["xyz"], (-1, 3)), frame.to_local(points.xyz[beside]).reshape(-1, 3)]),
            pixels=np.concatenate([np.reshape(manifest["pixels"], (-1, 2)), of.pixel[rows]]),
            sigma_px=np.asarray(manifest["sigma"], float), sigma_m=np.reshape(manifest["sigma_m"], (-1, 3)),
        )

    def row(self, index: int) -> Iteration:
        """The row shown at a position of the timeline: the last one when the trace ended earlier."""
        return self.rows[min(index, len(self.rows) - 1)]

    def exterior(self, row: Iteration) -> Exterior:
        return Exterior.from_vector(row.x)

    def interior(self, row: Iteration) -> Interior:
        """The camera of a row: freed parameters stand behind the twelve of the pose."""
        freed = {name: float(v) for name, v in zip(self.columns[12:], row.x[12:], strict=False) if name in PARAMETERS}
        return replace(self.camera, **freed) if freed else self.camera

    def projected(self, row: Iteration) -> np.ndarray:
        """(n, 2) px; NaN behind the camera."""
        return project(self.interior(row), self.exterior(row), self.xyz)

    def rays(self, row: Iteration) -> np.ndarray:
        """(m, 2, 3) m of the control: from the perspective centre through the measured point to the object point's depth."""
        exterior, interior, m = self.exterior(row), self.interior(row), len(self.sigma_px)
        photo = interior.ideal(self.pixels[:m])
        directions = np.column_stack([photo, np.full(len(photo), -interior.c)]) @ exterior.m
        depth = np.abs(exterior.camera(self.xyz[:m])[:, 2]) / interior.c
        ends = exterior.centre + depth[:, None] * directions
        return np.stack([np.broadcast_to(exterior.centre, ends.shape), ends], axis=1)

    def elements(self, row: Iteration) -> np.ndarray:
        """(6,) `ELEMENTS`."""
        exterior = self.exterior(row)
        return np.concatenate([exterior.centre, np.degrees(exterior.angles)])

    def to_final(self, row: Iteration) -> np.ndarray:
        """(6,) elements minus those of the last row; angles the short way round."""
        difference = self.elements(row) - self.elements(self.rows[-1])
        difference[3:] = (difference[3:] + 180.0) % 360.0 - 180.0
        return difference

    def normal(self, row: Iteration) -> np.ndarray:
        """(6, 6) normal matrix of the elements by collinearity at the row, scaled to a unit diagonal; control behind the
        camera is left out. Off the diagonal: cosines, how alike two elements act on the measurements."""
        m = len(self.sigma_px)
        at = project_derivatives(self.interior(row), self.exterior(row), self.xyz[:m])
        by_angles = at.rotation @ np.linalg.pinv(angle_derivatives(self.exterior(row).m))
        j = np.concatenate([at.centre, by_angles], axis=2)
        covariance = self.sigma_px[:, None, None] ** 2 * np.eye(2)
        covariance = covariance + (at.point * self.sigma_m[:, None, :] ** 2) @ np.swapaxes(at.point, 1, 2)
        seen = np.isfinite(j).all(axis=(1, 2))
        linear = Linear((self.pixels[:m] - at.pixels)[seen], j[seen], np.linalg.inv(covariance[seen]))
        return linear.normal().scaled

