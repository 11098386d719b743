"""Corners of a chessboard, found and measured to a fraction of a pixel.

Reference: Förstner & Gülch 1987 (the point nearest to all edges around it), as OpenCV's cornerSubPix does it.
"""

from __future__ import annotations

import numpy as np

from ..errors import DegenerateGeometry

WINDOW = 11
"""Half a window about a corner [px], less where squares are small."""


def find_chessboard(image: np.ndarray, board: tuple[int, int]) -> np.ndarray:
    """Inner corners (columns times rows, 2) px of a board, row after row; pixels count from the centre of the top-left one.

    image: (h, w) or (h, w, 3) uint8; board: inner corners across and down. A board that looks the same upside down may be read
    so. Raises DegenerateGeometry where not all corners are seen.
    """
    import cv2

    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    seen, corners = cv2.findChessboardCorners(grey, board, flags=cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not seen:
        raise DegenerateGeometry(f"no chessboard of {board[0]} x {board[1]} inner corners is seen whole; count its inner "
                                 "corners, or take a photo of all of it")
    square = float(np.linalg.norm(np.diff(corners.reshape(board[1], board[0], 2), axis=1), axis=2).min())
    half = int(np.clip(0.4 * square, 2, WINDOW))
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    exact = cv2.cornerSubPix(grey, corners.copy(), (half, half), (-1, -1), end)
    return exact.reshape(-1, 2).astype(float)


def board_points(board: tuple[int, int], square: float) -> tuple[tuple[str, ...], np.ndarray]:
    """Names column-row, from 1, and coordinates (n, 3) of the corners, in units of `square`: X across, Y up."""
    names = tuple(f"{c + 1}-{r + 1}" for r in range(board[1]) for c in range(board[0]))
    return names, np.array([(c * square, -r * square, 0.0) for r in range(board[1]) for c in range(board[0])])


__all__ = ["board_points", "find_chessboard"]
