"""The viewer's colours: the legend (`solvers.legend`) on a light and on a dark ground, buttons, grounds."""

from __future__ import annotations

from solvers.legend import CHECK, CONTROL, GEOREFERENCED, INITIAL, ORTHOGONAL, PERSPECTIVE, RESIDUAL, TRUTH, Colour

ACCENT_DARK: Colour = (0, 159, 248)  # buttons and the chosen tab on a dark ground: their words are black, the tab's ground is not
BACKGROUND_DARK: Colour = (30, 32, 36)
BACKGROUND_LIGHT: Colour = (255, 255, 255)
FOREGROUND_DARK: Colour = (226, 226, 226)
FOREGROUND_LIGHT: Colour = TRUTH  # `foreground` knows both

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
