"""Measuring on a mosaic: its standard errors agree with the registration's own prediction and with random draws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers.geometry import Exterior, exp
from solvers.io import read_project
from solvers.mosaic import Registration, measure, place_jacobian, seen_by
from solvers.mosaic.precision import GRID
from solvers.workflows_mosaic import MosaicRequest, point_offsets, registered_block

DEMO = Path(__file__).parents[2] / "assets" / "demo"


@pytest.fixture(scope="module", params=["exterior", "plane"])
def registration(request: pytest.FixtureRequest) -> Registration:
    return registered_block(read_project(DEMO), DEMO, MosaicRequest(model=request.param)).registration


def test_standard_errors_of_places_are_those_the_registration_predicts(registration: Registration) -> None:
    r = registration
    for k, i in enumerate(r.interiors[:2]):
        at = r.on_plane(k, (GRID + 1) / 2 * [i.width, i.height] - 0.5)
        of = [np.trace(j @ r.covariance[k] @ j.T) for j in (place_jacobian(r, k, p) for p in at)]
        assert np.sqrt(np.mean(of)) == pytest.approx(r.corner_sigma[k], rel=1e-6)


def test_length_and_area_scatter_as_predicted() -> None:
    r = registered_block(read_project(DEMO), DEMO, MosaicRequest(model="exterior")).registration
    middle = r.footprint(0).mean(axis=0)
    xy = middle + np.array([[0, 0], [12, 1], [10, 9], [-2, 7.0]])
    found = measure(r, xy)
    k = r.names.index(found.photos[0])
    assert len(set(found.photos)) == 1 and found.length is not None and found.area is not None
    pixels, root = r.to_pixels(k, xy), np.linalg.cholesky(r.covariance[k])
    rng, lengths, areas, places = np.random.default_rng(5), [], [], []
    for _ in range(500):
        d, e = root @ rng.standard_normal(6), r.exteriors[k]
        moved = Exterior(exp(d[3:]) @ e.m, e.centre + d[:3])
        other = replace(r, exteriors=tuple(moved if n == k else x for n, x in enumerate(r.exteriors)))
        seen = measure(other, other.on_plane(k, pixels))
        assert seen.length is not None and seen.area is not None
        lengths.append(seen.length.value)
        areas.append(seen.area.value)
        places.append(seen.xy)
    assert np.std(lengths) == pytest.approx(found.length.sigma, rel=0.13)
    assert np.std(areas) == pytest.approx(found.area.sigma, rel=0.13)
    np.testing.assert_allclose(np.std(places, axis=0), found.sigma, rtol=0.13)


def test_values_are_plain_geometry_and_unknown_errors_stay_unknown() -> None:
    done = registered_block(read_project(DEMO), DEMO, MosaicRequest(register="sequential"))
    r = done.registration
    middle = r.footprint(0).mean(axis=0)
    found = measure(r, middle + np.array([[0, 0], [3, 0], [3, 4.0]]))
    assert found.length is not None and found.area is not None
    assert found.length.value == pytest.approx(7) and found.area.value == pytest.approx(6)
    assert np.isnan(found.length.sigma) and np.isnan(found.sigma).all()
    assert seen_by(r, middle + 1e6) == [] and measure(r, [middle + 1e6]).photos == ("",)
    off = point_offsets(r, done.site.block, ("check",))
    assert done.check_rms_m == pytest.approx(np.sqrt((off.off**2).sum(axis=1).mean()))
