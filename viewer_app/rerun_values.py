"""Values of the project as rerun's own, and in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.adjustment import Iteration
from solvers.block import Block
from solvers.cameras import Interior
from solvers.geometry import Exterior, LocalFrame, to_opencv

from . import theme
from .replay import Replay

if TYPE_CHECKING:
    import rerun as rr


def pose(exterior: Exterior) -> rr.Transform3D:
    """From camera axes (x right, y down, z forward) to the local frame."""
    import rerun as rr

    r, centre = to_opencv(exterior)
    return rr.Transform3D(translation=centre, mat3x3=r.T)


def pinhole(camera: Interior, colour: theme.Colour, depth: float, photo: np.ndarray | None = None) -> rr.Pinhole:
    """The camera without its distortion, in pixels of the small photo if there is one (rerun counts from the corner)."""
    import rerun as rr

    height, width = (camera.height, camera.width) if photo is None else photo.shape[:2]
    scale = np.array([width / camera.width, height / camera.height])
    focal, centre = camera.c / camera.pitch * scale, (camera.pixels(camera.principal_point) + 0.5) * scale
    k = [[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]]
    return rr.Pinhole(image_from_camera=k, resolution=[width, height], image_plane_distance=depth, color=colour)


def drawn(pixels: np.ndarray) -> np.ndarray:
    """rerun counts pixels from the corner of the top-left one, photogrammetry here from its centre."""
    return pixels + 0.5


def shade(colour: theme.Colour, i: int, n: int) -> theme.Colour:
    """The i-th of n shades from the colour towards white."""
    r, g, b = (round(c + (255 - c) * 0.65 * i / n) for c in colour)
    return r, g, b


def sentence(replay: Replay, row: Iteration) -> str:
    start = f"{replay.image}, {replay.model}, row {row.index}: cost {row.cost:.6g}, sigma0 {row.sigma0:.4g}"
    moved = "" if row.index == 0 else f", step {row.step:.2e}, damping {row.damping:.1e}, {row.trials} trials"
    return start + moved + (f", stopped by {row.stop}" if row.stop else "")


def about(block: Block, frame: LocalFrame) -> str:
    """The page that opens with a recording: frame, origin, conventions and colours, in Markdown."""
    x, y, z = (f"{v:.10g}" for v in frame.origin)
    kind = "project coordinates minus the origin" if frame.cartesian else "tangent to the earth there, turned to grid north"
    colours = "\n".join(f"- {word}: rgb({r}, {g}, {b})" for word, (r, g, b) in theme.legend().items())
    return (f"# {block.name}\n\nMetres in the local frame of the block, {kind}.\n\n"
            f"- crs: {block.crs}\n- origin: X {x}, Y {y}, Z {z}\n\n"
            "Photo pixels are drawn from the corner of the top-left pixel: add 0.5 to the project's (0, 0 = its centre).\n"
            "Elements are drawn minus their final values. The normal matrix is that of X, Y, Z, omega, phi, kappa by\n"
            f"collinearity at each row, scaled to a unit diagonal.\n\n## Colours\n\n{colours}\n")
