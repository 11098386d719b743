"""Rotations, exterior orientation, frames."""

from .frame import LocalFrame
from .pose import Exterior, from_opencv, to_opencv
from .rotation import angle_derivatives, angles, closest_rotation, exp, log, rotation, skew

__all__ = ["Exterior", "LocalFrame", "angle_derivatives", "angles", "closest_rotation", "exp", "from_opencv", "log", "rotation",
           "skew", "to_opencv"]
