"""Files that others made: a user's gcp_list.txt, an agency's orientations, BAL, photos' EXIF and XMP."""

from pathlib import Path

import numpy as np
import pytest

from solvers.io.exchange import registry
from solvers.io.whereabouts import Reading, mistaken

pytestmark = pytest.mark.real


def test_odm_list_lies_at_its_photos(data: Path) -> None:
    value = registry.read(data / "resection_uav_odm_br" / "gcp_list_floatxy_subset.txt")
    assert value.crs == "EPSG:32722" and len(value.points) == 17 and len(value.observations) == 31
    photos = registry.read(data / "resection_uav_odm_br" / "exif_lalo_4326dms.txt")
    from solvers.io.crs import transformed

    at = np.array([s.exterior.centre for s in photos.shots if s.exterior is not None])
    degrees = transformed(np.nan_to_num(at), str(photos.crs), "EPSG:4326")[:, :2]
    assert mistaken(value.points.xyz, Reading("EPSG:32722"), degrees) is None
    for wrong, words in (("EPSG:32622", "hemisphere"), ("EPSG:32723", "zone")):
        found = mistaken(value.points.xyz, Reading(wrong), degrees)
        assert found is not None and words in found.words and found.options == "--crs EPSG:32722"
    found = mistaken(value.points.xyz[:, [1, 0, 2]], Reading("EPSG:32722"), degrees)
    assert found is not None and found.options == "--swap-xy"


def test_an_agencys_orientations_without_a_header(data: Path) -> None:
    value = registry.read(data / "ortho_ngi" / "camera_pos_ori.txt")
    assert value.kind == "OPK text" and len(value.oriented) == 4
    assert value.shots[0].exterior is not None
    np.testing.assert_allclose(np.degrees(value.shots[0].exterior.angles), [-0.349216, 0.298484, -179.086702], atol=1e-9)


def test_bal_comes_back_to_its_digits(data: Path, tmp_path: Path) -> None:
    source = data / "bal" / "problem-49-7776-pre.txt"
    value = registry.read(source)
    assert value.kind == "BAL" and len(value.oriented) == 49 and len(value.points) == 7776
    write = registry.FORMATS["bal"].write
    assert write is not None
    write(value, tmp_path / "again.txt")
    own, again = (np.array(p.read_text().split(), float) for p in (source, tmp_path / "again.txt"))
    assert np.abs(own - again).max() < 1e-9 * np.abs(own).max()


@pytest.mark.parametrize(("folder", "count", "crs"), [("uav_brighton8", 8, "EPSG:32615"), ("uav_strip5", 5, "EPSG:32632")])
def test_photos(data: Path, folder: str, count: int, crs: str) -> None:
    value = registry.read(data / folder)
    assert len(value.oriented) == count and value.crs == crs
    down = [s.exterior.m[2, 2] for s in value.oriented if s.exterior is not None]
    assert min(down) > 0.9  # nadir photos
