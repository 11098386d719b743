"""Start values of large blocks without approximations; where rays meet, all points at once."""

from dataclasses import replace

import numpy as np

from solvers.orientation.bundle.given import BundleRequest, given
from solvers.orientation.bundle.meeting import misses, points, without_wrong_rays
from solvers.orientation.bundle.start import start
from solvers.orientation.rays import Intersection
from solvers.simulation import large_block

MADE = large_block(3, images=60, points=12)
BARE = replace(MADE.block, images=tuple(replace(i, prior=None) for i in MADE.block.images))
DATA = given(BARE, BundleRequest())
TRUE = {i: DATA.frame_of(e) if hasattr(DATA, "frame_of") else replace(e, centre=DATA.frame.to_local(e.centre))
        for i, e in enumerate(MADE.exteriors.values())} if hasattr(MADE, "exteriors") else {}
