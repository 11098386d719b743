"""The advisor: predictions for the published clusters, prior share, distrust, and a choice that is (nearly) always best."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import DegenerateGeometry
from solvers.orientation import advise, resect, resect_orthogonal
from tests.checks import angle_between
from tests.synthetic import SEED_EXTERIOR, block_of, cluster, prior_of, scene


@pytest.mark.parametrize("centre, n, fov, relief, sd", [
    ((0.0, 0.0), 4, 6.0, 0.0, [0.38367, 0.38536]), ((0.0, 0.0), 4, 6.0, 1.0, [0.28505, 0.4371]),
    ((0.0, 0.0), 4, 6.0, 5.0, [0.10286, 0.13212]), ((0.0, 0.0), 4, 40.0, 5.0, [0.01328, 0.01626])])
def test_predicted_tilt_against_independent_values(centre, n, fov, relief, sd):
    """omega, phi [deg] of the perspective model at 0.3 px."""
    advice = advise(block_of(cluster(centre, n, fov, relief), SEED_EXTERIOR), "a")
    said = advice.predicted["perspective"].to_json()
    assert [said["omega_deg"], said["phi_deg"]] == pytest.approx(sd, rel=0.01)
    assert said["tilt_deg"] == pytest.approx(np.hypot(*sd), rel=0.01)


def test_without_a_prior_perspective_and_whether_orthogonal_is_equivalent():
    narrow = advise(block_of(cluster(n=10, fov_deg=2, relief=5), SEED_EXTERIOR), "a")
    assert narrow.model == "perspective" and any("equivalent" in r for r in narrow.reasons)
    wide = advise(block_of(cluster(n=10, fov_deg=40, relief=5), SEED_EXTERIOR), "a")
    assert wide.model == "perspective" and any("run away" in r or "lose precision" in r for r in wide.reasons)
    assert set(narrow.predicted) == {"perspective", "orthogonal iterated"}


def test_flat_narrow_control_is_not_sold_as_an_exterior_orientation():
    advice = advise(block_of(cluster(n=4, fov_deg=0.5, relief=0.0), SEED_EXTERIOR), "a")
    assert advice.model == "local registration" and "does not determine the tilt" in " ".join(advice.reasons)


def test_an_ambiguity_is_said():
    advice = advise(block_of(cluster((8.0, 5.0), 4, 1.0, 0.0), SEED_EXTERIOR, sigma_m=0.0), "a")
    assert advice.discrimination == pytest.approx(1.27, rel=0.01)
    assert any("cannot be told apart" in r for r in advice.reasons)


def test_prior_share_tells_where_the_tilt_comes_from():
    flat = block_of(cluster(n=4, fov_deg=1, relief=0.0), SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.1, 1.0))
    advice = advise(flat, "a")
    assert advice.model == "perspective with prior"
    assert advice.predicted["perspective with prior"].remarks["prior_share"] > 0.7
    assert any("comes from the prior" in r for r in advice.reasons)
    wide = block_of(cluster(n=10, fov_deg=40, relief=5), SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.1, 1.0))
    strong = advise(wide, "a").predicted["perspective with prior"].remarks["prior_share"]
    assert strong < 0.1


def test_gauss_markov_with_the_prior_is_never_worse():
    for relief in (0.0, 1.0, 5.0):
        block = block_of(cluster(n=6, fov_deg=6, relief=relief), SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.5, 2.0))
        p = advise(block, "a").predicted
        bound = p["perspective with prior"].tilt
        assert bound <= p["perspective"].tilt * 1.0001 and bound <= p["orthogonal one pass"].tilt * 1.0001


def test_a_prior_that_contradicts_the_image_is_distrusted():
    points = cluster(n=10, fov_deg=20, relief=5)
    off = replace(SEED_EXTERIOR, centre=SEED_EXTERIOR.centre + np.array([4.0, 0, 0]))
    advice = advise(block_of(points, SEED_EXTERIOR, prior=prior_of(off, 0.5, 0.5)), "a")
    assert advice.model == "perspective" and any("contradicts the image" in r for r in advice.reasons)


def test_priors_three_times_too_confident_are_found_where_the_image_can_see_it():
    """A strong image: most such priors are distrusted, and hardly an honest one is."""
    points, caught, blamed = cluster(n=10, fov_deg=30, relief=10), 0, 0
    rng = np.random.default_rng(1)
    for seed in range(12):
        for stated in (1 / 3, 1.0):
            prior = prior_of(SEED_EXTERIOR, 0.5, 2.0, rng, stated)
            advice = advise(block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed, prior=prior), "a")
            distrusted = advice.model == "perspective"
            caught += distrusted and stated < 1
            blamed += distrusted and stated == 1
    assert caught >= 8 and blamed <= 1


def test_the_choice_is_best_or_nearly_best_on_random_geometries():
    """Tilt error of the advised solution against that of every candidate, predicted at the truth: within 10 %."""
    rng, good, total = np.random.default_rng(2), 0, 0
    for seed in range(20):
        n, fov = int(rng.integers(4, 16)), float(np.exp(rng.uniform(np.log(3), np.log(40))))
        points, at = scene(rng, n, fov, depth=float(rng.choice([0.01, 0.1])))
        prior = prior_of(at, 0.3, 1.5, rng) if seed % 2 else None
        block = block_of(points, at, noise_px=0.3, seed=seed, prior=prior)
        advice = advise(block, "a")
        exact = advise(block_of(points, at, prior=prior and prior_of(at, 0.3, 1.5)), "a")
        truth = {name: p.tilt for name, p in exact.predicted.items()}
        total += 1
        if advice.model == "local registration":
            good += truth["perspective"] > np.radians(1.5)
        else:
            good += truth[advice.model] <= 1.1 * min(truth.values())
    assert good / total >= 0.95


def test_advice_can_be_followed_and_written_down():
    import json

    block = block_of(cluster(n=8, fov_deg=10), SEED_EXTERIOR, noise_px=0.3, prior=prior_of(SEED_EXTERIOR, 0.5, 2.0))
    advice = advise(block, "a")
    assert json.loads(json.dumps(advice.to_json()))["model"] == "perspective with prior"
    for name, got in (("perspective", resect(block, "a")), ("perspective with prior", resect(block, "a", prior="weighted")),
                      ("orthogonal iterated", resect_orthogonal(block, "a")),
                      ("orthogonal one pass", resect_orthogonal(block, "a", one_pass=True))):
        stated = np.sqrt(got.covariance[3, 3] + got.covariance[4, 4])
        assert stated == pytest.approx(advice.predicted[name].tilt, rel=0.05), name
        assert angle_between(got.exterior, SEED_EXTERIOR) < 6 * stated
    with pytest.raises(DegenerateGeometry):
        advise(block, "a", points=("P1", "P2"))
