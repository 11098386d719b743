"""Scene values to viser's nodes: what was painted is there, whatever hangs below what."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
import trimesh

from viewer_app.bridge import open_server
from viewer_app.glb import coloured_mesh
from viewer_app.paint_viser import Painter
from viewer_app.values import Scene, Segments

BLUE, RED = (0, 0, 255), (255, 0, 0)


def line(height: float, colour: tuple[int, int, int] = BLUE) -> Segments:
    return Segments(np.full((1, 2, 3), height), colour)


def test_what_hangs_below_a_node_is_there_after_the_node_was_made_anew() -> None:
    server = open_server()
    try:
        painter, nodes = Painter(server), server.scene._handle_from_node_name
        first: Scene = {"/a/b": line(1), "/a": line(2), "/a/b/c": line(3), "/ab": line(4)}
        painter.paint(first)
        kept: Any = nodes["/ab"]
        painter.paint({**first, "/a": line(2, RED)})  # another colour is another node
        assert set(first) <= set(nodes) and nodes["/ab"] is kept
        assert all(not painter._nodes[path][0]._impl.removed for path in first)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            painter.paint({"/ab": line(5)})
        assert not {"/a", "/a/b", "/a/b/c"} & set(nodes) and np.all(kept.points == 5)
    finally:
        server.stop()


def test_the_terrain_is_written_as_trimesh_would_read_it() -> None:
    rng = np.random.default_rng(1)
    vertices, colours = rng.normal(0, 100, (5, 3)).astype(np.float32), rng.integers(0, 256, (5, 3), np.uint8)
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 3, 2]])
    read: Any = trimesh.load(io.BytesIO(coloured_mesh(vertices, faces, colours)), file_type="glb", process=False)
    [mesh] = read.geometry.values()
    assert (mesh.vertices == vertices).all() and (mesh.faces == faces).all()
    assert (mesh.visual.vertex_colors == np.insert(colours, 3, 255, axis=1)).all()
