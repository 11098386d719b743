"""Orientation of images: resection by both models, batches, bundles, georeferencing, intersection, monoplotting, advice."""

from .advisor import Advice, Prediction, advise
from .batch import ResectMany, Status, resect_many, solve_candidates
from .bundle import Adjusted, BundleRequest, adjust
from .corners import CornerControl, corner_control, corner_orientation, with_corners
from .flightlog import Offset, match_log
from .footprint import CORNERS, Footprint, footprint, footprints_geojson
from .georeference import Georeferenced, Rig, Vertical, georeference, height_bias
from .grades import Flight, Grade, compare_control, compare_project
from .headings import Heading, check_headings
from .initial import Candidate, candidates, three_points
from .intersection import Intersected, ObjectPoint, intersect
from .monoplot import Monoplotted, Plane, monoplot
from .oriented import Known, Oriented
from .orthogonal import Leak, Orthogonal
from .resection import PriorOrientation, Resection
from .result import Orientation
from .single import Request, Start, conclude, orient, prepare, resect, resect_orthogonal, rows

__all__ = ["CORNERS", "Adjusted", "Advice", "BundleRequest", "Candidate", "CornerControl", "Flight", "Footprint",
           "Georeferenced", "Grade", "Heading", "Intersected", "Known", "Leak", "Monoplotted", "ObjectPoint", "Offset",
           "Orientation", "Oriented", "Orthogonal", "Plane", "Prediction", "PriorOrientation", "Request", "ResectMany",
           "Resection", "Rig", "Start", "Status", "Vertical", "adjust", "advise", "candidates", "check_headings",
           "compare_control", "compare_project", "conclude", "corner_control", "corner_orientation", "footprint",
           "footprints_geojson", "georeference", "height_bias", "intersect", "match_log", "monoplot", "orient", "prepare",
           "resect", "resect_many", "resect_orthogonal", "rows", "solve_candidates", "three_points", "with_corners"]
