"""Positions on a line hold no roll about it: the photos are taken to look down, that is said, and nobody else is touched."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Block
from solvers.block import Prior
from solvers.errors import DegenerateGeometry
from solvers.orientation.bundle import Begun, BundleRequest, adjust, prepare_bundle
from solvers.orientation.bundle.level import LEVEL, line_of, roll
from solvers.simulation import uav_block

SAID = "of one line and hardly hold the rotation about it"


def strip(sigma: float = 3.0, strips: int = 1, seed: int = 5, noise: float = 1.0) -> tuple[Block, dict[str, np.ndarray]]:
    """A flight with positions alone: no control, no angles; and the true viewing axes. noise: of the positions, in sigmas."""
    made = uav_block(seed, strips=strips, images=6, ties=250, control=0, checks=0, fine=False)
    rng = np.random.default_rng(seed)

    def placed(name: str) -> Prior:
        return Prior(made.exteriors[name].centre + noise * sigma * rng.standard_normal(3), None, np.full(3, sigma))

    images = tuple(replace(i, prior=placed(i.name)) for i in made.block.images)
    return replace(made.block, images=images), {i.name: -made.exteriors[i.name].m[2] for i in images}


@pytest.mark.parametrize("seed", [5, 6, 7, 8])
def test_a_strip_held_by_positions_alone_looks_down_and_says_so(seed: int) -> None:
    block, axes = strip(seed=seed)
    done = adjust(block, datum="prior")
    assert done.trace.converged and (done.sigma0 or 9) < 1.2
    assert [w for w in done.warnings if SAID in w and "look down on average" in w]
    assert done.groups["level"][0] is not None and "IMU" not in done.groups
    off = [np.degrees(np.arccos(-o.exterior.m[2] @ axes[o.image])) for o in done.orientations]
    assert max(off) < 15
    at = np.array([p.prior.centre for p in block.images if p.prior is not None])
    along = np.linalg.svd(at - at.mean(axis=0))[2][0]
    omega, phi = (np.sqrt(np.median([o.covariance[k, k] for o in done.orientations])) for k in (3, 4))
    assert 0.7 * LEVEL < max(omega, phi) < 1.1 * LEVEL and abs(along[2]) < 0.5  # as uncertain as the assumption


def test_positions_exactly_on_a_line_do() -> None:
    block, _ = strip()
    at = np.array([p.prior.centre for p in block.images if p.prior is not None])
    along = np.linalg.svd(at - at.mean(axis=0))[2][0]
    on = at.mean(axis=0) + np.outer((at - at.mean(axis=0)) @ along, along)
    images = tuple(replace(i, prior=Prior(c, None, np.full(3, 3.0))) for i, c in zip(block.images, on, strict=True))
    done = adjust(replace(block, images=images), datum="prior")
    assert done.trace.converged and np.mean([o.exterior.m[2] for o in done.orientations], axis=0)[2] > 0.9


def test_a_block_whose_positions_hold_it_is_as_it_was() -> None:
    for block in (strip(strips=2)[0], strip(sigma=0.02)[0]):
        start = prepare_bundle(block, BundleRequest(datum="prior"))
        assert line_of(start.problem.network) is None and not [w for w in start.warnings if SAID in w]
    block, _ = strip()
    turned = tuple(replace(i, prior=replace(i.prior, angles=(0.0, 0.0, 0.0), sigma_rad=np.full(3, 0.1)))  # type: ignore[type-var]
                   for i in block.images)
    start = prepare_bundle(replace(block, images=turned), BundleRequest(datum="prior"))
    assert line_of(start.problem.network) is None


def test_it_is_the_same_problem_when_it_is_gone_on_with() -> None:
    block, _ = strip()
    done = adjust(block, datum="prior")
    first, last = done.trace.rows[0].x, done.trace.last.x
    again = prepare_bundle(block, BundleRequest(datum="prior"), Begun(done.trace.manifest, first, last))
    assert again.problem.cost(last) == pytest.approx(done.cost, rel=1e-9)


def test_a_roll_looks_down() -> None:
    north = np.array([0.0, 1.0, 0.0])
    assert roll(north, np.array([1.0, 0, 0])) == pytest.approx(np.pi / 2)
    assert roll(north, np.array([0, 0, -1.0])) == pytest.approx(0)


def test_no_control_but_positions_is_told_with_its_cure() -> None:
    block, _ = strip()
    with pytest.raises(DegenerateGeometry, match=r"GPS positions of 6 images take no part .*--datum prior") as error:
        adjust(block, datum="control")
    assert "nor a prior" not in str(error.value)
