"""Registration: Jacobians, truth recovered, covariance, levels, groups, wrong control, nearly deficient networks."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points, Prior
from solvers.adjustment import Options, solve
from solvers.cameras import project
from solvers.errors import BadProject, DegenerateGeometry
from solvers.mosaic import RegistrationRequest, check_ties, register
from solvers.mosaic.georeferencing import similarity
from solvers.mosaic.growing import fit
from solvers.mosaic.models import Coefficients, Exteriors, through
from solvers.mosaic.network import Network
from solvers.mosaic.precision import Response
from solvers.mosaic.problem import PhotoPriors, Registering, ShapePriors
from solvers.orientation import BundleRequest, adjust
from tests.checks import central, chi_square_band

CAMERA = Interior(35.0, 0.05, -0.03, 2e-5, pixel_mm=0.016, width=1500, height=1000)
GSD = 300 * 0.016 / 35


def flight(rows=3, columns=4, *, noise=0.2, tilt=2.0, relief=0.0, seed=0, gps=True, control=0, per=14, step=(70.0, 75.0),
           hinge=False):
    """A block of photos 300 m above a plane at z = 50 m, and its true orientations."""
    rng = np.random.default_rng(seed)
    poses = []
    for r, c in np.ndindex(rows, columns):
        omega, phi = (float(v) for v in np.radians(rng.normal(0, tilt, 2)))
        kappa = np.pi * (r % 2) + rng.normal(0, 0.05)
        poses.append(Exterior.from_angles(omega, phi, kappa, np.array([1000 + c * step[0], 2000 + r * step[1], 350.0])
                                          + rng.normal(0, 2, 3)))
    centre = np.array([p.centre for p in poses])
    low, high = centre[:, :2].min(0) - 130, centre[:, :2].max(0) + 130
    n = per * rows * columns * 2
    xyz = np.column_stack([rng.uniform(low, high, (n, 2)), 50 + relief * rng.standard_normal(n)])
    if hinge:  # all points that two strips see lie on one line
        band = np.abs(xyz[:, 1] - 2000 - step[1] / 2) < 35
        xyz[band, 1] = 2000 + step[1] / 2 + 0.2 * rng.standard_normal(band.sum())
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8], [0.5, 0.5], [0.5, 0.2], [0.2, 0.5], [0.8, 0.5]])[:control]
    xyz[:control, :2] = low + corners * (high - low)
    image, point, pixel = [], [], []
    for k, pose in enumerate(poses):
        p = project(CAMERA, pose, xyz)
        ok = np.flatnonzero(CAMERA.inside(np.nan_to_num(p, nan=-9e9), -3))
        image += [k] * len(ok)
        point += list(ok)
        pixel += list(p[ok])
    known = np.full((n, 3), np.nan)
    known[:control] = xyz[:control] + 0.02 * rng.standard_normal((control, 3))
    images = tuple(Image(f"p{k}", "cam", None, Prior(e.centre + rng.normal(0, 1, 3), None, np.full(3, 1.0)) if gps else None)
                   for k, e in enumerate(poses))
    of = Observations(np.array(image), np.array(point), np.array(pixel) + noise * rng.standard_normal((len(image), 2)),
                      np.full(len(image), max(noise, 0.05)))
    points = Points(tuple(f"t{k}" for k in range(n)), known, np.full((n, 3), 0.02),
                    tuple("control" if k < control else "tie" for k in range(n)))
    return Block("site", "local", {"cam": CAMERA}, images, points, of), poses, xyz


def bundle(block, datum):
    return adjust(block, BundleRequest(datum=datum, start="prior", loss="cauchy"))


def network(block, **more):
    of = block.observations
    return Network.of([i.name for i in block.images], [CAMERA] * len(block.images), of.image, of.point, of.pixel, of.sigma,
                      **more).usable()


def at_truth(block, poses, xyz, model, **more):
    net = network(block, **more)
    if isinstance(model, Exteriors):
        photos = np.array([p.vector for p in poses])
    else:
        from solvers.mosaic.simultaneous import homographies

        photos = homographies(Exteriors((50.0, 0, 0)), np.array([p.vector for p in poses])).reshape(-1, 9)
    problem = Registering(net, model)
    return problem, problem.pack(photos, xyz[:, :2])


@pytest.mark.parametrize("model", [Coefficients("similarity"), Coefficients("affine"), Coefficients(),
                                   Exteriors((50.0, 0.01, -0.02))])
def test_gradient_and_normal_matrix_agree_with_differences(model):
    block, poses, xyz = flight(1, 2, seed=3)
    known = np.full((len(xyz), 2), np.nan)
    known[:3] = xyz[:3, :2] + 0.3
    problem, x = at_truth(block, poses, xyz, model, known=known, sigma_xy=np.full(known.shape, 0.2))
    if isinstance(model, Exteriors):
        info = np.broadcast_to(np.diag([1, 1, 1, 400, 400, 400.0]), (2, 6, 6))
        problem = replace(problem, priors=PhotoPriors(np.arange(2), np.array([p.centre + 0.1 for p in poses]),
                                                      np.array([p.m for p in poses]), info))
    elif model.size == 8:
        problem = replace(problem, priors=ShapePriors(np.arange(2), problem.split(x)[0].reshape(-1, 3, 3),
                                                      np.broadcast_to(np.eye(8) * 1e4, (2, 8, 8))))
    normal = problem.normal(x)
    h = 1e-3 / normal.scale
    gradient = central(lambda e: np.array(problem.cost(problem.retract(x, e))), len(h), h)
    assert np.allclose(-gradient * h, normal.gradient * h, atol=2e-5 * np.abs(normal.gradient * h).max() + 1e-9)
    step, _ = normal.step(1e-6)  # the reduced system solves the whole one
    v = problem.residuals(x).ravel()
    j = central(lambda e: problem.residuals(problem.retract(x, e)).ravel(), len(h), h)
    n = j.T @ j
    net = problem.network
    k = len(net.live) * model.size
    n[np.arange(k, len(h)), np.arange(k, len(h))] += net.weight_xy.ravel()
    if len(problem.priors.photo):
        for a, info in enumerate(problem.priors.information):
            s = slice(a * model.size, (a + 1) * model.size)
            n[s, s] += info
    free = np.repeat(net.rays == 0, 2)
    n[k:, k:][np.diag(free)] = 1
    n += 1e-6 * np.diag(np.diag(n))
    assert np.allclose(n @ step, normal.gradient, atol=1e-4 * np.abs(normal.gradient).max()) and len(v)


def test_truth_is_recovered_by_exterior_orientations_and_scatter_is_predicted():
    block, poses, xyz = flight(2, 3, noise=0.0)
    values, rng = [], np.random.default_rng(5)
    problem, x = at_truth(block, poses, xyz, Exteriors((50.0, 0, 0)), held=(0,), loss=None)
    problem = replace(problem, network=replace(problem.network, weight=problem.network.weight / 4))  # sigma 0.2 px
    q = problem.network.q.copy()
    covariance = Response(problem, x, np.ones((6, 2)) * 0.3).covariance
    for _ in range(25):
        net = replace(problem.network, q=q + rng.standard_normal(q.shape) / problem.network.weight)
        noisy = replace(problem, network=net)
        trace = solve(noisy, x, Options(step_tolerance=1e-6))
        assert trace.converged
        for k in (1, 5):
            e = Exterior.from_vector(noisy.split(trace.last.x)[0][k])
            d = np.concatenate([e.centre - poses[k].centre, _vector(e.m @ poses[k].m.T)])
            values.append(d @ np.linalg.solve(covariance[k], d))
    chi_square_band(np.array(values)[::2], 6, 0.998)
    chi_square_band(np.array(values)[1::2], 6, 0.998)


def _vector(r):
    return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2


def test_semicontrolled_mosaic_lies_where_the_photos_were():
    block, poses, _ = flight()
    r = register(block)
    assert (r.level, r.unit, len(r.names)) == ("semicontrolled", "m", 12) and not r.unused
    off = check_ties(r, tuple(i.name for i in block.images), block.observations)
    assert np.nanmedian(off) < 0.3
    seen = [r.frame.to_map(np.append(r.on_plane(k, CAMERA.pixels(np.zeros(2))), r.plane[0]))[:2] for k in range(12)]
    truth = [project_down(p) for p in poses]
    assert np.sqrt(((np.array(seen) - truth) ** 2).sum(1).mean()) < 2.0  # positions are good to 1 m


def project_down(pose):
    ray = -pose.m[2]
    return (pose.centre + ray * (50 - pose.centre[2]) / ray[2])[:2]


def test_controlled_mosaic_meets_the_truth_within_half_a_pixel():
    block, _poses, xyz = flight(2, 3, control=5, relief=4.0)
    r = register(block, bundle=bundle)
    assert (r.level, r.kind) == ("controlled", "exterior")
    local = r.frame.to_local(xyz)
    of = block.observations
    off = [r.to_pixels(r.names.index(f"p{i}"), local[p]) - project(CAMERA, _poses[i], xyz[p])
           for i, p in zip(of.image[::7], of.point[::7], strict=True)]
    assert np.sqrt(np.mean(np.square(off))) < 0.5


def test_a_wrong_control_point_is_named_and_left_out():
    block, *_ = flight(2, 3, control=8)
    xyz = block.points.xyz.copy()
    xyz[4, 0] += 25
    r = register(replace(block, points=replace(block.points, xyz=xyz)), bundle=bundle)
    assert r.rejected == ("t4",) and any("'t4'" in w for w in r.warnings)


def test_sequential_rows_can_be_stepped_through_and_its_box_grows():
    block, *_ = flight(gps=False)
    r = register(block, RegistrationRequest(method="sequential"))
    assert (r.level, r.unit, len(r.trace)) == ("uncontrolled", "px", 12)
    box = np.array(r.trace.manifest["bounding_boxes"])
    assert (np.diff(box[:, :2], axis=0) <= 1e-9).all() and (np.diff(box[:, 2:], axis=0) >= -1e-9).all()
    placed = [int(np.isfinite(row.x[::9]).sum()) for row in r.trace.rows]
    assert placed == list(range(1, 13))
    assert any("do not measure the drift" in w for w in r.warnings)


def test_every_stage_is_in_the_trace():
    block, *_ = flight(gps=False)
    r = register(block, RegistrationRequest(model="plane"))
    assert [s["stage"] for s in r.trace.manifest["stages"]] == ["similarity", "affine", "projective"]
    assert r.trace.last.x.shape == (12 * 9,) and r.trace.converged
    assert r.covariance.shape == (12, 8, 8) and np.isfinite(r.corner_sigma).all()


def test_blunders_in_the_tie_points_do_not_matter():
    block, *_ = flight()
    pixel = block.observations.pixel.copy()
    rows = np.random.default_rng(1).random(len(pixel)) < 0.05
    pixel[rows] += np.random.default_rng(2).normal(0, 60, (rows.sum(), 2))
    r = register(replace(block, observations=replace(block.observations, pixel=pixel)))
    off = check_ties(r, tuple(i.name for i in block.images), block.observations)
    assert not r.unused and np.nanmedian(off) < 0.4


def low_texture(rows=2, columns=15, *, seed, wrong, drop, false=0):
    """A few marks a photo, some of them wrong, and pairs of far photos that share twelve false points."""
    rng = np.random.default_rng(seed)
    block, poses, _ = flight(rows, columns, per=16, step=(32.0, 75.0), seed=seed)
    of = block.observations
    keep = rng.random(len(of)) >= drop
    image, point, pixel = of.image[keep], of.point[keep], of.pixel[keep].copy()
    bad = rng.random(len(image)) < wrong
    pixel[bad] += rng.normal(0, 110, (int(bad.sum()), 2))
    n, pairs = len(block.points), [(int(k), int(k) + 8) for k in rng.permutation(columns - 8)[:false]]
    for a, b in pairs:
        turn, u = rng.uniform(0, 6), rng.uniform(-350, 350, (12, 2))
        c, s = np.cos(turn), np.sin(turn)
        image = np.concatenate([image, np.full(12, a), np.full(12, b)])
        point = np.concatenate([point, n + np.arange(12), n + np.arange(12)])
        pixel = np.vstack([pixel, u + np.array([750, 500]), u @ np.array([[c, s], [-s, c]]) + np.array([740, 480])])
        n += 12
    unknown = np.full((n, 3), np.nan)
    names = tuple(f"t{k}" for k in range(n))
    return replace(block, points=Points(names, unknown, unknown.copy(), ("tie",) * n),
                   observations=Observations(image, point, pixel, np.full(len(image), 0.2))), poses, pairs


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_quarter_of_wrong_marks_on_few_points_loses_no_photo(seed):
    block, poses, _ = low_texture(seed=seed, wrong=0.25, drop=0.35)
    r = register(block)
    assert len(r.names) >= 29, dict(r.unused)
    seen = [r.frame.to_map(np.append(r.on_plane(k, CAMERA.pixels(np.zeros(2))), r.plane[0]))[:2] for k in range(len(r.names))]
    truth = [project_down(poses[int(n[1:])]) for n in r.names]
    assert np.median(np.linalg.norm(np.array(seen) - truth, axis=1)) < 1.5
    assert any("wrong matches" in w for w in r.warnings)


def test_false_links_between_far_photos_are_named_and_bend_nothing():
    block, poses, pairs = low_texture(seed=4, wrong=0.05, drop=0.2, false=4)
    r = register(block)
    assert len(r.names) == 30
    said = next(w for w in r.warnings if "agree with no other photo" in w)
    assert "4 pairs of" in said and all(f"'p{a}' and 'p{b}' (12 points)" in said for a, b in pairs)
    seen = [r.frame.to_map(np.append(r.on_plane(k, CAMERA.pixels(np.zeros(2))), r.plane[0]))[:2] for k in range(30)]
    assert np.abs(np.array(seen) - [project_down(p) for p in poses]).max() < 2


def test_a_photo_of_another_flight_and_a_separate_group_are_named():
    block, *_ = flight()
    of = block.observations
    n = len(block.points)
    point = of.point.copy()
    point[of.image == 5] = np.random.default_rng(0).permutation(n)[:int((of.image == 5).sum())]  # matches that cannot be
    r = register(replace(block, observations=replace(of, point=point)))
    assert set(r.unused) == {"p5"} and "points" in r.unused["p5"] and len(r.names) == 11
    apart = np.isin(of.image, (0, 1))
    keep = ~(apart & np.isin(of.point, of.point[~apart]))
    parts = [a[keep] for a in (of.image, of.point, of.pixel, of.sigma)]
    r = register(replace(block, observations=Observations(*parts)))
    assert set(r.unused) >= {"p0", "p1"} and len(r.names) == 10


def test_a_controlled_mosaic_goes_on_without_a_photo_that_does_not_belong():
    block, *_ = flight(2, 3, control=5)
    of = block.observations
    point = of.point.copy()
    point[of.image == 2] = np.random.default_rng(0).permutation(len(block.points))[:int((of.image == 2).sum())]
    r = register(replace(block, observations=replace(of, point=point)), bundle=bundle)
    assert set(r.unused) == {"p2"} and r.level == "controlled" and len(r.exteriors) == 5


def test_photos_that_do_not_overlap_are_refused():
    block, *_ = flight(2, 2)
    of = block.observations
    with pytest.raises(DegenerateGeometry, match="overlap"):
        register(replace(block, observations=replace(of, point=np.arange(len(of)) % len(block.points))))


def test_levels_that_cannot_be_are_refused():
    block, *_ = flight(gps=False)
    with pytest.raises(BadProject, match="controlled"):
        register(block, RegistrationRequest(level="controlled"))
    with pytest.raises(BadProject, match="semi"):
        register(block, RegistrationRequest(level="semicontrolled"))


def test_a_column_of_ties_in_the_side_overlap_is_named():
    block, *_ = flight(2, 4, gps=False, step=(60.0, 95.0), noise=0.3, tilt=0.5, hinge=True)
    r = register(block, RegistrationRequest(model="plane"))
    assert any("rank deficient" in w and "lie on one line" in w for w in r.warnings), r.warnings
    fine, *_ = flight(2, 4, gps=False, step=(60.0, 70.0), noise=0.3, tilt=0.5)
    assert not any("rank deficient" in w for w in register(fine, RegistrationRequest(model="plane")).warnings)


def test_a_wrong_onboard_position_is_said_with_how_far_it_is_off():
    block, *_ = flight()
    images = [replace(i, prior=Prior(i.prior.centre + np.array([90.0, 0, 0]) * (i.name == "p6"), None, np.ones(3)))
              for i in block.images if i.prior is not None and i.prior.centre is not None]
    said = [w for w in register(replace(block, images=tuple(images))).warnings if "onboard position" in w]
    assert len(said) == 1 and "of 1 photo disagrees" in said[0] and "'p6' (" in said[0]


def test_one_position_far_off_does_not_place_the_mosaic():
    source = np.array([[-400.0, -383], [1, -383], [-400, 13], [0, 0], [-164, 1341]])
    target = np.array([[-20.0, -12], [20, -12], [-20, 28], [20, 28], [0, -32]])
    scale, turn, _, off = similarity(source, target, np.full(5, 0.5))
    assert scale == pytest.approx(0.1, rel=0.03) and abs(turn) < 0.03 and np.argmax(off) == 4 and np.sort(off)[3] < 1


def test_a_photo_tilted_far_joins_by_its_projective():
    """Half of an oblique photo's points agree with no similarity: fitted to known points, it is where it was taken from."""
    pose = Exterior.from_angles(np.radians(50), 0.1, 0.3, np.array([1000.0, 1800, 350]))
    rng = np.random.default_rng(4)
    xy = rng.uniform([850, 1950], [1150, 2500], (300, 2))
    pixel = project(CAMERA, pose, np.column_stack([xy, np.full(len(xy), 50.0)]))
    xy, pixel = xy[CAMERA.inside(np.nan_to_num(pixel, nan=-9e9), -3)], pixel[CAMERA.inside(np.nan_to_num(pixel, nan=-9e9), -3)]
    wrong = rng.random(len(xy)) < 0.2
    xy[wrong] += rng.normal(0, 80, (int(wrong.sum()), 2))
    net = Network.of(["oblique"], [CAMERA], np.zeros(len(xy), int), np.arange(len(xy)), pixel, np.full(len(xy), 0.3),
                     loss="cauchy")
    made = fit(net, np.arange(len(xy)), xy, ())
    assert made is not None and made.agreeing > 0.7 * len(xy)
    at = through(np.broadcast_to(made.h, (len(xy), 3, 3)), xy)[0]
    assert np.abs(at - net.q)[~wrong].max() < 0.004
