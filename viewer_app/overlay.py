"""The photo looked through, laid over the scene so that every pixel lies on its own ray; and the camera that looks so."""

from __future__ import annotations

import io
import json
import struct
from functools import lru_cache

import numpy as np

from solvers import Exterior, Interior

from .looking import Looking, looked_through
from .scene import any_exterior, frustum_depth
from .state import State
from .values import Overlay, Scene

CELLS = 24
"""Meshes across the photo: between their corners distortion is taken as linear."""
MARGIN = 1.04
"""How much more than the photo is seen."""


def view_through(state: State, image: str, aspect: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
    """Position, point looked at, up (3,) and vertical angle of view [rad] that see just the photo on a screen of an aspect.

    None where the image has no place yet.
    """
    exterior = any_exterior(state, image)
    if exterior is None:
        return None
    interior = state.block.camera_of(image)
    half = np.array([interior.width, interior.height]) * interior.pitch / 2 / interior.c
    tangent = MARGIN * max(half[1], half[0] / max(aspect, 1e-3))
    at = exterior.centre - frustum_depth(state) * exterior.m[2]
    return exterior.centre, at, exterior.m[1], 2 * float(np.arctan(tangent))


def overlay(state: State) -> Scene:
    """The photo over the scene while one looks through it, a little before the frustum's own plane."""
    image = looked_through(state)
    photo, exterior = state.assets.photos.get(image), state.exterior("perspective", image) if image else None
    exterior = exterior or (any_exterior(state, image) if image else None)
    if photo is None or exterior is None:
        return {}
    vertices, faces, places = _grid(state.block.camera_of(image), 0.98 * frustum_depth(state), exterior)
    return {"/through": Overlay(vertices, faces, places, photo.pane, state.room(Looking).opacity)}


def _grid(interior: Interior, depth: float, exterior: Exterior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (n, 3) m on the rays of a grid of pixels, faces (k, 3), and places (n, 2) in the picture, 0..1."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, CELLS + 1), np.linspace(0, 1, CELLS + 1)))
    pixels = np.column_stack([u * interior.width, v * interior.height]) - 0.5
    rays = np.column_stack([interior.ideal(pixels) / interior.c, np.full(len(u), -1.0)])
    k = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel(), k[1:, :-1].ravel()
    faces = np.concatenate([np.column_stack([a, d, c]), np.column_stack([a, c, b])])
    return depth * rays @ exterior.m + exterior.centre, faces, np.column_stack([u, v])


def textured_glb(value: Overlay) -> bytes:
    """The photo as binary glTF 2.0: one unlit, blended, two-sided mesh. Reference: Khronos, glTF 2.0, KHR_materials_unlit."""
    parts = [
        np.ascontiguousarray(value.vertices, "<f4").tobytes(), np.ascontiguousarray(value.places, "<f4").tobytes(),
        np.ascontiguousarray(value.faces, "<u2").tobytes(),
        _jpeg(value.pixels.tobytes(), value.pixels.shape[1], value.pixels.shape[0]),
    ]  # fmt: skip
    views, offset = [], 0
    for part in parts:
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part)})
        offset += -(-len(part) // 4) * 4
    body = b"".join(part.ljust(-(-len(part) // 4) * 4, b"\0") for part in parts)
    n = len(value.vertices)
    low, high = np.float32(value.vertices).min(axis=0).tolist(), np.float32(value.vertices).max(axis=0).tolist()
    said = {
        "asset": {"version": "2.0"}, "extensionsUsed": ["KHR_materials_unlit"], "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5126, "count": n, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": int(value.faces.size), "type": "SCALAR"},
        ],
        "materials": [{
            "alphaMode": "BLEND", "doubleSided": True, "extensions": {"KHR_materials_unlit": {}},
            "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, value.opacity], "baseColorTexture": {"index": 0},
                                     "metallicFactor": 0},
        }],
        "textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": 3, "mimeType": "image/jpeg"}],
        "bufferViews": views, "buffers": [{"byteLength": len(body)}],
    }  # fmt: skip
    head = json.dumps(said, separators=(",", ":")).encode()
    head = head.ljust(-(-len(head) // 4) * 4)
    return (
        struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(body))
        + struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(body), b"BIN\0") + body
    )  # fmt: skip


@lru_cache(maxsize=2)
def _jpeg(pixels: bytes, width: int, height: int) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.frombytes("RGB", (width, height), pixels).save(out, "JPEG", quality=85)
    return out.getvalue()
