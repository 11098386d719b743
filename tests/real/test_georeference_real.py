"""Direct georeferencing of real flights: what the photos show must agree with where they are said to be."""

from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.geometry import LocalFrame
from solvers.io import read_control, read_onboard, read_positions
from solvers.orientation import (
    Georeferenced,
    Plane,
    Vertical,
    check_headings,
    footprint,
    georeference,
    height_bias,
    intersect,
    resect,
)
from solvers.orientation.headings import Matches
from solvers.orientation.monoplot import trace_ray

FC300S = Interior(3.61, pixel_mm=0.00156, width=4000, height=2250)
SEQUOIA = Interior(4.88, pixel_mm=0.00536, width=1152, height=864)
SX260 = Interior(4.5, pixel_mm=4.5 / 2904, width=4000, height=3000)


def matched(files: list[Path], names: list[str], scale: float, most: int = 30) -> Matches:
    """Pixels of the same objects in every pair of photos that overlaps: SIFT, ratio test, one homography."""
    import cv2

    sift, found = cv2.SIFT_create(1500), []  # type: ignore[attr-defined]
    for file in files:
        photo = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert photo is not None
        grey = cv2.resize(photo, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        keys, words = sift.detectAndCompute(grey, None)
        found.append(((np.array([k.pt for k in keys]) + 0.5) / scale - 0.5, words))
    out = {}
    for a in range(len(files)):
        for b in range(a + 1, len(files)):
            pairs = cv2.BFMatcher().knnMatch(found[a][1], found[b][1], k=2)
            rows = np.array([(m.queryIdx, m.trainIdx) for m, n in pairs if m.distance < 0.75 * n.distance]).reshape(-1, 2)
            if len(rows) < 12:
                continue
            pa, pb = found[a][0][rows[:, 0]], found[b][0][rows[:, 1]]
            _, ok = cv2.findHomography(pa, pb, cv2.RANSAC, 12)
            keep = np.flatnonzero(ok.ravel())
            if len(keep) >= 20:
                keep = keep[:: max(len(keep) // most, 1)]
                out[names[a], names[b]] = (pa[keep], pb[keep])
    return out


def empty(camera: Interior, names: list[str], crs: str) -> Block:
    return Block("flight", crs, {"cam": camera}, tuple(Image(n, "cam") for n in names),
                 Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                 Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)))


def apart(block: Block, georeferenced: tuple[Georeferenced, ...], matches: Matches, z: float) -> np.ndarray:
    """Median distance [m] on the ground between the two positions of a matched object, pair by pair."""
    by, frame = {g.image: g for g in georeferenced}, LocalFrame.around(np.array([g.exterior.centre for g in georeferenced]),
                                                                       block.crs)

    def ground(image: str, pixels: np.ndarray) -> np.ndarray:
        at = Exterior(by[image].exterior.m, frame.to_local(by[image].exterior.centre))
        return np.array([trace_ray(image, block.camera_of(image), at, frame, (p[0], p[1]), Plane(z)).ground[:2] for p in pixels])

    return np.array([np.median(np.linalg.norm(ground(a, pa) - ground(b, pb), axis=1)) for (a, b), (pa, pb) in matches.items()])


def test_brighton_reversed_strip(data: Path) -> None:
    """The second strip (24 to 27) has yaw wrong by 180 degrees; it is named, and put right matched objects agree to 4 m."""
    files = sorted((data / "uav_brighton8").glob("*.JPG"))
    onboard = [read_onboard(f) for f in files]
    assert all(o.datum == "barometric" and o.mount == "gimbal" and o.relative is not None for o in onboard)
    names = [o.image for o in onboard]
    given = georeference(onboard, "EPSG:32615")
    matches, block = matched(files, names, 0.2), empty(FC300S, names, "EPSG:32615")
    z = float(np.mean([g.exterior.centre[2] - (g.relative or 0.0) for g in given]))
    headings = {h.image: h for h in check_headings(block, given, matches, z)}
    assert [n for n in names if "reversed" in headings[n].words] == ["DJI_0024", "DJI_0025", "DJI_0026", "DJI_0027"]
    assert all(abs(headings[n].correction_deg) < 12 for n in names[:4])  # the compass is off by about 5 degrees
    before = apart(block, given, matches, z)
    right = tuple(g.turned(180.0) if "reversed" in headings[g.image].words else g for g in given)
    after = apart(block, right, matches, z)
    tuned = apart(block, tuple(g.turned(headings[g.image].correction_deg) for g in given), matches, z)
    assert before.max() > 30 and np.median(after) < 5 and after.max() < 8 and np.median(tuned) < 4
    outlines = [footprint(block, g, Plane(z)) for g in right]
    assert all(abs(f.area / (4000 * 2250 * (0.00156 / 3.61 * 40) ** 2) - 1) < 0.02 for f in outlines)


def test_strip_of_five(data: Path) -> None:
    """Parrot Sequoia: its yaw is not that of the photo's top but about 70 degrees off, alike in every photo, and is named so."""
    files = sorted((data / "uav_strip5").glob("*.JPG"))
    onboard = [read_onboard(f) for f in files]
    assert all(o.mount == "nadir" and o.sigma_m is not None and 3 < o.sigma_m[0] < 3.4 for o in onboard)
    names = [o.image for o in onboard]
    given = georeference(onboard, "EPSG:32632")
    assert all(abs(g.convergence_deg + 1.778) < 2e-3 for g in given)
    matches, block = matched(files, names, 1.0), empty(SEQUOIA, names, "EPSG:32632")
    z = float(np.mean([g.exterior.centre[2] for g in given])) - 105.0
    headings = check_headings(block, given, matches, z)
    assert len(headings) == 5 and all("is wrong by" in h.words for h in headings)
    corrections = np.array([h.correction_deg for h in headings])
    assert 45 < corrections.min() and corrections.max() < 100
    turned = tuple(g.turned(float(np.median(corrections))) for g in given)
    assert np.median(apart(block, turned, matches, z)) < 0.5 * np.median(apart(block, given, matches, z))


@pytest.fixture(scope="module")
def brazil(data: Path) -> Block:
    """Four photos' painted targets as a block."""
    control = read_control(data / "resection_uav_odm_br" / "gcp_list_floatxy_subset.txt")
    names = sorted({Path(m.image).stem for m in control.marks})
    place = {n: k for k, n in enumerate(control.names)}
    return Block("br", "EPSG:32722", {"cam": SX260}, tuple(Image(n, "cam") for n in names),
                 Points(control.names, control.xyz, np.full((len(control.names), 3), 0.03), ("control",) * len(control.names)),
                 Observations(np.array([names.index(Path(m.image).stem) for m in control.marks]),
                              np.array([place[m.point] for m in control.marks]),
                              np.array([[m.col, m.row] for m in control.marks]), np.full(len(control.marks), 2.0)))


def test_odm_brazil(data: Path, brazil: Block) -> None:
    """Positions only (degrees, minutes, seconds): within 5 m of the resections; the flying height comes from control."""
    names = {i.name for i in brazil.images}
    onboard = [o for o in read_positions(data / "resection_uav_odm_br" / "exif_lalo_4326dms.txt") if o.image in names]
    frame = LocalFrame.around(brazil.points.xyz, brazil.crs)
    given = georeference(onboard, brazil.crs, frame=frame, vertical=Vertical(entered=960.0))
    assert all("no attitude" in g.warnings[0] and "entered flying height" in g.heights for g in given)
    solved = {g.image: resect(brazil, g.image) for g in given}
    gaps = np.array([g.exterior.centre - solved[g.image].exterior.centre for g in given])
    assert np.linalg.norm(gaps[:, :2], axis=1).max() < 5
    towards = [Georeferenced(g.image, Exterior(solved[g.image].exterior.m, g.exterior.centre), g.covariance, "", 0.0,
                             None) for g in given]
    bias, sigma, count = height_bias(brazil, towards)
    assert count == len(brazil.observations) and abs(bias + gaps[:, 2].mean()) < max(4 * sigma, 6)
    points = intersect(brazil, list(solved.values())).points
    off = np.array([p.xyz - p.given for p in points])
    assert len(points) >= 10 and np.abs(np.median(off, axis=0)).max() < 0.3 and np.sqrt((off[:, :2] ** 2).mean()) < 0.5
