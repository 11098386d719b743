"""Bundle adjustment: images, interior orientations and object points together, perspective model."""

from .adjust import Begun, BundleRequest, BundleStart, Stopped, Watch, adjust, conclude_bundle, exteriors, prepare_bundle
from .problem import Bundle
from .result import MANY, MOST, Adjusted, AdjustedPoint

__all__ = ["MANY", "MOST", "Adjusted", "AdjustedPoint", "Begun", "Bundle", "BundleRequest", "BundleStart", "Stopped", "Watch",
           "adjust", "conclude_bundle", "exteriors", "prepare_bundle"]
