"""What a format holds comes back to 1e-9: orientations, cameras, points, measurements."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solvers.cameras.brown import Brown
from solvers.io.exchange import registry
from solvers.io.exchange.drawing import read_dxf_lines, read_world, write_dxf, write_world
from solvers.io.exchange.scene import Exchange, named

from .scenes import FULL, MIDDLE, OURS, scene

PLACES = {"local": np.array([12.5, -40.25, 7.0]), "UTM": np.array([684_210.125, 5_334_100.3, 412.7]),
          "UTM south": np.array([333_210.7, 9_834_100.1, 1412.3])}
NEAR = PLACES["local"]
FILES = {"colmap": "m", "colmap-bin": "m", "opf": "m", "blocks": "b.xml", "pix4d": "x_calibrated_camera_parameters.txt",
         "nerfstudio": "transforms.json", "bundler": "bundle.out", "bal": "p.txt", "opk": "o.csv", "opk-metashape": "o.txt",
         "opk-pix4d": "o.txt", "pok": "o.csv", "opk-gon": "o.csv", "patb": "o.ori", "gcp": "g.csv", "gcp-odm": "gcp_list.txt",
         "gcp-geojson": "g.geojson", "metashape-csv": "m.csv"}


def back(kind: str, value: Exchange, folder: Path) -> Exchange:
    write = registry.FORMATS[kind].write
    assert write is not None
    write(value, folder / FILES[kind])
    return registry.read(folder / FILES[kind])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", [k for k in FILES if "orientations" in registry.FORMATS[k].holds])
def test_orientations(tmp_path: Path, kind: str, place: str) -> None:
    """To 1e-9 m also at map coordinates, where formats store t = -R C."""
    truth = scene(MIDDLE if kind in ("bundler", "bal") else FULL, origin=PLACES[place])
    value = back(kind, truth, tmp_path)
    assert len(value.oriented) == 4
    for a, b in zip(truth.shots, value.shots, strict=True):
        assert a.exterior is not None and b.exterior is not None
        np.testing.assert_allclose(b.exterior.centre, a.exterior.centre, rtol=0, atol=1e-9)
        np.testing.assert_allclose(b.exterior.m, a.exterior.m, rtol=0, atol=1e-9)
        assert a.name == b.name or kind in ("bal",)


@pytest.mark.parametrize("kind", [k for k in FILES if "cameras" in registry.FORMATS[k].holds])
def test_cameras(tmp_path: Path, kind: str) -> None:
    truth = scene(MIDDLE if kind in ("bundler", "bal") else FULL, origin=NEAR)
    [camera] = back(kind, truth, tmp_path).cameras.values()
    own = truth.cameras["lens"]
    assert isinstance(camera, Brown) and isinstance(own, Brown)
    for name in ("fx", "fy", "k1", "k2", "k3", "p1", "p2",
                 *(() if kind in ("bundler", "bal") else ("cx", "cy", "width", "height"))):
        assert getattr(camera, name) == pytest.approx(getattr(own, name), abs=1e-9, rel=0), name


@pytest.mark.parametrize("place", ["local", "UTM south"])
@pytest.mark.parametrize("kind", ["colmap", "colmap-bin", "blocks", "bundler", "bal", "opf", "gcp"])
def test_points_and_measurements(tmp_path: Path, kind: str, place: str) -> None:
    truth = scene(MIDDLE if kind in ("bundler", "bal") else FULL, origin=PLACES[place])
    value = back(kind, truth, tmp_path)
    own, other = (_marks(v) for v in (truth, value))
    kept = {k: v for k, v in own.items() if kind != "opf" or k[1] in {x for _, x in other}}
    assert len(kept) == len(other) > 15
    half = np.array([value.cameras[c].width - 5472 if value.cameras else 0 for c in list(value.cameras)[:1]] + [0])[0]
    gap = (half / 2, (next(iter(value.cameras.values())).height - 3648) / 2 if half else 0.0)
    for key, (pixel, xyz) in kept.items():
        found = min(other.values(), key=lambda v: np.abs(v[1] - xyz).max() + np.abs(v[0] - gap - pixel).max())
        np.testing.assert_allclose(found[0] - gap, pixel, rtol=0, atol=1e-9, err_msg=str(key))
        np.testing.assert_allclose(found[1], xyz, rtol=0, atol=1e-9)


def _marks(v: Exchange) -> dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]:
    of = v.observations
    return {(v.shots[i].name, v.points.names[j]): (p, v.points.xyz[j]) for i, j,
            p in zip(of.image, of.point, of.pixel, strict=True)
            if np.isfinite(v.points.xyz[j]).all()}


def test_roles_and_sigmas_stay(tmp_path: Path) -> None:
    truth = scene(origin=NEAR)
    for kind in ("blocks", "opf", "gcp"):
        (tmp_path / kind).mkdir()
        value = back(kind, truth, tmp_path / kind)
        roles = dict(zip(value.points.names, value.points.role, strict=True))
        sigmas = dict(zip(value.points.names, value.points.sigma, strict=True))
        assert roles["P1"] == "control" and roles["P2"] == "check"
        np.testing.assert_allclose(sigmas["P1"], [0.02, 0.02, 0.03])


@pytest.mark.parametrize("kind", ["metashape-csv", "gcp-odm", "gcp-geojson", "gcp-pix4dmatic", "gcp"])
def test_control_lists(tmp_path: Path, kind: str) -> None:
    """Every control point with its name, coordinates to 1e-9 m and, where the format has them, sigmas."""
    truth = scene(crs="EPSG:32632")
    write = registry.FORMATS[kind].write
    assert write is not None
    path = tmp_path / FILES.get(kind, "p.csv")
    write(truth, path)
    value = registry.read(path, kind, registry.Reading(crs="EPSG:32632"))
    own, other = (dict(zip(v.points.names, v.points.xyz, strict=True)) for v in (truth, value))
    assert len(other) >= 8 and set(other) <= set(own)
    for name, xyz in other.items():
        np.testing.assert_allclose(xyz, own[name], rtol=0, atol=1e-9)
    if kind != "gcp-odm":
        np.testing.assert_allclose(value.points.sigma[0], [0.02, 0.02, 0.03])


def test_a_list_with_a_crs(tmp_path: Path) -> None:
    truth = scene(crs="EPSG:32632")
    for kind in ("gcp-odm", "gcp-geojson", "qgis", "gcp-pix4dmatic"):
        path = tmp_path / {"qgis": "DSC01.points", "gcp-pix4dmatic": "p.csv"}.get(kind, FILES.get(kind, ""))
        write = registry.FORMATS[kind].write
        assert write is not None
        write(truth, path)
        value = registry.read(path, kind, registry.Reading(crs="EPSG:32632"))
        assert value.crs == "EPSG:32632" and len(value.points) >= 6
        first = truth.points.xyz[0]
        gap = np.abs(value.points.xyz - first)[:, :2].max(axis=1).min()
        assert gap < 1e-9


def test_world_files_and_drawings(tmp_path: Path) -> None:
    affine = (0.033, 0.0012, 679333.3, 0.0013, -0.0331, 9123675.1)
    write_world(tmp_path / "a.jgw", affine)
    lines = (tmp_path / "a.jgw").read_text().split()
    assert float(lines[4]) == pytest.approx(679333.3 + (0.033 + 0.0012) / 2, abs=1e-9)  # the centre of the first pixel
    np.testing.assert_allclose(read_world(tmp_path / "a.jgw"), affine, atol=1e-9)
    line = np.array([[1.5, 2, 3], [4, 5.25, 6], [7, 8, 9.125]])
    write_dxf(tmp_path / "a.dxf", {"edges": [("a", line, False), ("b", line[::-1], True)]}, {"control": [("P1", line[0])]})
    found = read_dxf_lines(tmp_path / "a.dxf")["EDGES"]
    np.testing.assert_array_equal(found[0], line)
    assert "P1" in (tmp_path / "a.dxf").read_text()


def test_glb_is_read_by_another_library(tmp_path: Path) -> None:
    import trimesh

    truth = scene(OURS)
    write = registry.FORMATS["glb"].write
    assert write is not None
    notes = write(truth, tmp_path / "s.glb")
    loaded: Any = trimesh.load(tmp_path / "s.glb")
    assert {"DSC01", "control", "tie"} <= set(loaded.geometry)
    origin = np.array([float(v) for v in notes[0].split(": ")[1].split(" (")[0].split(", ")])
    y_up = np.asarray(loaded.geometry["control"].vertices)
    own = truth.points.xyz[[r == "control" for r in truth.points.role]] - origin
    np.testing.assert_allclose(y_up, own[:, [0, 2, 1]] * [1, 1, -1], atol=1e-3)


def test_names_of_photos() -> None:
    assert named(["a/b/DSC1.JPG", "C:\\x\\DSC2.jpg", "plain"]) == [("DSC1", "a/b/DSC1.JPG"), ("DSC2", "C:\\x\\DSC2.jpg"),
                                                                    ("plain", None)]
    assert [n for n, _ in named(["a/x.jpg", "b/x.jpg"])] == ["a_x.jpg", "b_x.jpg"]
    assert [n for n, _ in named(["x.jpg", "x.tif"])] == ["x.jpg", "x.tif"]
