"""Direct georeferencing: rotation chains, convergence, lever arm, heights, log matching, headings, corners, footprints."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.block import Prior
from solvers.cameras import project
from solvers.errors import BadProject, DegenerateGeometry
from solvers.geometry import (
    FlightLog,
    Grid,
    LocalFrame,
    Onboard,
    Surface,
    angles,
    body_to_ned,
    exp,
    photo_rotation,
    rotation,
    yaw_pitch_roll,
)
from solvers.geometry.gimbal import Mount
from solvers.orientation.bundle import adjust
from solvers.orientation.corners import corner_control, corner_orientation, vertical_corners, with_corners
from solvers.orientation.flightlog import match_log
from solvers.orientation.footprint import footprint, footprints_geojson
from solvers.orientation.georeference import Rig, Vertical, georeference, height_bias
from solvers.orientation.grades import Flight, compare_control, compare_project
from solvers.orientation.headings import check_headings
from solvers.orientation.monoplot import Plane
from solvers.orientation.oriented import Known, vector_covariance
from tests.checks import angle_between, chi_square_band
from tests.synthetic import SEED_CAMERA, SEED_EXTERIOR

ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
CRS = "EPSG:32632"
CAMERA = Interior(8.8, pixel_mm=0.0048, width=2736, height=1824)
CORNER_GROUND = np.array([[-85.74702339497102, 88.48299824032738, 0], [-92.43867220684756, -116.8846190140621, 0],
                          [44.83578871866735, -116.2854445324222, 0], [47.09265826881225, 83.05362620587925, 0]])
"""Golden corner coordinates: upper right, upper left, lower left, lower right of SEED_CAMERA at SEED_EXTERIOR on Z = 0."""


def site(camera: Interior, images: tuple[str, ...], crs: str = "local") -> Block:
    """Images without any points."""
    return Block("site", crs, {"cam": camera}, tuple(Image(i, "cam") for i in images),
                 Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                 Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0)))


def photo(name: str = "a", lat: float = 47.0, lon: float = 8.2, height: float | None = 500.0, yaw: float = 30.0,
          **more) -> Onboard:
    return Onboard(name, lat, lon, height, **{"attitude": (yaw, -90.0, 0.0), "mount": "gimbal", **more})


# -- rotation chains --------------------------------------------------------------------------------------------------------


def test_where_the_camera_looks() -> None:
    """In words: level and north, the photo's x is east and up is up; nadir, the photo's top is the heading."""
    m = photo_rotation(np.zeros(3), "gimbal", ENU)
    np.testing.assert_allclose(m, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-15)
    mounts: tuple[tuple[Mount, float], ...] = (("gimbal", -90.0), ("nadir", 0.0))
    for mount, pitch in mounts:
        m = photo_rotation(np.radians([40.0, pitch, 0.0]), mount, ENU)
        np.testing.assert_allclose(m[1], [np.sin(np.radians(40)), np.cos(np.radians(40)), 0], atol=1e-15)
        np.testing.assert_allclose(np.degrees(angles(m)), [0, 0, -40], atol=1e-9)
    right_wing_down = photo_rotation(np.radians([0.0, 0.0, 10.0]), "nadir", ENU)
    assert -right_wing_down[2, 0] < 0 and abs(np.degrees(angles(right_wing_down)[1]) - 10) < 1e-9  # it looks to the left (west)


@pytest.mark.parametrize("mount", ["gimbal", "nadir"])
def test_round_trip(mount: Mount) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        a = np.radians(rng.uniform([-180, -89, -180], [180, 89, 180]))
        back = yaw_pitch_roll(photo_rotation(a, mount, ENU), mount, ENU)
        np.testing.assert_allclose(np.exp(1j * back), np.exp(1j * a), atol=1e-12)
    locked = np.radians([50.0, -90.0, 0.0])
    np.testing.assert_allclose(yaw_pitch_roll(photo_rotation(locked, mount, ENU), mount, ENU), locked, atol=1e-9)


def test_the_shortcut_is_wrong() -> None:
    """Adding 90 degrees to the pitch is exact without roll and wrong by degrees with it (yaw 120, pitch -45, roll 2)."""
    def shortcut(yaw: float, pitch: float, roll: float) -> np.ndarray:
        return photo_rotation(np.radians([yaw, pitch + 90, roll]), "nadir", ENU)

    whole = photo_rotation(np.radians([120.0, -45.0, 0.0]), "gimbal", ENU)
    np.testing.assert_allclose(shortcut(120, -45, 0), whole, atol=1e-12)
    whole = photo_rotation(np.radians([120.0, -45.0, 2.0]), "gimbal", ENU)
    gap = np.degrees(angles(whole) - angles(shortcut(120, -45, 2)))
    np.testing.assert_allclose(np.abs(gap), [2.0, 1.3, 3.2], atol=0.1)


@pytest.mark.parametrize(("lat", "lon", "crs"),
                         [(47.0, 8.2, CRS), (47.0, 11.9, CRS), (-25.6, -49.4, "EPSG:32722"), (0.0, 8.2, CRS)])
def test_meridian_convergence(lat: float, lon: float, crs: str) -> None:
    """kappa is turned by the convergence that pyproj gives: -0.585 degrees at 8.2 E, +2.12 at 11.9 E in zone 32."""
    from pyproj import Proj

    expected = Proj(crs).get_factors(lon, lat).meridian_convergence
    [g] = georeference([photo(lat=lat, lon=lon, yaw=0.0)], crs)
    assert abs(g.convergence_deg - expected) < 1e-4
    assert abs(np.degrees(g.exterior.angles[2]) - expected) < 1e-4 and np.abs(g.exterior.angles[:2]).max() < 1e-6
    xy = Proj(crs)(lon, lat)
    np.testing.assert_allclose(g.exterior.centre, [*xy, 500], atol=1.1e-6)


def test_lever_arm_and_boresight() -> None:
    """2 m forward of the antenna at yaw 90 is 2 m to the true east; 1 m down is down whatever the yaw."""
    plain, moved = (georeference([photo(yaw=90.0, body=(90.0, 0.0, 0.0))], CRS,
                                 frame=LocalFrame(np.array([439000.0, 5205000, 0]), CRS), rig=rig)[0]
                    for rig in (Rig(), Rig(lever_arm=(2.0, 0.0, 1.0))))
    d, turn = moved.exterior.centre - plain.exterior.centre, np.radians(plain.convergence_deg)
    np.testing.assert_allclose(d, [2 * np.cos(turn), 2 * np.sin(turn), -1], atol=2e-3)  # the map's scale is 0.9996
    [turned] = georeference([photo()], CRS, rig=Rig(boresight_deg=(0.5, 0.0, 0.0)))
    assert abs(np.degrees(angle_between(turned.exterior, georeference([photo()], CRS)[0].exterior)) - 0.5) < 1e-9


def test_covariance_of_gimbal_errors() -> None:
    """Tilt and yaw errors about north, east, down and GPS errors through a lever arm: the covariance predicts the scatter."""
    rng, chi = np.random.default_rng(3), []
    true = photo(yaw=60.0, attitude=(60.0, -70.0, 2.0), body=(60.0, 3.0, -2.0))
    rig = Rig(lever_arm=(1.5, 0.2, -0.4), sigma_m=(0.02, 0.03, 0.05), sigma_deg=(0.5, 0.5, 1.0))
    frame = LocalFrame(np.array([439000.0, 5205000.0, 500.0]), CRS)
    [g] = georeference([true], CRS, frame=frame, rig=rig)
    local, ned = frame.to_local(g.exterior.centre), frame.north_east_down(np.zeros(3))
    lever = body_to_ned(*np.radians(true.body or (0, 0, 0))) @ np.array(rig.lever_arm)
    covariance = vector_covariance(g)
    assert covariance is not None
    for _ in range(300):
        d = np.radians([0.5, 0.5, 1.0]) * rng.standard_normal(3)
        centre = local + ned.T @ ((exp(d) - np.eye(3)) @ lever + np.array([0.03, 0.02, 0.05]) * rng.standard_normal(3))
        m = g.exterior.m @ ned.T @ exp(d).T @ ned
        left = m @ g.exterior.m.T
        e = np.concatenate([centre - local, [left[2, 1], left[0, 2], left[1, 0]]])
        chi.append(e @ np.linalg.solve(covariance, e))
    chi_square_band(np.array(chi), 6)


# -- heights and standard errors --------------------------------------------------------------------------------------------


def test_heights_are_stated() -> None:
    geoid = Surface(Grid((3, 3), (1.0, 0, 6.5, 0, -1.0, 48.5), "EPSG:4326"), np.full((3, 3), 48.2), name="geoid.tif")
    cases = [
        (photo(datum="ellipsoidal"), Vertical("ellipsoidal"), 500.0, "as recorded (ellipsoidal)"),
        (photo(datum="ellipsoidal"), Vertical("levelled", undulation=47.5), 452.5, "entered undulation N = 47.50"),
        (photo(datum="ellipsoidal"), Vertical("levelled", undulation=geoid), 451.8, "geoid grid geoid.tif N = 48.20"),
        (photo(datum="barometric"), Vertical("ellipsoidal", source="levelled", undulation=geoid), 548.2,
         "levelled to ellipsoidal"),
        (photo(datum="barometric"), Vertical("levelled", bias=-6.2, bias_sigma=1.5), 493.8, "bias -6.20 m (sigma 1.50 m)"),
        (photo(relative=40.0), Vertical(take_off=410.0), 450.0, "take-off point 410 m"),
        (photo(height=None), Vertical(entered=530.0), 530.0, "entered flying height"),
    ]
    for o, vertical, z, words in cases:
        [g] = georeference([o], CRS, vertical=vertical)
        assert abs(g.exterior.centre[2] - z) < 1e-6 and words in g.heights
    [g] = georeference([photo(datum="barometric")], CRS, vertical=Vertical("levelled", bias=1.0, bias_sigma=24.0))
    assert abs(g.sigma[2] - 26) < 1e-6
    for o, vertical in ((photo(datum="barometric"), Vertical("levelled")), (photo(datum="ellipsoidal"), Vertical("levelled"))):
        assert "bias" in " ".join(georeference([o], CRS, vertical=vertical)[0].warnings)
    for o, words in ((photo(height=None), "has no height"), (replace(photo(), lat=None), "has no GPS position")):
        with pytest.raises(BadProject, match=words):
            georeference([o], CRS)
    with pytest.raises(BadProject, match="outside the geoid grid"):
        georeference([photo(lat=10.0, datum="ellipsoidal")], CRS, vertical=Vertical("levelled", undulation=geoid))
    with pytest.raises(BadProject, match="no place in a project with crs"):
        georeference([photo()], "local")


def test_standard_errors_stated_or_assumed() -> None:
    [stated] = georeference([photo(sigma_m=(0.011, 0.012, 0.03))], CRS)
    np.testing.assert_allclose(stated.sigma[:3], [0.011, 0.012, 0.03], rtol=1e-3)
    [assumed] = georeference([photo()], CRS)
    np.testing.assert_allclose(assumed.sigma[:3], [5, 5, 10], rtol=1e-3)
    assert any("position sigma 5 5 10 m: assumed" in n for n in assumed.notes) and not any("position" in n for n in stated.notes)
    np.testing.assert_allclose(np.degrees(assumed.sigma[3:]), [1, 1, 3], rtol=1e-3)
    out = assumed.to_json()
    assert out["model"] == "georeferenced" and out["sigma0"] is None and out["dof"] == 0 and len(out["covariance"]) == 6
    np.testing.assert_allclose(np.degrees(assumed.turned(180.0).exterior.angles[2] - assumed.exterior.angles[2]) % 360, 180,
                               atol=1e-9)


def test_without_attitude() -> None:
    """The photo's top is taken along the flight; a single photo says that its yaw is not known."""
    line = [Onboard(f"p{k}", 47 + 1e-4 * k, 8.2 + 1e-4 * k, 500.0) for k in range(3)]
    for g in georeference(line, CRS):
        true = np.degrees(np.arctan2(np.cos(np.radians(47)), 1))
        assert abs(-np.degrees(g.exterior.angles[2]) + g.convergence_deg - true) < 0.2 and "no attitude" in g.warnings[0]
    assert np.degrees(georeference(line[:1], CRS)[0].sigma[5]) > 90


def test_height_bias_from_control() -> None:
    """A common error of the heights is found from control, within its stated standard error."""
    rng, off, known = np.random.default_rng(8), [], []
    sigma = np.diag(np.array([0.05, 0.05, 0.05, 2e-3, 2e-3, 2e-3]) ** 2)
    for _ in range(40):
        xyz = rng.uniform([-30, -20, -2], [30, 20, 2], (6, 3))
        true = [Exterior(rotation(0.02, 0.01, k), np.array([20.0 * k - 10, 0, 100])) for k in range(2)]
        pixels = np.array([project(CAMERA, e, xyz) for e in true]) + 0.5 * rng.standard_normal((2, 6, 2))
        given = [Exterior(exp(2e-3 * rng.standard_normal(3)) @ e.m,
                          e.centre + np.array([*0.05 * rng.standard_normal(2), 7.0])) for e in true]
        block = replace(site(CAMERA, ("i0", "i1")), points=Points(tuple("ABCDEF"), xyz, np.full((6, 3), 0.01), ("control",) * 6),
                        observations=Observations(np.repeat([0, 1], 6), np.tile(np.arange(6), 2), pixels.reshape(-1, 2),
                                                  np.full(12, 0.5)))
        known = [Known(f"i{k}", e, e.angle_covariance(sigma)) for k, e in enumerate(given)]
        bias, s, count = height_bias(block, known)
        off.append(((bias + 7) / s) ** 2)
        assert count == 12
    chi_square_band(np.array(off), 1)
    with pytest.raises(DegenerateGeometry, match="no control point"):
        height_bias(site(CAMERA, ("i0", "i1")), known)


# -- autopilot log ----------------------------------------------------------------------------------------------------------


def flight_log(trigger: bool = False) -> FlightLog:
    """Ten minutes of lanes at 12 m/s, five rows a second."""
    t = np.arange(0, 600, 0.2)
    lane = (t // 60).astype(int)
    along = np.where(lane % 2 == 0, t % 60, 60 - t % 60) * 12.0
    lat, lon = 47 + along / 111_200, 8.2 + lane * 40 / 75_900
    attitude = np.column_stack([np.where(lane % 2 == 0, 359.0, 179.0) + np.sin(t) * 2, 2 * np.sin(t / 3), 3 * np.cos(t / 5)])
    fired = np.isin(np.arange(len(t)), FIRED) if trigger else np.zeros(len(t), bool)
    return FlightLog("log.csv", t, np.column_stack([lon, lat, np.full_like(t, 510.0)]), attitude, fired)


FIRED = np.cumsum([400, 11, 13, 10, 17, 12, 19, 10, 14, 23, 11, 16])


def test_log_offset_from_positions() -> None:
    """Clocks 3,271.4 s apart are found from coarse positions of the photos, within the standard error."""
    log, rng = flight_log(), np.random.default_rng(2)
    at = np.arange(70, 160, 7.3)
    place = np.column_stack([np.interp(at, log.time, log.degrees[:, k]) for k in range(2)]) + rng.standard_normal((len(at),
                                                                                                                   2)) * 4 / 1e5
    photos = [Onboard(f"p{k}", y, x, 480.0, time=t - 3271.4) for k, (t, (x, y)) in enumerate(zip(at, place, strict=True))]
    matched, offset = match_log(log, photos)
    assert abs(offset.seconds - 3271.4) < 4 * offset.sigma < 1.0
    assert matched[0].height == 510.0 and matched[0].mount == "nadir" and "clocks +3271." in matched[0].stated[0]
    exact, _ = match_log(log, photos, offset=3271.4)
    assert abs(exact[3].lat - np.interp(at[3], log.time, log.degrees[:, 1])) < 1e-12  # type: ignore[operator]
    assert abs(((exact[0].attitude or (0, 0, 0))[0] - 180 * (at[0] // 60 % 2) + 1 + 180) % 360 - 180) < 2.5  # yaw through 360
    with pytest.raises(BadProject, match=r"outside log\.csv"):
        match_log(log, photos, offset=0.0)
    with pytest.raises(BadProject, match="has no time"):
        match_log(log, [replace(photos[0], time=None)])


def test_log_offset_from_triggers() -> None:
    log = flight_log(trigger=True)
    photos = [Onboard(f"p{k}", time=t + 1e6) for k, t in enumerate(log.time[FIRED[3:9]])]
    matched, offset = match_log(log, photos)
    assert abs(offset.seconds + 1e6) < 1e-6 and offset.how == "6 triggers" and matched[2].lat is not None
    with pytest.raises(DegenerateGeometry, match="enter the offset"):
        match_log(flight_log(), photos)


# -- content, corners, footprints -------------------------------------------------------------------------------------------


def test_reversed_yaw_is_named() -> None:
    """Two strips flown to and fro; the yaw of one is wrong by 180 degrees, as some cameras write it."""
    rng, photos = np.random.default_rng(5), []
    frame = LocalFrame(np.array([439000.0, 5205000.0, 500.0]), CRS)
    for k in range(6):
        lon, lat, _ = frame.to_degrees(np.array([20.0 * (k % 3), 25.0 * (k // 3), 0]))
        photos.append(photo(f"p{k}", lat, lon, 500.0, yaw=90.0))
    true = georeference(photos, CRS)
    block, ground = site(CAMERA, tuple(o.image for o in photos), CRS), frame.to_map(
        np.column_stack([rng.uniform(-20, 60, 300), rng.uniform(-20, 45, 300), np.full(300, -60.0)]))
    seen = LocalFrame.around(np.array([g.exterior.centre for g in true]), CRS)
    pixels = [project(CAMERA, Exterior(g.exterior.m, seen.to_local(g.exterior.centre)), seen.to_local(ground)) for g in true]
    matches = {}
    for a in range(6):
        for b in range(a + 1, 6):
            both = np.flatnonzero(CAMERA.inside(pixels[a]) & CAMERA.inside(pixels[b]))[:40]
            if len(both) >= 10:
                matches[f"p{a}", f"p{b}"] = (pixels[a][both], pixels[b][both])
    given = georeference([replace(o, attitude=(-90.0, -90.0, 0.0)) if k >= 3 else o for k, o in enumerate(photos)], CRS)
    found = check_headings(block, given, matches, 440.0)
    assert [("reversed" in h.words) for h in found] == [False] * 3 + [True] * 3
    for g, h, t in zip(given, found, true, strict=True):
        assert angle_between(g.turned(h.correction_deg).exterior, t.exterior) < 1e-3 and abs(h.height_ratio - 1) < 1e-3


def test_golden_corners() -> None:
    """Corner coordinates to 1e-6 m, in the stated order, and in the printed formula where the photo is vertical."""
    known = Known("a", SEED_EXTERIOR, SEED_EXTERIOR.angle_covariance(np.diag([1, 1, 2, 1e-4, 1e-4, 4e-4])))
    got = corner_control(site(SEED_CAMERA, ("a",)), known, 0.0, 0.5)
    np.testing.assert_allclose(got.xyz, CORNER_GROUND, atol=1e-6)
    assert got.names[0] == "a F1 upper right" and np.linalg.eigvalsh(got.covariance).min() > 0
    vertical = Exterior.from_angles(0, 0, 0.7, np.array([5.0, 6, 300]))
    printed = vertical_corners(SEED_CAMERA, vertical.centre, 0.7, 0.0)
    np.testing.assert_allclose(corner_control(site(SEED_CAMERA, ("a",)), Known("a", vertical), 0.0, 0.5).xyz, printed, atol=1e-9)


def test_corner_covariance() -> None:
    """The twelve coordinates scatter together as their covariance says."""
    rng, chi, block = np.random.default_rng(11), [], site(SEED_CAMERA, ("a",))
    sigma = np.array([1, 1, 1.5, 3e-3, 3e-3, 5e-3])
    truth = corner_control(block, Known("a", SEED_EXTERIOR), 0.0, 0.0, 0.0)
    for _ in range(150):
        d = sigma * rng.standard_normal(6)
        given = Exterior(exp(d[3:]) @ SEED_EXTERIOR.m, SEED_EXTERIOR.centre + d[:3])
        got = corner_control(block, Known("a", given, given.angle_covariance(np.diag(sigma**2))), 0.0, 0.5, 1.0)
        extra = np.linalg.cholesky(corner_control(block, Known("a", given), 0.0, 0.5, 1.0).covariance) @ rng.standard_normal(12)
        e = (got.xyz - truth.xyz).ravel() + extra
        chi.append(e @ np.linalg.solve(got.covariance, e))
    chi_square_band(np.array(chi), 12)


def _two(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def test_grades_of_control() -> None:
    """The printed formula is worst; correlated corners repeat the onboard orientation exactly; surveyed control is best."""
    rng = np.random.default_rng(0)
    flight = Flight(CAMERA,
                    tuple(Exterior(rotation(*_two(np.radians(rng.normal(0, 3, 2))), np.pi * s),
                                   np.array([25.0 * k, 45.0 * s, 100]))
                                  for s in range(2) for k in range(2)),
                    rng.uniform([-20, -20, -2], [45, 65, 2], (24, 3)), rng.uniform([-10, -10, -2], [35, 55, 2], (12, 3)), 0.0,
                    2.0)
    table = [compare_control(flight, np.random.default_rng(s)) for s in range(2)]
    mean = {g.method: np.sqrt(np.mean([r[k].rms_horizontal ** 2 for r in table])) for k, g in enumerate(table[0])}
    printed, onboard, corners, coarse, surveyed = mean.values()
    assert surveyed < 0.1 < min(coarse, onboard) and onboard < printed and abs(corners / onboard - 1) < 0.01
    for rms, row in ((onboard, table[0][1]), (surveyed, table[0][4])):
        assert row.predicted_horizontal is not None and 0.5 < rms / row.predicted_horizontal < 2


def test_footprint_and_geojson() -> None:
    """A footprint is as large as its scale says; its ring is closed, counterclockwise, in longitude and latitude."""
    block = site(CAMERA, ("a",), CRS)
    [g] = georeference([photo()], CRS)
    f = footprint(block, g, Plane(400.0))
    assert abs(f.area / (2735 * 1823 * (0.0048 / 8.8 * 100) ** 2) - 1) < 2e-3 and f.corners.shape == (4, 3)
    [feature] = footprints_geojson([f], CRS)["features"]
    ring = np.array(feature["geometry"]["coordinates"][0])
    x, y = (ring - ring[0]).T
    assert (ring[0] == ring[-1]).all() and (x[:-1] * y[1:] - x[1:] * y[:-1]).sum() > 0
    assert np.abs(ring - [8.2, 47.0]).max() < 2e-3 and feature["properties"]["image"] == "a"
    with pytest.raises(BadProject, match="on no map"):
        footprints_geojson([f], "local")
    [far] = georeference([photo(lat=-18.0, lon=179.9999)], "EPSG:32760")
    cut = footprints_geojson([footprint(site(CAMERA, ("a",), "EPSG:32760"), far, Plane(400.0))],
                             "EPSG:32760")["features"][0]["geometry"]
    assert cut["type"] == "MultiPolygon" and {np.sign(part[0][1][0]) for part in cut["coordinates"]} == {-1.0, 1.0}
    assert all(abs(lon) <= 180 for part in cut["coordinates"] for lon, _ in part[0])
    with pytest.raises(DegenerateGeometry, match="horizon"):
        footprint(block, georeference([photo(attitude=(0.0, -5.0, 0.0))], CRS)[0], Plane(400.0))


def test_corners_give_back_the_orientation_they_came_from() -> None:
    """Four weighted corners amount to the onboard orientation and its covariance; moved as their covariance says, the
    orientation scatters as its own says."""
    rng, block = np.random.default_rng(5), site(SEED_CAMERA, ("a",))
    onboard = Known("a", SEED_EXTERIOR, SEED_EXTERIOR.angle_covariance(np.diag([1, 1, 2, 1e-4, 1e-4, 4e-4])))
    control = corner_control(block, onboard, 0.0, 0.05, 0.05)
    back = corner_orientation(block, control)
    np.testing.assert_allclose(back.exterior.centre, SEED_EXTERIOR.centre, atol=1e-6)
    assert back.covariance is not None and onboard.covariance is not None
    np.testing.assert_allclose(back.covariance, onboard.covariance, rtol=0.05, atol=0.02 * np.abs(onboard.covariance).max())
    control = corner_control(block, Known("a", SEED_EXTERIOR), 0.0, 0.3, 2.0)
    root, chi = np.linalg.cholesky(control.covariance), []
    for _ in range(150):
        got = corner_orientation(block, replace(control, xyz=control.xyz + (root @ rng.standard_normal(12)).reshape(4, 3)))
        assert got.covariance is not None
        d = np.concatenate([got.exterior.centre - SEED_EXTERIOR.centre, got.exterior.angles - SEED_EXTERIOR.angles])
        chi.append(d @ np.linalg.solve(got.covariance, d))
    chi_square_band(np.array(chi), 6)


def flown() -> tuple[Block, list[Known]]:
    """Six images over 30 points, ten of them control, five check, and their onboard orientations with what errors they have."""
    rng, interior = np.random.default_rng(3), CAMERA
    at = [Exterior(rotation(*_two(np.radians(rng.normal(0, 3, 2))), np.pi * s), np.array([20.0 * k, 30.0 * s, 100]))
          for s in range(2) for k in range(3)]
    xyz = rng.uniform([-20, -20, -2], [60, 50, 2], (30, 3))
    seen = [(i, j, p) for i, e in enumerate(at) for j, p in enumerate(project(interior, e, xyz))
            if np.isfinite(p).all() and interior.inside(p)]
    role = ("control",) * 10 + ("check",) * 5 + ("tie",) * 15
    given = np.where(np.array(role)[:, None] == "tie", np.nan, xyz + np.array([0.02, 0.02, 0.03]) * rng.standard_normal((30, 3)))
    pixel = np.array([p for *_, p in seen])
    block = Block("flown", "local", {"cam": interior}, tuple(Image(f"i{k}", "cam") for k in range(6)),
                  Points(tuple(f"P{j}" for j in range(30)), given, np.full((30, 3), 0.03), role),
                  Observations(np.array([i for i, *_ in seen]), np.array([j for _, j, _ in seen]),
                               pixel + 0.5 * rng.standard_normal(pixel.shape), np.full(len(seen), 0.5)))
    sigma = np.array([2, 2, 3, *np.radians([1, 1, 2])])
    onboard = []
    for k, e in enumerate(at):
        d = sigma * rng.standard_normal(6)
        near = Exterior(exp(d[3:]) @ e.m, e.centre + d[:3])
        onboard.append(Known(f"i{k}", near, near.angle_covariance(np.diag(sigma**2))))
    return block, onboard


def test_corners_are_control_for_a_bundle() -> None:
    """Corners alone carry a block to the accuracy of the onboard positions, and their weight is honest."""
    block, onboard = flown()
    got = adjust(with_corners(block, [corner_control(block, o, 0.0, 2.0) for o in onboard]), datum="prior")
    assert got.trace.converged and got.check_rms is not None and 0.05 < np.linalg.norm(got.check_rms) < 4
    assert 0.6 < (got.groups["GPS/IMU"][0] or 0.0) < 1.5
    off = np.array([p.off for p in got.points if p.role == "check"])
    predicted = np.sqrt(np.mean([np.trace(p.covariance) for p in got.points if p.role == "check"]))
    assert 0.2 < np.sqrt((off**2).sum(axis=1).mean()) / predicted < 2.5
    with pytest.raises(BadProject, match="twice"):
        with_corners(block, [corner_control(block, onboard[0], 0.0, 2.0)] * 2)
    moving = Prior(velocity=np.ones(3), turning=np.zeros((3, 3)))
    first = replace(block, images=(replace(block.images[0], prior=moving), *block.images[1:]))
    prior = with_corners(first, [corner_control(first, onboard[0], 0.0, 2.0)]).images[0].prior
    assert prior and prior.velocity is moving.velocity and prior.turning is moving.turning and prior.covariance is not None


def test_comparison_in_a_project() -> None:
    """At check points: the printed formula is worst, corners in a bundle better than single images, surveyed control best."""
    block, onboard = flown()
    rows, said = compare_project(block, onboard, 0.0, 2.0)
    printed, direct, corners, coarse, surveyed = (r.rms_horizontal for r in rows)
    assert surveyed < 0.2 < min(corners, coarse) and corners < direct and printed > corners
    assert all(r.points == 5 for r in rows) and "5 check points" in said[0]
    few = ("control",) * 5 + ("tie",) * 25
    one_by_one, said = compare_project(replace(block, points=replace(block.points, role=few)), onboard, 0.0, 2.0)
    assert "left out" in said[0] and one_by_one[4].rms_horizontal < 0.2 and one_by_one[4].points == 5
    with pytest.raises(BadProject, match="3 points"):
        compare_project(replace(block, points=replace(block.points, role=("tie",) * 30)), onboard, 0.0, 2.0)


def test_without_an_attitude_the_course_follows_the_strip_also_at_its_ends() -> None:
    """Two strips flown to and fro: the last photo before the turn looks along its own strip, and so does the first after it."""
    from solvers.orientation.georeference import _course

    x = [0.0, 20, 40, 60, 62, 42, 22, 2]
    at = np.column_stack([x, [0.0] * 4 + [45.0] * 4, np.full(8, 100.0)])
    courses = [_course(at, k) for k in range(8)]
    assert np.degrees([c for c in courses if c is not None]) == pytest.approx([90.0] * 4 + [-90.0] * 4)
    assert _course(at[:1], 0) is None
