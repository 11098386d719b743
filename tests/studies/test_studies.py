"""Studies: the batched estimators are the package's own, and their numbers those of an independent reference.

Bounds: an RMSE of N runs has a relative standard error of about 1 / sqrt(2 N) (more for six elements pooled, less for two);
all bounds below are five of them or more, and the seeds are fixed.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from solvers import Exterior
from solvers.cli import main
from solvers.orientation import orient
from solvers.orientation.single import Request
from solvers.studies import KINDS, clusters, fov, monitoring, page, published, starts
from solvers.studies.clusters import chances
from solvers.studies.design import CAMERA, TABLE_I, Sample, cluster, errors, estimate, mirrored, predict, summary, tilt_deg
from solvers.studies.estimators import Poses, exponential, orthogonal_iterated, orthogonal_pass, perspective
from tests.synthetic import block_of, prior_of


@pytest.mark.parametrize("centre_mm", [(0.0, 0.0), (8.0, 5.0)])
def test_estimators_agree_with_the_package(centre_mm):
    points = cluster(centre_mm, 6, 6.0, 5.0)
    prior = prior_of(TABLE_I, 0.3, 1.0, np.random.default_rng(7))
    block = block_of(points, TABLE_I, noise_px=0.3, sigma_m=1e-9, prior=prior)
    seen, xy = block.points.xyz[None], CAMERA.ideal(block.observations.pixel)[None]
    sigma = np.full((1, 6), 0.3 * CAMERA.pitch[0])
    assert prior.angles is not None and prior.centre is not None
    at = Exterior.from_angles(*prior.angles, centre=prior.centre)
    given, truth = Poses.same(at.m, at.centre, 1), Poses.same(TABLE_I.m, TABLE_I.centre, 1)
    weight = 1 / np.array([1.0] * 3 + [np.radians(0.3)] * 3) ** 2
    pairs = [
        (perspective(seen, xy, CAMERA.c, sigma, truth)[0], Request("a")),
        (orthogonal_pass(seen, xy, CAMERA.c, given), Request("a", "orthogonal", one_pass=True)),
        (orthogonal_pass(seen, xy, CAMERA.c, given, "printed", False),
         Request("a", "orthogonal", one_pass=True, form="printed", recentre=False)),
        (orthogonal_pass(seen, xy, CAMERA.c, given, "printed", True), Request("a", "orthogonal", one_pass=True, form="printed")),
        (orthogonal_iterated(seen, xy, CAMERA.c, truth), Request("a", "orthogonal")),
    ]
    for mine, request in pairs:
        theirs = orient(block, request)
        assert mine.ok.all() and theirs.trace.converged
        assert np.abs(mine.centre[0] - theirs.exterior.centre).max() < 1e-6, request
        assert np.abs(mine.m[0] - theirs.exterior.m).max() < 1e-8, request
    mine, _ = perspective(seen, xy, CAMERA.c, sigma, truth, (given, weight))
    theirs = orient(block, Request("a", prior="weighted"))  # whose prior weighs omega, phi, kappa, not a rotation vector
    scatter = np.sqrt(np.diag(theirs.covariance))
    assert (np.abs(errors(mine)[0] - _difference(theirs.exterior)) < 0.05 * np.r_[np.degrees(scatter[3:]), scatter[:3]]).all()


def _difference(exterior):
    return np.r_[np.degrees(np.array(exterior.angles) - np.array(TABLE_I.angles)), exterior.centre - TABLE_I.centre]


# acceptance: RMSE of omega, phi, kappa [degrees], X, Y, Z [m], four points, 6 degrees, of an independent program (2000 runs)
REFERENCE = {
    ("centre", 1.0, 0.1): {
        "P": (0.1083, 0.1625, 0.0094, 0.8506, 0.5661, 0.1114),
        "O1_bench": (0.1372, 0.1353, 0.0092, 0.7074, 0.7178, 0.0953),
        "B_0.1_1": (0.0677, 0.0776, 0.008, 0.4065, 0.3545, 0.0642),
        "O1_1_5": (0.3377, 0.3418, 0.0159, 1.7936, 1.7609, 0.2219),
    },
    ("corner", 5.0, 0.5): {
        "P": (0.1349, 0.1555, 0.037, 0.8297, 0.6997, 0.3365),
        "O1rc_bench": (0.1456, 0.1427, 0.0363, 0.761, 0.7537, 0.3419),
        "O1_bench": (0.1905, 0.186, 0.0308, 0.9739, 0.9977, 0.197),
        "B_1_1": (0.1082, 0.1173, 0.0338, 0.6257, 0.5607, 0.2823),
        "O1rc_1_20": (0.1868, 0.1843, 0.0407, 0.9876, 0.9645, 0.4153),
    },
}


@pytest.mark.parametrize("place,relief,noise", REFERENCE)
def test_clusters_agree_with_the_reference(place, relief, noise, monkeypatch):
    monkeypatch.setattr(clusters, "PRIORS", ((0.1, 1.0), (1.0, 1.0), (1.0, 5.0), (1.0, 20.0)))
    rows, count = clusters.cell(relief, noise, 300, np.random.default_rng(3))
    assert count["all"] == 0
    for method, want in REFERENCE[place, relief, noise].items():
        (row,) = (r for r in rows if r["where"] == place and r["method"] == method)
        got = np.array([row[k] for k in ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")])
        assert np.abs(got / want - 1).max() < 0.18, method
        assert (np.array([row[f"{k}_lo"] for k in ("omega_deg", "Z_m")]) < got[[0, 5]]).all()


@pytest.mark.parametrize("where,n,angle,relief,noise,want", [
    ("centre", 4, 6.0, 0.0, 0.3, {"P": 0.5463, "O1rc_0.1_1": 0.6581, "B_0.1_1": 0.1243, "B_1_5": 0.4721}),
    ("centre", 4, 20.0, 0.0, 0.3, {"P": 0.0826, "O1_0.01_0.05": 0.1936, "Oitrc": 0.1936, "B_0.1_1": 0.0701}),
])
def test_fields_of_view_agree_with_the_reference(where, n, angle, relief, noise, want):
    rows = {r["method"]: r for r in fov.cell(where, n, angle, relief, noise, 600, np.random.default_rng(4))}
    for method, tilt in want.items():
        assert rows[method]["tilt_deg"] == pytest.approx(tilt, rel=0.15), method
        assert rows[method]["tilt_predicted_deg"] == pytest.approx(tilt, rel=0.1), method


@pytest.mark.parametrize("where,n,angle,noise,d,apart", [
    ("centre", 4, 2.0, 0.3, 1.452, 8.955), ("corner", 4, 1.0, 0.3, 1.271, 31.05), ("centre", 10, 3.0, 0.3, 3.259, 7.384),
])
def test_reversal_is_decided_as_predicted(where, n, angle, noise, d, apart):
    row = fov.reversal(where, n, angle, noise, 800, np.random.default_rng(5))
    assert row["D"] == pytest.approx(d, rel=0.05) and row["apart_deg"] == pytest.approx(apart, rel=1e-3)
    assert abs(row["simulated"] - row["predicted"]) < 0.08
    assert fov.reversal(where, n, 30.0, noise, 2, np.random.default_rng(5))["D"] is None


def test_leak_amplifies_as_printed_and_not_re_centred():
    flat = predict(cluster((8.0, 5.0), 4, 6.0, 0.0), 0.3, ())
    assert flat["rho"] == pytest.approx(3.28, abs=0.01) and flat["rho_rc"] < 0.01
    sample = Sample.draw(cluster((8.0, 5.0), 4, 6.0, 0.0), 0.01, 200, np.random.default_rng(6))
    found = estimate(sample, np.random.default_rng(6), ((0.1, 0.01),))
    assert summary(found["O1_0.1_0.01"])["tilt_deg"] > 10 * summary(found["O1rc_0.1_0.01"])["tilt_deg"]


def test_mirrored_twice_is_the_same():
    points = cluster((8.0, 5.0), 4, 6.0, 0.0)[None]
    truth = Poses.same(TABLE_I.m, TABLE_I.centre, 1)
    other = mirrored(truth, points)
    mean = points.mean(axis=1)
    assert abs(np.linalg.norm(other.centre - mean) - np.linalg.norm(TABLE_I.centre - mean)) < 1e-9
    back = other.project(points[0], CAMERA.c) - truth.project(points[0], CAMERA.c)
    assert np.abs(back).max() < 0.02 * CAMERA.c  # the same photo to first order
    assert np.allclose(exponential(np.zeros((1, 3))), np.eye(3))


def test_published_tables_say_what_they_say():
    orthogonal, perspective_ = ([published.turn_deg(r) for r in t] for t in (published.ORTHOGONAL, published.PERSPECTIVE))
    assert orthogonal == pytest.approx([0.0020, 0.0040, 0.0109, 0.0232, 0.0069], abs=1e-4)
    assert perspective_ == pytest.approx([2.125, 3.133, 0.995, 3.328, 6.701], abs=1e-3)
    shifts = np.array([published.along_axis(r) for r in published.ORTHOGONAL])
    assert np.abs(shifts[:, 0]) == pytest.approx([5.749, 2.249, 0.820, 5.543, 0.577], abs=1e-3)
    assert shifts[:, 1].max() < 0.03
    reference = {(0.1, 0.0): 3.43e-11, (0.2, 1.0): 1.39e-12, (0.2, 5.0): 3.15e-8}  # each of 20,000 draws' product
    for (sigma, relief), p in reference.items():
        assert 0.25 < chances(sigma, relief) / p < 4


def test_chance_is_that_of_the_simulation():
    points = cluster((0.0, 0.0), 4, 6.0, 1.0)
    sample = Sample.draw(points, 0.3, 4000, np.random.default_rng(8))
    tilt = np.hypot(*errors(orthogonal_pass(sample.seen, sample.xy, CAMERA.c, sample.truth, "printed", False))[:, :2].T)
    assert (tilt < 0.3).mean() == pytest.approx(published.chance(points, 0.3, 0.3), abs=0.04)
    assert tilt_deg(predict(points, 0.3, ())["P"]) > 0.1


def test_starts_succeed_and_cost_something():
    rows = {r["start"]: r for r in starts.cell(6, 40.0, 0.5, "oblique", 8, np.random.default_rng(9))}
    assert set(rows) == set(starts.STARTS) - {"homography"}
    assert rows["all, refined"]["success"] == 1 and all(r["us"] > 0 for r in rows.values())
    assert rows["three points"]["success"] >= 0.75
    assert set(r["start"] for r in starts.cell(4, 10.0, 0.0, "steep", 2, np.random.default_rng(9))) == {
        "both planar", "three points", "homography", "all, refined"}


def test_unknown_principal_distance_needs_the_total_derivative():
    row, traces = starts.unknown_c(20.0, 30.0, 2, np.random.default_rng(10))
    assert row["total_right"] and row["total_iterations"] <= 20 and not row["partial_right"]
    assert row["predicted_mm"] == pytest.approx(0.1225, rel=0.03)
    assert traces[True].converged


def test_study_command_writes_page_tables_and_figures(tmp_path, capsys, monkeypatch):
    assert main(["study", "nonsense", "-o", str(tmp_path)]) == 2
    assert main(["study", "fov", "-o", str(tmp_path), "--runs", "0"]) == 2
    for name, value in {"FOVS_DEG": (6.0,), "NECKER_FOVS": (2.0,), "SERIES": fov.SERIES}.items():
        monkeypatch.setattr(fov, name, value)
    monkeypatch.setattr(fov, "_errors", lambda rows: "")  # its words need the whole sweep
    assert main(["study", "fov", "-o", str(tmp_path), "--runs", "4", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert '"study": "fov"' in out and "6 degrees" in err
    text = (tmp_path / "fov.md").read_text(encoding="utf-8")
    figures = re.findall(r"\]\((\S+\.png)\)", text)
    assert "--runs 4" in text and len(figures) == 3 and all((tmp_path / name).exists() for name in figures)
    assert (tmp_path / "fov-reversal.svg").stat().st_size > 1000
    assert set(KINDS) >= {"clusters", "fov", "starts", "ono"}


def test_figures_are_drawn_anew_from_tables_or_what_is_missing_is_said(tmp_path, capsys):
    """As starts, which holds truths, gaps and numbers that ran away."""
    for name in ("starts.csv", "starts-iterations.csv"):
        shutil.copy(Path(__file__).parents[2] / "docs/studies" / name, tmp_path)
    assert main(["study", "starts", "-o", str(tmp_path), "--figures", "--quiet"]) == 0
    assert all((tmp_path / name).stat().st_size > 5000 for name in ("starts-success.svg", "starts-unknown-c.svg"))
    assert main(["study", "gcp", "-o", str(tmp_path), "--figures"]) == 1
    assert "gcp.csv: there is no such table; run the study first" in capsys.readouterr().err
    (tmp_path / "gcp.csv").write_text("kind,method\nstrip,none\n", encoding="utf-8")
    assert main(["study", "gcp", "-o", str(tmp_path), "--figures"]) == 1
    assert "its tables are not those of a whole study of gcp" in capsys.readouterr().err


@pytest.mark.parametrize("rows", [[{"a": 1, "b": 0.25, "c": True, "d": None, "e": "2 x"}, {"a": -3, "b": float("inf"), "c": False,
                                                                                     "d": 7, "e": ""}]])
def test_tables_come_back_as_they_were_written(tmp_path, rows):
    back = page.read_csv(page.write_csv(tmp_path / "t.csv", rows))
    assert back == [{k: None if v == "" else v for k, v in row.items()} for row in rows]
    assert [type(v) for v in back[0].values()] == [type(v) for v in rows[0].values()]


def test_study_of_monitoring_counts_alarms_and_movements(tmp_path):
    """Few runs: every movement of 3 mm is found, none of 0.01 mm; the interval holds the share; the page says what it ran."""
    (epoch,) = monitoring._adjusted(0, 0.0, 1)
    large, small = (monitoring.redrawn(epoch, movement, 0.05, 12, seed=2) for movement in (0.003, 0.00001))
    assert large["found"] == 1.0 and small["found"] < 0.2
    often = monitoring.redrawn(epoch, 0.0, 0.45, 12, seed=1)
    assert 1 <= often["false_alarms"] < 12 and often["low"] < often["share"] < often["high"]
    assert main(["study", "monitoring", "-o", str(tmp_path), "--runs", "4", "--quiet"]) == 0
    text = (tmp_path / "monitoring.md").read_text(encoding="utf-8")
    assert "--runs 4" in text and "](monitoring.png)" in text and (tmp_path / "monitoring.png").stat().st_size > 5000
    lines = (tmp_path / "monitoring.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(monitoring.LEVELS) + len(monitoring.MOVEMENTS) + 2
