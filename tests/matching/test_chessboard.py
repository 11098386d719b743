"""Corners of a chessboard: where they were drawn, in photos of a project that is then calibrated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.cameras import project
from solvers.cli import main
from solvers.errors import DegenerateGeometry
from solvers.io import read_project, write_image, write_project
from solvers.matching.chessboard import board_points, find_chessboard
from solvers.simulation.close_range import look_at

CAMERA = Interior(8.0, pixel_mm=0.01, width=640, height=480)
BOARD = (7, 5)
STATIONS = np.array([[0.05, -0.35, 0.4], [0.45, -0.1, 0.42], [-0.1, 0.1, 0.45], [0.15, -0.08, 0.5]])


def drawn(at: Exterior) -> np.ndarray:
    """A photo (h, w, 3) of the board, eight by six squares of 30 mm, smoothed by a lens."""
    import cv2

    n, size = 24, 4
    squares = (np.indices((BOARD[1] + 1, BOARD[0] + 1)).sum(axis=0) % 2).astype(np.uint8) * 200 + 30
    flat = np.pad(np.kron(squares, np.ones((n, n), np.uint8)), n, constant_values=230)
    corners = np.array([[0, 0], [BOARD[0] + 1, 0], [BOARD[0] + 1, BOARD[1] + 1], [0, BOARD[1] + 1]], float)
    world = np.column_stack([(corners[:, 0] - 1) * 0.03, -(corners[:, 1] - 1) * 0.03, np.zeros(4)])
    there = project(CAMERA, at, world) * size + (size - 1) / 2
    h = cv2.getPerspectiveTransform((corners * n + n - 0.5).astype(np.float32), there.astype(np.float32))
    large = cv2.warpPerspective(flat, h, (CAMERA.width * size, CAMERA.height * size), borderValue=230, flags=cv2.INTER_LINEAR)
    photo = cv2.resize(cv2.GaussianBlur(large, (0, 0), 3.0), (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
    return np.repeat(photo[:, :, None], 3, axis=2)


def test_corners_are_where_they_were_drawn() -> None:
    at = look_at(STATIONS[0], np.array([0.09, -0.06, 0.0]))
    names, xyz = board_points(BOARD, 0.03)
    pixel = find_chessboard(drawn(at), BOARD)
    true = project(CAMERA, at, xyz)
    off = min(np.abs(pixel - true).max(), np.abs(pixel[::-1] - true).max())  # it looks the same upside down
    assert len(names) == 35 and names[0] == "1-1" and names[-1] == "7-5" and off < 0.1
    with pytest.raises(DegenerateGeometry, match="no chessboard of 6 x 4"):
        find_chessboard(np.full((100, 100), 128, np.uint8), (6, 4))


def test_photos_of_a_board_become_a_project_to_calibrate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "board"
    folder.mkdir()
    images = []
    for k, station in enumerate(STATIONS):
        write_image(folder / f"p{k}.png", drawn(look_at(station, np.array([0.09, -0.06, 0.0]), 90.0 * (k % 2))))
        images.append(Image(f"p{k}", "lens", f"p{k}.png"))
    nothing = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    block = Block("board", "local", {"lens": CAMERA}, tuple(images), Points((), np.zeros((0, 3)), np.zeros((0, 3)), ()), nothing)
    write_project(block, folder)
    assert main(["targets", str(folder), "--kind", "chessboard"]) == 1 and "--board" in capsys.readouterr().err
    assert main(["targets", str(folder), "--kind", "chessboard", "--board", "7x5", "--square", "0.03", "--json", "-"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert done["points"] == 35 and done["observations"] == 4 * 35
    made = read_project(folder)
    assert set(made.points.role) == {"control"} and (made.points.sigma == 0).all()
    assert main(["calibrate", str(folder), "--free", "c", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["interior"]["lens"]["c_mm"] == pytest.approx(8.0, abs=0.05) and found["rms_px"] < 0.1
    assert main(["targets", str(folder), "--kind", "chessboard", "--board", "7x5"]) == 1
    assert "has observations already" in capsys.readouterr().err
