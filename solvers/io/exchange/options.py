"""What a person may say about a file that does not say it itself."""

from __future__ import annotations

from dataclasses import dataclass

from ..gcp import Ask
from ..sniff import Tell
from .conventions import AngleOrder, AngleUnit

ORDERS = {"opk": AngleOrder.OPK, "pok": AngleOrder.POK, "pok-left": AngleOrder.POK_LEFT}
UNITS = {"deg": AngleUnit.DEGREES, "gon": AngleUnit.GON, "rad": AngleUnit.RADIANS}


@dataclass(frozen=True)
class Reading:
    """crs: of the file's coordinates. angles, unit: of its angles. size: width, height of its photos [px]. mapping: columns of
    a table. pixel_origin: "center" or "corner". matrix: what a PATB matrix turns. ask: puts a question to a person. tell: shows a
    person the columns of a table before they are used."""

    crs: str | None = None
    angles: str | None = None
    unit: str | None = None
    size: tuple[int, int] | None = None
    mapping: str | None = None
    pixel_origin: str | None = None
    matrix: str | None = None
    ask: Ask | None = None
    tell: Tell | None = None


NOTHING = Reading()
"""Nothing was said."""
