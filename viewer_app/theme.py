"""The one legend: the same colours in scene, plots, recording and report, told apart by colour-blind people too.

Okabe and Ito's eight colours, each used once, the brightest a little darker: the scene's film curve (`tones`) must reach them.

Reference: Okabe & Ito 2008, "Color universal design".
"""

from __future__ import annotations

Colour = tuple[int, int, int]
"""Red, green, blue, 0..255."""

INITIAL: Colour = (128, 128, 128)  # approximate value, grey
PERSPECTIVE: Colour = (0, 114, 178)  # blue
ORTHOGONAL: Colour = (220, 149, 24)  # orange
GEOREFERENCED: Colour = (0, 158, 115)  # direct georeferencing, bluish green
CONTROL: Colour = (204, 121, 167)  # control points, reddish purple
CHECK: Colour = (86, 180, 226)  # check points, sky blue
RESIDUAL: Colour = (211, 94, 8)  # residual vectors, vermilion

ACCENT_DARK: Colour = (0, 159, 248)  # buttons and the chosen tab on a dark ground: their words are black, the tab's ground is not
BACKGROUND_DARK: Colour = (30, 32, 36)
BACKGROUND_LIGHT: Colour = (255, 255, 255)
FOREGROUND_DARK: Colour = (226, 226, 226)
FOREGROUND_LIGHT: Colour = (20, 20, 20)
TRUTH: Colour = FOREGROUND_LIGHT  # truth of a simulation on a light ground; `foreground` knows both

MODELS: dict[str, Colour] = {"perspective": PERSPECTIVE, "orthogonal": ORTHOGONAL, "georeferenced": GEOREFERENCED}


def foreground(dark: bool) -> Colour:
    """The colour of text and of the truth on a dark or a light ground."""
    return FOREGROUND_DARK if dark else FOREGROUND_LIGHT


def accent(dark: bool) -> Colour:
    """The colour of buttons and of the chosen tab, from which the page makes its shades."""
    return ACCENT_DARK if dark else PERSPECTIVE


def background(dark: bool) -> Colour:
    """The colour behind the scene."""
    return BACKGROUND_DARK if dark else BACKGROUND_LIGHT


def legend(dark: bool = False) -> dict[str, Colour]:
    """Every word of the legend with its colour, in the order shown."""
    return {"initial": INITIAL, **MODELS, "truth": foreground(dark), "control": CONTROL, "check": CHECK, "residual": RESIDUAL}
