"""Rotations, exterior orientation, frames."""

from .frame import LocalFrame
from .gimbal import FlightLog, Onboard, body_to_ned, photo_rotation, yaw_pitch_roll
from .grid import Grid, Surface
from .pose import Exterior, from_opencv, to_opencv
from .rotation import angle_derivatives, angles, closest_rotation, exp, log, rotation, skew

__all__ = ["Exterior", "FlightLog", "Grid", "LocalFrame", "Onboard", "Surface", "angle_derivatives", "angles", "body_to_ned",
           "closest_rotation", "exp", "from_opencv", "log", "photo_rotation", "rotation", "skew", "to_opencv", "yaw_pitch_roll"]
