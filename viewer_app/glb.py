"""A coloured triangle mesh as binary glTF for the page. trimesh writes the same, but half a second passes until it is loaded.

Source: Khronos glTF 2.0 specification, 4.4 (GLB file format).
"""

from __future__ import annotations

import json
import struct

import numpy as np

UNSIGNED, FLOAT, BYTE = 5125, 5126, 5121  # component types


def coloured_mesh(vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> bytes:
    """vertices (n, 3) m, faces (m, 3), colours (n, 3) of 0..255, linear."""
    opaque = np.insert(colours, 3, 255, axis=1)
    index, place, colour = (np.ascontiguousarray(a, t) for a, t in ((faces, "<u4"), (vertices, "<f4"), (opaque, "u1")))
    parts = [a.tobytes() for a in (index, place, colour)]  # each a multiple of four bytes
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    said = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1, "COLOR_0": 2}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": UNSIGNED, "type": "SCALAR", "count": index.size},
            {"bufferView": 1, "componentType": FLOAT, "type": "VEC3", "count": len(place),
             "min": place.min(axis=0).tolist(), "max": place.max(axis=0).tolist()},
            {"bufferView": 2, "componentType": BYTE, "normalized": True, "type": "VEC4", "count": len(colour)},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": at, "byteLength": len(p)} for at, p in zip(starts, parts, strict=False)],
        "buffers": [{"byteLength": starts[-1]}],
    }  # fmt: skip
    words = json.dumps(said).encode()
    words += b" " * (-len(words) % 4)
    chunks = [struct.pack("<I4s", len(words), b"JSON"), words, struct.pack("<I4s", starts[-1], b"BIN\0"), *parts]
    return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks)
