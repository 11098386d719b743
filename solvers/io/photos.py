"""Photos: where they are, how large they are, and small pictures of very large ones without holding them whole."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np

from ..block import Block
from ..errors import BadProject, Unsupported
from .files import write_atomic

EXTENSIONS = (".jpg", ".jpeg", ".tif", ".tiff", ".png")


class Thumbnail(NamedTuple):
    """A photo made smaller: pixels uint8 (h, w, 3) and scale = w / photo width <= 1.

    A photo pixel (col, row) lies at ((col + 0.5) * scale - 0.5, (row + 0.5) * scale - 0.5), to half a small pixel.
    """

    pixels: np.ndarray
    scale: float


def photo_path(folder: Path | str, block: Block, image: str) -> Path:
    """The photo file of an image, absolute or inside the project folder.

    Raises BadProject when the image has no file, when a relative path leaves the folder, or when the photo is missing.
    """
    return _found(Path(folder), block, image)


def check_photos(folder: Path | str, block: Block, images: tuple[str, ...] | None = None) -> None:
    """Raises BadProject when a photo named in project.toml is missing, unreadable or of another shape than its camera says."""
    for image in block.images:
        if image.file is None or (images is not None and image.name not in images):
            continue
        path, camera = _found(Path(folder), block, image.name), block.camera_of(image.name)
        width, height = photo_size(path)
        if abs(width * camera.height - height * camera.width) > 0.01 * width * camera.height:
            raise BadProject(f"{Path(folder) / 'project.toml'} [cameras.{image.camera}] width, height: {camera.width} x "
                             f"{camera.height} pixels do not "
                             f"have the shape of {path.name}, which has {width} x {height}; correct them or name the right photo")


def photo_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels, as stored (an EXIF orientation is not applied). Raises Unsupported."""
    with opened(path) as photo:
        return photo.size


def thumbnail(path: Path | str, max_side: int, cache: Path | str | None = None) -> Thumbnail:
    """A photo with its longer side at most `max_side` pixels, decoded small: a 115-Mpixel JPEG takes about 10 MB.

    cache: a folder where the result is kept as PNG, found again while the photo is unchanged.
    Raises Unsupported for files that are no photos.
    """
    path = Path(path)
    kept = None if cache is None else Path(cache) / f"{_key(path, max_side)}.png"
    width = photo_size(path)[0]
    if kept is not None and kept.exists():
        with opened(kept) as photo:
            pixels = np.asarray(photo.convert("RGB"))
    else:
        pixels = _decode(path, max_side)
        if kept is not None:
            _keep(kept, pixels)
    return Thumbnail(pixels, pixels.shape[1] / width)


def photo_window(path: Path | str, col: int, row: int, width: int, height: int) -> np.ndarray:
    """Full-resolution pixels uint8 (height, width, 3) from column `col` and row `row`; black beyond the photo's edge."""
    with _raster(Path(path)) as data:
        from rasterio.windows import Window

        left, top = max(col, 0), max(row, 0)
        right, bottom = min(col + width, data.width), min(row + height, data.height)
        out = np.zeros((height, width, 3), np.uint8)
        if right > left and bottom > top:
            part = data.read(_bands(data), window=Window.from_slices((top, bottom), (left, right)))
            out[top - row:bottom - row, left - col:right - col] = _eight_bits(part, data.dtypes[0])
        return out


def photo_values(path: Path | str, col: int, row: int, width: int, height: int) -> np.ndarray:
    """Part of a photo as it is stored, in its own depth: (height, width) grey or (height, width, 3) colour values.

    The part must lie within the photo. Raises Unsupported.
    """
    with _raster(Path(path)) as data:
        from rasterio.windows import Window

        bands = [1, 2, 3] if data.count >= 3 else [1]
        part = data.read(bands, window=Window(int(col), int(row), int(width), int(height)))  # type: ignore[call-arg]
        return np.ascontiguousarray(np.moveaxis(part, 0, -1) if len(bands) == 3 else part[0])


def read_photo(path: Path, grey: bool = True) -> np.ndarray:
    """A whole photo at full resolution: uint8 (h, w) grey or (h, w, 3) colour values. Raises Unsupported."""
    with opened(path) as photo:
        if min(photo.size) < 2:
            raise Unsupported(f"{path}: {photo.width} x {photo.height} pixels show nothing that could be measured; give the "
                              "whole photo")
        if photo.mode in ("1", "L", "P", "RGB", "RGBA", "YCbCr", "CMYK"):
            try:
                if grey:
                    photo.draft("L", photo.size)  # a JPEG is decoded to its brightness at once, a quarter of the memory
                mode = "L" if grey else "RGB"
                return np.asarray(photo if photo.mode == mode else photo.convert(mode))
            except OSError as error:
                raise Unsupported(f"{path}: the photo is damaged ({error}); copy it again") from None
        width, height = photo.size
    pixels = photo_window(path, 0, 0, width, height)
    return np.round(pixels.mean(2)).astype(np.uint8) if grey else pixels


def colours(path: Path) -> np.ndarray:
    """`read_photo` in colours, by the quicker decoder where the photo is a plain JPEG: uint8 (h, w, 3)."""
    import cv2

    with opened(path) as photo:
        plain, size = photo.format in ("JPEG", "MPO") and photo.mode in ("RGB", "L"), photo.size
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if plain else None
    if image is None or image.shape[1::-1] != size:
        return read_photo(path, grey=False)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=image))


def photo_rows(path: Path, rows: int = 256) -> Iterator[np.ndarray]:
    """A whole photo strip by strip, uint8 (<= rows, w, 3), for photos too large to be held."""
    with _raster(path) as data:
        from rasterio.enums import Resampling
        from rasterio.windows import Window

        small = None if data.dtypes[0] == "uint8" else data.read(
            _bands(data), out_shape=(3, min(data.height, 1000), min(data.width, 1000)), resampling=Resampling.nearest)
        low, high = (0.0, 255.0) if small is None else np.percentile(small, [1, 99])
        for top in range(0, data.height, rows):
            strip = data.read(_bands(data), window=Window.from_slices((top, min(top + rows, data.height)), (0, data.width)))
            picture = np.moveaxis(strip, 0, -1)
            scaled = picture if small is None else np.clip((picture - low) * (255.0 / max(high - low, 1e-9)), 0, 255)
            yield scaled.astype(np.uint8)


def photo_state(path: Path) -> str:
    """A word that changes when the photo's file does."""
    state = path.stat()
    return f"{state.st_size}-{state.st_mtime_ns}"


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A photo opened with Pillow, whatever its size, metadata only until asked. Raises Unsupported."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # aerial photos are that large
            with open(path, "rb") as stream, Image.open(stream) as photo:
                yield photo
    except Image.DecompressionBombError:
        raise Unsupported(f"{path}: the photo has more than {2 * (Image.MAX_IMAGE_PIXELS or 0) / 1e6:.0f} Mpixel; "
                          "save it as tiles or at a lower resolution") from None
    except UnidentifiedImageError:
        raise Unsupported(f"{path}: this is not a photo that can be read; save it as JPEG, TIFF or PNG") from None
    except FileNotFoundError:
        raise BadProject(f"{path}: there is no such photo; correct the path") from None


def surface_path(folder: Path | str, block: Block) -> Path | None:
    """The height grid of a project, None without one. Raises BadProject as `photo_path` does."""
    file = block.surface.get("file")
    where = f"{Path(folder) / 'project.toml'} [surface] file"
    return None if file is None else _inside(Path(folder), file, where, "height grid")


def write_image(path: Path, pixels: np.ndarray, quality: int = 88) -> None:
    """Write pixels uint8 (h, w, 3) as JPEG (or PNG by the ending), atomically; makes the folder."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    kind = "PNG" if path.suffix.lower() == ".png" else "JPEG"
    write_atomic(path, lambda stream: Image.fromarray(pixels).save(stream, kind, quality=quality, optimize=True))


def _found(folder: Path, block: Block, name: str) -> Path:
    file = block.images[block.image_index(name)].file
    where = f"{folder / 'project.toml'} [images.{name}] file"
    if file is None:
        raise BadProject(f"{where}: image '{name}' has no photo; write file = \"images/{name}.jpg\"")
    return _inside(folder, file, where, "photo")


def _inside(folder: Path, file: str, where: str, what: str) -> Path:
    """A file of a project by its absolute path or inside the folder. Raises BadProject for escapes and missing files."""
    absolute = Path(file).is_absolute()
    if not absolute and ".." in (*PurePosixPath(file).parts, *PureWindowsPath(file).parts):
        raise BadProject(f"{where}: '{file}' leaves the project folder; write the absolute path or move the {what} into the "
                         "folder")
    path = Path(file) if absolute else folder / file
    if not path.is_file():
        raise BadProject(f"{where}: there is no {what} '{file}'; put it there, correct the path, or remove the line to work "
                         "without it")
    return path


def _decode(path: Path, max_side: int) -> np.ndarray:
    with opened(path) as photo:
        width, height = photo.size
        factor = min(1.0, max_side / max(width, height))
        size = max(1, round(width * factor)), max(1, round(height * factor))
        if photo.format == "JPEG":
            photo.draft("RGB", size)  # the decoder itself leaves out detail: at most twice the wanted size is ever in memory
            try:
                return np.asarray(photo.convert("RGB").resize(size, resample=3, reducing_gap=2.0))
            except OSError as error:
                raise Unsupported(f"{path}: the photo is damaged ({error}); copy it again") from None
    with _raster(path) as data:
        from rasterio.enums import Resampling

        part = data.read(_bands(data), out_shape=(len(_bands(data)), size[1], size[0]), resampling=Resampling.average)
        return _eight_bits(part, data.dtypes[0])


@contextmanager
def _raster(path: Path) -> Iterator[Any]:
    """A photo opened with rasterio, which reads windows and reduced pictures without the whole. Raises Unsupported."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as data:
                yield data
    except RasterioIOError as error:
        raise Unsupported(f"{path}: the photo cannot be read ({' '.join(str(error).split())}); copy it again") from None


def _bands(data: Any) -> list[int]:
    return [1, 2, 3] if data.count >= 3 else [1, 1, 1]


def _eight_bits(bands: np.ndarray, kind: str) -> np.ndarray:
    """uint8 (h, w, 3) of bands (3, h, w); other depths are stretched between their 1 % and 99 % values."""
    picture = np.moveaxis(bands, 0, -1)
    if kind == "uint8":
        return np.ascontiguousarray(picture)
    low, high = np.percentile(picture, [1, 99])
    return np.clip((picture - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)


def _key(path: Path, max_side: int) -> str:
    state = path.stat()
    text = f"{path.resolve()}|{state.st_size}|{state.st_mtime_ns}|{max_side}"
    return hashlib.sha256(os.fsencode(text)).hexdigest()[:24]


def _keep(path: Path, pixels: np.ndarray) -> None:
    from PIL import Image

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, lambda stream: Image.fromarray(pixels).save(stream, "PNG", compress_level=1))
    except OSError:
        return  # a folder that cannot be written only means that nothing is kept for the next time
