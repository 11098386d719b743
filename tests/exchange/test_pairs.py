"""Every format that holds orientations puts a known point at the same pixel, and every pair of formats agrees."""

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from solvers.cameras.brown import Brown
from solvers.io.exchange import registry
from solvers.io.exchange.scene import Exchange

from .scenes import FULL, HANDMADE, MIDDLE, OURS, micmac_folder, opencv_pixels, pixels_of, scene

FILES = {"colmap": "model", "colmap-bin": "model", "opf": "site", "blocks": "block.xml",
         "pix4d": "x_calibrated_camera_parameters.txt",
         "nerfstudio": "transforms.json", "bundler": "bundle.out", "bal": "problem.txt"}
POSES = {"opk": "opk.csv", "opk-metashape": "opk.txt", "opk-pix4d": "opk.txt", "pok": "pok.csv", "opk-gon": "opk.csv",
         "patb": "x.ori"}
WHOLE = ("colmap", "colmap-bin", "opf", "blocks", "pix4d", "nerfstudio")
"""Formats that hold the full camera and are written."""


def through(kind: str, value: Exchange, folder: Path) -> Exchange:
    """Written and read again; orientation-only formats keep the cameras they had."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind in HANDMADE:
        name, write = HANDMADE[kind]
        return registry.read(write(value, folder / name))
    path = folder / (FILES | POSES)[kind]
    write = registry.FORMATS[kind].write
    assert write is not None
    write(value, path)
    found = registry.sniff(path)
    assert registry.FORMATS[found].read is registry.FORMATS[kind].read or found.split("-")[0] == kind.split("-")[0]
    back = registry.read(path)
    return back if len(back.points) else replace(back, points=value.points, observations=value.observations)


def assert_pixels(value: Exchange, truth: Exchange, tolerance: float = 1e-6) -> None:
    """The images by file name see the truth's points at the truth's pixels (by OpenCV)."""
    camera = truth.cameras["lens"]
    named = {s.name: s for s in value.shots}
    for n, shot in enumerate(truth.shots):
        found = named.get(shot.name) or value.shots[n]
        assert shot.exterior is not None and found.exterior is not None
        expected = opencv_pixels(camera, shot.exterior, truth.points.xyz) if isinstance(camera, Brown) else \
            pixels_of(camera, shot, truth.points.xyz)
        own = value.cameras[found.camera] if found.camera is not None else camera
        gap = (own.cx - camera.cx,
               own.cy - camera.cy) if isinstance(own, Brown) and isinstance(camera,
                                                                            Brown) and own.width != camera.width else (0, 0)
        np.testing.assert_allclose((pixels_of(own, found, truth.points.xyz) - gap)[seen(camera, expected)],
                                   expected[seen(camera, expected)], atol=tolerance)


def seen(camera, pixels: np.ndarray) -> np.ndarray:
    rows = camera.inside(pixels)
    assert rows.sum() >= 6
    return rows


@pytest.mark.parametrize("kind", [*WHOLE, *HANDMADE, *POSES])
def test_one_format(tmp_path: Path, kind: str) -> None:
    truth = scene(crs="EPSG:32632" if kind == "shots" else "local")
    assert_pixels(through(kind, truth, tmp_path), truth)


@pytest.mark.parametrize(("a", "b"), [(a, b) for a, b in permutations((*WHOLE, *HANDMADE), 2) if b in WHOLE])
def test_pairs(tmp_path: Path, a: str, b: str) -> None:
    truth = scene(FULL, "EPSG:32632" if a == "shots" else "local")
    first = through(a, truth, tmp_path / "a")
    assert_pixels(through(b, first, tmp_path / "b"), truth)


@pytest.mark.parametrize(("a", "b"), [*permutations((*WHOLE, "bundler", "bal"), 2)])
def test_pairs_with_the_camera_that_all_hold(tmp_path: Path, a: str, b: str) -> None:
    truth = scene(MIDDLE)
    assert_pixels(through(b, through(a, truth, tmp_path / "a"), tmp_path / "b"), truth)


@pytest.mark.parametrize(("a", "b"), [*permutations(POSES, 2)])
def test_pairs_of_angles(tmp_path: Path, a: str, b: str) -> None:
    truth = scene()
    assert_pixels(through(b, through(a, truth, tmp_path / "a"), tmp_path / "b"), truth)


def test_micmac_corrects_measured_pixels_as_we_do(tmp_path: Path) -> None:
    truth = scene(OURS)
    value = registry.read(micmac_folder(truth, tmp_path / "Ori-Rel"))
    assert value.kind == "MicMac" and not value.notes
    assert_pixels(value, truth)


@pytest.mark.parametrize("kind", WHOLE)
def test_the_other_direction_is_refitted_and_told(tmp_path: Path, kind: str) -> None:
    truth = scene(OURS)
    write = registry.FORMATS[kind].write
    assert write is not None
    notes = write(truth, tmp_path / FILES[kind])
    [told] = [n for n in notes if "refitted" in n]
    most = float(told.split("at most ")[1].split()[0])
    assert 1e-6 <= most < 0.05
    value = registry.read(tmp_path / FILES[kind])
    assert_pixels(value, truth, most * 1.05)
