"""Orthogonal bundle: derivatives, datum, truth, covariance by simulation, what a stereo pair leaves free, fixed points."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from solvers import BadProject, Block, DegenerateGeometry
from solvers.adjustment import Trace, iterate, solve
from solvers.adjustment.fronts import Pattern
from solvers.cli import main
from solvers.io import demo_assets, read_project, write_project
from solvers.orientation.bundle import BundleRequest, BundleStart, adjust, conclude_bundle, prepare_bundle
from solvers.orientation.bundle.datum import motions, similarity
from solvers.orientation.bundle.orthogonal import OrthogonalBundle, free_directions
from solvers.orientation.bundle.orthogonal_sparse import Sparse
from solvers.orientation.bundle.orthogonal_statistics import orthogonal_statistics
from solvers.orientation.bundle.problem import Bundle
from solvers.simulation import field_long_range, ono_stereo, ono_triplet, uav_block
from tests.checks import assert_same, check_jacobian, chi_square_band, normalised_error
from tests.orientation.test_bundle_extras import barred, everything


def controlled(block: Block, xyz: np.ndarray, count: int, sigma: float, rng: np.random.Generator | None = None) -> Block:
    """The block with its first `count` points as control of some sigma [m], their coordinates in error by it."""
    error = np.zeros(xyz.shape) if rng is None else rng.normal(0, sigma, xyz.shape)
    given = np.where(np.arange(len(xyz))[:, None] < count, xyz + error, block.points.xyz)
    roles = ("control",) * count + ("tie",) * (len(xyz) - count)
    return replace(block, points=replace(block.points, xyz=given, sigma=np.full(xyz.shape, sigma), role=roles))


def start_of(block: Block, **options) -> tuple[OrthogonalBundle, BundleStart]:
    start = prepare_bundle(block, BundleRequest(model="orthogonal", **options))
    assert isinstance(start.problem, OrthogonalBundle)
    return start.problem, start


@pytest.mark.parametrize("options", [{"datum": "free"}, {"datum": "free", "free": ("c",)}, {"datum": "control", "free": ("c",)},
                                     {"datum": "both"}])
def test_jacobian_of_the_frozen_model_is_that_of_the_iterated_one(options):
    sim = ono_triplet(2)
    problem, start = start_of(controlled(sim.block, sim.xyz, 5, 0.001), transform="frozen", **options)
    problem = replace(problem, inner=None, extra=0)
    rng = np.random.default_rng(1)
    normal = problem.normal(start.x0)
    check_jacobian(problem, problem.retract(start.x0, rng.normal(size=len(normal.gradient)) / normal.scale), rtol=3e-6)
    iterated = replace(problem, frozen=None)
    np.testing.assert_allclose(iterated.linear(start.x0).j, problem.linear(start.x0).j, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(iterated.linear(start.x0).v, problem.linear(start.x0).v, rtol=1e-6, atol=1e-7)


def twins(problem: OrthogonalBundle) -> tuple[OrthogonalBundle, OrthogonalBundle]:
    """The dense and the sparse path of a problem, the sparse one in many fronts."""
    sparse = Sparse(problem.network)
    p = sparse.compiled.pattern
    sparse.compiled.__dict__["pattern"] = Pattern.of(p.count, p.size, p.row, p.column, leaf=1)
    return replace(problem, sparse=None), replace(problem, sparse=sparse)


@pytest.mark.parametrize("options", [
    {"datum": "free"}, {"datum": "free", "free": ("c",), "transform": "frozen"}, {"datum": "control", "free": ("c",)},
    {"datum": "both", "free": ("c",), "loss": "huber"}, {"datum": "control", "transform": "frozen", "free": ("c",)},
    "everything"])
def test_the_sparse_path_gives_what_the_dense_one_gives(options):
    """Normal equations, damped steps, Newton's steps, statistics: with priors, bars, common covariances and shifts of strips."""
    if options == "everything":
        start = prepare_bundle(everything(), BundleRequest(datum="both", free=("c",)))
        problem = OrthogonalBundle(start.problem.network)
        x = solve(start.problem, start.x0, start.options).last.x
        assert problem.network.extras.held and problem.network.extras.shifts and len(problem.network.prior_arrays[0])
    else:
        sim = ono_triplet(2)
        problem, start = start_of(controlled(sim.block, sim.xyz, 5, 0.001, np.random.default_rng(1)), **options)
        x = start.x0
    dense, sparse = twins(problem)
    one, other = dense.normal(x), sparse.normal(x)
    np.testing.assert_allclose(other.scale, one.scale, rtol=1e-12)
    np.testing.assert_allclose(other.gradient / one.scale, one.gradient / one.scale, atol=1e-9)
    for damping in (0.0, 1e-3):
        a, b = one.step(damping)[0] * one.scale, other.step(damping)[0] * one.scale
        assert np.abs(a - b).max() < 1e-6 * np.abs(a).max()
    if not dense.frozen and not dense.inner:
        dx, linear = replace(sparse, aimed=True).normal(x).step(0.0)[0], dense.linear(x)
        pg = np.einsum("oab,obu->oau", linear.p, linear.j / one.scale)
        right = np.einsum("oau,oa->u", pg, linear.v)
        reached = np.einsum("oau,oa->u", pg, dense.steps_of(Bundle(problem.network).linear(x).j, x) @ dx)
        np.testing.assert_allclose(reached, right, atol=1e-7 * np.abs(right).max())
    if options != "everything":
        x = solve(dense, x, start.options).last.x
        end = solve(sparse, x, start.options).last.x
        np.testing.assert_allclose(end, x, rtol=1e-7, atol=1e-7)
    judged, again = orthogonal_statistics(dense, x), orthogonal_statistics(sparse, x)
    for name in ("poses", "interior", "points", "redundancy", "w", "cross", "border"):
        a, b = getattr(judged, name), getattr(again, name)
        assert a.shape == b.shape
        assert not a.size or np.nanmax(np.abs(a - b)) < 1e-5 * np.nanmax(np.abs(a)), name


def test_a_scale_bar_gives_the_scale():
    sim = field_long_range(2)
    names = sim.block.points.names
    block = barred(sim.block, sim.xyz, [(names[0], names[-1])], 0.001)
    one, other = adjust(block, datum="free"), adjust(block, datum="free", model="orthogonal")
    assert other.trace.converged and other.dof == one.dof and other.sigma0 == pytest.approx(one.sigma0, rel=0.05)
    for got in (one, other):
        at = {p.name: p.xyz for p in got.points}
        assert np.linalg.norm(at[names[0]] - at[names[-1]]) == pytest.approx(block.scale_bars[0].length, abs=1e-5)


def test_the_sparse_path_is_taken_when_asked_for_and_says_what_is_free():
    sim = ono_triplet(1)
    block = controlled(sim.block, sim.xyz, 5, 0.001)
    one, other = (adjust(block, model="orthogonal", free=("c",), compiled=c) for c in (False, True))
    assert other.sigma0 == pytest.approx(one.sigma0, rel=1e-9) and other.dof == one.dof
    np.testing.assert_allclose([p.xyz for p in other.points], [p.xyz for p in one.points], atol=1e-9)
    np.testing.assert_allclose([p.covariance for p in other.points], [p.covariance for p in one.points], rtol=1e-5, atol=1e-12)
    with pytest.raises(DegenerateGeometry, match="stereo pairs do not determine the angle"):
        adjust(ono_stereo(1).block, datum="free", model="orthogonal", compiled=True)
    problem, start = start_of(block, free=("c",))
    lost = replace(twins(problem)[1], network=replace(problem.network, weight=np.zeros_like(problem.network.weight)))
    with pytest.raises(DegenerateGeometry, match="the datum"):
        orthogonal_statistics(lost, start.x0)


@pytest.mark.parametrize(("make", "free", "extra"), [(ono_stereo, (), 1), (ono_triplet, (), 0), (ono_triplet, ("c",), 0)])
def test_what_is_free_beyond_the_datum_is_counted(make, free, extra):
    for transform in ("iterated", "frozen"):
        problem, start = start_of(make(1).block, datum="free", free=free, transform=transform)
        assert problem.extra == extra and bool(start.warnings) == bool(extra)
        plain = replace(problem, inner=None, extra=0)
        linear, n = plain.linear(start.x0), len(plain.network.image)
        values, _ = free_directions(linear.j[:n], linear.p[:n], linear.j[n:], None)
        assert (values[:7 + extra] < 1e-12).all() and values[7 + extra] > 1e-8  # the defect is 8, 7, 7
        moved = np.abs(linear.j @ motions(plain.network, start.x0)).max()
        assert moved < 1e-12 * np.abs(linear.j).max()
        result = adjust(make(1).block, datum="free", free=free, transform=transform, model="orthogonal")
        assert result.dof == linear.v.size - len(linear.j[0, 0]) + 7 + extra


@pytest.mark.parametrize("free", [(), ("c",)])
def test_truth_is_recovered_to_round_off(free):
    for make in (ono_triplet, field_long_range):
        sim = make(3, noise=0.0)
        off = replace(sim.block.cameras["camera"], c=sim.block.cameras["camera"].c * 0.98)
        block = replace(sim.block, points=replace(sim.block.points, xyz=sim.xyz),
                        cameras={"camera": off} if free else sim.block.cameras)
        got = adjust(block, datum="free", model="orthogonal", free=free)
        assert got.trace.converged and got.rms_px < 1e-4
        assert got.interiors["camera"].c == pytest.approx(sim.cameras["camera"].c, rel=1e-6)
        for o in got.orientations:
            assert o.model == "orthogonal"
            assert_same(o.exterior, sim.exteriors[o.image], 2e-4, 1e-5)


def test_with_control_and_a_lens_it_solves_what_the_perspective_model_solves():
    sim = field_long_range(2)
    plain = sim.block.cameras["camera"]
    lens = replace(plain, xp=0.2, yp=-0.1, k1=2e-5, p1=1e-5, b1=1e-4)
    of = sim.block.observations
    seen = replace(of, pixel=lens.measured(plain.ideal(of.pixel)))
    block = controlled(replace(sim.block, cameras={"camera": lens}, observations=seen), sim.xyz, 6, 0.001)
    one, other = adjust(block), adjust(block, model="orthogonal")
    assert other.trace.converged and other.dof == one.dof
    for a, b in zip(one.orientations, other.orientations, strict=True):
        assert np.abs(normalised_error(b, a.exterior) / np.sqrt(np.diag(b.covariance))).max() < 2
        ratio = np.sqrt(np.diag(b.covariance) / np.diag(a.covariance))
        assert (ratio > 1 - 1e-4).all() and (ratio < 1.5).all()  # never better than least squares (Gauss-Markov)


def test_a_wide_field_is_aimed_at_its_fixed_point_or_refused_in_words():
    block = read_project(demo_assets())
    one, other = adjust(block), adjust(block, model="orthogonal")
    assert other.trace.converged and any("aimed at the fixed point" in w for w in other.warnings)
    assert one.cost < other.cost < 1.3 * one.cost and not any("do not use" in w for w in other.warnings)
    got = adjust(uav_block(1, strips=2, images=2, ties=30, control=6, checks=3, fine=False).block, model="orthogonal")
    assert not got.trace.converged and "do not use" in got.warnings[0]


@pytest.mark.parametrize("transform", ["iterated", "frozen"])
@pytest.mark.parametrize("free", [(), ("c",)])
def test_covariance_predicts_the_scatter(transform, free):
    """With control in error by its sigma. The frozen model is frozen at the truth: errors of that are not in its covariance."""
    images, points, distances = [], [], []
    for seed in range(12):
        sim = ono_triplet(seed)
        block = controlled(sim.block, sim.xyz, 5, 0.0005, np.random.default_rng(seed))
        problem, start = start_of(block, free=free, transform=transform)
        names = [int(n) - 1 for n in problem.network.points]
        if problem.frozen:
            poses = np.array([sim.exteriors[n].vector for n in problem.network.images])
            poses[:, :3] -= start.data.frame.origin
            interiors, origin = problem.network.split(start.x0)[1], start.data.frame.origin
            truth = problem.network.pack(poses, interiors, sim.xyz[names] - origin)
            problem = replace(problem, frozen=problem.kept(truth))
            start = replace(start, problem=problem)
        got = conclude_bundle(start, Trace(tuple(iterate(problem, start.x0, start.options)), start.manifest))
        assert got.trace.converged
        for o in got.orientations:
            e = normalised_error(o, sim.exteriors[o.image])
            images.append(e @ np.linalg.solve(o.covariance, e))
        p = got.points[seed % len(got.points)]
        e = p.xyz - sim.xyz[int(p.name) - 1]
        points.append(e @ np.linalg.solve(p.covariance, e))
        if free:
            distances.append((got.interiors["camera"].c - 300.0) ** 2 / got.interior_covariance[0, 0])
    chi_square_band(np.array(points), 3, 0.999)
    assert np.mean(images) / 6 == pytest.approx(1.0, abs=0.35)  # images of one network are correlated: no strict test
    if free:
        chi_square_band(np.array(distances), 1, 0.999)


def test_redundancy_adds_up_and_blunders_are_named():
    sim = field_long_range(4)
    got = adjust(sim.block, datum="free", model="orthogonal")
    assert sum(o.redundancy.sum() for o in got.orientations) == pytest.approx(got.dof, abs=1e-6)
    of = sim.block.observations
    pixel = of.pixel.copy()
    pixel[17] += [4.0, -3.0]
    got = adjust(replace(sim.block, observations=replace(of, pixel=pixel)), datum="free", model="orthogonal")
    worst = got.suspects[0]
    assert (worst["image"], worst["point"]) == (sim.block.images[of.image[17]].name, sim.block.points.names[of.point[17]])
    robust = adjust(replace(sim.block, observations=replace(of, pixel=pixel)), datum="free", model="orthogonal", loss="danish")
    (o,) = (o for o in robust.orientations if o.image == worst["image"])
    assert worst["point"] in o.rejected and sum(len(o.rejected) for o in robust.orientations) <= 2


def test_stereo_keeps_the_depth_of_its_start_and_the_perspective_model_does_not():
    shape = {}
    for seed in range(6):
        sim = ono_stereo(seed)
        for model in ("perspective", "orthogonal"):
            got = adjust(sim.block, datum="free", model=model, start="prior")
            assert got.trace.converged
            xyz = np.array([p.xyz for p in sorted(got.points, key=lambda p: int(p.name))])
            s, r, t = similarity(xyz, sim.xyz)
            shape.setdefault(model, []).append(np.sqrt(((s * xyz @ r.T + t - sim.xyz) ** 2).mean()))
    assert np.mean(shape["orthogonal"]) > 2.5 * np.mean(shape["perspective"])


def test_what_the_model_cannot_do_is_said():
    block = ono_triplet(1).block
    with pytest.raises(BadProject, match="principal distance c only, not k1"):
        adjust(block, datum="free", model="orthogonal", free=("c", "k1"))
    with pytest.raises(DegenerateGeometry, match="no control is measured, and the GPS positions of 3 images"):
        adjust(block, model="orthogonal")


def test_little_relief_is_reached_by_steps_that_are_held_back():
    for seed, start in ((6, "auto"), (7, "prior"), (9, "prior")):
        sim = field_long_range(seed, relief=0.2, images=3)
        got = adjust(sim.block, datum="free", model="orthogonal", start=start)
        assert got.trace.converged and got.sigma0 == pytest.approx(1.0, abs=0.2), (seed, start)
        assert not any("false fixed point" in w for w in got.warnings)


def test_aimed_steps_and_repetition_meet_at_the_fixed_point():
    problem, start = start_of(field_long_range(1).block, datum="free", free=("c",))
    plain = solve(problem, start.x0, start.options).last
    aimed = solve(replace(problem, aimed=True), start.x0, start.options).last
    assert plain.stop == aimed.stop == "step" and aimed.index < plain.index + 3
    assert np.abs((plain.x - aimed.x) / np.maximum(np.abs(plain.x), 1)).max() < 1e-6


def test_a_place_far_from_the_perspective_solution_is_named():
    problem, start = start_of(field_long_range(1).block, datum="free")
    last = solve(problem, start.x0, start.options).last
    off = np.zeros(len(problem.normal(last.x).scale))
    off[30:] = np.random.default_rng(1).normal(0, 0.003, len(off) - 30)
    for x, said in ((last.x, False), (problem.retract(last.x, off), True)):
        got = conclude_bundle(start, Trace((replace(last, x=x, cost=problem.cost(x)),), start.manifest))
        assert any("false fixed point" in w for w in got.warnings) == said


def test_adjust_command_takes_the_model_and_its_transformation(tmp_path, capsys):
    write_project(ono_triplet(1).block, tmp_path / "net")
    done = {}
    for transform in ("iterated", "frozen"):
        words = ["adjust", str(tmp_path / "net"), "--model", "orthogonal", "--datum", "free", "--free", "c"]
        assert main([*words, "--transform", transform, "--json", "-"]) == 0
        done[transform] = json.loads(capsys.readouterr().out)
        assert {o["model"] for o in done[transform]["orientations"]} == {"orthogonal"}
        assert done[transform]["interior"]["camera"]["sigma"]["c_mm"] > 0
    assert done["frozen"]["sigma0"] > done["iterated"]["sigma0"]
    assert main(["adjust", str(tmp_path / "net"), "--model", "orthogonal", "--datum", "free", "--free", "all"]) == 1
    assert "principal distance c only" in capsys.readouterr().err
