"""Features of one photo: where they are, how large and how turned, and descriptors to compare them by."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import Unsupported
from .patches import gray

NAMES = ("sift", "orb", "akaze", "brisk")
"""Features that can be asked for, as far as the installed OpenCV has them."""
_FEW = 0.25  # of the features asked for: below it the contrast is equalised
_PART, _RIM = 1300, 100  # px, side of the parts in which SIFT is searched, and what is seen around them
_CELL = 16  # cells along the longer side when features are spread over the photo


@dataclass(frozen=True)
class Features:
    """N features. pixel (N, 2) col, row in the photo as it is stored; scale (N,) px, diameter; angle (N,) rad; response (N,);
    descriptor (N, d) uint8 (SIFT's 128 numbers, or bits); size: cols, rows of the photo; reduction: photo px per px of
    the picture in which they were found; binary: descriptors are compared by their bits."""

    pixel: np.ndarray
    scale: np.ndarray
    angle: np.ndarray
    response: np.ndarray
    descriptor: np.ndarray
    size: tuple[int, int]
    reduction: float
    binary: bool = False

    def __len__(self) -> int:
        return len(self.pixel)

    def arrays(self) -> dict[str, np.ndarray]:
        """As arrays, to be stored."""
        return {name: np.asarray(getattr(self, name)) for name in self.__dataclass_fields__}

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> Features:
        """The inverse of `arrays`."""
        plain = {"size": tuple(int(v) for v in arrays["size"]), "reduction": float(arrays["reduction"]),
                 "binary": bool(arrays["binary"])}
        return cls(**{**arrays, **plain})


def find_features(image: np.ndarray, kind: str = "sift", count: int = 4000, side: int = 2400,
                  equalise: bool | None = None) -> Features:
    """About `count` features, spread evenly, found in a picture reduced to `side` px along its longer side.

    equalise: contrast limited adaptive histogram equalisation (CLAHE) and a lower contrast limit; None: where a photo of
    low texture gives few features without it. Raises Unsupported. Reference: Lowe 2004; Arandjelovic & Zisserman 2012.
    """
    import cv2

    grey = image if image.dtype == np.uint8 and image.ndim == 2 else gray(image)  # a large photo is not copied into numbers
    rows, cols = grey.shape
    reduction = max(1.0, max(rows, cols) / side)
    small = grey
    if reduction > 1:
        small = cv2.resize(grey, (round(cols / reduction), round(rows / reduction)), interpolation=cv2.INTER_AREA)
    picture = _eight_bits(small, image.dtype)
    table, descriptors = np.empty((0, 5)), np.empty((0, 128), np.uint8)
    if equalise is not True:
        table, descriptors = _detected(picture, kind, 4 * count, weak=False)
    if equalise or (equalise is None and len(table) < _FEW * count):
        more = _detected(cv2.createCLAHE(3.0, (8, 8)).apply(picture), kind, 4 * count, weak=True)
        table, descriptors = more if len(more[0]) > len(table) else (table, descriptors)
    ratio = np.array([cols / small.shape[1], rows / small.shape[0]])
    kept = _spread(table[:, :2], table[:, 4], small.shape, count)
    table, descriptors = table[kept], descriptors[kept]
    return Features((table[:, :2] + 0.5) * ratio - 0.5, table[:, 2] * reduction, table[:, 3], table[:, 4], descriptors,
                    (cols, rows), reduction, kind != "sift")


def _detected(picture: np.ndarray, kind: str, count: int, weak: bool) -> tuple[np.ndarray, np.ndarray]:
    """(N, 5) col, row, diameter, angle, response of about `count` features and their descriptors (N, d) uint8.

    SIFT holds eleven pictures of four times the size and more: a large one is done part by part, each with a rim around it.
    """
    rows, cols = picture.shape
    parts = [-(-n // _PART) if kind == "sift" else 1 for n in (rows, cols)]
    detector = _detector(kind, count if max(parts) == 1 else 2 * count // (parts[0] * parts[1]), weak)
    tables, descriptors = [], []
    for top, bottom in pairwise(np.linspace(0, rows, parts[0] + 1).astype(int)):
        for left, right in pairwise(np.linspace(0, cols, parts[1] + 1).astype(int)):
            corner = np.array([max(left - _RIM, 0), max(top - _RIM, 0)])
            part = np.ascontiguousarray(picture[corner[1] : bottom + _RIM, corner[0] : right + _RIM])
            found, described = detector.detectAndCompute(part, None)
            table = np.array([(*k.pt, k.size, np.radians(k.angle), k.response) for k in found]).reshape(-1, 5)
            table[:, :2] += corner
            own = ((table[:, :2] >= [left - 0.5, top - 0.5]) & (table[:, :2] < [right - 0.5, bottom - 0.5])).all(1)
            if own.any():
                tables.append(table[own])
                descriptors.append(described[own].astype(np.uint8))
    return (np.concatenate(tables), np.concatenate(descriptors)) if tables else (np.empty((0, 5)), np.empty((0, 128), np.uint8))


def check_kind(kind: str) -> None:
    """Raises Unsupported for features that are not known, or not built into the installed OpenCV."""
    known = [n for n in NAMES if _maker(n) is not None]
    if kind not in known:
        raise Unsupported(f"features '{kind}' are not known here; choose one of {', '.join(known)}")


def _maker(kind: str) -> Any:
    import cv2

    name = f"{kind.upper()}_create"
    return getattr(cv2, name, None) or getattr(getattr(cv2, "xfeatures2d", None), name, None)


def _detector(kind: str, count: int, weak: bool) -> Any:
    check_kind(kind)
    maker = _maker(kind)
    if kind == "sift":
        return maker(count, contrastThreshold=0.01 if weak else 0.03)
    return maker(count, fastThreshold=5 if weak else 15) if kind == "orb" else maker()


def _eight_bits(grey: np.ndarray, kind: np.dtype) -> np.ndarray:
    """uint8; other depths are stretched between their 0.5 % and 99.5 % values."""
    if kind == np.uint8:
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)
    low, high = np.nanpercentile(grey, [0.5, 99.5])
    return np.clip((np.nan_to_num(grey) - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)


def _spread(pixel: np.ndarray, response: np.ndarray, shape: tuple[int, ...], count: int) -> np.ndarray:
    """Indices of `count` features: the strongest of each cell, then the second strongest, and so on, in the order they came."""
    if len(pixel) <= count:
        return np.arange(len(pixel))
    cell = (pixel * (_CELL / max(shape[:2]))).astype(int)
    key = cell[:, 1] * 2 * _CELL + cell[:, 0]
    order = np.lexsort((-response, key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(first, append=len(order)))
    best = order[np.lexsort((-response[order], rank))][:count]
    return np.sort(best)
