"""Readout times and velocities of photos, and that a project keeps them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture

from solvers.errors import BadProject
from solvers.io import read_motion, read_project
from solvers.workflows_init import init_project


def photo(path: Path, entries: str, rows: int = 3000) -> Path:
    exif = Picture.Exif()
    exif.get_ifd(0x8769).update({40963: rows, 37386: 5.0})
    gps = exif.get_ifd(0x8825)
    gps.update({1: "N", 2: (46.0, 30.0, 0.0), 3: "E", 4: (6.0, 30.0, 0.0), 6: 500.0})
    xmp = ('<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
           '<rdf:Description xmlns:Camera="http://pix4d.com/camera/1.0/" '
           f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {entries}/></rdf:RDF>'
           '</x:xmpmeta>')
    Picture.new("L", (80, 60), 90).save(path, exif=exif, xmp=xmp.encode())
    return path


@pytest.mark.parametrize(("entries", "readout", "velocity"), [
    ('Camera:LineReadoutTime="20000" Camera:IMULinearVelocity="1.5,-2,0.5"', 60.0, [1.5, -2, 0.5]),
    ('drone-dji:FlightXSpeed="+4.0" drone-dji:FlightYSpeed="-1.0" drone-dji:FlightZSpeed="+0.2"', None, [-1.0, 4.0, -0.2]),
    ('Camera:LineReadoutTime="soon" Camera:IMULinearVelocity="1,2"', None, None), ("", None, None)])
def test_what_a_photo_says(tmp_path, entries, readout, velocity) -> None:
    got = read_motion(photo(tmp_path / "a.jpg", entries))
    assert got.readout_ms == readout
    assert (got.velocity is None) == (velocity is None)
    if velocity is not None and got.velocity is not None:
        np.testing.assert_allclose(got.velocity, velocity)


def test_init_writes_it_and_says_where_it_matters(tmp_path) -> None:
    file = photo(tmp_path / "a.jpg", 'Camera:LineReadoutTime="20000" Camera:IMULinearVelocity="3,4,0"')
    done = init_project([file], tmp_path / "p", pixel_um=100.0)
    assert any("it moves by 0.30 m" in n and "smaller than 0.60 m" in n for n in done.notes)
    block = read_project(tmp_path / "p")
    prior = block.images[0].prior
    assert list(block.readout_ms.values()) == [60.0] and prior is not None and prior.velocity is not None
    np.testing.assert_array_equal(prior.velocity, [3, 4, 0])
    text = (tmp_path / "p" / "project.toml").read_text()
    (tmp_path / "p" / "project.toml").write_text(text.replace("readout_ms = 60.0", "readout_ms = -1"))
    with pytest.raises(BadProject, match="readout_ms"):
        read_project(tmp_path / "p")
