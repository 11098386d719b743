"""Monoplotting: exact on planes and bilinear DEMs, on maps and off, ellipse against Monte Carlo, and every miss in words."""

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Observations, Points
from solvers.cameras import project
from solvers.errors import BadProject, DegenerateGeometry
from solvers.geometry import Grid, LocalFrame, Surface, exp, photo_rotation, rotation
from solvers.orientation.monoplot import Plane, monoplot, trace_ray
from solvers.orientation.oriented import Known
from tests.checks import chi_square_band
from tests.synthetic import REAL_CAMERA, SEED_CAMERA

ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRAME = LocalFrame(np.zeros(3))
AT = Exterior(rotation(0.05, -0.08, 1.5), np.array([5.0, -8.0, 120.0]))


def hills(crs: str = "local", origin: tuple[float, float, float] = (0.0, 0.0, 0.0), cell: float = 2.0, n: int = 121,
          height: float = 6.0) -> Surface:
    """Rough hills on a grid about an origin."""
    rng = np.random.default_rng(4)
    u, v = np.meshgrid(np.arange(n), np.arange(n))
    z = height * np.sin(u / 9) * np.cos(v / 7) + 0.2 * rng.standard_normal((n, n)) + origin[2]
    half = n * cell / 2
    return Surface(Grid((n, n), (cell, 0, origin[0] - half, 0, -cell, origin[1] + half), crs), z)


def block_of(camera=REAL_CAMERA, crs: str = "local", xyz: np.ndarray | None = None) -> Block:
    known = np.zeros((1, 3)) if xyz is None else xyz
    return Block("site", crs, {"cam": camera}, (Image("a", "cam"),), Points(("P",), known, np.full((1, 3), np.nan), ("check",)),
                 Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)))


def test_grid_and_surface() -> None:
    """Edges and centres of a turned grid; nodes, edges, voids and slopes of a surface."""
    grid = Grid((4, 5), (2.0, 0.5, 100.0, 0.3, -2.0, 50.0))
    pixels = np.random.default_rng(0).uniform(0, 4, (6, 2))
    np.testing.assert_allclose(grid.to_pixels(grid.to_map(pixels)), pixels, atol=1e-12)
    np.testing.assert_allclose(grid.corners[0], [100, 50])
    z = np.random.default_rng(1).uniform(0, 9, (4, 5))
    surface = Surface(grid, z)
    nodes = np.stack(np.meshgrid(np.arange(5), np.arange(4)), -1)
    np.testing.assert_allclose(surface.sample(grid.to_map(nodes)), z, atol=1e-9)
    assert np.isnan(surface.sample(grid.to_map(np.array([-0.1, 2.0])))) and np.isnan(surface.sample(grid.to_map(np.array([2.0,
                                                                                                                          3.1]))))
    at = grid.to_map(np.array([1.3, 2.6]))
    numeric = [(surface.sample(at + e) - surface.sample(at - e)) / 2e-4 for e in 1e-4 * np.eye(2)]
    np.testing.assert_allclose(surface.slope(at), numeric, rtol=1e-6)


@pytest.mark.parametrize("pixel", [(100.0, 200.0), (3000.0, 2000.0), (5900.0, 3900.0)])
def test_round_trip(pixel: tuple[float, float]) -> None:
    """The point found projects back to the pixel and lies on the ground, with all ten camera parameters at work."""
    for ground in (Plane(3.0), hills()):
        hit = trace_ray("a", REAL_CAMERA, AT, FRAME, pixel, ground)
        np.testing.assert_allclose(project(REAL_CAMERA, AT, hit.ground), pixel, atol=1e-7)
        z = 3.0 if isinstance(ground, Plane) else ground.sample(hit.ground[:2])
        assert abs(hit.ground[2] - z) < 1e-9


def test_map_and_far_origin() -> None:
    """On a map at 1e7 m the ray bends: the point still lies on plane and DEM, and projects back."""
    frame = LocalFrame(np.array([679421.0, 9123785.0, 495.0]), "EPSG:32749")
    for ground in (Plane(490.0), hills("EPSG:32749", (679421.0, 9123785.0, 495.0))):
        hit = trace_ray("a", REAL_CAMERA, AT, frame, (800.0, 3100.0), ground)
        np.testing.assert_allclose(project(REAL_CAMERA, AT, frame.to_local(hit.ground)), [800, 3100], atol=2e-6)
        z = 490.0 if isinstance(ground, Plane) else ground.sample(hit.ground[:2])
        assert abs(hit.ground[2] - z) < 1e-6


def test_first_of_many_hits() -> None:
    """A low oblique ray over hills: the nearest hit is given, found as a fine search finds it, and the others are named."""
    surface = hills(height=6.0)
    at = Exterior(photo_rotation(np.radians([90.0, -3.0, 0.0]), "gimbal", ENU), np.array([-115.0, 50.0, 9.0]))
    hit = trace_ray("a", SEED_CAMERA, at, FRAME, (2999.5, 1999.5), surface)
    t = np.arange(0, 230, 1e-3)
    unit = -at.m[2]
    path = at.centre + t[:, None] * unit
    over = path[:, 2] - surface.sample(path[:, :2])
    crossing = t[1:][(over[:-1] > 0) & (over[1:] <= 0)]
    assert len(crossing) == 1 + len(hit.others) >= 2
    assert abs(hit.distance - crossing[0]) < 2e-3 and "times from above" in " ".join(hit.warnings)
    np.testing.assert_allclose(np.linalg.norm(hit.others - at.centre, axis=1), crossing[1:], atol=2e-3)


def test_covariance_on_a_slope() -> None:
    """Image noise, orientation, height error: the covariance predicts the scatter on sloping ground, oblique view."""
    slope = Surface(Grid((3, 3), (400.0, 0, -600.0, 0, -400.0, 600.0)), np.array([[90, 30, -30.0]] * 3) * 0.5, sigma=0.4)
    at, rng, chi = Exterior(photo_rotation(np.radians([70.0, -50.0, 5.0]), "gimbal", ENU),
                            np.array([0, 0, 100.0])), np.random.default_rng(6), []
    sigma = np.array([0.2, 0.2, 0.3, 1e-3, 1e-3, 2e-3])
    pixel = np.array([2000.0, 1500.0])
    for _ in range(400):
        d = sigma * rng.standard_normal(6)
        given = Exterior(exp(d[3:]) @ at.m, at.centre + d[:3])
        ground = Surface(slope.grid, slope.z + 0.4 * rng.standard_normal(), sigma=0.4)
        seen = pixel + 0.7 * rng.standard_normal(2)
        hit = trace_ray("a", SEED_CAMERA, given, FRAME, (seen[0], seen[1]), ground, 0.7, np.diag(sigma**2))
        truth = trace_ray("a", SEED_CAMERA, at, FRAME, (pixel[0], pixel[1]), slope).ground
        e = hit.ground - truth
        chi.append(e @ np.linalg.solve(hit.covariance, e))
    chi_square_band(np.array(chi), 3)


def test_ellipse() -> None:
    """Semi-axes and azimuth of a known covariance; an oblique view is longest along the line of sight."""
    at = Exterior(photo_rotation(np.radians([30.0, -30.0, 0.0]), "gimbal", ENU), np.array([0, 0, 100.0]))
    hit = monoplot(block_of(SEED_CAMERA), Known("a", at), (2999.5, 1999.5), Plane(0.0), sigma_px=1.0)
    assert abs(hit.ellipse.azimuth_deg - 30) < 1e-6
    assert abs(hit.ellipse.semi_major_m / hit.ellipse.semi_minor_m - 2) < 1e-3  # 1 / sin 30
    assert abs(hit.ellipse.semi_minor_m - 2.4477 * 200 * SEED_CAMERA.pitch[0] / 35) < 1e-4
    out = hit.to_json()
    assert out["ellipse95"]["azimuth_deg"] == hit.ellipse.azimuth_deg and "no covariance" in " ".join(out["warnings"])
    raised = monoplot(block_of(SEED_CAMERA), Known("a", at), (2999.5, 1999.5), Plane(0.0, sigma=1.0), sigma_px=0.0)
    assert abs(raised.ellipse.semi_major_m - 2.4477 / np.tan(np.radians(30))) < 1e-3  # height error slides along the ray


def test_misses_in_words() -> None:
    level = Exterior(photo_rotation(np.radians([0.0, 5.0, 0.0]), "gimbal", ENU), np.array([0, 0, 50.0]))
    down = Exterior(photo_rotation(np.radians([0.0, -90.0, 0.0]), "gimbal", ENU), np.array([0, 0, 50.0]))
    middle, low = (2999.5, 1999.5), Exterior(down.m, np.array([0, 0, -20.0]))
    void = hills()
    holed = Surface(void.grid, np.where(np.abs(np.arange(121) - 60)[:, None] < 8, np.nan, void.z))
    aside = Exterior(down.m, np.array([900.0, 0, 50]))
    grazing = Exterior(photo_rotation(np.radians([0.0, -15.0, 0.0]), "gimbal", ENU), np.array([0, 100.0, 50]))
    for at, ground, words in ((level, Plane(0.0), "above the horizon"), (level, hills(), "above the horizon"),
                              (low, Plane(0.0), "below the plane"),
                              (low, hills(), "below DEM"), (aside, hills(), "never passes over DEM"),
                              (grazing, hills(), "leaves DEM"),
                              (down, holed, "never passes over DEM")):
        with pytest.raises(DegenerateGeometry, match=words):
            trace_ray("a", SEED_CAMERA, at, FRAME, middle, ground)
    with pytest.raises(BadProject, match="outside its 6000 x 4000"):
        monoplot(block_of(SEED_CAMERA), Known("a", down), (7000.0, 0.0), Plane(0.0))
    with pytest.raises(BadProject, match="warp the DEM"):
        monoplot(block_of(SEED_CAMERA), Known("a", down), middle, hills("EPSG:32632"))


def test_horizon_on_a_map() -> None:
    """Just below the horizon a ray still meets a plane far away, on the curved earth; above it never does."""
    frame = LocalFrame(np.array([500000.0, 5300000.0, 0.0]), "EPSG:32632")
    for pitch, meets in ((-2.0, True), (0.0, False)):
        at = Exterior(photo_rotation(np.radians([0.0, pitch, 0.0]), "gimbal", ENU), np.array([0, 0, 100.0]))
        if meets:
            hit = trace_ray("a", SEED_CAMERA, at, frame, (2999.5, 1999.5), Plane(0.0))
            assert abs(hit.ground[2]) < 1e-6 and 2864 < hit.distance < 2900 and "grazes" in " ".join(hit.warnings)
        else:
            with pytest.raises(DegenerateGeometry, match="above the horizon"):
                trace_ray("a", SEED_CAMERA, at, frame, (2999.5, 1999.5), Plane(0.0))
