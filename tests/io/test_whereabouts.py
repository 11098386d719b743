"""Coordinates in the wrong place are recognised by their distance from the photos, and the cure works."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from solvers import BadProject
from solvers.cli import main
from solvers.io import crs
from solvers.io.surface import find_geoid
from solvers.io.whereabouts import Reading, mistaken
from solvers.workflows_init import init_project

MUNICH, CURITIBA = (11.4834, 48.1334), (-49.421, -25.6059)
GROUND = np.array([[-60.0, -30, 500], [70, -25, 510], [55, 38, 505], [-65, 22, 500]])


def photo(path: Path, degrees: tuple[float, float], make: str = "DJI") -> Path:
    exif = Image.Exif()
    exif[271], exif[272] = make, "FC6310"
    exif.get_ifd(0x8769)[37386] = 8.8
    lon, lat = degrees
    exif.get_ifd(0x8825).update({1: "N" if lat > 0 else "S", 2: (abs(lat), 0.0, 0.0), 3: "E" if lon > 0 else "W",
                                 4: (abs(lon), 0.0, 0.0),
                                 5: b"\0", 6: 600.0})
    Image.new("RGB", (547, 365)).save(path, exif=exif)
    return path


def at(degrees: tuple[float, float], code: str) -> np.ndarray:
    """Control (4, 3) around a place, in a crs."""
    x, y = crs.transformed(np.array([[*degrees, 0.0]]), "EPSG:4326", code)[0, :2]
    return GROUND + np.array([x, y, 0])


def table(path: Path, xyz: np.ndarray) -> Path:
    path.write_text("name,X,Y,Z\n" + "".join(f"P{n},{a!r},{b!r},{c!r}\n" for n, (a, b, c) in enumerate(xyz.tolist(), 1)))
    return path


CASES: dict[str, tuple[tuple[float, float], str, Any, str, dict[str, Any]]] = {
    # place, crs as said, coordinates in the file, what the sentence says, what mends it
    "zone": (MUNICH, "EPSG:32633", at(MUNICH, "EPSG:32632"), r"another zone.*--control-crs EPSG:32632",
             {"control_crs": "EPSG:32632"}),
    "hemisphere": (CURITIBA, "EPSG:32622", at(CURITIBA, "EPSG:32722"), r"other hemisphere.*--control-crs EPSG:32722",
                   {"control_crs": "EPSG:32722"}),
    "northing": (CURITIBA, "EPSG:32722", at(CURITIBA, "EPSG:32622"), r"hemisphere's count.*--control-crs EPSG:32622",
                 {"control_crs": "EPSG:32622"}),
    "swapped": (MUNICH, "EPSG:32632", at(MUNICH, "EPSG:32632")[:, [1, 0, 2]], r"swapped.*--swap-xy", {"swap_xy": True}),
    "degrees": (MUNICH, "EPSG:32632", crs.transformed(at(MUNICH, "EPSG:32632"), "EPSG:32632", "EPSG:4326"),
                r"degrees, longitude before.*--control-crs EPSG:4326", {"control_crs": "EPSG:4326"}),
    "latitude first": (MUNICH, "EPSG:32632", crs.transformed(at(MUNICH, "EPSG:32632"), "EPSG:32632", "EPSG:4326")[:, [1, 0, 2]],
                       r"degrees, latitude before.*--control-crs EPSG:4326 --swap-xy",
                       {"control_crs": "EPSG:4326", "swap_xy": True}),
    "feet": (MUNICH, "EPSG:32632", at(MUNICH, "EPSG:32632") / [0.3048, 0.3048, 1], r"in feet.*--unit ft", {"unit": "ft"}),
    "zone number": (MUNICH, "EPSG:32632", at(MUNICH, "EPSG:4647"), r"zone number.*--control-crs EPSG:4647",
                    {"control_crs": "EPSG:4647"}),
    "nothing known": (MUNICH, "EPSG:32632", GROUND + np.array([100_000.0, 200_000, 0]), r"neither another zone", {}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_mistake_is_named_and_its_cure_works(tmp_path: Path, case: str) -> None:
    degrees, said, xyz, says, cure = CASES[case]
    b, g = photo(tmp_path / "b.jpg", degrees), table(tmp_path / "g.csv", xyz)
    with pytest.raises(BadProject, match=rf"g\.csv: its points lie (\d+ km from|nowhere near) the photos' GPS.*{says}"):
        init_project([b, g], tmp_path / "p", project_crs=said, control_crs=said)
    assert not (tmp_path / "p").exists()
    if not cure:
        return
    home = "EPSG:32632" if degrees == MUNICH else "EPSG:32722"
    done = init_project([b, g], tmp_path / "p", **{"project_crs": home, "control_crs": said, **cure}).block
    np.testing.assert_allclose(done.points.xyz, at(degrees, home), atol=2e-3)


def test_a_person_is_asked_and_may_say_no(tmp_path: Path) -> None:
    degrees, said, xyz, _, _ = CASES["swapped"]
    b, g = photo(tmp_path / "b.jpg", degrees), table(tmp_path / "g.csv", xyz)
    questions: list[str] = []

    def yes(question: str) -> str:
        questions.append(question)
        return "yes"

    block = init_project([b, g], tmp_path / "p", project_crs=said, ask=yes).block
    np.testing.assert_allclose(block.points.xyz, at(degrees, said), atol=1e-9)
    assert "perhaps x and y are swapped" in questions[0]
    with pytest.raises(BadProject, match="--swap-xy"):
        init_project([b, g], tmp_path / "q", project_crs=said, ask=lambda q: "no")


def test_near_is_near() -> None:
    photos = np.array([MUNICH])
    assert mistaken(at(MUNICH, "EPSG:32632") + np.array([8000.0, 0, 0]), Reading("EPSG:32632"), photos) is None
    assert mistaken(at(MUNICH, "EPSG:32633"), Reading("EPSG:32633"), photos) is None  # a neighbouring zone, rightly used
    assert mistaken(GROUND, Reading("local"), photos) is None


def test_feet_are_named(tmp_path: Path) -> None:
    """State plane in US survey feet: heights must be named; survey and international feet differ by 2 ppm."""
    place = (-121.5, 38.6)
    b = photo(tmp_path / "b.jpg", place)
    x, y = crs.transformed(np.array([[*place, 0.0]]), "EPSG:4326", "EPSG:2226")[0, :2]
    g = table(tmp_path / "g.csv", np.array([[x, y, 328.083333], [x + 100, y, 400], [x, y + 100, 350]]))
    with pytest.raises(BadProject, match=r"EPSG:2226 is not in metres but in US survey feet \(0\.3048006096 m\).*--height-unit"):
        init_project([b, g], tmp_path / "p", control_crs="EPSG:2226")
    block = init_project([b, g], tmp_path / "p", control_crs="EPSG:2226", height_unit="us-ft").block
    assert block.crs == "EPSG:32610" and block.points.xyz[0, 2] == pytest.approx(100.0, abs=1e-5)
    expected = crs.transformed(np.array([[*place, 0.0]]), "EPSG:4326", "EPSG:32610")[0, :2]
    np.testing.assert_allclose(block.points.xyz[0, :2], expected, atol=2e-3)
    # a compound crs says its heights itself
    block = init_project([b, g], tmp_path / "q", control_crs="EPSG:2226+6360").block
    assert block.points.xyz[0, 2] == pytest.approx(100.0, abs=1e-5)


def test_compound_codes_wkt_and_prj(tmp_path: Path) -> None:
    from pyproj import CRS

    b, g = photo(tmp_path / "b.jpg", MUNICH), table(tmp_path / "g.csv", at(MUNICH, "EPSG:25832"))
    made = init_project([b, g], tmp_path / "p", project_crs="EPSG:25832+7837")
    assert made.block.crs == "EPSG:25832+7837" and any("DHHN2016 height" in n for n in made.notes)
    (tmp_path / "utm.prj").write_text(CRS(25832).to_wkt("WKT1_ESRI"))
    assert init_project([b, g], tmp_path / "q", project_crs=str(tmp_path / "utm.prj")).block.crs == "EPSG:25832"
    assert init_project([b, g], tmp_path / "r", project_crs=CRS(25832).to_wkt()).block.crs == "EPSG:25832"
    (tmp_path / "bad.prj").write_text("PROJCS[nothing")
    with pytest.raises(BadProject, match=r"bad\.prj' is not known"):
        init_project([b, g], tmp_path / "s", project_crs=str(tmp_path / "bad.prj"))
    assert crs.described("EPSG:25832+7837").heights == "levelled" and crs.described("EPSG:4979").heights == "ellipsoidal"


def test_axes_are_those_of_pyproj_always_xy() -> None:
    for code in ("EPSG:31467", "EPSG:2193", "EPSG:4326"):
        assert crs.north_first(code)
    assert not crs.north_first("EPSG:32632") and not crs.north_first("local")
    x, y = crs.transformed(np.array([[11.5, 48.1, 0.0]]), "EPSG:4326", "EPSG:31468")[0, :2]
    assert 4.4e6 < x < 4.6e6 and 5.3e6 < y < 5.4e6  # easting first, though EPSG:31468 defines northing first


def test_heights_of_photos_by_an_entered_undulation_or_a_grid(tmp_path: Path) -> None:
    import rasterio
    from rasterio.transform import from_origin

    b, g = photo(tmp_path / "b.jpg", MUNICH, "ACME"), table(tmp_path / "g.csv", at(MUNICH, "EPSG:25832"))
    with rasterio.open(tmp_path / "geoid.tif", "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
                       crs="EPSG:4326",
                       transform=from_origin(10, 50, 0.2, 0.2)) as data:
        data.write(np.full((1, 20, 20), 46.5, np.float32))
    for n, said in enumerate((46.5, str(tmp_path / "geoid.tif"))):
        made = init_project([b, g], tmp_path / f"p{n}", project_crs="EPSG:25832+7837", undulation=said)
        prior = made.block.images[0].prior
        assert prior is not None and prior.centre is not None
        assert prior.centre[2] == pytest.approx(600 - 46.5)
        assert any("undulation 46.50 m" in note for note in made.notes)
    barometric = photo(tmp_path / "c.jpg", MUNICH)  # DJI without RTK: no heights above the ellipsoid
    with pytest.raises(BadProject, match="barometric"):
        init_project([barometric, g], tmp_path / "q", project_crs="EPSG:25832", undulation=46.5)


def test_undulation_auto_takes_the_geoid_grid_that_proj_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A grid in PROJ's own format and under PROJ's name, of a made undulation; PROJ's vgridshift has the last word."""
    import struct

    from pyproj import Transformer

    monkeypatch.setenv("PROJ_DATA", str(tmp_path / "empty"))
    lat, lon = np.mgrid[40:56:0.25, 5:20:0.25]
    n = (40 + 0.7 * (lat - 48) - 0.4 * (lon - 11) + 2 * np.sin(lon)).astype(">f4")
    (tmp_path / "proj").mkdir()
    grid = tmp_path / "proj" / "egm96_15.gtx"  # south-west corner, steps, rows, columns, then rows from the south
    grid.write_bytes(struct.pack(">4d2i", 40.0, 5.0, 0.25, 0.25, *n.shape) + n.tobytes())
    b, g = photo(tmp_path / "b.jpg", MUNICH, "ACME"), table(tmp_path / "g.csv", at(MUNICH, "EPSG:25832"))
    if find_geoid() is None:
        with pytest.raises(BadProject, match="no geoid grid is installed on this machine; give a grid's file or metres"):
            init_project([b, g], tmp_path / "none", project_crs="EPSG:25832+7837", undulation="auto")
    monkeypatch.setenv("PROJ_DATA", f"{tmp_path / 'empty'}{os.pathsep}{tmp_path / 'proj'}")
    assert find_geoid() == grid
    made = init_project([b, g], tmp_path / "p", project_crs="EPSG:25832+7837", undulation="auto")
    levelled = Transformer.from_pipeline(f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +inv "
                                         f"+proj=vgridshift +grids={grid} +multiplier=1").transform(*MUNICH, 600.0)[2]
    prior = made.block.images[0].prior
    assert prior is not None and prior.centre is not None and abs(levelled - 560) < 5
    assert prior.centre[2] == pytest.approx(levelled, abs=2e-3)
    assert any("egm96_15.gtx" in note for note in made.notes)


def test_convert_checks_the_photos_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "photos").mkdir()
    photo(tmp_path / "photos" / "b.jpg", MUNICH)
    table(tmp_path / "g.csv", at(MUNICH, "EPSG:32632"))
    words = ["convert", str(tmp_path / "g.csv"), str(tmp_path / "out.geojson"), "--to", "gcp-geojson", "--photos",
             str(tmp_path / "photos")]
    assert main([*words, "--crs", "EPSG:32631"]) == 1
    error = capsys.readouterr().err
    assert re.search(r"g\.csv: its coordinates lie \d+ km from the photos' GPS.*give --crs EPSG:32632", error)
    assert not (tmp_path / "out.geojson").exists()
    assert main([*words, "--crs", "EPSG:32632"]) == 0 and (tmp_path / "out.geojson").exists()


def test_utm_zones_in_words() -> None:
    for text, code in (("WGS84 UTM 32N", "EPSG:32632"), ("wgs84 utm 23 s", "EPSG:32723"), ("UTM zone 7N", "EPSG:32607"),
                       ("WGS 84 / UTM zone 32N", "EPSG:32632")):
        assert crs.short_crs(text) == code
    with pytest.raises(BadProject, match="not known"):
        crs.short_crs("UTM 61N")
