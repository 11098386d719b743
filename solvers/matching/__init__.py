"""Image matching: correlation, least squares matching and signalised targets."""

from .codes import number_targets
from .lsm import LsmOptions, match_lsm
from .ncc import match_ncc
from .patches import Photo, prepare
from .problem import GAUSS_NEWTON, LsmProblem, lsm_problem
from .result import LsmResult, NccResult, Status
from .search import Shared, predict, shared, tie_points
from .stepped import Patches, Stepped, match_stepped
from .targets import TargetOptions, Targets, find_targets
from .ties import Store, TieOptions, TiePair, TiePhoto, Ties

__all__ = ["GAUSS_NEWTON", "LsmOptions", "LsmProblem", "LsmResult", "NccResult", "Patches", "Photo", "Shared", "Status",
           "Stepped", "Store", "TargetOptions", "Targets", "TieOptions", "TiePair", "TiePhoto", "Ties", "find_targets",
           "lsm_problem", "match_lsm", "match_ncc", "match_stepped", "number_targets", "predict", "prepare", "shared",
           "tie_points"]
