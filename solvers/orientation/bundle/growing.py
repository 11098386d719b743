"""A block that grows image by image, adjusted on the way: what little each resection is off would add up across a large one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...adjustment import Options, solve
from ...geometry import Exterior
from .datum import Inner
from .given import Given, network
from .meeting import behind, points, without_wrong_rays
from .problem import Bundle
from .statistics import datum_defects

ROUGH = Options(max_iterations=6, max_trials=6, damping=1e-3, step_tolerance=0.05, cost_tolerance=1e-3)
"""How such an adjustment iterates: to what a start needs."""


def straightened(data: Given, poses: dict[int, Exterior], known: np.ndarray) -> None:
    """Adjust the oriented images in place, by their common points and by control where `known` (n, 3) has it: robustly, with the
    interior orientations as they are, in the datum they have."""
    held = np.asarray((np.isfinite(known) & np.isfinite(data.known)).all(axis=1))
    request = replace(data.request, loss="huber", free=(), per_image=False, rolling_shutter="none", model="perspective")
    lone = replace(data, block=replace(data.block, scale_bars=(), together=()), request=request, priors={},
                   known=np.where(held[:, None], data.known, np.nan), weight=np.where(held[:, None], data.weight, 0.0))
    xyz = points(data, poses)
    without_wrong_rays(data, poses, xyz)
    xyz = np.where(np.isfinite(xyz), xyz, np.where(held[:, None], known, np.nan))
    behind(data, poses, xyz)
    order = sorted(poses)
    net, x, _ = network(lone, poses, xyz)
    problem = Bundle.of(net)
    if datum_defects(problem, x):
        at = net.split(x)[2]
        net = replace(net, known=np.full_like(at, np.nan), weight=np.zeros_like(at))
        problem = Bundle.of(net, Inner(np.arange(len(at)), at.copy()))
    last = solve(problem, x, ROUGH).last
    if np.isfinite(last.cost) and last.cost < problem.cost(x):
        poses.update({i: Exterior.from_vector(row) for i, row in zip(order, net.split(last.x)[0], strict=True)})
