"""Intersection: exact points, covariance against Monte Carlo with and without orientation errors, weak geometry in words."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.cameras import project
from solvers.errors import BadProject, DegenerateGeometry
from solvers.geometry import LocalFrame, angle_derivatives, exp, rotation
from solvers.orientation.intersection import intersect
from solvers.orientation.oriented import Known
from solvers.orientation.rays import Intersection
from tests.checks import check_jacobian, chi_square_band
from tests.synthetic import REAL_CAMERA, SEED_CAMERA

SIGMA = 0.5
EO_SIGMA = np.array([0.1, 0.1, 0.15, 5e-4, 5e-4, 8e-4])


def cameras(n: int = 4, base: float = 40.0) -> list[Exterior]:
    """Cameras along a line at 150 m, a little tilted, kappa near 90 degrees."""
    return [Exterior(rotation(0.03 * (-1) ** i, 0.02 * i - 0.03, 1.5 + 0.01 * i),
                     np.array([base * (i - (n - 1) / 2), 3.0 * i, 150.0]))
            for i in range(n)]


def ground(n: int = 8, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-30, -25, -10], [30, 25, 10], (n, 3))


def block_of(points: np.ndarray, exteriors: list[Exterior], pixels: np.ndarray, crs: str = "local",
             origin: np.ndarray | None = None,
             camera: Interior = REAL_CAMERA) -> Block:
    """Every point in every image."""
    n, m = len(points), len(exteriors)
    stated = points.copy() if origin is None else LocalFrame(origin, crs).to_map(points)
    return Block("site", crs, {"cam": camera}, tuple(Image(f"i{k}", "cam") for k in range(m)),
                 Points(tuple(f"P{k}" for k in range(n)), stated, np.full((n, 3), np.nan), ("check",) * n),
                 Observations(np.repeat(np.arange(m), n), np.tile(np.arange(n), m), pixels.reshape(-1, 2), np.full(n * m, SIGMA)))


def projected(points: np.ndarray, exteriors: list[Exterior], camera: Interior = REAL_CAMERA) -> np.ndarray:
    return np.array([project(camera, e, points) for e in exteriors])


def known(exteriors: list[Exterior], covariance: np.ndarray | None = None) -> list[Known]:
    return [Known(f"i{k}", e, None if covariance is None else e.angle_covariance(covariance)) for k, e in enumerate(exteriors)]


def problem_of(points: np.ndarray, exteriors: list[Exterior], pixels: np.ndarray) -> Intersection:
    n, m = len(points), len(exteriors)
    return Intersection(tuple((REAL_CAMERA, e) for e in exteriors), np.repeat(np.arange(m), n), np.tile(np.arange(n), m),
                        pixels.reshape(-1, 2), np.full(n * m, SIGMA), np.broadcast_to(np.eye(2) / SIGMA**2, (n * m, 2, 2)), n)


def test_exact() -> None:
    points, at = ground(), cameras()
    result = intersect(block_of(points, at, projected(points, at)), known(at))
    np.testing.assert_allclose([p.xyz for p in result.points], points, atol=1e-8)
    assert result.trace.converged and all(p.dof == 5 and abs(p.redundancy.sum() - 5) < 1e-9 for p in result.points)


def test_jacobian() -> None:
    points, at = ground(3), cameras(3)
    pixels = projected(points, at) + np.random.default_rng(2).standard_normal((3, 3, 2))
    check_jacobian(problem_of(points, at, pixels), (points + 0.3).ravel())


def test_engine_equals_dense() -> None:
    """The blockwise normal equations step as the dense ones do."""
    points, at = ground(5), cameras(3)
    problem = problem_of(points, at, projected(points, at) + np.random.default_rng(3).standard_normal((3, 5, 2)))
    x = (points + 0.5).ravel()
    blocks, dense = problem.normal(x), problem.linear(x).normal()
    np.testing.assert_allclose(blocks.gradient, dense.gradient, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(blocks.scale, dense.scale, rtol=1e-12)
    np.testing.assert_allclose(blocks.step(1e-3)[0], dense.step(1e-3)[0], rtol=1e-9)


def _monte_carlo(joint: bool, runs: int = 120) -> None:
    """Normalized errors of one point per run (points of one run share the orientation errors)."""
    points, true, rng = ground(1), cameras(3), np.random.default_rng(20)
    sigma = np.diag(EO_SIGMA**2)
    common = EO_SIGMA * [1, 1, 1, 0, 0, 0] * joint  # a GPS bias shared by all images
    whole = np.kron(np.eye(3), sigma) + np.kron(np.ones((3, 3)), np.diag(common**2))
    chi = []
    for _ in range(runs):
        bias, given = common * rng.standard_normal(6), []
        for e in true:
            d = EO_SIGMA * rng.standard_normal(6) + bias
            given.append(Exterior(exp(d[3:]) @ e.m, e.centre + d[:3]))
        pixels = projected(points, true, SEED_CAMERA) + SIGMA * rng.standard_normal((3, 1, 2))
        angles = np.asarray(block_diag(*(block_diag(np.eye(3), angle_derivatives(e.m)) for e in given)))
        [p] = intersect(block_of(points, true, pixels, camera=SEED_CAMERA), known(given, sigma),
                        joint=angles @ whole @ angles.T if joint else None).points
        chi.append((p.xyz - points[0]) @ np.linalg.solve(p.covariance, p.xyz - points[0]))
    chi_square_band(np.array(chi), 3)


def test_covariance_with_orientation_errors() -> None:
    """The covariance predicts the scatter of points whose images' orientations err by their own covariance."""
    _monte_carlo(joint=False)


def test_covariance_with_joint_orientation_errors() -> None:
    """The same when all images share an error, given by a joint covariance."""
    _monte_carlo(joint=True)


def test_covariance_of_image_noise_alone() -> None:
    points, at, rng = ground(400), cameras(3), np.random.default_rng(5)
    result = intersect(block_of(points, at, projected(points, at) + SIGMA * rng.standard_normal((3, 400, 2))), known(at))
    chi_square_band(np.array([(p.xyz - q) @ np.linalg.solve(p.covariance, p.xyz - q)
                              for p, q in zip(result.points, points, strict=True)]), 3)
    chi_square_band(np.array([p.dof * p.sigma0**2 for p in result.points if p.sigma0 is not None]), 3)


def test_map_coordinates() -> None:
    """In a map grid the points come back in map coordinates, 1e7 m from its origin."""
    points, at = ground(), cameras()
    origin = np.array([679421.0, 9123785.0, 495.0])
    block = block_of(points, at, projected(points, at), "EPSG:32749", origin)
    frame = LocalFrame.around(block.points.xyz, block.crs)
    there = [Known(f"i{k}", Exterior(e.m, LocalFrame(origin, block.crs).to_map(e.centre))) for k, e in enumerate(at)]
    turned = [Known(k.image, Exterior(_between(origin, frame, k.exterior.m), k.exterior.centre)) for k in there]
    result = intersect(block, turned)
    np.testing.assert_allclose([p.xyz for p in result.points], block.points.xyz, atol=1e-6)


def _between(origin: np.ndarray, frame: LocalFrame, m: np.ndarray) -> np.ndarray:
    """M in the axes of the block's own frame, a few metres from the one the cameras were made in."""
    made = LocalFrame(origin, frame.crs)
    axes = np.array([made.to_local(frame.to_map(e)) - made.to_local(frame.to_map(np.zeros(3))) for e in np.eye(3)])
    return m @ axes.T


@pytest.mark.parametrize("blunder", [20.0, 400.0])
def test_robust_names_the_ray(blunder: float) -> None:
    points, at, rng = ground(), cameras(5), np.random.default_rng(7)
    pixels = projected(points, at) + SIGMA * rng.standard_normal((5, 8, 2))
    pixels[2, 3] += [blunder, -blunder / 2]
    result = intersect(block_of(points, at, pixels), known(at), robust=True)
    assert [p.rejected for p in result.points] == [("i2",) if p.name == "P3" else () for p in result.points]
    bad = result.points[3]
    assert "rejected: the rays of i2" in " ".join(bad.warnings) and np.linalg.norm(bad.xyz - points[3]) < 1
    assert np.abs(bad.residuals[2]).max() > 0.8 * blunder / 2 and not bad.used[2]
    loud = intersect(block_of(points, at, pixels), known(at)).points[3]
    assert "bad fit" in " ".join(loud.warnings) and not loud.rejected


def test_weak_geometry_is_named() -> None:
    points = ground(2)
    near = cameras(2, base=1.2)
    result = intersect(block_of(points, near, projected(points, near)), known(near))
    assert "weak geometry" in " ".join(result.points[0].warnings)
    same = [near[0], replace(near[0], centre=near[0].centre + np.array([1e-4, 0, 0]))]
    with pytest.raises(DegenerateGeometry, match="parallel within their noise"):
        intersect(block_of(points, same, projected(points, same)), known(same))


def test_behind_the_camera() -> None:
    """Two images whose rays diverge meet behind them."""
    points, at = ground(1), cameras(2)
    pixels = projected(points, at)
    with pytest.raises(DegenerateGeometry, match="meet behind image"):
        intersect(block_of(points, at, pixels[::-1]), known(at))


def test_one_ray() -> None:
    points, at = ground(2), cameras(2)
    block = block_of(points, at, projected(points, at))
    of = block.observations
    keep = np.array([True, True, True, False])
    block = replace(block, observations=Observations(of.image[keep], of.point[keep], of.pixel[keep], of.sigma[keep]))
    result = intersect(block, known(at), ["P0", "P1"])
    assert [p.name for p in result.points] == ["P0"]
    assert "one ray only (image i0)" in result.failed[0][1]
    with pytest.raises(DegenerateGeometry, match="one ray only"):
        intersect(block, known(at), ["P1"])
    with pytest.raises(BadProject, match="no image is oriented"):
        intersect(block, [])
    with pytest.raises(BadProject, match="there is no point 'Q'"):
        intersect(block, known(at), ["Q"])


def test_json() -> None:
    points, at = ground(2), cameras(2)
    out = intersect(block_of(points, at, projected(points, at)), known(at)).to_json()
    assert {"name", "X", "Y", "Z", "sX", "sY", "sZ", "role", "dX", "dY", "dZ"} <= set(out["points"][0])
    assert abs(out["points"][0]["dX"]) < 1e-8 and out["converged"]


def test_many_points_at_once() -> None:
    """Ten thousand points of four images are one problem, not ten thousand."""
    points, at = ground(10000), cameras(4)
    problem = problem_of(points, at, projected(points, at))
    np.testing.assert_allclose(problem.start().reshape(-1, 3), points, atol=1e-6)
