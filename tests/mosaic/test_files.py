"""Mosaics as files: read by GDAL, right to the pixel, resumed after a kill, whole or not there; threads and clusters alike."""

import errno
import importlib.util
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import workflows_compose
from solvers.errors import BadProject, Unsupported
from solvers.geometry import LocalFrame
from solvers.io import TileFolder, write_image
from solvers.mosaic import Registration
from solvers.workflows_compose import ComposeRequest, compose_photos

from .land import CAMERA, FLAT, FRAME, Album, offset, strip

PHOTOS = strip(3)


def registration(frame: LocalFrame = FRAME) -> Registration:
    from solvers.adjustment import Trace

    return Registration("exterior", "controlled", "simultaneous", tuple(p.name for p in PHOTOS), (CAMERA,) * 3, None,
                        tuple(p.exterior for p in PHOTOS if p.exterior is not None), np.zeros(3), frame, "m",
                        np.zeros((3, 6, 6)), np.zeros(3), 0.1, Trace((), {}))


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    folder, album = tmp_path_factory.mktemp("photos"), Album(PHOTOS, FLAT)
    for name, picture in album.pictures.items():
        write_image(folder / f"{name}.png", picture)
    return {name: folder / f"{name}.png" for name in album.pictures}


FINE = ComposeRequest(gsd=0.06)  # 3 x 2 tiles and more


def made(out: Path, files: dict[str, Path], request: ComposeRequest = FINE) -> dict:
    return compose_photos(registration(), files, out, request)


@pytest.fixture(scope="module")
def whole(files, tmp_path_factory) -> tuple[Path, dict]:
    out = tmp_path_factory.mktemp("whole") / "m.tif"
    return out, made(out, files)


def test_gdal_reads_it_and_a_pixel_is_where_its_coordinates_say(whole):
    import rasterio

    out, said = whole
    with rasterio.open(out) as data:
        assert (data.width, data.height, data.count) == (said["width"], said["height"], 4)
        assert tuple(data.bounds) == pytest.approx(said["bounds"]) and data.transform.a == said["gsd"] == 0.06
        assert data.colorinterp[3].name == "alpha" and data.overviews(1)[:2] == [2, 4]
        assert data.block_shapes[0] == (512, 512) and data.crs is None
        rgba = np.moveaxis(data.read(), 0, -1)
        col, row = np.meshgrid(np.arange(0, data.width, 7), np.arange(0, data.height, 7))
        x, y = data.xy(row.ravel(), col.ravel())  # GDAL's own idea of the pixel centres
        at = np.stack([np.reshape(x, col.shape), np.reshape(y, col.shape)], -1)
    with rasterio.open(out, overview_level=0) as data:
        small = np.moveaxis(data.read(), 0, -1)[:rgba.shape[0] // 2, :rgba.shape[1] // 2]
    values = rgba[::7, ::7]
    seen = values[..., 3] == 255
    assert np.abs(offset(values[..., :3].astype(float), at, seen, 0.06)).max() < 0.1
    assert (rgba[rgba[..., 3] == 0] == 0).all()
    h, w = small.shape[:2]
    four = rgba[:2 * h, :2 * w].reshape(h, 2, w, 2, 4).astype(float)
    inner = (four[..., 3] == 255).all(axis=(1, 3))
    assert np.abs(four.mean(axis=(1, 3)) - small)[inner].max() <= 0.51  # the overview is the mean of four


def cloud_optimized(path: Path) -> int:
    """Checks the layout that readers over a network need; gives the number of overviews: directories first, largest resolution
    first, then blocks, smallest overview first, whole resolution last, nothing but blocks."""
    import rasterio

    with rasterio.open(path) as data:
        count, last, end = len(data.overviews(1)), 0, None
        for k in range(-1, count):
            level = {} if k < 0 else {"ovr": k}
            at = int(data.get_tag_item("IFD_OFFSET", "TIFF", 1, **level))
            assert at > last and (k >= 0 or at in (8, 16))
            last = at
        for k in range(-1, count):
            level = {} if k < 0 else {"ovr": k}
            first = min(int(o) for r in range(9) for c in range(9)
                        if (o := data.get_tag_item(f"BLOCK_OFFSET_{c}_{r}", "TIFF", 1, **level)) is not None and int(o) > 0)
            assert first > last and (end is None or first <= end)
            end = first
        assert all(shape == (512, 512) for shape in data.block_shapes)
        return count


@pytest.fixture(scope="module")
def coded(files, tmp_path_factory) -> dict[str, Path]:
    folder, frame = tmp_path_factory.mktemp("coded"), LocalFrame(FRAME.origin, "EPSG:32632")
    for name, how in {"alpha": ComposeRequest(), "jpeg": ComposeRequest(compression="jpeg"), "nodata": ComposeRequest(nodata=90),
                      }.items():
        compose_photos(registration(frame), files, folder / f"{name}.tif", replace(how, gsd=0.12))
    return {name: folder / f"{name}.tif" for name in ("alpha", "jpeg", "nodata")}


def test_alpha_mask_and_nodata_say_the_same_and_all_files_are_cloud_optimized(coded):
    import rasterio

    with rasterio.open(coded["alpha"]) as data:
        rgba, seen = data.read(), data.read(4) > 0
    assert 0.1 < seen.mean() < 0.99
    for name, path in coded.items():
        assert cloud_optimized(path) == 2
        with rasterio.open(path) as data:
            assert data.count == (4 if name == "alpha" else 3)
            assert ((data.dataset_mask() > 0) == seen).all()
            off = np.abs(data.read((1, 2, 3)).astype(int) - rgba[:3])[:, seen]
            assert off.mean() < 2.5 if name == "jpeg" else off.max() <= (0 if name == "alpha" else 1)
            assert data.nodata == (90 if name == "nodata" else None)
            if name == "nodata":
                assert (data.read()[:, ~seen] == 90).all() and (data.read_masks()[:, seen] > 0).all()
        with rasterio.open(path, overview_level=0) as small:
            assert (small.dataset_mask() > 0).mean() == pytest.approx(seen.mean(), abs=0.01)
    assert coded["jpeg"].stat().st_size < coded["alpha"].stat().st_size / 4


@pytest.mark.skipif(shutil.which("gdalinfo") is None, reason="gdalinfo (gdal-bin) is not installed")
def test_gdalinfo_reads_them(coded):
    for name, path in coded.items():
        done = subprocess.run(["gdalinfo", "-json", "-checksum", str(path)], capture_output=True, text=True, check=True)
        said = json.loads(done.stdout)
        assert not done.stderr and said["driverShortName"] == "GTiff" and 'ID["EPSG",32632]' in said["coordinateSystem"]["wkt"]
        bands = said["bands"]
        assert [b["colorInterpretation"] for b in bands] == ["Red", "Green", "Blue", "Alpha"][:len(bands)]
        assert all(b["block"] == [512, 512] and len(b["overviews"]) == 2 for b in bands)
        assert said["geoTransform"][1] == 0.12 and (bands[0].get("noDataValue") == 90) == (name == "nodata")
        if name == "jpeg":
            assert bands[0]["mask"]["flags"] == ["PER_DATASET"]
            assert said["metadata"]["IMAGE_STRUCTURE"]["COMPRESSION"] == "YCbCr JPEG"


def test_crs_world_file_and_outlines(files, tmp_path):
    import rasterio

    frame = LocalFrame(FRAME.origin, "EPSG:32632")
    out = tmp_path / "utm.tif"
    said = compose_photos(registration(frame), files, out, ComposeRequest(blend="multiband", seams=True, gain=True))
    with rasterio.open(out) as data:
        assert data.crs.to_epsg() == 32632 and data.tags()["AREA_OR_POINT"] == "Area"
        world = [float(line) for line in (tmp_path / "utm.tfw").read_text().split()]
        assert world == pytest.approx([data.transform.a, 0, 0, data.transform.e, *data.xy(0, 0)])
    for kind in ("footprints", "seams"):
        areas = json.loads((tmp_path / f"utm.{kind}.geojson").read_text())["features"]
        assert {a["properties"]["image"] for a in areas} == {"p0", "p1", "p2"}
        lon, lat = np.array(areas[0]["geometry"]["coordinates"][0]).T
        assert np.allclose(lon, 9.0, atol=0.01) and np.allclose(lat, 46.95, atol=0.05)
    assert said["seams"]["places"] > 3 and said["seam_rms"] < 0.15
    assert said["gain"]["rms_after"] <= said["gain"]["rms_before"]


@pytest.mark.parametrize("name", ["m.png", "m.jpg"])
def test_pictures_tell_their_scale(files, tmp_path, name):
    from PIL import Image

    said = made(tmp_path / name, files, ComposeRequest(gsd=0.25))
    with Image.open(tmp_path / name) as picture:
        assert picture.size == (said["width"], said["height"])
        told = picture.info.get("Description") or picture.info["comment"].decode()
        assert told == "1 px = 0.25 m"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "m.footprints.geojson", f"m.{name[2]}gw"])


def test_an_interrupted_work_repeats_no_finished_tile(files, whole, tmp_path, monkeypatch):
    out, total = tmp_path / "m.tif", whole[1]["tiles"]
    real, count = workflows_compose.make_tile, []

    def killed(job, store, coding):
        if len(count) == 3:
            raise KeyboardInterrupt
        count.append(job.index)
        return real(job, store, coding)

    monkeypatch.setattr(workflows_compose, "make_tile", killed)
    with pytest.raises(KeyboardInterrupt):
        made(out, files)
    assert not out.exists() and len(list(tmp_path.glob(".m.tif.parts/*.tile"))) == 3
    spoiled = max(tmp_path.glob(".m.tif.parts/*.tile"))
    spoiled.write_bytes(spoiled.read_bytes()[:-1])  # half-written by a dying machine: done again
    again = []
    monkeypatch.setattr(workflows_compose, "make_tile", lambda job, store, coding: (
        again.append(job.index), real(job, store, coding))[1])
    said = made(out, files)
    assert said["tiles_kept"] == 2 and len(again) == total - 2 and not set(again) & (set(count) - {int(spoiled.stem)})
    assert out.read_bytes() == whole[0].read_bytes()
    assert not (tmp_path / ".m.tif.parts").exists()


def test_other_photos_or_options_begin_anew(files, tmp_path):
    folder = TileFolder(tmp_path / "x.tif", "one plan")
    folder.open()
    (folder.folder / "0000001.tile").write_bytes(b"{}")
    folder.release()
    assert TileFolder(tmp_path / "x.tif", "another").open() == frozenset()
    assert not (folder.folder / "0000001.tile").exists()


@pytest.mark.skipif(importlib.util.find_spec("fcntl") is None, reason="no such locks on this system")
def test_two_runs_do_not_make_one_mosaic_at_once(files, whole, tmp_path):
    one = TileFolder(tmp_path / "m.tif", "a plan")
    one.open()
    with pytest.raises(BadProject, match="another run is making"):
        made(tmp_path / "m.tif", files)
    one.release()
    made(tmp_path / "m.tif", files)
    assert (tmp_path / "m.tif").read_bytes() == whole[0].read_bytes()


def test_a_full_disk_is_named_and_nothing_half_written_stays(files, tmp_path, monkeypatch):
    real, kept = TileFolder.keep, []

    def keep(self, part):
        if len(kept) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        kept.append(part.number)
        real(self, part)

    monkeypatch.setattr(TileFolder, "keep", keep)
    with pytest.raises(Unsupported, match=r"m\.tif: the disk is full .* 2 of \d+ tiles are kept"):
        made(tmp_path / "m.tif", files)
    assert [p.name for p in tmp_path.iterdir()] == [".m.tif.parts"]
    monkeypatch.undo()
    assert made(tmp_path / "m.tif", files)["tiles_kept"] == 2


def test_threads_give_the_same_file(files, whole, tmp_path):
    made(tmp_path / "m.tif", files, ComposeRequest(gsd=0.06, workers=3))
    assert (tmp_path / "m.tif").read_bytes() == whole[0].read_bytes()


def test_bad_outputs_are_named(files, tmp_path):
    with pytest.raises(Unsupported, match=r"\.tif, \.png or \.jpg"):
        made(tmp_path / "m.gif", files)
    with pytest.raises(BadProject, match="no such folder"):
        made(tmp_path / "none" / "m.tif", files)
    for wrong, said in ((ComposeRequest(nodata=300), "0 to 255"),
                        (ComposeRequest(nodata=0, compression="jpeg"), "leave --nodata out")):
        with pytest.raises(BadProject, match=said):
            made(tmp_path / "m.tif", files, wrong)
    with pytest.raises(Unsupported, match=r"for \.tif"):
        made(tmp_path / "m.png", files, ComposeRequest(nodata=0))
    with pytest.raises(BadProject, match="no such height grid"):
        made(tmp_path / "m.tif", files, ComposeRequest(surface=str(tmp_path / "dem.tif")))


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask.distributed is not installed")
def test_on_a_cluster_with_a_worker_killed_it_is_the_same_file(files, whole, tmp_path):
    import os
    import signal
    from typing import Any

    from distributed import LocalCluster

    out = tmp_path / "m.tif"
    local: Any = LocalCluster
    with local(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        killed = []

        def report(at):
            if not killed:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        compose_photos(registration(), files, out, ComposeRequest(gsd=0.06, scheduler=cluster.scheduler_address), report)
    assert killed and out.read_bytes() == whole[0].read_bytes()
