"""Drift and control: the deterministic networks have known answers, and prediction meets the runs."""

import csv

import numpy as np
import pytest

from solvers.mosaic.growing import Step, grow
from solvers.mosaic.network import Network
from solvers.studies import drift, gcp
from solvers.studies.mosaics import C, layout, sequential, systematic

STRIP = layout("strip", 0.6, 0.3, 600.0)
BLOCK = layout("block", 0.8, 0.6, 600.0)
NONE = np.zeros(0, int)


@pytest.mark.parametrize(("net", "method", "gcps", "last"), [
    (STRIP, "coefficients", 0, 516.2), (STRIP, "exterior", 0, 30.04), (STRIP, "exterior", 4, 0.849),
    (STRIP, "coefficients", 12, 2.67), (STRIP, "exterior", 12, 0.761), (BLOCK, "coefficients", 0, 3.551),
    (BLOCK, "exterior", 0, 0.879), (BLOCK, "exterior", 12, 0.276)])
def test_predicted_drift_of_the_last_photo(net, method, gcps, last):
    values = net.response(method, net.gcps(gcps) if gcps else NONE).noise()
    assert values[-1] == pytest.approx(last, rel=0.01)


def test_a_strip_of_sequential_photos_drifts_by_hundreds_and_its_seams_do_not_show_it():
    q = STRIP.q + np.random.default_rng(3).normal(0, 0.3 / C, (60, len(STRIP.image), 2))
    h = sequential(STRIP, q)
    assert np.sqrt((STRIP.drift(h)[:, -1] ** 2).mean()) == pytest.approx(535, rel=0.35)
    assert STRIP.seam(h[0], q[0]) == pytest.approx(0.31, abs=0.03)


def test_the_batched_sequential_registration_is_the_one_of_the_product():
    net = layout("block", 0.8, 0.6, 1000.0)
    q = systematic(net, 0, 0, np.random.default_rng(2))[0]
    n = len(net.points)
    ours = Network(tuple(map(str, range(36))), net.image, net.point, q, np.full(q.shape, C / 0.3), np.full((n, 2), np.nan),
                   np.zeros((n, 2)), np.zeros(n), np.zeros(36, bool), None)
    h, order = sequential(net, q[None])[0], []
    for k, step in enumerate(grow(ours, 0, net.truth[0])):
        assert isinstance(step, Step)
        order.append(step.photo)
        if order != list(range(k + 1)):
            break  # another order is another registration
        assert net.drift(np.repeat(step.h[None], 36, 0))[k] == pytest.approx(net.drift(np.repeat(h[k][None], 36, 0))[k], abs=0.02)
    assert len(order) > 5


def test_prediction_meets_the_runs_with_control():
    values, gcps = [], BLOCK.gcps(12)
    predicted = BLOCK.response("exterior", gcps).noise()
    for run in range(12):
        rng = np.random.default_rng(run)
        q = BLOCK.q + rng.normal(0, 0.3 / C, BLOCK.q.shape)
        h, rest = BLOCK.adjusted("exterior", gcps, q, BLOCK.points[gcps] + rng.normal(0, 0.3, (12, 2)))
        assert rest
        values.append(BLOCK.drift(h))
    ratio = np.sqrt((np.array(values) ** 2).mean(axis=0)) / predicted
    assert 0.75 < np.sqrt((ratio**2).mean()) < 1.25


def test_distortion_left_in_is_predicted():
    q = systematic(BLOCK, 0, 30.0, np.random.default_rng(1))[0]
    h, rest = BLOCK.adjusted("exterior", NONE, q)
    assert rest and BLOCK.drift(h)[-1] == pytest.approx(BLOCK.response("exterior", NONE).distortion(30 / C)[-1], rel=0.1)


def test_hinged_networks_are_marked():
    weak = layout("block", 0.6, 0.3, 1000.0)
    rows = drift.deterministic(weak, 2)
    assert all(r["nearly_deficient"] for r in rows if r["method"] == "coefficients" and r["control"] == "free")
    assert not any(r["nearly_deficient"] for r in rows if r["method"] == "exterior")


def test_control_at_the_edge_beats_control_in_the_centre():
    edge, centre = (gcp.case(BLOCK, "exterior", place, 4, 2) for place in ("edge", "centre"))
    assert edge["predicted_rms_px"] < 0.7 * centre["predicted_rms_px"]
    assert edge["came_to_rest"] == 2 and 0.4 < edge["actual_rms_px"] / edge["predicted_rms_px"] < 2.0
    for place in gcp.PLACES:
        assert len(gcp.chosen(BLOCK, place, 12)) == 12


def test_the_gcp_study_writes_its_files(tmp_path, monkeypatch):
    monkeypatch.setattr(gcp, "COUNTS", (4, 8, 12, 20))
    files = gcp.study(tmp_path, runs=1)
    assert {f.name for f in files} == {"gcp.csv", "gcp.png", "gcp.svg", "gcp.md"}
    with (tmp_path / "gcp.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 2 * 2 * 3 * 4
    assert "edge" in (tmp_path / "gcp.md").read_text()


def test_the_drift_study_writes_its_files(tmp_path, monkeypatch):
    monkeypatch.setattr(drift, "CASES", ((0.0, 0.0), (0.3, 0.0)))
    monkeypatch.setattr(drift, "NETWORKS", (("strip", 0.6, 0.3, 600.0), ("block", 0.8, 0.6, 600.0)))
    files = drift.study(tmp_path, runs=4)
    assert {f.name for f in files} == {"drift.csv", "drift-systematic.csv", "drift.png", "drift.svg", "drift-systematic.png",
                                       "drift-systematic.svg", "drift.md"}
    assert "Seams do not measure drift" in (tmp_path / "drift.md").read_text()
