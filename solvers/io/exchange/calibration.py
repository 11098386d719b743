"""Camera calibrations of other tools: OpenCV (YAML, XML, JSON), Pix4D .cam, Australis, DJI DewarpData.

Metashape's is read in metashape.py. What a file does not say (mostly the size of the photos) is asked for.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras.brown import Brown
from ...cameras.foreign import CORNER, from_australis, from_opencv, from_pix4d
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ..files import read_bytes
from ..sniff import read_text
from .options import NOTHING, Reading
from .scene import Camera, Exchange
from .structure import AGAIN, read_json

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
MATRIX_NAMES = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "intrinsic", "intrinsics", "mtx", "M1")
DISTORTION_NAMES = ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "dist_coeffs", "dist_coeff", "distortion",
                    "D",
                    "dist", "D1")
WIDTHS, HEIGHTS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")


def _exchange(kind: str, path: Path, camera: Camera, *notes: str) -> Exchange:
    return Exchange(kind, path, None, {path.stem: camera}, notes=notes)


def _size(path: Path, options: Reading) -> tuple[int, int]:
    if options.size is None:
        raise BadTable(f"{path}: it does not say the size of the photos; give --size WIDTH,HEIGHT")
    return options.size


# -- OpenCV ---------------------------------------------------------------------------------------------------------------


def looks_like_opencv(head: str) -> bool:
    """Whether a text's beginning is OpenCV's FileStorage or a JSON with a camera matrix."""
    known = any(re.search(rf"[\"<\s]?{name}\b", head) for name in MATRIX_NAMES[:4]) or \
        ('"mtx"' in head and '"dist"' in head)
    return known and (head.startswith("%YAML") or "<opencv_storage>" in head or "opencv-matrix" in head
                      or head.lstrip().startswith("{") or re.search(r"^camera_matrix:\s*$", head, re.MULTILINE) is not None)


def read_opencv(path: Path, options: Reading = NOTHING) -> Exchange:
    """Camera matrix and distortion coefficients. Raises BadTable and Unsupported."""
    values = _json(path) if read_text(path).lstrip().startswith("{") and '"type_id"' not in read_text(path) else _storage(path)
    matrix, d = values["matrix"], values["distortion"]
    size = values.get("size") or _size(path, options)
    if matrix is None or matrix.size != 9 or not np.isfinite(matrix).all():
        raise BadTable(f"{path}: there is no camera matrix of 3 x 3 numbers ({', '.join(MATRIX_NAMES[:3])}); {AGAIN}")
    if d is not None and (d.size not in (0, 4, 5, 8, 12, 14) or not np.isfinite(d).all()):
        raise BadTable(f"{path}: there are {d.size} distortion coefficients, expected 4, 5 or 8; {AGAIN}")
    try:
        return _exchange("OpenCV calibration", path, from_opencv(matrix, np.zeros(0) if d is None else d, *size))
    except PhotogrammetryError as error:
        raise type(error)(f"{path}: {error}") from None


def _json(path: Path) -> dict[str, Any]:
    root = read_json(path)

    def first(names: tuple[str, ...], counts: tuple[int, ...]) -> np.ndarray | None:
        item = next((root.get(n) for n in names if root.maybe(n) is not None), None)
        if item is None:
            return None
        item = item.get("data") if isinstance(item.value, dict) else item
        return item.numbers(counts)

    w, h = (next((root.get(n).integer() for n in names if root.maybe(n) is not None), None) for names in (WIDTHS, HEIGHTS))
    return {"matrix": first(MATRIX_NAMES, (9,)), "distortion": first(DISTORTION_NAMES, (0, 4, 5, 8, 12, 14)),
            "size": (w, h) if w and h else None}


def _tagged(text: str) -> str:
    """YAML as OpenCV writes it; ROS's camera_info lacks the first line and the word that a mapping is a matrix."""
    if text.startswith("%YAML") or text.lstrip().startswith(("<", "{")):
        return text
    text = re.sub(r"^(\w+):[ \t]*\n(\s+)rows:", r"\1: !!opencv-matrix\n\2rows:", text, flags=re.MULTILINE)
    text = re.sub(r"^(\s+)(data:)", r"\1dt: d\n\1\2", text, flags=re.MULTILINE) if "dt: d" not in text else text
    return "%YAML:1.0\n---\n" + text


def _storage(path: Path) -> dict[str, Any]:
    """By OpenCV's own reader, from memory."""
    import cv2

    data = read_bytes(path, AGAIN)
    try:
        storage = cv2.FileStorage(_tagged(data.decode("utf-8-sig", "strict")), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)

        def first(names: tuple[str, ...]) -> Any:
            return next((storage.getNode(n) for n in names if not storage.getNode(n).empty()), None)

        matrix, d = first(MATRIX_NAMES), first(DISTORTION_NAMES)
        w, h = (node.real() if (node := first(names)) is not None else 0.0 for names in (WIDTHS, HEIGHTS))
        out = {"matrix": None if matrix is None else matrix.mat(), "distortion": None if d is None else d.mat()}
        storage.release()
    except (cv2.error, SystemError, UnicodeDecodeError, ValueError):
        raise BadTable(f"{path}: this is not a whole file of OpenCV's FileStorage; {AGAIN}") from None
    whole = 1 <= w <= 1e7 and 1 <= h <= 1e7
    return {k: None if v is None else np.asarray(v, float).ravel() for k,
            v in out.items()} | {"size": (round(w), round(h)) if whole
                                                                                               else None}


def write_opencv(camera: Camera) -> tuple[str, tuple[str, ...]]:
    """The YAML text of a calibration as OpenCV's FileStorage reads it, with 5 or 8 coefficients, and notes."""
    from ...cameras.foreign import as_opencv

    matrix, distortion, fit = as_opencv(camera)

    def told(name: str, a: np.ndarray) -> str:
        numbers = ", ".join(f"{v!r}" for v in a.ravel().tolist())
        return f"{name}: !!opencv-matrix\n   rows: {a.shape[0]}\n   cols: {a.shape[1]}\n   dt: d\n   data: [ {numbers} ]\n"

    return (f"%YAML:1.0\n---\nimage_width: {camera.width}\nimage_height: {camera.height}\n" + told("camera_matrix", matrix)
            + told("distortion_coefficients", distortion[None])), fit.told("camera")


# -- Pix4D .cam -----------------------------------------------------------------------------------------------------------


def looks_like_cam(head: str) -> bool:
    """Whether a text's beginning is a Pix4D .cam file."""
    return "Pix4D camera calibration" in head or ("assuming a sensor width" in head
                                                  and re.search(r"^F ", head, re.MULTILINE) is not None)


def read_cam(path: Path, options: Reading = NOTHING) -> Exchange:
    """Focal length and principal point in mm from the top-left corner, on the sensor the file assumes. Raises BadTable."""
    text = read_text(path)
    sensor = re.search(rf"sensor width of\s*({NUMBER})\s*x\s*({NUMBER})\s*mm", text)
    found = {k: float(v) for k, v in re.findall(rf"^\s*(F|Px|Py|K1|K2|K3|T1|T2)\s+({NUMBER})\s*$", text, re.MULTILINE)}
    missing = [k for k in ("F", "Px", "Py") if k not in found]
    if sensor is None or missing:
        raise BadTable(f"{path}: {missing[0] if missing else 'the sensor size'} is missing; {AGAIN}")
    width, height = _size(path, options)
    across = float(sensor[1])
    if across <= 0:
        raise BadTable(f"{path}: the sensor width is {sensor[1]} mm, expected a positive number; {AGAIN}")
    pitch = across / width
    try:
        camera = from_pix4d(found["F"] / pitch, (found["Px"] / pitch, found["Py"] / pitch),
                            [found.get(k, 0.0) for k in ("K1", "K2", "K3")],
                            [found.get(k, 0.0) for k in ("T1", "T2")], width, height, (pitch, pitch))
    except PhotogrammetryError as error:
        raise BadTable(f"{path}: {error}; {AGAIN}") from None
    return _exchange("Pix4D .cam", path, camera)


# -- Australis ------------------------------------------------------------------------------------------------------------

AUSTRALIS = {"c": r"C|c|principal distance", "xp": "XP|xp", "yp": "YP|yp", "k1": "K1", "k2": "K2", "k3": "K3", "p1": "P1",
             "p2": "P2",
             "b1": "B1", "b2": "B2"}


def looks_like_australis(head: str) -> bool:
    """Whether a text's beginning names Australis or iWitness, or lists C, XP, YP and K1."""
    return (bool(re.search(r"australis|iwitness", head, re.IGNORECASE)) and "K1" in head) or \
        all(re.search(rf"^\s*{k}\b", head, re.MULTILINE | re.IGNORECASE) for k in ("C", "XP", "YP", "K1"))


def read_australis(path: Path, options: Reading = NOTHING) -> Exchange:
    """A report of Australis or iWitness: C, XP, YP [mm], K1..K3, P1, P2, B1, B2, sensor size and pixel size. Raises BadTable."""
    text = read_text(path)
    values = _australis_values(text)
    missing = [k.upper() for k in ("c", "xp", "yp") if k not in values]
    if missing:
        raise BadTable(f"{path}: {missing[0]} is missing; write lines such as C 28.9, XP 0.05, YP -0.02, K1 1.2e-4")
    size, pitch = _australis_sensor(text)
    width, height = options.size or size or _size(path, options)
    if pitch is None:
        raise BadTable(f"{path}: the pixel size is missing; write a line such as: Pixel size 0.006 mm")
    if max(pitch) > 0.5:  # micrometres
        pitch = (pitch[0] * 1e-3, pitch[1] * 1e-3)
    try:
        return _exchange("Australis", path, from_australis(values, width, height, pitch))
    except PhotogrammetryError as error:
        raise BadTable(f"{path}: {error}; {AGAIN}") from None


def _australis_values(text: str) -> dict[str, float]:
    """The parameters by name. In a table of initial value, adjustment and final value the final one is meant."""
    rows = {}
    for name, pattern in AUSTRALIS.items():
        found = re.search(rf"^\s*(?:{pattern})\s*[:=]?((?:[ \t]*{NUMBER}(?=\s|$))+)", text, re.MULTILINE)
        if found:
            rows[name] = [float(v) for v in found[1].split()]
    adjusted = [len(v) >= 3 and np.isclose(v[0] + v[1], v[2], rtol=1e-4, atol=1e-9) and v[2] != 0 for v in rows.values()]
    return {k: v[2] if any(adjusted) and len(v) >= 3 else v[0] for k, v in rows.items()}


def _australis_sensor(text: str) -> tuple[tuple[int, int] | None, tuple[float, float] | None]:
    """Width and height [px] and the pixel size as written, None each where not found: in one line, or in rows H and V."""
    table = [re.search(rf"^\s*{k}\s*[:=]?\s*(\d+)\s+({NUMBER})\s*$", text, re.MULTILINE) for k in "HV"]
    if table[0] and table[1]:
        return (int(table[0][1]), int(table[1][1])), (float(table[0][2]), float(table[1][2]))
    whole = r"(?<![\d.,])(\d{2,6})(?![\d.,]*\d)"  # not the millimetres of a sensor
    size = re.search(rf"(?:sensor size|image size|resolution|pixels)[^\d\n]*?{whole}[^\d\n]+?{whole}", text, re.IGNORECASE)
    pixel = re.search(rf"pixel size[^\d\n]*?({NUMBER})(?:[^\d\n]+?({NUMBER}))?", text, re.IGNORECASE)
    return ((int(size[1]), int(size[2])) if size else None), ((float(pixel[1]), float(pixel[2] or pixel[1])) if pixel else None)


def write_australis(camera: Camera) -> tuple[str, tuple[str, ...]]:
    """The text of a calibration as Australis lists it, and notes."""
    from ...cameras.foreign import to_interior

    ours, fit = to_interior(camera)
    rows = [f"{name.upper()} {getattr(ours, name)!r}" for name in ("c", "xp", "yp", "k1", "k2", "k3", "p1", "p2", "b1", "b2")]
    px, py = (float(p) for p in ours.pitch)
    return "\n".join(["Australis camera calibration (mm)", f"Sensor size: {ours.width} x {ours.height}",
                      f"Pixel size: {px!r} x {py!r}",
                      *rows]) + "\n", fit.told("camera")


# -- DJI ------------------------------------------------------------------------------------------------------------------

DEWARP = re.compile(r"DewarpData[\"'>=\s]*([^\"'<]*)")


def dewarp(text: str, width: int, height: int, where: str) -> tuple[Brown, tuple[str, ...]]:
    """The camera of DJI's DewarpData, "date;fx,fy,cx,cy,k1,k2,p1,p2,k3" (cx, cy from the middle). Raises BadTable."""
    date, _, numbers = text.strip().rpartition(";")
    try:
        values = [float(v) for v in numbers.split(",")]
    except ValueError:
        values = []
    if len(values) != 9 or not np.isfinite(values).all():
        raise BadTable(f"{where}: DewarpData is '{text.strip()[:40]}', expected date;fx,fy,cx,cy,k1,k2,p1,p2,k3; take another "
                       f"photo")
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = values
    camera = Brown(fx, fy, width / 2 + cx - CORNER, height / 2 + cy - CORNER, k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, width=width,
                   height=height)
    return camera, (f"DewarpData of {date}",) if date else ()


def read_dewarp(path: Path, options: Reading = NOTHING) -> Exchange:
    """The calibration in the XMP of a DJI photo. Raises Unsupported where there is none."""
    from ..metadata import dewarp_data
    from ..photos import photo_size

    data, flag = dewarp_data(path)
    if data is None:
        raise Unsupported(f"{path}: its XMP has no DewarpData; give another calibration with --camera")
    camera, notes = dewarp(data, *photo_size(path), str(path))
    if flag == 1:
        camera = Brown(camera.fx, camera.fy, camera.cx, camera.cy, width=camera.width, height=camera.height)
        notes = (*notes, "DewarpFlag is 1: the photo is already without distortion, its coefficients are left out")
    return _exchange("DJI DewarpData", path, camera, *notes)
