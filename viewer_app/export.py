"""Scene values -> GLB or PLY by trimesh: terrain and everything else that has a place, colours as in the legend."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solvers import BadProject

from .state import State
from .values import (
    Ellipsoid,
    Ellipsoids,
    Frusta,
    Frustum,
    Mesh,
    Plane,
    PointCloud,
    Scene,
    Segments,
    Value,
    frusta_corners,
    frustum_corners,
    linear,
)

UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From z up to y up, as glTF has it."""
SITE = "site"


def where(state: State) -> dict[str, Any]:
    """What a file must say of its numbers: their unit, axes and origin."""
    frame = state.assets.frame
    axes = "x east, y north, z up" if frame.cartesian else "x east, y north, z up at the origin (local tangent frame)"
    return {"name": state.block.name, "unit": "metre", "axes": axes, "crs": frame.crs, "origin": [float(v) for v in frame.origin]}


def glb(scene: Scene, said: Mapping[str, Any] | None = None) -> bytes:
    """The scene as binary glTF, every entity a node under its own path, in a node that stands z up; said: `where` it is, which
    the file keeps as extras of the scene."""
    return bytes(_collect(scene, said or {}).export(file_type="glb"))


def ply(scene: Scene, said: Mapping[str, Any] | None = None) -> bytes:
    """Terrain, planes, ellipsoids and frustums as one coloured triangle mesh; said: `where` it is, as comments.

    Raises BadProject where there is nothing of the kind.
    """
    import trimesh

    meshes = [m for value in scene.values() if (m := _triangles(value)) is not None]
    if not meshes:
        raise BadProject("the scene has no surface, plane or camera to write as PLY yet; orient an image or give a height grid")
    mesh: Any = trimesh.util.concatenate(meshes)
    head, end, rest = bytes(mesh.export(file_type="ply")).partition(b"\n")
    form, line, rest = rest.partition(b"\n")
    comments = "".join(f"comment {k} {' '.join(str(v).split())}\n" for k, v in (said or {}).items())
    return head + end + form + line + comments.encode("ascii", "replace") + rest


def _collect(scene: Scene, said: Mapping[str, Any]) -> Any:
    import trimesh

    out = trimesh.Scene(metadata=dict(said))
    out.graph.update(frame_to=SITE, frame_from=out.graph.base_frame, matrix=UPRIGHT)
    for path, value in scene.items():
        solid = _triangles(value)
        if solid is not None:
            solid.visual.vertex_colors[:, :3] = linear(solid.visual.vertex_colors[:, :3])
        for kind, geometry in (("", solid), ("/lines", _lines(value))):
            if geometry is not None:
                out.add_geometry(geometry, node_name=path + kind, geom_name=path + kind, parent_node_name=SITE)
    return out


def _triangles(value: Value) -> Any:
    import trimesh

    if isinstance(value, Mesh):
        return trimesh.Trimesh(value.vertices, value.faces, vertex_colors=value.colours, process=False)
    if isinstance(value, Plane):
        return _painted(value.corners, [[0, 1, 2], [0, 2, 3]], value.colour, value.opacity)
    if isinstance(value, Ellipsoid):
        ball = trimesh.creation.icosphere(subdivisions=3)
        return _painted((ball.vertices * value.radii) @ value.axes.T + value.centre, ball.faces, value.colour, value.opacity)
    if isinstance(value, Ellipsoids):
        ball = trimesh.creation.icosphere(subdivisions=2)
        shaped = (ball.vertices[None] * value.radii[:, None]) @ np.swapaxes(value.axes, 1, 2) + value.centres[:, None]
        balls = ball.faces[None] + len(ball.vertices) * np.arange(len(shaped))[:, None, None]
        return _painted(shaped.reshape(-1, 3), balls.reshape(-1, 3), value.colour, value.opacity)
    if isinstance(value, Frustum):
        faces = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [1, 2, 3], [1, 3, 4]]
        return _painted(np.vstack([value.exterior.centre, frustum_corners(value)]), faces, value.colour, 0.35)
    if isinstance(value, Frusta):
        corners = np.concatenate([value.centres[:, None], frusta_corners(value)], axis=1)
        faces = np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [1, 2, 3], [1, 3, 4]])
        every = (faces[None] + 5 * np.arange(len(corners))[:, None, None]).reshape(-1, 3)
        return _painted(corners.reshape(-1, 3), every, value.colour, 1.0)
    return None


def _painted(vertices: Any, faces: Any, colour: tuple[int, int, int], opacity: float) -> Any:
    import trimesh

    rgba = np.tile(np.array([*colour, round(255 * opacity)], np.uint8), (len(vertices), 1))
    return trimesh.Trimesh(vertices, faces, vertex_colors=rgba, process=False)


def _lines(value: Value) -> Any:
    from trimesh import PointCloud as Cloud
    from trimesh.path import Path3D
    from trimesh.path.entities import Line

    if isinstance(value, PointCloud):
        return Cloud(value.points, colors=value.colours)
    if isinstance(value, Segments) and len(value.points):
        colour = np.array([*value.colour, 255], np.uint8)
        entities = [Line([2 * i, 2 * i + 1], color=colour) for i in range(len(value.points))]
        return Path3D(entities=entities, vertices=value.points.reshape(-1, 3), process=False)
    return None
