"""Positions on a line leave a block free to roll about it: then, and only then, the photos are taken to look down on average."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...geometry import Exterior, exp
from .network import Network

LEVEL = np.radians(10)
"""Standard error of the assumption that photos taken along a line look down on average [rad]."""
STEEP, AHEAD = 0.9, 0.3
"""Vertical part of a line's direction from which nothing hangs down from it, and part of a photo's axis that is across the line,
below which the axis tells no roll."""
CREDIBLE = (1 / LEVEL) ** 2
"""Information [rad^-2] on the roll from which positions hold it better than the assumption would."""


@dataclass(frozen=True)
class Line:
    """A line that positions hardly leave: its middle (3,) m and direction (3,), and the farthest of them from it [m]."""

    middle: np.ndarray
    along: np.ndarray
    within: float

    @classmethod
    def through(cls, at: np.ndarray) -> Line:
        """The line that lies best among positions (n, 3) m."""
        middle = at.mean(axis=0)
        along = np.linalg.svd(at - middle)[2][0]
        return cls(middle, along, float(np.linalg.norm(np.cross(at - middle, along), axis=1).max()))


def line_of(net: Network) -> Line | None:
    """The line on which the positions lie that alone hold the network, None where they hold its roll, or others do.

    What positions scatter across a line by their own errors holds nothing and is not counted.
    """
    images, given, roots = net.prior_arrays
    if len(images) < 2 or (net.weight > 0).any() or net.unknown < len(net.points) or roots[:, 3:].any():
        return None
    line = Line.through(given[:, :3])
    turn = np.cross(line.along, given[:, :3] - line.middle)  # how positions move when the block rolls
    information = float(((roots[:, :3, :3] @ turn[:, :, None]) ** 2).sum()) - 2 * (len(images) - 2)
    return None if information > CREDIBLE else line


def roll(along: np.ndarray, axis: np.ndarray) -> float:
    """By what a viewing axis (3,) is to be turned about a line, to look down as far as the line lets it [rad]."""
    down = np.array([0.0, 0.0, -1.0])
    a, b = (v - along * (v @ along) for v in (axis, down))
    return float(np.arctan2(np.cross(a, b) @ along, a @ b))


def looking_down(line: Line, poses: dict[int, Exterior]) -> dict[int, Exterior]:
    """Orientations turned about the line, as a whole, until their mean axis looks down."""
    r = exp(roll(line.along, -np.sum([e.m[2] for e in poses.values()], axis=0)) * line.along)
    return {i: Exterior(e.m @ r.T, r @ (e.centre - line.middle) + line.middle) for i, e in poses.items()}


def turned(net: Network, line: Line, x: np.ndarray) -> np.ndarray:
    """x, turned about the line until its photos look down on average; motions as they are known beforehand."""
    poses, interiors, points = net.split(x)
    r = exp(roll(line.along, -poses[:, 9:].sum(axis=0)) * line.along)
    m = (poses[:, 3:].reshape(-1, 3, 3) @ r.T).reshape(-1, 9)
    centres, points = ((at - line.middle) @ r.T + line.middle for at in (poses[:, :3], points))
    return net.pack(np.column_stack([centres, m]), interiors, points, net.shifts_at(x))


def levelled(net: Network, line: Line, x: np.ndarray) -> Network | None:
    """The network with the roll of its photos observed: none about the line, all together to `LEVEL`. None where no photo tells
    its roll. x: beside which their other turns are counted."""
    poses = net.split(x)[0][:, 3:].reshape(-1, 3, 3)
    across = np.linalg.norm(np.cross(poses[:, 2], line.along), axis=1)
    of = [i for i, p in enumerate(net.priors) if p is not None and across[i] > AHEAD]
    if not of or abs(line.along[2]) > STEEP:
        return None
    priors = list(net.priors)
    for i in of:
        prior = priors[i]
        assert prior is not None
        root = prior.root.copy()
        root[3, 3:] = poses[i] @ line.along / (LEVEL * np.sqrt(len(of)))
        level = poses[i] @ exp(roll(line.along, -poses[i, 2]) * line.along).T
        priors[i] = replace(prior, exterior=Exterior(level, prior.exterior.centre), root=root)
    return replace(net, priors=tuple(priors))


def said_of(line: Line, assumed: bool) -> str:
    """A sentence on what the positions do not hold."""
    then = f": the photos are taken to look down on average (to {np.degrees(LEVEL):.0f} degrees)" if assumed else ""
    return (f"the GPS positions lie within {line.within:.2g} m of one line and hardly hold the rotation about it{then}; that "
            "rotation is not to be believed without control or angles")


__all__ = ["LEVEL", "Line", "levelled", "line_of", "looking_down", "roll", "said_of", "turned"]
