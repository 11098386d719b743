"""Mosaics: plane coefficients, registration, orthorectification, composition."""

from .blend import half
from .checks import check_ties
from .compose import ComposeOptions, Composition, Job, coarse, compose, composition, render
from .measured import Measured, measure, place_jacobian, seen_by
from .orthorectify import orthorectify
from .placed import Placed
from .plane import PlaneFit, Rectification, coefficients_of, orientation_of, plane_coefficients, rectification
from .register import RegistrationRequest, register
from .registration import Registration
from .seamcheck import SeamCheck, check_seams
from .surface import Ground, MosaicPlane, fit_plane

__all__ = ["ComposeOptions", "Composition", "Ground", "Job", "Measured", "MosaicPlane", "Placed", "PlaneFit", "Rectification",
           "Registration", "RegistrationRequest", "SeamCheck", "check_seams", "check_ties", "coarse", "coefficients_of",
           "compose", "composition", "fit_plane", "half", "measure", "orientation_of", "orthorectify", "place_jacobian",
           "plane_coefficients", "rectification", "register", "render", "seen_by"]
