"""Image matching: correlation, least squares matching, targets and tie points."""

from .lsm import LsmOptions, match_lsm
from .ncc import match_ncc
from .patches import Photo, prepare
from .result import LsmResult, NccResult, Status

__all__ = ["LsmOptions", "LsmResult", "NccResult", "Photo", "Status", "match_lsm", "match_ncc", "prepare"]
