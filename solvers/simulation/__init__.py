"""Scenes with known truth: what a project would hold, and what is behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..errors import BadProject
from .close_range import calibration_plate, field_long_range, ono_stereo, ono_triplet
from .clusters import uav_cluster
from .flights import uav_block
from .large import large_block
from .monitoring import cliff_epochs
from .scene import Render, Simulated
from .terrain import Terrain

__all__ = ["KINDS", "SERIES", "Render", "Simulated", "Terrain", "calibration_plate",
           "cliff_epochs", "field_long_range", "large_block", "ono_stereo", "ono_triplet",
           "simulate", "uav_block", "uav_cluster"]

KINDS: Mapping[str, Callable[..., Simulated]] = {
    "uav_cluster": uav_cluster, "ono_stereo": ono_stereo, "ono_triplet": ono_triplet, "field_long_range": field_long_range,
    "uav_block": uav_block, "calibration_plate": calibration_plate, "large_block": large_block,
}

SERIES: Mapping[str, Callable[..., tuple[Simulated, ...]]] = {"cliff_epochs": cliff_epochs}
"""Kinds that are several projects: epochs of one network."""


def simulate(kind: str, seed: int = 0, **options: Any) -> Simulated:
    """A simulated scene of one of `KINDS`; the same seed gives the same scene. Raises BadProject for an unknown kind."""
    if kind not in KINDS:
        raise BadProject(f"there is no simulation '{kind}'; choose {', '.join(KINDS)}")
    return KINDS[kind](seed, **options)
