"""Scenes for 3D programs: cameras as frustums, points by role, relative to a round origin that the file names. GLB and PLY.

GLB (glTF 2.0) has y up and single precision; PLY is text with double precision and keeps x east, y north, z up.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from ...cameras import Interior
from ...errors import BadTable
from ...legend import CHECK, CONTROL, INITIAL, PERSPECTIVE
from ..files import write_atomic, write_text
from .scene import Camera, Exchange

COLOURS = {"control": CONTROL, "check": CHECK, "tie": INITIAL, "camera": PERSPECTIVE}


def origin_of(scene: Exchange) -> np.ndarray:
    """A round place (3,) amid points and cameras."""
    at = [scene.points.xyz[np.isfinite(scene.points.xyz).all(axis=1)]]
    at.append(np.array([s.exterior.centre for s in scene.oriented if s.exterior is not None]).reshape(-1, 3))
    both = np.vstack(at)
    if not len(both):
        raise BadTable("there is neither an oriented image nor a point with coordinates to show; orient the images first")
    return np.round(np.median(both, axis=0), -1) if np.abs(both).max() > 1000 else np.zeros(3)


def frustums(scene: Exchange) -> list[tuple[str, np.ndarray]]:
    """Apex and four corners (5, 3) [m] of each oriented image; their length suits the scene."""
    shots = [s for s in scene.oriented if s.camera in scene.cameras]
    if not shots:
        return []
    centres = np.array([s.exterior.centre for s in shots if s.exterior is not None])
    known = scene.points.xyz[np.isfinite(scene.points.xyz).all(axis=1)]
    far = float(np.median(np.linalg.norm(centres - known.mean(axis=0), axis=1))) if len(known) else 0.0
    apart = float(np.linalg.norm(np.ptp(centres, axis=0))) if len(centres) > 1 else 0.0
    length = 0.1 * far or 0.1 * apart or 1.0
    out = []
    for s in shots:
        assert s.exterior is not None and s.camera is not None
        rays = _corner_rays(scene.cameras[s.camera])
        out.append((s.name, np.vstack([s.exterior.centre, s.exterior.centre + length * rays @ s.exterior.m])))
    return out


def _corner_rays(camera: Camera) -> np.ndarray:
    """(4, 3) directions of the corners in the photo's axes, depth 1; without distortion."""
    w, h = camera.width, camera.height
    if isinstance(camera, Interior):
        fx, fy = camera.c / camera.pitch
        cx, cy = camera.pixels(camera.principal_point)
    else:
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    corners = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    return np.column_stack([(corners[:, 0] - cx) / fx, -(corners[:, 1] - cy) / fy, -np.ones(4)])


def write_ply(scene: Exchange, path: Path) -> tuple[str, ...]:
    """Vertices with colours (points, then frustums) and faces (frustums)."""
    origin, shapes = origin_of(scene), frustums(scene)
    rows, faces = [], []
    for xyz, role in zip(scene.points.xyz, scene.points.role, strict=True):
        if np.isfinite(xyz).all():
            rows.append((xyz - origin, COLOURS[role]))
    for _, shape in shapes:
        first = len(rows)
        rows += [(p - origin, COLOURS["camera"]) for p in shape]
        faces += [f"3 {first} {first + 1 + k} {first + 1 + (k + 1) % 4}" for k in range(4)]
    head = ["ply", "format ascii 1.0", f"comment origin {' '.join(repr(float(v)) for v in origin)} crs "
                                       f"{' '.join(str(scene.crs).split())}",
            f"element vertex {len(rows)}", *(f"property double {k}" for k in "xyz"),
            *(f"property uchar {k}" for k in ("red", "green", "blue")),
            f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    body = [" ".join([*(repr(float(v)) for v in at), *map(str, colour)]) for at, colour in rows]
    write_text(path, "\n".join([*head, *body, *faces]) + "\n")
    return (_said(origin),)


def _said(origin: np.ndarray) -> str:
    return f"origin of the scene: {', '.join(f'{v:g}' for v in origin)} (subtracted)"


def write_glb(scene: Exchange, path: Path) -> tuple[str, ...]:
    """One node a camera (lines of its frustum) and one a role of points, in glTF 2.0 binary."""
    origin, shapes = origin_of(scene), frustums(scene)
    edges = np.array([0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1])  # pairs; no index, which some readers of lines overlook
    parts: list[tuple[str, np.ndarray, int, str]] = [(name, shape[edges], 1, "camera") for name, shape in shapes]
    for role in ("control", "check", "tie"):
        at = scene.points.xyz[[r == role for r in scene.points.role]]
        at = at[np.isfinite(at).all(axis=1)]
        if len(at):
            parts.append((role, at, 0, role))
    kinds = list(COLOURS)
    document = {"asset": {"version": "2.0", "generator": "collinea",
                          "extras": {"origin": origin.tolist(), "crs": scene.crs, "axes": "x east, y up, z south"}},
                "scene": 0, "scenes": [{"nodes": list(range(len(parts)))}], "nodes": [], "meshes": [], "accessors": [],
                "bufferViews": [],
                "materials": [{"name": k, "extensions": {"KHR_materials_unlit": {}},
                               "pbrMetallicRoughness": {"baseColorFactor": [*(round((v / 255) ** 2.2, 4) for v in COLOURS[k]),
                                                                            1.0],
                                                        "metallicFactor": 0.0}} for k in kinds],
                "extensionsUsed": ["KHR_materials_unlit"], "buffers": []}
    data = b""
    for n, (name, xyz, mode, kind) in enumerate(parts):
        local = (xyz - origin) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) -> (x, z, -y)
        data = _accessor(document, data, local.astype("<f4"))
        primitive = {"attributes": {"POSITION": len(document["accessors"]) - 1}, "mode": mode, "material": kinds.index(kind)}
        document["meshes"].append({"name": name, "primitives": [primitive]})
        document["nodes"].append({"name": name, "mesh": n})
    document["buffers"].append({"byteLength": len(data)})
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    whole = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)) + struct.pack("<I4s", len(text), b"JSON") + text + \
        struct.pack("<I4s", len(data), b"BIN\0") + data
    write_atomic(path, lambda stream: stream.write(whole))
    return (_said(origin),)


def _accessor(document: dict, data: bytes, points: np.ndarray) -> bytes:
    """The bytes with points (n, 3) of single precision appended, and their entry in the document."""
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": points.nbytes, "target": 34962})
    document["accessors"].append({"bufferView": len(document["bufferViews"]) - 1, "componentType": 5126, "count": len(points),
                                  "type": "VEC3", "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()})
    return data + points.tobytes()
