"""Photos made small and cut out: the right pixels, little memory, kept pictures, no way out of the project folder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pillow

from solvers import BadProject, Unsupported
from solvers.io import (
    check_photos,
    demo_assets,
    demo_copy,
    photo_path,
    photo_window,
    read_heights,
    read_photo,
    thumbnail,
    write_heights,
    write_image,
)
from tests.projects import good_block


def ramp(width: int, height: int) -> np.ndarray:
    """A picture whose colours say where one is: red by column, green by row."""
    col, row = np.meshgrid(np.linspace(0, 255, width), np.linspace(0, 255, height))
    return np.stack([col, row, np.full_like(col, 128)], -1).astype(np.uint8)


@pytest.mark.parametrize("kind", ["jpg", "png", "tif"])
def test_thumbnails_show_the_same_places(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"
    Pillow.fromarray(ramp(3000, 2000)).save(path, quality=95)
    small = thumbnail(path, 300)
    assert small.pixels.shape == (200, 300, 3) and small.pixels.dtype == np.uint8 and small.scale == 0.1
    for col, row in ((300, 200), (1500, 1700), (2800, 400)):
        x, y = round((col + 0.5) * small.scale - 0.5), round((row + 0.5) * small.scale - 0.5)
        np.testing.assert_allclose(small.pixels[y, x, :2], [col / 2999 * 255, row / 1999 * 255], atol=3)
    assert thumbnail(path, 9000).scale == 1.0  # never larger than the photo


def test_thumbnails_are_kept_until_the_photo_changes(tmp_path: Path) -> None:
    path, cache = tmp_path / "a.jpg", tmp_path / "runs" / "c"
    Pillow.fromarray(ramp(600, 400)).save(path, quality=95)
    first = thumbnail(path, 100, cache)
    [kept] = cache.iterdir()
    Pillow.fromarray(255 - first.pixels).save(kept)  # seen when the kept picture is used
    np.testing.assert_array_equal(thumbnail(path, 100, cache).pixels, 255 - first.pixels)
    Pillow.fromarray(ramp(600, 402)).save(path, quality=95)
    assert np.abs(thumbnail(path, 100, cache).pixels[:60].astype(int) - first.pixels[:60]).max() < 10
    assert len(list(cache.iterdir())) == 2


@pytest.mark.parametrize("mode", ["L", "RGBA", "CMYK", "I;16"])
def test_other_kinds_of_pixels(tmp_path: Path, mode: str) -> None:
    if mode == "I;16":
        picture = Pillow.fromarray(ramp(64, 48)[..., 0].astype(np.uint16) * 200)
    else:
        picture = Pillow.fromarray(ramp(64, 48)).convert(mode)
    path = tmp_path / ("a.jpg" if mode == "CMYK" else "a.tif")
    picture.save(path)
    small = thumbnail(path, 32).pixels
    assert small.shape == (24, 32, 3) and int(small[12, 30, 0]) > int(small[12, 1, 0]) + 60


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_windows_are_the_very_pixels(tmp_path: Path, kind: str) -> None:
    path, picture = tmp_path / f"a.{kind}", np.random.default_rng(5).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    Pillow.fromarray(picture).save(path)
    np.testing.assert_array_equal(photo_window(path, 7, 11, 20, 10), picture[11:21, 7:27])
    edge = photo_window(path, -3, 35, 10, 10)
    np.testing.assert_array_equal(edge[:5, 3:], picture[35:, :7])
    assert not edge[5:].any() and not edge[:, :3].any()
    assert not photo_window(path, 100, 100, 5, 5).any()


def test_files_that_are_no_photos(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    for content in (b"", b"nothing", b"\xff\xd8\xff\xe0"):
        path.write_bytes(content)
        with pytest.raises(Unsupported, match=r"a\.jpg"):
            thumbnail(path, 100)
    Pillow.fromarray(ramp(600, 400)).save(path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(Unsupported, match=r"a\.jpg: the photo is damaged"):
        thumbnail(path, 100)
    with pytest.raises(BadProject, match="no such photo"):
        thumbnail(tmp_path / "none.jpg", 100)
    Pillow.new("L", (1, 1)).save(path)
    with pytest.raises(Unsupported, match=r"a\.jpg: 1 x 1 pixels show nothing"):
        read_photo(path)


@pytest.mark.parametrize("file", ["../a.jpg", "images/../../a.jpg", "..\\a.jpg"])
def test_relative_paths_stay_inside(tmp_path: Path, file: str) -> None:
    block = good_block()
    block = replace(block, images=(replace(block.images[0], file=file),))
    write_image(tmp_path / "a.jpg", ramp(60, 40))
    (tmp_path / "p" / "images").mkdir(parents=True)
    with pytest.raises(BadProject, match="leaves the project folder"):
        photo_path(tmp_path / "p", block, "a")


def test_photos_are_found_and_must_have_their_cameras_shape(tmp_path: Path) -> None:
    block = good_block()
    write_image(tmp_path / "images" / "a.jpg", ramp(60, 40))
    inside = replace(block, images=(replace(block.images[0], file="images/a.jpg"),))
    assert photo_path(tmp_path, inside, "a") == tmp_path / "images" / "a.jpg"
    absolute = replace(block, images=(replace(block.images[0], file=str(tmp_path / "images" / "a.jpg")),))
    assert photo_path(tmp_path / "elsewhere", absolute, "a").is_file()
    check_photos(tmp_path, inside)  # 60 x 40 is 6000 x 4000 made smaller
    write_image(tmp_path / "images" / "a.jpg", ramp(40, 60))
    with pytest.raises(BadProject, match=r"\[cameras.cam\] width, height: 6000 x 4000 .* 40 x 60"):
        check_photos(tmp_path, inside)
    with pytest.raises(BadProject, match="has no photo"):
        photo_path(tmp_path, block, "a")


def test_heights_come_back_where_they_were(tmp_path: Path) -> None:
    heights = np.random.default_rng(2).uniform(100, 200, (30, 40))
    write_heights(tmp_path / "dem.tif", heights, 500.0, 900.0, 2.5, "EPSG:32632")
    x, y, z = read_heights(tmp_path / "dem.tif", 40)
    np.testing.assert_allclose(x, 500 + 2.5 * np.arange(40))
    np.testing.assert_allclose(y, 900 - 2.5 * np.arange(30))
    np.testing.assert_allclose(z, heights, atol=1e-5)


def test_the_demo_is_copied_once_to_a_writable_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    copy = demo_copy()
    assert copy.is_relative_to(tmp_path) and (copy / "project.toml").read_bytes() == (demo_assets() / "project.toml").read_bytes()
    (copy / "points.csv").write_text("changed")
    assert demo_copy() == copy and (copy / "points.csv").read_text() == "changed"  # a person's work stays
    assert [p.name for p in copy.parent.iterdir()] == [copy.name]
