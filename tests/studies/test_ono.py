"""Ono & Hattori's free networks: batch against bundle, tables against an independent program, what stays free, who arrives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solvers import Exterior
from solvers.cli import main
from solvers.orientation.bundle import adjust as bundle
from solvers.orientation.bundle import coplanarity
from solvers.simulation import ono_triplet
from solvers.studies import ono
from solvers.studies.free_networks import Networks, adjust, after_affinity, after_similarity, pooled, spectrum
from tests.checks import assert_same


@pytest.mark.parametrize("model", ["perspective", "orthogonal"])
@pytest.mark.parametrize("free_c", [False, True])
def test_the_batch_agrees_with_the_bundle(model, free_c):
    sim = ono_triplet(4)
    block, camera = sim.block, sim.block.cameras["camera"]
    got = bundle(block, datum="free", model=model, free=("c",) if free_c else ())
    of = block.observations
    order = np.lexsort((of.point, of.image))
    xy = camera.ideal(of.pixel[order]).reshape(1, 3, 12, 2)
    poses = [Exterior.from_vector(e.vector) for e in sim.exteriors.values()]
    start = Networks(np.array([300.0]), np.array([[e.m for e in poses]]), np.array([[e.centre * 1e3 for e in poses]]),
                     block.points.xyz[None] * 1e3)
    mine = adjust(xy, start, model, free_c, 7)
    names = [int(p.name) - 1 for p in got.points]
    theirs = np.array([p.xyz for p in got.points]) * 1e3
    assert mine.converged.all()
    assert np.abs(after_similarity(mine.networks.points[:, names], theirs[None])).max() < 1e-4
    assert mine.networks.c[0] == pytest.approx(got.interiors["camera"].c, abs=1e-4)
    assert mine.sigma0[0] / 0.001 == pytest.approx(got.sigma0, rel=0.01 if model == "orthogonal" else 1e-6)
    if model == "perspective":
        sd = np.sqrt(np.mean([np.diag(p.covariance) for p in got.points], axis=0)) * 1e3 * got.sigma0
        np.testing.assert_allclose(mine.internal[0], sd, rtol=5e-3)  # their scales differ a little


# mean of 500 runs of an independent program: sigma0 [0.001 mm], errors XYZ [mm] (2) internal, (3) similarity, (4) affinity
REFERENCE = {
    ("2", "orthogonal"): (2.22, 0.1025, 1.340, 0.0784), ("2", "perspective"): (0.980, 0.2547, 0.2104, 0.0431),
    ("3", "orthogonal"): (1.003, 0.0773, 0.0725, 0.0412), ("3", "perspective"): (1.000, 0.0758, 0.0713, 0.0412),
    ("4", "orthogonal"): (2.136, 0.1644, 0.1418, 0.1059), ("4", "perspective"): (2.075, 0.1576, 0.1470, 0.1071),
    ("5", "orthogonal"): (1.002, 0.0776, 0.0727, 0.0425), ("5", "perspective"): (1.000, 0.0771, 0.0726, 0.0425),
}


@pytest.mark.parametrize(("case", "model"), REFERENCE)
def test_tables_agree_with_an_independent_program(case, model):
    rows, values = ono.table(case, model, 250, np.random.default_rng(7))
    assert rows[0]["converged"] == 1 and np.isfinite(values).all()
    got = [r["mean"] for q in ("sigma0", "2 XYZ", "3 XYZ", "4 XYZ") for r in rows if r["quantity"] == q]
    tolerance = 0.2 if case == "2" else 0.08
    assert got == pytest.approx(REFERENCE[case, model], rel=tolerance)
    for r in rows:
        if "reference_p5" in r and case != "2":
            assert r["p5"] == pytest.approx(r["reference_p5"], rel=0.2) and r["p95"] == pytest.approx(r["reference_p95"], rel=0.2)


def test_what_stays_free_is_counted_as_the_paper_counts():
    stereo, triplet, with_c = ono.indefinite()
    assert [(r["dlt"], r["affine"], r["orthogonal"], r["perspective"]) for r in (stereo, triplet, with_c)] == [
        (15, 12, 8, 7), (15, 12, 7, 7), (15, 12, 7, 7)]
    for r, told in ((stereo, 4), (triplet, 11), (with_c, 12)):
        assert r["determined_17"] == r["determined_19"] == told and r["left"] == r["unknowns"] - told == r["orthogonal"]
        assert r["determinants"] < 1e-11 and r["fourth_singular_value"] < 1e-12 < 0.1 < r["third_singular_value"]
        assert r["orthogonal_next"] > 1e-3


def test_a_pair_bends_unseen_while_its_parallel_coordinates_are_kept():
    rows = ono.deformation((0.1, 1.0, 10.0))
    for r in rows:
        assert r["frozen_residual_mm"] < 1e-9
        assert r["after_similarity_mm"] == pytest.approx(r["deformation_mm"], rel=0.01)
        assert r["perspective_residual_mm"] == pytest.approx(3.3e-4 * r["deformation_mm"], rel=0.1)


def test_coplanarity_notices_what_does_not_meet():
    truth, xy, _ = ono.simulated(2, 1, 300.0, np.random.default_rng(0))
    s, m, t, xa, _ = ono.parallel_images(truth)
    a = np.concatenate([s[:, None, None] * m[:, :2], t[:, :, None]], axis=2)
    noisy = xa + (xy - truth.project())[0]
    assert np.abs(coplanarity.determinants(a, noisy)).max() > 1e-4
    _, off, values = coplanarity.relation(xa)
    assert np.abs(off).max() < 1e-9 and values[3] > 1e-4  # (18): four numbers, all determined
    assert np.linalg.svd(coplanarity.stacked(a, noisy), compute_uv=False)[:, 3].max() > 1e-7


def test_the_field_says_who_arrives_before_how_well():
    rng = np.random.default_rng(8)
    deep = ono.field_cell(60, 1.5, 3, 40, rng, ("coarse", "affine"))
    for c in ("known", "unknown"):
        one, other = (next(r for r in deep if r["c"] == c and r["start"] == "coarse" and r["method"] == m)
                      for m in ("perspective", "orthogonal"))
        assert one["right"] == other["right"] == 1
        for key in ("similarity_p50_mm", "affinity_p50_mm"):
            assert other[key] == pytest.approx(one[key], rel=0.15 if c == "known" else 0.05)
    assert next(r for r in deep if r["start"] == "affine" and r["method"] == "orthogonal")["right"] > 0.9
    flat = {r["method"]: r for r in ono.field_cell(30, 0.2, 5, 40, rng, ("coarse",)) if r["c"] == "known"}
    assert flat["perspective"]["right"] == 1 and flat["orthogonal, held back"]["right"] > 0.95
    assert flat["orthogonal"]["right"] < 0.7 and flat["orthogonal"]["false"] > 0
    assert flat["orthogonal"]["similarity_p90_mm"] == np.inf  # failures are not left out


def test_a_start_that_cannot_be_is_said():
    truth, xy, coarse = ono.field(60, 0.2, 3, 4, np.random.default_rng(1))
    start, ok = ono.started(xy, coarse, "DLT")
    assert not ok.any() and not adjust(xy[ok], start.take(ok), "perspective", True, 7).converged.any()
    start, ok = ono.started(truth.project(), replace(truth), "affine")
    assert ok.all()
    for i in range(3):
        assert_same(Exterior(start.m[0, i], start.centre[0, i] / 1e3), Exterior(truth.m[0, i], truth.centre[0, i] / 1e3), 3, 0.02)
    assert (spectrum(truth, "perspective")[:, :7] < 1e-10).all()
    assert pooled(after_affinity(truth.points * [1, 2, 3], truth.points)).max() < 1e-6


def test_the_study_writes_page_tables_and_figures(tmp_path):
    assert main(["study", "ono", "-o", str(tmp_path), "--runs", "4", "--quiet"]) == 0
    text = (tmp_path / "ono.md").read_text(encoding="utf-8")
    assert "--runs 4" in text and text.index("who arrives") < text.index("how well")
    for name in ("tables", "deformation", "rates", "field"):
        assert f"(ono-{name}.png)" in text and (tmp_path / f"ono-{name}.svg").stat().st_size > 1000
    assert (tmp_path / "ono-field.csv").read_text().count("\n") == 97
    drawn = {f.name: f.read_bytes() for f in tmp_path.glob("*.svg")}
    for name in drawn:
        (tmp_path / name).unlink()
    assert main(["study", "ono", "-o", str(tmp_path), "--figures", "--quiet"]) == 0  # from the tables alone, the same
    assert {f.name: f.read_bytes() for f in tmp_path.glob("*.svg")} == drawn
