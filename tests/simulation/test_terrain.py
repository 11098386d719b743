import numpy as np
import pytest

from solvers.errors import DegenerateGeometry
from solvers.simulation import Terrain


def _bumpy(seed: int = 3) -> Terrain:
    heights = np.random.default_rng(seed).uniform(0, 3, (26, 31))
    return Terrain(heights, west=679400.0, north=9123800.0, cell=10.0)


def test_the_surface_passes_through_its_nodes_and_is_bilinear_between_them():
    terrain = _bumpy()
    assert terrain.height(np.array([679400.0 + 70, 9123800.0 - 50])) == pytest.approx(terrain.heights[5, 7], abs=1e-12)
    middle = terrain.height(np.array([679400.0 + 75, 9123800.0 - 55]))
    assert middle == pytest.approx(terrain.heights[5:7, 7:9].mean(), abs=1e-12)
    west, south, east, north = terrain.bounds
    assert (east - west, north - south) == (300.0, 250.0)
    assert terrain.contains(np.array([[west, south], [east + 0.1, north]])).tolist() == [True, False]


def test_rays_meet_the_surface_on_the_ray_and_on_the_ground():
    terrain, rng = _bumpy(), np.random.default_rng(5)
    centre = np.array([679550.0, 9123680.0, 300.0])
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (200, 2)), np.full(200, -1.0)]) * rng.uniform(0.01, 40, (200, 1))
    at = terrain.meet(centre, rays, 1e-9)
    assert np.abs(terrain.height(at[:, :2]) - at[:, 2]).max() < 1e-8
    along = at - centre
    cosine = (along * rays).sum(1) / np.linalg.norm(along, axis=1) / np.linalg.norm(rays, axis=1)
    assert np.abs(np.linalg.norm(np.cross(along, rays), axis=1) / np.linalg.norm(rays, axis=1)).max() < 1e-7
    assert np.all(cosine > 0)


def test_rays_that_do_not_point_down_are_refused():
    with pytest.raises(DegenerateGeometry, match="tilt the camera less"):
        _bumpy().meet(np.array([679550.0, 9123680.0, 300.0]), np.array([[0.1, 0.0, 0.0]]))
