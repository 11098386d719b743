"""Mosaics: plane coefficients, registration, orthorectification, composition."""

from .registration import Registration

__all__ = ["Registration"]
