"""Readout times and velocities of photos, and that a project keeps them."""

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture

from solvers.errors import BadProject
from solvers.io import read_exif, read_motion, read_project
from solvers.io.lens import read_lens
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


def gyroscope(rates: np.ndarray, flag: int = 1) -> str:
    """A record of rates (n, 3) about body axes, one a millisecond."""
    record = np.zeros(len(rates), [("t", "<u8"), ("rate", "<f4", 3), ("flag", "<u4")])
    record["t"], record["rate"], record["flag"] = 5_000_000 + 1000 * np.arange(len(rates)), rates, flag
    return base64.b64encode(record.tobytes()).decode()


def test_a_gyroscope_is_summed_up_about_the_middle_row(tmp_path) -> None:
    rates = np.tile([0.3, -0.2, 0.1], (80, 1))  # roll, pitch, yaw [rad/s]
    entries = f'Camera:LineReadoutTime="20000" Camera:IMUAngularVelocity="{gyroscope(rates)}"'
    turning = read_motion(photo(tmp_path / "a.jpg", entries)).turning
    assert turning is not None and not turning[len(turning) // 2].any()
    # forward turns about the photo's y axis, right about x, down about -z; what the camera sees turns the other way
    np.testing.assert_allclose(turning[-1] - turning[0], -0.06 * np.array([-0.2, 0.3, -0.1]), atol=1e-7)
    broken = ("AAAA", "soon", gyroscope(rates[:20]), gyroscope(1e3 * rates))
    for n, text in enumerate(broken):
        entries = f'Camera:LineReadoutTime="20000" Camera:IMUAngularVelocity="{text}"'
        assert read_motion(photo(tmp_path / f"{n}.jpg", entries)).turning is None


def test_a_project_keeps_the_turning(tmp_path) -> None:
    rates = np.linspace([0.3, -0.2, 0.1], [-0.3, 0.1, 0.0], 80)
    file = photo(tmp_path / "a.jpg", f'Camera:LineReadoutTime="20000" Camera:IMUAngularVelocity="{gyroscope(rates)}"')
    done = init_project([file], tmp_path / "p", pixel_um=100.0)
    assert any("1 photos record how they turned" in n for n in done.notes)
    prior, said = read_project(tmp_path / "p").images[0].prior, read_motion(file).turning
    assert prior is not None and prior.turning is not None and said is not None
    np.testing.assert_allclose(prior.turning, said, atol=2e-8)
    text = (tmp_path / "p" / "project.toml").read_text()
    (tmp_path / "p" / "project.toml").write_text(text.replace("turning_deg = [", "turning_deg = [1.0, "))
    with pytest.raises(BadProject, match="turning_deg: write three numbers"):
        read_project(tmp_path / "p")


LENS = 'Camera:PerspectiveFocalLength="4.5" Camera:PrincipalPoint="4.1,2.9" '


@pytest.mark.parametrize(("entries", "known"), [
    (LENS + 'Camera:PerspectiveDistortion="0.05,-0.03,0.01,0.001,-0.002"', True), (LENS, True),
    (LENS + 'Camera:ModelType="fisheye"', False), (LENS.replace("4.5", "45"), False), (LENS.replace("4.1", "0"), False)])
def test_a_lens_stated_by_the_photo_is_taken(tmp_path, entries, known) -> None:
    file = photo(tmp_path / "a.jpg", entries)
    exif = replace(read_exif(file), pitch_mm=0.1, focal_mm=4.9)  # 80 x 60 px are 8 x 6 mm
    lens = read_lens(file, exif)
    assert (lens is not None) == known
    if lens is None:
        return
    camera, fit = lens
    assert camera.c == pytest.approx(4.5) and fit.max_px < 0.3
    assert (camera.xp, camera.yp) == pytest.approx((0.1, 0.1))  # the principal point is 4.1, 2.9 mm from the corner
    corner = camera.ideal(np.array([[79.0, 59.0]]))[0] / camera.c
    if "Distortion" in entries:  # of the ideal direction, back to where it is seen
        x, y = corner[0], -corner[1]
        r2 = x * x + y * y
        bent = 1 + 0.05 * r2 - 0.03 * r2**2 + 0.01 * r2**3
        seen = np.array([x * bent + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x),
                         y * bent + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y])
        np.testing.assert_allclose(seen * 45 + [41, 29] - 0.5, [79, 59], atol=0.3)


@pytest.mark.parametrize(("model", "step", "height", "moved"), [
    ("FC300S", 3.0, 40.0, 2.6), ("FC300S", 0.3, 40.0, None), ("FC6310", 3.0, 40.0, None), ("FC300S", 3.0, None, None)])
def test_a_readout_that_no_photo_tells_is_asked_for_where_it_matters(tmp_path, model, step, height, moved) -> None:
    """Photos 2 s and `step` m apart, northwards; 5 mm, 0.004 mm pixels: 1 m at 40 m is 31 px."""
    files = [photo(tmp_path / f"{k}.jpg", "" if height is None else f'drone-dji:RelativeAltitude="+{height}"') for k in range(3)]
    for k, file in enumerate(files):
        with Picture.open(file) as picture:
            exif, xmp = picture.getexif(), picture.info["xmp"]
            exif[272] = model
            exif.get_ifd(0x8769)[36867] = f"2020:05:01 10:00:{2 * k:02d}"
            exif.get_ifd(0x8825)[2] = (46.0, 30.0, k * step / 111_200 * 3600)
            picture.save(file, exif=exif, xmp=xmp)
    notes = [n for n in init_project(files, tmp_path / "p", pixel_um=2.2).notes if n.startswith("rolling shutter")]
    assert len(notes) == (moved is not None)
    if moved is not None:
        assert f"moves by {moved} px" in notes[0] and "1.5 m/s, 40 m" in notes[0] and "readout_ms" in notes[0]
