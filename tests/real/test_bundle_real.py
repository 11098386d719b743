"""A real block adjusted: Strasbourg, five aerial photos, sixteen control points, the interior orientation given."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Image, Interior, Observations, Points
from solvers.io import read_bal, read_control
from solvers.orientation.bundle import BundleRequest, adjust, prepare_bundle

SXB = ("8811", "8936", "8937", "8938", "9111")


@pytest.fixture(scope="module")
def strasbourg(data: Path) -> Block:
    source = data / "aerial_sxb"
    control = read_control(source / "sxb-control.txt", "name=Id,X=X,Y=Y,Z=Z,sX=sigmaX,sY=sigmaY,sZ=sigmaZ")
    index = {name: j for j, name in enumerate(control.names)}
    marks = [line.split(",") for line in (source / "markpts.txt").read_text().splitlines() if not line.startswith("#")]
    table = np.array([(int(m[1]) - 1, index[m[0].strip()], float(m[2]) - 1, float(m[3]) - 1) for m in marks
                      if m[0].strip() in index])
    camera = Interior(123.9392, 26.577 - 8858 * 0.003, 12996 * 0.003 - 38.811, pixel_mm=0.006, width=8858, height=12996)
    return Block("Strasbourg", "local", {"rc30": camera}, tuple(Image(n, "rc30") for n in SXB),
                 Points(control.names, control.xyz, control.sigma, control.role),
                 Observations(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:], np.full(len(table), 1.0)))


def test_strasbourg_as_a_block(strasbourg: Block) -> None:
    """All five photos at once to about a pixel; standard errors of the centres near a metre, no more, over flat control."""
    got = adjust(strasbourg)
    assert got.trace.converged and [o.image for o in got.orientations] == list(SXB)
    assert got.sigma0 is not None and got.sigma0 < 1.3 and got.rms_px < 1.5 and got.dof == 64
    assert got.control_rms is not None and (got.control_rms < 0.02).all()
    for o in got.orientations:
        assert (o.sigma[:3] < [2.5, 4.0, 0.6]).all() and 1800 < o.exterior.centre[2] < 2100


def test_strasbourg_check_points(strasbourg: Block) -> None:
    """Every third control point kept out: found again within its own standard error."""
    roles = tuple("check" if j % 3 == 0 else r for j, r in enumerate(strasbourg.points.role))
    got = adjust(replace(strasbourg, points=replace(strasbourg.points, role=roles)))
    off = np.array([p.off / np.sqrt(np.diag(p.covariance) + np.array([0.02, 0.02, 0.04]) ** 2) for p in got.points
                    if p.role == "check"])
    assert len(off) >= 4 and np.abs(off).max() < 4


def test_strasbourg_control_in_feet_is_named(strasbourg: Block) -> None:
    """One control point whose height is given in feet heads the list of suspects."""
    xyz = strasbourg.points.xyz.copy()
    j = strasbourg.points.names.index("375")
    xyz[j, 2] /= 0.3048
    got = adjust(replace(strasbourg, points=replace(strasbourg.points, xyz=xyz)))
    assert "control point '375' does not fit the others by 317 m; its Z look given in feet" in got.warnings
    assert got.sigma0 is not None and got.sigma0 < 1.1


def test_strasbourg_all_heights_in_feet_and_exchanged_marks_are_named(strasbourg: Block) -> None:
    xyz = strasbourg.points.xyz.copy()
    xyz[:, 2] /= 0.3048
    got = adjust(replace(strasbourg, points=replace(strasbourg.points, xyz=xyz)))
    assert got.warnings[0].startswith("the heights of all control points look given in feet")
    of, point = strasbourg.observations, strasbourg.observations.point.copy()
    rows = np.flatnonzero(of.image == 2)[:2]
    point[rows] = point[rows[::-1]]
    got = adjust(replace(strasbourg, observations=replace(of, point=point)))
    assert "look exchanged in image '8937'" in got.warnings[0] and "'317'" in got.warnings[0] and "'333'" in got.warnings[0]


def test_ladybug_starts_where_everybody_starts(data: Path) -> None:
    """The 49 cameras of Agarwal et al. 2010: 850,912.46 at the start (and 13,344.24 at the end: too long for a test)."""
    block = read_bal(data / "bal" / "problem-49-7776-pre.txt")
    start = prepare_bundle(block, BundleRequest(datum="free", free=("c", "k1", "k2"), start="given"))
    assert start.problem.network.sizes == (49, 147, 7776) and len(start.problem.network.image) == 31843
    assert start.problem.cost(start.x0) == pytest.approx(850_912.46, abs=0.01)
