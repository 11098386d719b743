"""Pyramids: any window of a photo comes out as it is in the photo, at any reduction; a damaged file is a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from solvers import PhotogrammetryError
from solvers.errors import Unsupported
from solvers.io.pyramid import SMALLEST, TILE, build_pyramid, pyramid_path, read_window


@pytest.fixture(scope="module")
def photo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    rng = np.random.default_rng(2)
    coarse = Image.fromarray(rng.integers(40, 220, (60, 90, 3), dtype=np.uint8))
    pixels = np.asarray(coarse.resize((2250, 1500), Image.Resampling.BICUBIC))
    path = tmp_path_factory.mktemp("pyramid") / "photo.png"
    Image.fromarray(pixels).save(path, compress_level=1)
    return path, pixels


@pytest.fixture(scope="module")
def built(photo: tuple[Path, np.ndarray]) -> Path:
    path = pyramid_path(photo[0], photo[0].parent / "cache")
    shares = list(build_pyramid(photo[0], path))
    assert shares == sorted(shares) and shares[-1] == 1.0 and shares[0] < 0.5
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    return path


@pytest.mark.parametrize("box", [(0, 0, 100, 80), (TILE - 20, TILE - 30, 60, 60), (2200, 1460, 50, 40), (1000, 700, 300, 200)])
def test_a_window_is_that_of_the_photo(photo: tuple[Path, np.ndarray], built: Path, box: tuple[int, int, int, int]) -> None:
    x, y, w, h = box
    found = read_window(built, x, y, w, h, 1000)
    assert found.shape == (h, w, 3)
    assert np.abs(found.astype(int) - photo[1][y : y + h, x : x + w]).mean() < 3


@pytest.mark.parametrize("side", [1000, 500, 200, 64])
def test_the_whole_is_reduced(photo: tuple[Path, np.ndarray], built: Path, side: int) -> None:
    found = read_window(built, 0, 0, 2250, 1500, side)
    assert max(found.shape) == side
    honest = np.asarray(Image.fromarray(photo[1]).resize((found.shape[1], found.shape[0]), Image.Resampling.BOX))
    assert np.abs(found.astype(int) - honest).mean() < 4


def test_the_coarsest_level_is_small(built: Path) -> None:
    import json
    import zipfile

    sizes = json.loads(zipfile.ZipFile(built).read("levels.json"))
    assert sizes[0] == [2250, 1500] and max(sizes[-1]) <= SMALLEST < max(sizes[-2])


def test_stopping_leaves_nothing_behind(photo: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    steps = build_pyramid(photo[0], tmp_path / "x.pyramid")
    next(steps)
    steps.close()
    assert not list(tmp_path.iterdir())


def test_what_is_no_photo_or_no_pyramid_is_a_sentence(tmp_path: Path, photo: tuple[Path, np.ndarray]) -> None:
    text = tmp_path / "notes.jpg"
    text.write_text("no photo")
    with pytest.raises(PhotogrammetryError, match=r"notes\.jpg"):
        list(build_pyramid(text, tmp_path / "a.pyramid"))
    damaged = tmp_path / "damaged.jpg"
    Image.fromarray(photo[1][:600, :600]).save(damaged)
    damaged.write_bytes(damaged.read_bytes()[:20_000])
    with pytest.raises(PhotogrammetryError, match="copy it again"):
        list(build_pyramid(damaged, tmp_path / "b.pyramid"))
    wrong = tmp_path / "wrong.pyramid"
    wrong.write_bytes(b"PK no")
    with pytest.raises(Unsupported, match="made anew"):
        read_window(wrong, 0, 0, 10, 10, 10)
