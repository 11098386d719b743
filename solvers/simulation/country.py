"""A country to photograph: terrain, its painted ground, and renderers of blocks over it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block import Block
from ..geometry import Exterior
from .relief import hills
from .render import photograph
from .scene import Render
from .terrain import Terrain


@dataclass(frozen=True)
class Country:
    """Terrain around a map position `middle` (2,) m and the seed and cell [m] of the picture painted on it."""

    terrain: Terrain
    middle: np.ndarray
    paint: np.random.SeedSequence
    cell: float

    @classmethod
    def around(cls, middle: np.ndarray, relief: np.random.SeedSequence, paint: np.random.SeedSequence, cell: float) -> Country:
        """The hills around `middle`; the ground is painted only when a photo is asked for."""
        return cls(hills(relief, middle), np.asarray(middle, float), paint, cell)

    def renderer(self, block: Block, exteriors: Mapping[str, Exterior], targets: np.ndarray) -> Render:
        """render(image, reduction) of a block over this country with ring targets at true points (n, 3) m."""

        @lru_cache(maxsize=1)
        def ground() -> np.ndarray:
            from .paint import paint_ground

            return paint_ground(self.terrain, self.middle, targets[:, :2] - self.middle, self.paint, self.cell)

        def render(image: str, reduction: int = 4) -> np.ndarray:
            return photograph(block.camera_of(image), exteriors[image], self.terrain, ground(), self.cell, targets, reduction)

        return render
