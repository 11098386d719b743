"""Monitoring: congruency of free networks, datum, what moved and nothing else, false alarms at the stated level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from solvers import BadProject, DegenerateGeometry
from solvers.orientation import BundleRequest, adjust
from solvers.orientation.bundle.joint import free_epoch
from solvers.orientation.deformation import Epoch, compare_epochs, noncentrality
from solvers.simulation import cliff_epochs, ono_stereo, ono_triplet
from solvers.simulation.monitoring import MOVED
from tests.checks import chi_square_band


def epochs_of(seed: int, count: int = 2, request: BundleRequest | None = None, **options) -> list[Epoch]:
    out, frame = [], None
    for k, sim in enumerate(cliff_epochs(seed, epochs=count, **options)):
        epoch, frame, said = free_epoch(sim.block, request or BundleRequest(), f"epoch{k + 1}", frame=frame)
        assert not said
        out.append(epoch)
    return out


@pytest.fixture(scope="module")
def still() -> tuple[Epoch, np.ndarray]:
    """An epoch of the cliff and a root of the covariance of its points."""
    epoch = epochs_of(1, 1)[0]
    values, vectors = np.linalg.eigh(epoch.covariance)
    return epoch, vectors * np.sqrt(np.maximum(values, 0))


def drawn(still: tuple[Epoch, np.ndarray], rng: np.random.Generator, name: str, shift: np.ndarray | float = 0.0) -> Epoch:
    """Another epoch of the same network, its points in error as its covariance says, its sigma0 as its redundancy says."""
    epoch, root = still
    error = (root @ rng.standard_normal(root.shape[1])).reshape(-1, 3)
    sigma0 = float(np.sqrt(rng.chisquare(epoch.dof) / epoch.dof))
    return replace(epoch, name=name, xyz=epoch.xyz + error + shift, sigma0=sigma0)


def test_movements_of_three_millimetres_are_found_and_nothing_else():
    found = 0
    for seed in range(3):
        epochs = epochs_of(seed, 3)
        got = compare_epochs(epochs)
        assert not got.warnings
        found += set(got.moved) == set(MOVED)
        assert set(MOVED) <= set(got.moved) and len(got.moved) <= len(MOVED) + 1
        for k, pair in enumerate(got.pairs):
            assert not pair.tests[0].congruent and pair.tests[-1].congruent
            for d in pair.displacements:
                true = np.array(MOVED.get(d.point, (0, 0, 0))) * 0.003 * (k + 1)
                assert (d.d - true) @ np.linalg.solve(d.covariance, d.d - true) < 25  # chi-square with 3
                inside = d.directions @ (d.d - true) / d.axes
                assert (inside**2).sum() < 3.5
    assert found >= 2  # each run may raise a false alarm with 5 %


def test_false_alarms_come_at_the_stated_level(still):
    rng, runs = np.random.default_rng(5), 240
    for level in (0.05, 0.3):
        alarms = sum(bool(compare_epochs([drawn(still, rng, "a"), drawn(still, rng, "b")], level=level).moved)
                     for _ in range(runs if level < 0.1 else runs // 2))
        n = runs if level < 0.1 else runs // 2
        low, high = binom.ppf([0.001, 0.999], n, level)
        assert alarms <= high and alarms >= binom.ppf(0.001, n, 0.6 * level), (level, alarms, low, high)


def test_false_alarms_of_several_epochs_and_beside_true_movements(still):
    rng, runs, alarms, missed = np.random.default_rng(6), 60, 0, 0
    names = still[0].points
    step = np.array([np.array(MOVED.get(n, (0, 0, 0))) * 0.003 for n in names])
    for _ in range(runs):
        got = compare_epochs([drawn(still, rng, "a"), drawn(still, rng, "b", step), drawn(still, rng, "c", 2 * step)])
        alarms += bool(set(got.moved) - set(MOVED))
        missed += bool(set(MOVED) - set(got.moved))
    assert alarms <= binom.ppf(0.999, runs, 0.05) and missed == 0


def test_displacements_scatter_as_their_covariance_says(still):
    rng = np.random.default_rng(7)
    step = np.zeros((len(still[0].points), 3))
    step[6] = [0.0, -0.003, 0.001]
    values, others = [], []
    for _ in range(60):
        a, b = drawn(still, rng, "a"), drawn(still, rng, "b", step)
        (pair,) = compare_epochs([replace(a, sigma0=1.0), replace(b, sigma0=1.0)]).pairs
        d = pair.displacements[6]
        assert d.moved and not d.datum
        values.append((d.d - step[6]) @ np.linalg.solve(d.covariance, d.d - step[6]))
        d = pair.displacements[20]
        others.append(d.d @ np.linalg.solve(d.covariance, d.d))
    chi_square_band(np.array(values), 3)
    chi_square_band(np.array(others), 3)


def test_the_detectable_movement_is_found_as_often_as_it_says(still):
    rng, hits, runs = np.random.default_rng(8), 0, 100
    d = compare_epochs([drawn(still, rng, "a"), drawn(still, rng, "b")]).pairs[0].displacements[12]
    step = np.zeros((len(still[0].points), 3))
    step[12] = d.directions[0] * d.detectable
    for _ in range(runs):
        got = compare_epochs([drawn(still, rng, "a"), drawn(still, rng, "b", step)])
        hits += d.point in got.moved
    assert 0.68 < hits / runs < 0.94  # the congruency of all adds a little to the test of one
    assert noncentrality(0.05, 10**6) == pytest.approx(10.903, abs=0.01)  # tabulated: 3 degrees of freedom, 5 %, 80 %


def test_place_attitude_and_scale_of_an_epoch_do_not_matter():
    a, b = epochs_of(2, 2)
    turn, scale = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0], 1.004
    turn *= np.sign(np.linalg.det(turn))
    big = np.kron(np.eye(len(b.points)), scale * turn)
    other = replace(b, xyz=scale * b.xyz @ turn.T + [5.0, -3.0, 2.0], covariance=big @ b.covariance @ big.T)
    one, two = compare_epochs([a, b]), compare_epochs([a, other])
    assert one.moved == two.moved and two.pairs[0].scale * scale == pytest.approx(one.pairs[0].scale, rel=1e-9)
    for p, q in zip(one.pairs[0].displacements, two.pairs[0].displacements, strict=True):
        np.testing.assert_allclose(p.d, q.d, atol=1e-9)
        np.testing.assert_allclose(p.covariance, q.covariance, rtol=1e-5, atol=1e-15)


def test_the_datum_can_be_named_and_a_point_that_fits_comes_back(still):
    rng = np.random.default_rng(9)
    names = still[0].points
    step = np.zeros((len(names), 3))
    step[:14] = [0.0, -0.004, 0.0]  # a third of the wall slides as one
    a, b = drawn(still, rng, "a"), drawn(still, rng, "b", step)
    assert set(compare_epochs([a, b]).moved) == set(names[:14])
    few = names[20:32]
    got = compare_epochs([a, b], stable=few)
    assert set(got.datum) <= set(few) and set(got.moved) == set(names[:14])
    slid = compare_epochs([a, b], stable=names[:14])  # told that the moving part stands still
    assert set(slid.moved) == set(names[14:]) and any("less than half" in w for w in slid.warnings)
    assert all(abs(d.d[1] - 0.004) < 0.002 for d in slid.pairs[0].displacements[14:])


def test_a_network_that_bends_everywhere_is_said_to_have_no_datum(still):
    rng = np.random.default_rng(10)
    bend = 0.01 * rng.normal(size=(len(still[0].points), 3))
    got = compare_epochs([drawn(still, rng, "a"), drawn(still, rng, "b", bend)])
    assert len(got.pairs[0].stable) < 12 and got.warnings


def test_what_cannot_be_compared_is_said(still):
    epoch = still[0]
    with pytest.raises(BadProject, match="two epochs or more"):
        compare_epochs([epoch])
    with pytest.raises(BadProject, match="no point 'x'"):
        compare_epochs([epoch, epoch], stable=["x", "1", "2", "3"])
    with pytest.raises(BadProject, match="level"):
        compare_epochs([epoch, epoch], level=2.0)
    with pytest.raises(DegenerateGeometry, match="share 2 point"):
        compare_epochs([epoch, replace(epoch, points=("1", "2", *(f"n{k}" for k in range(len(epoch.points) - 2))))])
    with pytest.raises(DegenerateGeometry, match="on a line"):
        compare_epochs([epoch, epoch], stable=epoch.points[:3])
    with pytest.raises(DegenerateGeometry, match="no redundancy"):
        compare_epochs([epoch, replace(epoch, dof=0)])
    with pytest.raises(DegenerateGeometry, match="two images leaves depths"):
        free_epoch(ono_stereo(1).block, BundleRequest(model="orthogonal"), "e")
    far = replace(epoch, sigma0=3.0)
    assert any("differ by more than chance" in w for w in compare_epochs([epoch, far]).warnings)


@pytest.mark.parametrize("model", ["perspective", "orthogonal"])
def test_an_epoch_holds_what_the_bundle_says(model):
    block = ono_triplet(2).block
    epoch, frame, _ = free_epoch(block, BundleRequest(model=model), "e")
    got = adjust(block, datum="free", model=model)
    assert epoch.sigma0 == pytest.approx(got.sigma0, rel=1e-6) and epoch.dof == got.dof
    for k, p in enumerate(got.points):
        assert epoch.points[k] == p.name and np.abs(frame.to_map(epoch.xyz[k]) - p.xyz).max() < 1e-7
        np.testing.assert_allclose(epoch.covariance[3 * k:3 * k + 3, 3 * k:3 * k + 3], p.covariance, rtol=1e-5, atol=1e-14)
    values = np.linalg.eigvalsh(epoch.covariance)
    assert (values[:7] < 1e-9 * values[-1]).all() and values[7] > 1e-6 * values[-1]
    again, _, _ = free_epoch(block, BundleRequest(model=model), "e", got.trace)
    np.testing.assert_allclose(again.xyz, epoch.xyz, atol=1e-7)


def test_the_orthogonal_model_sees_the_same_movements():
    got = compare_epochs(epochs_of(3, 2, BundleRequest(model="orthogonal")))
    assert set(got.moved) == set(MOVED)
