import numpy as np
import pytest

from solvers.cameras import project
from solvers.errors import BadProject
from solvers.simulation import Simulated, simulate
from solvers.simulation.relief import RIVER_HALF_WIDTH, river


@pytest.fixture(scope="module")
def exact() -> Simulated:
    return simulate("uav_cluster", 0, noise=0.0)


def test_the_first_image_is_that_of_table_one(exact: Simulated):
    """Tjahjadi & Agustina 2019, Table I, and the camera of their section I."""
    first = next(iter(exact.truth["images"].values()))
    assert first == {"X": 679421.0695, "Y": 9123785.2218, "Z": 794.8981,
                     "omega_deg": -2.6368, "phi_deg": 3.9069, "kappa_deg": 88.933}
    camera = exact.block.camera_of(exact.block.images[0].name)
    assert (camera.c, camera.width, camera.height) == (35.0, 6000, 4000)
    assert camera.pixel_mm == pytest.approx((23.5 / 6000, 23.5 / 6000), rel=1e-15)


def test_thirty_three_points_in_five_clusters_of_six_degrees(exact: Simulated):
    points, centre = exact.block.points, exact.exteriors[exact.block.images[0].name].centre
    control = np.array(points.role) == "control"
    assert control.sum() == 33 and sum(r == "check" for r in points.role) == 6
    for k in range(1, 6):
        members = np.array([g == f"cluster{k}" for g in points.group])
        rays = exact.xyz[members] - centre
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        widest = np.degrees(np.arccos((rays @ rays.T).min()))
        assert members.sum() >= 4 and np.all(control[members])
        assert 5.2 < widest < 6.2
    assert len(exact.block.seen_in(exact.block.images[0].name, ("control",))) == 33


def test_points_lie_on_dry_ground_with_real_relief(exact: Simulated):
    terrain = exact.terrain
    assert terrain is not None
    assert np.abs(terrain.height(exact.xyz[:, :2]) - exact.xyz[:, 2]).max() < 1e-5
    middle = np.array([(terrain.bounds[0] + terrain.bounds[2]) / 2, (terrain.bounds[1] + terrain.bounds[3]) / 2])
    at = exact.xyz[:, :2] - middle
    assert np.abs(at[:, 1] - river(at[:, 0])).min() > RIVER_HALF_WIDTH + 2
    assert 15 < np.ptp(exact.xyz[:, 2]) < 50 and abs(exact.xyz[:, 2].mean() - 495) < 10


def test_without_noise_the_observations_are_projections_inside_the_format(exact: Simulated):
    block, of = exact.block, exact.block.observations
    for i, image in enumerate(block.images):
        rows = np.flatnonzero(of.image == i)
        pixels = project(block.camera_of(image.name), exact.exteriors[image.name], exact.xyz[of.point[rows]])
        assert np.abs(pixels - of.pixel[rows]).max() < 1e-7
        assert block.camera_of(image.name).inside(of.pixel[rows]).all()
    assert np.array_equal(block.points.xyz, exact.xyz)
    assert (np.bincount(of.point) >= 3).mean() > 0.9


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_noise_is_as_large_as_the_sigmas_say(seed: int):
    noisy, exact = simulate("uav_cluster", seed), simulate("uav_cluster", seed, noise=0.0)
    key = lambda s: list(zip(s.block.observations.image.tolist(), s.block.observations.point.tolist(), strict=True))  # noqa: E731
    assert key(noisy) == key(exact)
    image = (noisy.block.observations.pixel - exact.block.observations.pixel).ravel()
    ground = (noisy.block.points.xyz - exact.xyz).ravel()
    assert image.std() == pytest.approx(0.3, rel=0.2) and abs(image.mean()) < 0.08
    assert ground.std() == pytest.approx(0.002, rel=0.3)
    assert set(noisy.block.observations.sigma) == {0.3} and np.all(noisy.block.points.sigma == 0.002)


def test_priors_are_near_the_truth_as_their_sigmas_say():
    ratios = []
    for seed in range(12):
        simulated = simulate("uav_cluster", seed)
        for image in simulated.block.images:
            true, prior = simulated.exteriors[image.name], image.prior
            assert prior is not None and prior.centre is not None and prior.angles is not None
            assert prior.sigma_m is not None and prior.sigma_rad is not None
            ratios += [(prior.centre - true.centre) / prior.sigma_m, (prior.angles - true.angles) / prior.sigma_rad]
    assert np.concatenate(ratios).std() == pytest.approx(1.0, abs=0.15)


def test_the_same_seed_gives_the_same_scene_and_another_seed_another():
    a, b, c = (simulate("uav_cluster", s) for s in (7, 7, 8))
    assert np.array_equal(a.block.observations.pixel, b.block.observations.pixel) and a.truth == b.truth
    assert not np.array_equal(a.block.points.xyz, c.block.points.xyz)


def test_options_set_the_sigmas():
    simulated = simulate("uav_cluster", 0, image_px=1.0, control_m=0.01)
    assert simulated.block.image_px == 1.0 and simulated.block.control_m == (0.01, 0.01, 0.01)
    assert set(simulated.block.observations.sigma) == {1.0}


def test_an_unknown_kind_is_named():
    with pytest.raises(BadProject, match="'moon'; choose uav_cluster"):
        simulate("moon")
