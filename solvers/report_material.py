"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .adjustment import Trace
from .block import Block

MOST_ROWS = 200
"""Rows of a table; what is left out is said."""
CRITICAL = 3.29
"""Standardized residual above which an observation is tested as a blunder (Baarda, two-sided 0.1 %)."""


@dataclass(frozen=True)
class Ground:
    """Where an oriented photo puts a control or check point at that point's given height, beside the given place.

    off (2,) m: photo minus given; covariance (2, 2) m^2: of the photo's place.
    """

    image: str
    point: str
    role: str
    xy: np.ndarray
    off: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Material:
    """All that a report is made of.

    command: of the run; traces by name; grounds and outlines in project coordinates; mosaic: result of the latest mosaic run,
    picture: its small PNG; said: what the reader of the files has to say.
    """

    block: Block
    command: str
    run: str
    when: str
    version: str
    result: Mapping[str, Any]
    traces: Mapping[str, Trace]
    grounds: Sequence[Ground] = ()
    outlines: Mapping[str, np.ndarray] | None = None
    surface: str = ""
    mosaic: Mapping[str, Any] | None = None
    mosaic_run: str = ""
    picture: Path | None = None
    said: Sequence[str] = ()


@dataclass(frozen=True)
class Wanted:
    """Which edition of the accuracy standard, and the accuracy classes the data were made for [cm]."""

    edition: str = "2024"
    class_h_cm: float | None = None
    class_v_cm: float | None = None


def left(count: int, what: str) -> str:
    """How much a shortened table leaves out."""
    return f" Of {count} {what} the first {MOST_ROWS} are shown." if count > MOST_ROWS else ""


def crs_text(block: Block) -> str:
    """The coordinate system in words."""
    return "local, metres" if block.crs == "local" else f"{block.crs}, metres"
