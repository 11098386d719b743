"""Bundle adjustment: images, interior orientations and object points together, perspective model."""

from .adjust import BundleRequest, BundleStart, adjust, conclude_bundle, exteriors, prepare_bundle
from .problem import Bundle
from .result import Adjusted, AdjustedPoint

__all__ = ["Adjusted", "AdjustedPoint", "Bundle", "BundleRequest", "BundleStart", "adjust", "conclude_bundle", "exteriors",
           "prepare_bundle"]
