"""Scene values -> viser nodes. Only what changed since the last painting is sent, in one atomic block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np
import viser
import viser.transforms as tf

from solvers import Exterior
from solvers.geometry import to_opencv

from .glb import coloured_mesh
from .tones import sent
from .values import (
    Ellipsoid,
    Ellipsoids,
    Frusta,
    Frustum,
    Label,
    Mesh,
    Overlay,
    Picture,
    Plane,
    PointCloud,
    Scene,
    Segments,
    Value,
    linear,
)


class Painter:
    """Keeps what the browsers show; `paint` makes it equal to a scene. sent: nodes touched by the last painting."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._shown: Scene = {}
        self._nodes: dict[str, list[Any]] = {}
        self.sent = 0

    def paint(self, scene: Scene) -> None:
        self.sent = 0
        with self._server.atomic():
            for path in [p for p in self._shown if p not in scene]:
                self._remove(path)
            todo = scene
            while todo:
                for path, value in todo.items():
                    self._show(path, value)
                todo = {path: value for path, value in scene.items() if path not in self._shown}

    def _show(self, path: str, value: Value) -> None:
        old = self._shown.get(path)
        if old is value or (old is not None and equal(old, value)):
            return
        self.sent += 1
        if old is None or type(old) is not type(value) or not self._change(path, old, value):
            self._remove(path)
            self._nodes[path] = ADD[type(value)](self._server.scene, path, value)
        self._shown[path] = value

    def _remove(self, path: str) -> None:
        """A node leaves, and with it all below it, as viser has it."""
        for node in self._nodes.pop(path, []):
            node.remove()
        for gone in [p for p in self._shown if p == path or p.startswith(f"{path}/")]:
            self._nodes.pop(gone, None)
            del self._shown[gone]

    def _change(self, path: str, old: Value, new: Value) -> bool:
        """Change nodes in place; False where they have to be made anew."""
        change = CHANGE.get(type(new))
        return bool(change and change(self._nodes[path], old, new))


def equal(a: Value, b: Value) -> bool:
    """Whether two scene values look the same."""
    return type(a) is type(b) and all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))


def _same(a: Any, b: Any) -> bool:
    if a is b:
        return True
    if isinstance(a, Exterior) and isinstance(b, Exterior):
        return np.array_equal(a.vector, b.vector)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    return type(a) is type(b) and not isinstance(a, np.ndarray) and bool(a == b)


def frustum_pose(exterior: Exterior) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion wxyz (camera axes x right, y down, z forward -> object axes) and position, as viser wants them."""
    r, centre = to_opencv(exterior)
    return tf.SO3.from_matrix(r.T).wxyz, centre


def _frustum_scale(value: Frustum) -> float:
    """viser's `scale` that puts the image plane at the value's depth (viser keeps the volume, not the depth)."""
    y = np.tan(value.fov / 2)
    return value.depth * float(np.cbrt(y * y * value.aspect / 3))


def _add_frustum(scene: viser.SceneApi, path: str, value: Frustum) -> list[Any]:
    wxyz, position = frustum_pose(value.exterior)
    return [
        scene.add_camera_frustum(
            path,
            value.fov,
            value.aspect,
            scale=_frustum_scale(value),
            thickness=value.thickness,
            thickness_units="screen",
            color=sent(value.colour),
            image=value.image,
            format="jpeg",
            jpeg_quality=80,
            wxyz=wxyz,
            position=position,
            cast_shadow=False,
            receive_shadow=False,
        )
    ]


def _change_frustum(nodes: list[Any], old: Frustum, new: Frustum) -> bool:
    if (old.fov, old.aspect, old.colour) != (new.fov, new.aspect, new.colour) or old.image is not new.image:
        return False
    node = nodes[0]
    if not _same(old.exterior, new.exterior):
        node.wxyz, node.position = frustum_pose(new.exterior)
    if old.depth != new.depth:
        node.scale = _frustum_scale(new)
    if old.thickness != new.thickness:
        node.thickness = new.thickness
    return True


PYRAMID = np.array([[0, 0, 0], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [1, 3, 2], [1, 4, 3]], np.uint32)


def _frusta_poses(value: Frusta) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions (n, 4) and centres (n, 3), float32."""
    turned = np.swapaxes(value.matrices, 1, 2) * np.array([1.0, -1.0, -1.0])  # photo axes to x right, y down, z forward
    return _quaternions(turned).astype(np.float32), value.centres.astype(np.float32)


def _quaternions(r: np.ndarray) -> np.ndarray:
    """wxyz (n, 4) of rotation matrices (n, 3, 3). Reference: Shepperd 1978, "Quaternion from rotation matrix"."""
    d = np.diagonal(r, axis1=1, axis2=2)
    trace = d.sum(axis=1)
    size = np.column_stack([1 + trace, 1 + 2 * d - trace[:, None]])
    a, b, c = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    e, f, g = r[:, 1, 0] + r[:, 0, 1], r[:, 0, 2] + r[:, 2, 0], r[:, 2, 1] + r[:, 1, 2]
    rows = np.stack(
        [
            np.stack([size[:, 0], a, b, c], axis=1),
            np.stack([a, size[:, 1], e, f], axis=1),
            np.stack([b, e, size[:, 2], g], axis=1),
            np.stack([c, f, g, size[:, 3]], axis=1),
        ],
        axis=1,
    )
    best = rows[np.arange(len(r)), size.argmax(axis=1)]
    return best / np.linalg.norm(best, axis=1, keepdims=True)


def _add_frusta(scene: viser.SceneApi, path: str, value: Frusta) -> list[Any]:
    wxyz, positions = _frusta_poses(value)
    scales = (np.column_stack([value.half, np.ones(len(value.half))]) * value.depth).astype(np.float32)
    return [
        scene.add_batched_meshes_simple(
            path,
            PYRAMID,
            FACES,
            wxyz,
            positions,
            batched_scales=scales,
            batched_colors=linear(np.array(value.colour, np.uint8)),
            lod="off",
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
    ]


def _change_frusta(nodes: list[Any], old: Frusta, new: Frusta) -> bool:
    same = len(old.centres) == len(new.centres) and old.depth == new.depth and old.colour == new.colour
    if not same or not _same(old.half, new.half):
        return False
    nodes[0].batched_wxyzs, nodes[0].batched_positions = _frusta_poses(new)
    return True


def _add_segments(scene: viser.SceneApi, path: str, value: Segments) -> list[Any]:
    return [
        scene.add_line_segments(
            path, value.points.astype(np.float32), sent(value.colour), thickness=value.thickness, thickness_units="screen"
        )
    ]


def _change_segments(nodes: list[Any], old: Segments, new: Segments) -> bool:
    if old.colour != new.colour or old.thickness != new.thickness:
        return False
    nodes[0].points = new.points.astype(np.float32)
    return True


def _add_cloud(scene: viser.SceneApi, path: str, value: PointCloud) -> list[Any]:
    return [
        scene.add_point_cloud(
            path, value.points.astype(np.float32), value.colours, point_size=value.size, point_shape="circle",
            point_shading="flat", precision="float32",  # shaded, it would have its legend's colour half way out alone
        )
    ]


def _add_ellipsoid(scene: viser.SceneApi, path: str, value: Ellipsoid) -> list[Any]:
    vertices, faces = _sphere()
    radii = tuple(float(r) for r in value.radii)
    return [
        scene.add_mesh_simple(
            path,
            vertices,
            faces,
            color=value.colour,
            opacity=value.opacity,
            scale=(radii[0], radii[1], radii[2]),
            wxyz=tf.SO3.from_matrix(value.axes).wxyz,
            position=value.centre,
            cast_shadow=False,
            receive_shadow=False,
        )
    ]


def _change_ellipsoid(nodes: list[Any], old: Ellipsoid, new: Ellipsoid) -> bool:
    if (old.colour, old.opacity) != (new.colour, new.opacity):
        return False
    node = nodes[0]
    node.scale = tuple(float(r) for r in new.radii)
    node.wxyz, node.position = tf.SO3.from_matrix(new.axes).wxyz, new.centre
    return True


def _add_ellipsoids(scene: viser.SceneApi, path: str, value: Ellipsoids) -> list[Any]:
    vertices, faces = _sphere(9, 16)
    return [
        scene.add_batched_meshes_simple(
            path,
            vertices,
            faces,
            _quaternions(value.axes).astype(np.float32),
            value.centres.astype(np.float32),
            batched_scales=value.radii.astype(np.float32),
            batched_colors=linear(np.array(value.colour, np.uint8)),
            opacity=value.opacity,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
    ]


def _change_cloud(nodes: list[Any], old: PointCloud, new: PointCloud) -> bool:
    if len(old.points) != len(new.points):
        return False
    node = nodes[0]
    node.points = new.points.astype(np.float32)
    if old.colours is not new.colours:
        node.colors = new.colours
    if old.size != new.size:
        node.point_size = new.size
    return True


def _add_plane(scene: viser.SceneApi, path: str, value: Plane) -> list[Any]:
    return [
        scene.add_mesh_simple(
            path,
            value.corners.astype(np.float32),
            np.array([[0, 1, 2], [0, 2, 3]]),
            color=value.colour,
            opacity=value.opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
    ]


def _change_plane(nodes: list[Any], old: Plane, new: Plane) -> bool:
    if (old.colour, old.opacity) != (new.colour, new.opacity):
        return False
    nodes[0].vertices = new.corners.astype(np.float32)
    return True


def _add_mesh(scene: viser.SceneApi, path: str, value: Mesh) -> list[Any]:
    mesh = coloured_mesh(value.vertices, value.faces, linear(value.colours))
    return [scene.add_glb(path, mesh, position=(0.0, 0.0, -value.lower), cast_shadow=False, receive_shadow=False)]


def _add_picture(scene: viser.SceneApi, path: str, value: Picture) -> list[Any]:
    """viser spreads a picture over the x and y axes of its node, y downwards."""
    rgba = np.ascontiguousarray(value.rgba)
    if value.opacity < 1:
        rgba = rgba.copy()
        rgba[..., 3] = np.round(rgba[..., 3] * value.opacity)
    solid = bool((rgba[..., 3] == 255).all())
    wxyz, position, width, height = _picture_pose(value)
    return [
        scene.add_image(
            path,
            np.ascontiguousarray(rgba[..., :3]) if solid else rgba,
            width,
            height,
            format="jpeg" if solid else "png",
            jpeg_quality=88,
            cast_shadow=False,
            receive_shadow=False,
            wxyz=wxyz,
            position=position,
        )
    ]


def _picture_pose(value: Picture) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Quaternion and middle of a picture, its width and height [m]."""
    top_left, top_right, _, bottom_left = np.asarray(value.corners, float)
    x, y = top_right - top_left, bottom_left - top_left
    width, height = float(np.linalg.norm(x)), float(np.linalg.norm(y))
    x = x / width
    y = y / height - x * float(x @ y) / height
    y = y / np.linalg.norm(y)
    turn = np.stack([x, y, np.cross(x, y)], axis=1)
    return tf.SO3.from_matrix(turn).wxyz, np.asarray(value.corners, float).mean(axis=0), width, height


def _change_picture(nodes: list[Any], old: Picture, new: Picture) -> bool:
    if old.rgba is not new.rgba or old.opacity != new.opacity:
        return False
    node = nodes[0]
    node.wxyz, node.position, node.render_width, node.render_height = _picture_pose(new)
    return True


def _add_label(scene: viser.SceneApi, path: str, value: Label) -> list[Any]:
    return [scene.add_label(path, value.text, position=value.position, font_screen_scale=value.size, anchor=value.anchor)]


def _change_label(nodes: list[Any], old: Label, new: Label) -> bool:
    if old.anchor != new.anchor:
        return False
    node = nodes[0]
    if old.size != new.size:
        node.font_screen_scale = new.size
    if old.text != new.text:
        node.text = new.text
    node.position = new.position
    return True


def _add_overlay(scene: viser.SceneApi, path: str, value: Overlay) -> list[Any]:
    from .overlay import textured_glb

    return [scene.add_glb(path, textured_glb(value), cast_shadow=False, receive_shadow=False)]


def _change_overlay(nodes: list[Any], old: Overlay, new: Overlay) -> bool:
    from .overlay import textured_glb

    nodes[0].glb_data = textured_glb(new)
    return True


@lru_cache(maxsize=2)
def _sphere(rows: int = 17, columns: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a unit sphere, by latitude and longitude."""
    lat, lon = np.linspace(-np.pi / 2, np.pi / 2, rows), 2 * np.pi * np.arange(columns) / columns
    a, b = np.meshgrid(lat, lon, indexing="ij")
    vertices = np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    p, q = i * columns + j, i * columns + (j + 1) % columns
    faces = np.concatenate([np.stack([p, q, q + columns], axis=-1), np.stack([p, q + columns, p + columns], axis=-1)]).reshape(
        -1, 3
    )
    return vertices.astype(np.float32), faces.astype(np.uint32)


ADD: dict[type, Callable[[viser.SceneApi, str, Any], list[Any]]] = {
    Frustum: _add_frustum,
    Frusta: _add_frusta,
    Segments: _add_segments,
    PointCloud: _add_cloud,
    Ellipsoid: _add_ellipsoid,
    Ellipsoids: _add_ellipsoids,
    Plane: _add_plane,
    Mesh: _add_mesh,
    Overlay: _add_overlay,
    Picture: _add_picture,
    Label: _add_label,
}
CHANGE: dict[type, Callable[[list[Any], Any, Any], bool]] = {
    Frustum: _change_frustum,
    Frusta: _change_frusta,
    Segments: _change_segments,
    PointCloud: _change_cloud,
    Ellipsoid: _change_ellipsoid,
    Overlay: _change_overlay,
    Plane: _change_plane,
    Picture: _change_picture,
    Label: _change_label,
}
