"""Four models of the same control: exact where their geometry is, and honest where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.orientation.models import MODELS, compare_models
from solvers.simulation import uav_cluster


def test_without_noise_the_central_models_are_exact_and_the_affine_one_is_not() -> None:
    sim = uav_cluster(3, noise=0.0)
    images, space = compare_models(sim.block)
    assert [f.model for f in images[:4]] == list(MODELS) and len(images) == 4 * len(sim.block.images)
    for f in images:
        assert not f.refused and f.dof == 2 * f.points - {"dlt": 11, "affine": 8}.get(f.model, 6)
        assert f.redundancy[1] == pytest.approx(f.dof / (2 * f.points), rel=1e-6)
        assert (f.rms_px < 1e-3) == (f.model != "affine") and f.check_px is not None
        assert f.matrix is not None
    at = {m.model: m for m in space}
    assert all(m.rms is not None and m.points > 3 for m in space)
    for model in MODELS:
        off = np.linalg.norm(np.asarray(at[model].rms))
        assert off > 0.1 if model == "affine" else off < 1e-3


def test_too_little_control_is_said_of_the_model_that_needs_it() -> None:
    block = uav_cluster(3).block
    for name in [n for n, r in zip(block.points.names, block.points.role, strict=True) if r == "control"][5:]:
        block = block.with_role(name, "check")
    refused = {f.model for f in compare_models(block, (block.images[0].name,))[0] if f.refused}
    assert "dlt" in refused and "perspective" not in refused
