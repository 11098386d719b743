"""The one legend: the same colours in scene, plots, recording, report, studies and 3D files, told apart by colour-blind people.

Okabe and Ito's eight colours, each used once, the brightest a little darker: the viewer's film curve must reach them.

Reference: Okabe & Ito 2008, "Color universal design".
"""

from __future__ import annotations

Colour = tuple[int, int, int]
"""Red, green, blue, 0..255."""

INITIAL: Colour = (128, 128, 128)  # approximate value, grey
PERSPECTIVE: Colour = (0, 114, 178)  # blue
ORTHOGONAL: Colour = (220, 149, 24)  # orange
GEOREFERENCED: Colour = (0, 158, 115)  # direct georeferencing and what is known beforehand, bluish green
CONTROL: Colour = (204, 121, 167)  # control points, reddish purple
CHECK: Colour = (86, 180, 226)  # check points, sky blue
RESIDUAL: Colour = (211, 94, 8)  # residual vectors and what went wrong, vermilion
TRUTH: Colour = (20, 20, 20)  # truth of a simulation on a light ground

PAPER: dict[str, Colour] = {"initial": INITIAL, "perspective": PERSPECTIVE, "orthogonal": ORTHOGONAL,
                            "georeferenced": GEOREFERENCED, "truth": TRUTH, "control": CONTROL, "check": CHECK,
                            "residual": RESIDUAL}
"""Every word of the legend with its colour on a light ground, in the order shown."""


def css(colour: Colour) -> str:
    """The colour as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


INKS: dict[str, str] = {name: css(colour) for name, colour in PAPER.items()}
"""The same as #rrggbb, for figures."""
