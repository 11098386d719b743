"""Draws the pictures of conventions.md with the code's own rotations and pixel formulas: python docs/make_figures.py"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Polygon, Rectangle

from solvers import Exterior, Interior
from solvers.cameras import project
from solvers.geometry import rotation
from solvers.legend import INKS

FOLDER = Path(__file__).parent / "figures"
INK, BLUE, ORANGE, GREEN = "#333333", INKS["perspective"], INKS["residual"], INKS["georeferenced"]
VIEW = np.array([[0.86, -0.5, 0.0], [0.2, 0.35, 0.92]])
"""(2, 3) oblique drawing of object coordinates: east to the right, north to the upper left, Z up."""


def flat(points: Any) -> np.ndarray:
    """Object points (..., 3) on the paper (..., 2)."""
    return np.asarray(points, float) @ VIEW.T


def arrow(ax: Any, start: Any, end: Any, colour: str, text: str = "", shift: tuple[float, float] = (0.06, 0.06)) -> None:
    """An axis from start to end, named at its tip."""
    a, b = flat(start), flat(end)
    ax.annotate("", b, a, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8, "shrinkA": 0, "shrinkB": 0})
    ax.text(*(b + shift), text, color=colour, fontsize=11, ha="center", va="center")


def polygon(ax: Any, corners: Any, colour: str, alpha: float) -> None:
    ax.add_patch(Polygon(flat(corners), closed=True, facecolor=colour, edgecolor=colour, alpha=alpha))


def frames() -> None:
    """Object frame, camera, photo frame, and one ray through both."""
    m = rotation(*np.radians([8.0, -6.0, 20.0]))
    centre, c, half = np.array([1.2, 1.2, 2.4]), 0.62, np.array([0.55, 0.4])
    ground = np.array([2.3, 0.7, 0.0])
    out = lambda xyz: centre + np.asarray(xyz) @ m  # noqa: E731   photo axes to object axes: M^T v
    fig, ax = plt.subplots(figsize=(7, 5.2))
    polygon(ax, [(-0.2, -0.2, 0), (2.9, -0.2, 0), (2.9, 2.6, 0), (-0.2, 2.6, 0)], GREEN, 0.12)
    for axis, name in zip(np.eye(3), ("X  east", "Y  north", "Z  up"), strict=True):
        arrow(ax, (0, 0, 0), axis * 0.95, INK, name, (0.0, 0.12))
    corners = [out((sx * half[0], sy * half[1], -c)) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    polygon(ax, corners, BLUE, 0.22)
    for corner in corners:
        ax.plot(*np.transpose([flat(centre), flat(corner)]), color=BLUE, lw=0.8)
    middle = out((0, 0, -c))
    arrow(ax, middle, out((0.8, 0, -c)), BLUE, "x", (0.08, 0.0))
    arrow(ax, middle, out((0, 0.68, -c)), BLUE, "y", (-0.02, 0.1))
    arrow(ax, centre, out((0, 0, 0.75)), BLUE, "z  back towards the viewer", (0.65, 0.06))
    ax.plot(*np.transpose([flat(centre), flat(middle)]), color=BLUE, lw=0.9, ls=":")
    beside = flat(out((0, 0, -c / 2))) + np.array([-0.09, 0.02])
    ax.text(beside[0], beside[1], "c", color=BLUE, fontsize=12)
    u = (ground - centre) @ m.T
    image = out(u * (-c / u[2]))
    ax.plot(*np.transpose([flat(centre), flat(ground)]), color=ORANGE, lw=1.4)
    for at, name, shift in ((ground, "object point X", (0.42, -0.1)), (image, "image point", (0.48, 0.0)),
                            (centre, r"perspective centre $X_C$", (-0.85, 0.08))):
        ax.plot(*flat(at), "o", color=ORANGE, ms=5)
        spot = flat(at) + shift
        ax.text(spot[0], spot[1], name, color=ORANGE, fontsize=10, ha="center", va="center")
    ax.text(-1.35, -0.55, r"$(x-x_p,\ y-y_p,\ -c)^T=\lambda\,M\,(X-X_C),\qquad \lambda>0$", fontsize=13, color=INK)
    ax.set(xlim=(-1.6, 3.4), ylim=(-0.7, 4.1))
    save(fig, ax, "frames")


def angles() -> None:
    """What omega, phi, kappa alone do to the photo frame seen over the object axes."""
    fig, axes = plt.subplots(1, 3, figsize=(10.5, 3.7))
    named = (("omega", (28, 0, 0), "about X: y tips up"), ("phi", (0, 28, 0), "about Y: x tips down"),
             ("kappa", (0, 0, 28), "about Z: counterclockwise"))
    for ax, (name, turn, words) in zip(axes, named, strict=True):
        m = rotation(*np.radians(np.array(turn, float)))
        for axis, letter in zip(np.eye(3), "XYZ", strict=True):
            arrow(ax, (0, 0, 0), axis * 1.15, "#999999", letter, (0.08, 0.05))
        for axis, letter in zip(m, "xyz", strict=True):  # the rows of M are the photo axes in object coordinates
            arrow(ax, (0, 0, 0), axis, BLUE, letter, (0.1, -0.08))
        ax.set_title(f"{name} = +28°   ({words})", fontsize=10.5, color=INK)
        ax.set(xlim=(-0.95, 1.35), ylim=(-0.35, 1.35))
    for ax in axes:
        ax.set_aspect("equal")
        ax.axis("off")
    fig.tight_layout()
    write(fig, "angles")


def pixels() -> None:
    """A format of 6 x 4 pixels: pixel frame from the first centre, photo frame from the middle."""
    width, height = 6, 4
    camera = Interior(10.0, pixel_mm=1.0, width=width, height=height)
    seen = project(camera, Exterior(np.eye(3), np.array([0.0, 0.0, 10.0])), np.array([[1.5, -1.5, 0.0]]))
    at = seen[0]
    fig, ax = plt.subplots(figsize=(7, 4.6))
    for col in range(width):
        for row in range(height):
            ax.add_patch(Rectangle((col - 0.5, row - 0.5), 1, 1, facecolor="none", edgecolor="#BBBBBB"))
            ax.plot(col, row, ".", color="#BBBBBB", ms=4)
    for end, name, shift in (((1.6, 0), "col", (0.28, 0)), ((0, 1.6), "row", (0, 0.25))):
        ax.annotate("", end, (0, 0), arrowprops={"arrowstyle": "-|>", "color": ORANGE, "lw": 1.8})
        ax.text(end[0] + shift[0], end[1] + shift[1], name, color=ORANGE, ha="center", va="center", fontsize=11)
    ax.text(-0.42, -0.72, "(0, 0): centre of the top-left pixel", color=ORANGE, fontsize=10)
    middle = ((width - 1) / 2, (height - 1) / 2)
    for end, name, shift in (((middle[0] + 1.7, middle[1]), "x", (0.2, 0)), ((middle[0], middle[1] - 1.7), "y", (0, -0.2))):
        ax.annotate("", end, middle, arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.8})
        ax.text(end[0] + shift[0], end[1] + shift[1], name, color=BLUE, ha="center", va="center", fontsize=11)
    ax.text(middle[0] - 0.12, middle[1] + 0.22, "format centre", color=BLUE, fontsize=10, ha="right")
    ax.plot(*at, "o", color=GREEN, ms=7)
    words = f"col {at[0]:.1f}, row {at[1]:.1f}\nx = +1.5 p, y = -1.5 p"
    ax.text(at[0] - 0.15, at[1] + 0.3, words, color=GREEN, fontsize=10, ha="right", va="center",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5})
    ax.text(-0.42, height, r"$x=(col-\frac{W-1}{2})\,p,\quad y=-(row-\frac{H-1}{2})\,p$",
            fontsize=13, color=INK, va="center")
    ax.set(xlim=(-0.9, width + 0.1), ylim=(height + 0.4, -1.1))
    save(fig, ax, "pixels")


def save(fig: Any, ax: Any, name: str) -> None:
    ax.set_aspect("equal")
    ax.axis("off")
    fig.tight_layout()
    write(fig, name)


def write(fig: Any, name: str) -> None:
    """SVG on white, the same bytes each time."""
    FOLDER.mkdir(exist_ok=True)
    with plt.rc_context({"svg.hashsalt": "collinea", "svg.fonttype": "path"}):
        fig.savefig(FOLDER / f"{name}.svg", metadata={"Date": None}, facecolor="white")
    plt.close(fig)


if __name__ == "__main__":
    frames()
    angles()
    pixels()
