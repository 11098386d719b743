"""Project folders made of real measurements, oriented by the command line and compared with what others published."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solvers import Block, Image, Interior, Observations, Points
from solvers.cli import main
from solvers.io import read_control, read_project, thumbnail, write_project
from solvers.io.crs import transformed

PITCH = 0.01  # mm; any pitch and a format large enough turn photo millimetres into pixels and back
FORMAT = 23001


def resected(folder: Path, *words: str) -> list[dict[str, Any]]:
    """Orientations that `collinea resect` gives for a project folder."""
    out = folder.parent / f"{folder.name}.json"
    assert main(["resect", str(folder), "--quiet", "--json", str(out), *words]) == 0
    return json.loads(out.read_text())["orientations"]


def textbook(data: Path, name: str, folder: Path, origin: str = "center") -> dict[str, Any]:
    """A worked example as a project folder: control without error, equally weighted photo coordinates."""
    [example] = [e for e in json.loads((data / "textbook" / "resection_examples.json").read_text()) if e["name"] == name]
    table = np.array(example["points_x_y_X_Y_Z"])
    camera = Interior(example["f_mm"], pixel_mm=PITCH, width=FORMAT, height=FORMAT)
    n = len(table)
    write_project(Block(name, "local", {"camera": camera}, (Image("photo", "camera"),),
                        Points(tuple(f"{i + 1}" for i in range(n)), table[:, 2:], np.zeros((n, 3)), ("control",) * n),
                        Observations(np.zeros(n, int), np.arange(n), camera.pixels(table[:, :2]), np.full(n, 1.0))),
                  folder, pixel_origin=origin)
    return example


@pytest.mark.parametrize("origin", ["center", "corner"])
def test_mikhail(data: Path, tmp_path: Path, origin: str) -> None:
    """Mikhail, Bethel & McGlone 2001: to 1 mm and 1e-6 degree of the recomputed values, 2e-5 degree of the published ones."""
    example = textbook(data, "mikhail2001", tmp_path / "p", origin)
    [o] = resected(tmp_path / "p", "--model", "perspective")
    again, printed = example["recomputed"], example["published"]
    np.testing.assert_allclose([o[k] for k in "XYZ"], [again[k + "L"] for k in "XYZ"], atol=1e-3, rtol=0)
    angles = np.array([o[f"{k}_deg"] for k in ("omega", "phi", "kappa")])
    np.testing.assert_allclose(angles, [again[f"{k}_deg"] for k in ("omega", "phi", "kappa")], atol=1e-6, rtol=0)
    np.testing.assert_allclose(angles, np.degrees([printed[f"{k}_rad"] for k in ("omega", "phi", "kappa")]), atol=2e-5, rtol=0)
    np.testing.assert_allclose(o["sigma0"] * PITCH, again["sigma0_mm"], rtol=1e-6)
    np.testing.assert_allclose([o["sigma_scaled"][k] for k in "XYZ"], again["sd_XYZ"], rtol=1e-4)
    np.testing.assert_allclose([o["sigma_scaled"][f"{k}_deg"] for k in ("omega", "phi", "kappa")], again["sd_opk_deg"], rtol=1e-4)
    residuals = np.array([[r["col"], -r["row"]] for r in o["residuals"]]) * -PITCH  # observed minus projected, y down -> theirs
    np.testing.assert_allclose(residuals, again["residuals_calc_minus_obs_mm"], atol=1e-6)


def test_wuhan(data: Path, tmp_path: Path) -> None:
    """Wuhan University's course example, published in the phi omega kappa system: 1 cm and 1e-5 rad after conversion."""
    printed = textbook(data, "whu", tmp_path / "p")["published"]
    [o] = resected(tmp_path / "p", "--model", "perspective")
    np.testing.assert_allclose([o[k] for k in "XYZ"], [printed[k + "s"] for k in "XYZ"], atol=0.01, rtol=0)
    w, p, k = np.radians([o[f"{a}_deg"] for a in ("omega", "phi", "kappa")])
    rx = np.array([[1, 0, 0], [0, np.cos(w), -np.sin(w)], [0, np.sin(w), np.cos(w)]])
    ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    rz = np.array([[np.cos(k), -np.sin(k), 0], [np.sin(k), np.cos(k), 0], [0, 0, 1]])
    r = rx @ ry @ rz  # photo axes -> object axes; theirs is R = Ry(-phi) Rx(omega) Rz(kappa)
    theirs = np.array([np.arctan2(-r[0, 2], r[2, 2]), np.arcsin(-r[1, 2]), np.arctan2(r[1, 0], r[1, 1])])
    np.testing.assert_allclose(theirs, [printed["phi"], printed["omega"], printed["kappa"]], atol=1e-5, rtol=0)


# -- Strasbourg: five aerial photos, full format, nearly coplanar control ---------------------------------------------------

SXB = ("8811", "8936", "8937", "8938", "9111")


@pytest.fixture(scope="module")
def strasbourg(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The five photos with their measured control points; pixels and principal point from the corner of the top-left pixel."""
    source, folder = data / "aerial_sxb", tmp_path_factory.mktemp("sxb") / "sxb"
    control = read_control(source / "sxb-control.txt", "name=Id,X=X,Y=Y,Z=Z,sX=sigmaX,sY=sigmaY,sZ=sigmaZ")
    marks = [line.split(",") for line in (source / "markpts.txt").read_text().splitlines() if not line.startswith("#")]
    index = {name: j for j, name in enumerate(control.names)}
    used = [(int(m[1]) - 1, index[m[0].strip()], float(m[2]) - 0.5, float(m[3]) - 0.5) for m in marks if m[0].strip() in index]
    table = np.array(used)
    x, y = 26.577, 38.811  # mm from the top-left corner
    camera = Interior(123.9392, x - 8858 * 0.003, 12996 * 0.003 - y, pixel_mm=0.006, width=8858, height=12996)
    write_project(Block("Strasbourg", "local", {"rc30": camera}, tuple(Image(n, "rc30", str(source / f"{n}.jpg")) for n in SXB),
                        Points(control.names, control.xyz, control.sigma, control.role),
                        Observations(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:], np.full(len(table), 1.0))),
                  folder, pixel_origin="corner")
    return folder


def test_strasbourg_fits(strasbourg: Path) -> None:
    """Every photo to 1.7 px by the perspective model."""
    orientations = resected(strasbourg, "--model", "perspective")
    assert [o["image"] for o in orientations] == list(SXB)
    for o in orientations:
        assert o["converged"] and o["rms_px"] <= 1.7, (o["image"], o["rms_px"])
        assert 1800 < o["Z"] < 2100


def test_strasbourg_orthogonal(strasbourg: Path) -> None:
    """Over nearly flat control the orthogonal model agrees within its standard errors, or says that it must not be used."""
    orientations = resected(strasbourg)
    assert len(orientations) == 10
    keys = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")
    trusted = 0
    for p, q in zip(orientations[::2], orientations[1::2], strict=True):
        assert q["model"] == "orthogonal" and p["image"] == q["image"]
        if any("do not use" in w for w in q["warnings"]):
            continue
        trusted += 1
        assert q["converged"] and q["rms_px"] < 4, (q["image"], q["rms_px"], q["warnings"])
        assert all(abs(p[k] - q[k]) < 4 * q["sigma"][k] * max(q["sigma0"], 1) for k in keys)
    assert trusted >= 4


def test_strasbourg_thumbnails_are_small_and_quick(strasbourg: Path) -> None:
    """A 115-Mpixel photo becomes a small picture with less memory than a tenth of the photo."""
    import tracemalloc

    path = Path(read_project(strasbourg).images[0].file or "")
    tracemalloc.start()
    small = thumbnail(path, 1024)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert small.pixels.shape == (1024, 698, 3) and small.pixels.std() > 20
    assert small.scale == pytest.approx(698 / 8858) and peak < 8858 * 12996 * 3 / 10


# -- Brazil: four photos of a compact camera, uncalibrated ------------------------------------------------------------------


def test_odm_br_fits(data: Path, tmp_path: Path) -> None:
    """A gcp_list.txt with geodetic GPS: every photo to 3.7 px, near its EXIF position."""
    source = data / "resection_uav_odm_br"
    control = read_control(source / "gcp_list_floatxy_subset.txt")
    assert control.crs is not None and len(control.marks) == 31
    names = sorted({m.image for m in control.marks})
    images, points = {n: i for i, n in enumerate(names)}, {n: j for j, n in enumerate(control.names)}
    camera = Interior(4.5, pixel_mm=4.5 / 2904, width=4000, height=3000)
    m = control.marks
    write_project(Block("br", "EPSG:32722", {"sx260": camera}, tuple(Image(Path(n).stem, "sx260") for n in names),
                        Points(control.names, control.xyz, control.sigma, control.role),
                        Observations(np.array([images[k.image] for k in m]), np.array([points[k.point] for k in m]),
                                     np.array([[k.col, k.row] for k in m]), np.full(len(m), 1.0))), tmp_path / "br")
    positions = {}
    for line in (source / "exif_lalo_4326dms.txt").read_text().splitlines()[1:]:
        lat, lon, name = line.split("\t")
        degrees = [_degrees(v) for v in (lon, lat)]
        positions[Path(name).stem] = transformed(np.array([[*degrees, 0.0]]), "EPSG:4326", "EPSG:32722")[0, :2]
    orientations = resected(tmp_path / "br", "--model", "perspective")
    assert len(orientations) == 4
    for o in orientations:
        assert o["converged"] and o["rms_px"] <= 3.7, (o["image"], o["rms_px"])
        assert np.hypot(*(np.array([o["X"], o["Y"]]) - positions[o["image"]])) < 4.0


def _degrees(text: str) -> float:
    """Degrees of "-25 36 21.73"."""
    d, m, s = (float(part) for part in text.split())
    return float(np.copysign(abs(d) + m / 60 + s / 3600, d))
