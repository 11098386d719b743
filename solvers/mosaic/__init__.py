"""Mosaics: plane coefficients, registration, orthorectification, composition."""

from .blend import half
from .compose import ComposeOptions, Composition, Job, coarse, compose, composition, render
from .orthorectify import orthorectify
from .placed import Placed
from .registration import Registration
from .surface import Ground, MosaicPlane, fit_plane

__all__ = ["ComposeOptions", "Composition", "Ground", "Job", "MosaicPlane", "Placed", "Registration", "coarse", "compose",
           "composition", "fit_plane", "half", "orthorectify", "render"]
