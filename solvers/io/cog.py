"""Mosaics written tile by tile as cloud-optimized GeoTIFF: finished tiles are kept in a folder beside the file until all are
there, then the file appears at once, overviews first. An interrupted work goes on with the tiles that it lacks."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np

from ..errors import BadProject, Unsupported
from ..geometry import Grid
from . import tiff
from .files import write_atomic
from .tiff import Tag

BLOCK = 512
"""px of a block in the file; a tile has 2 x 2 of them, and is one block of the first overview."""
LARGEST_PICTURE = 80_000_000
"""px of a PNG or JPEG, which are held in memory as a whole."""
COMPRESSIONS = {"deflate": {"compress": "deflate", "zlevel": 1, "predictor": 2}, "zstd": {"compress": "zstd", "zstd_level": 3,
                                                                                           "predictor": 2},
                "jpeg": {"compress": "jpeg", "jpeg_quality": 90}, "none": {}}


class Coding(NamedTuple):
    """How pixels stand in the file: compression, one of `COMPRESSIONS`, and what says where nothing is seen: alpha, with jpeg
    (whose loss would fray it) a mask of single bits, or a value `nodata` 0..255 in place of both."""

    compression: str = "deflate"
    nodata: int | None = None

    @property
    def masked(self) -> bool:
        """Whether a mask of its own goes with every resolution."""
        return self.compression == "jpeg" and self.nodata is None

    @property
    def profile(self) -> dict[str, Any]:
        """What GDAL is told."""
        out = {"driver": "GTiff", "dtype": "uint8", "tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK,
               "interleave": "pixel", **COMPRESSIONS[self.compression]}
        if self.compression == "jpeg":
            return {**out, "count": 3, "photometric": "YCBCR"}
        if self.nodata is not None:
            return {**out, "count": 3, "photometric": "RGB"}
        return {**out, "count": 4, "photometric": "RGB", "alpha": "non-premultiplied"}

    def bands(self, rgba: np.ndarray) -> np.ndarray:
        """(h, w, 3 or 4) of RGBA; what is seen is never nodata: such a value goes one step aside."""
        if self.nodata is not None:
            aside = self.nodata + 1 if self.nodata < 255 else 254
            rgb = np.where(rgba[..., :3] == self.nodata, np.uint8(aside), rgba[..., :3])
            return np.where(rgba[..., 3:] > 0, rgb, np.uint8(self.nodata))
        return rgba[..., :3] if self.masked else rgba


PLAIN = Coding()


class Part(NamedTuple):
    """A tile as it will lie in the file: its four blocks, its block of the first overview, each followed by those of the mask
    where there is one, its quarter (256, 256, 4)."""

    number: int
    blocks: tuple[bytes, ...]
    overview: tuple[bytes, ...]
    quarter: np.ndarray
    note: dict[str, Any]


def encode_tile(index: int, rgba: np.ndarray, half: Callable[[np.ndarray], np.ndarray], coding: Coding = PLAIN,
                note: dict[str, Any] | None = None) -> Part:
    """A tile (<= 1024, <= 1024, 4) uint8 ready for the file; half: halves the resolution of RGBA."""
    if not rgba[..., 3].any():
        return Part(index, (), (), np.zeros((BLOCK // 2, BLOCK // 2, 4), np.uint8), note or {})
    whole = np.zeros((2 * BLOCK, 2 * BLOCK, 4), np.uint8)
    whole[:rgba.shape[0], :rgba.shape[1]] = rgba
    smaller = half(whole)
    return Part(index, tuple(encode(whole, coding)), tuple(encode(smaller, coding)), half(smaller), note or {})


def encode(rgba: np.ndarray, coding: Coding) -> list[bytes]:
    """The blocks of an RGBA picture whose sides are multiples of BLOCK, row after row; then, where the coding has them, those of
    its mask: rows of bits, 1 where something is seen, deflated."""
    blocks = _deflated(rgba, coding) if coding.compression == "deflate" else _encoded(rgba, coding)
    if coding.masked:
        for top in range(0, rgba.shape[0], BLOCK):
            for left in range(0, rgba.shape[1], BLOCK):
                seen = rgba[top:top + BLOCK, left:left + BLOCK, 3] > 0
                blocks.append(zlib.compress(np.packbits(seen, axis=1).tobytes(), 6))
    return blocks


def _deflated(rgba: np.ndarray, coding: Coding) -> list[bytes]:
    """Blocks as TIFF's predictor 2 and deflate have them: what each pixel adds to its left neighbour, in less than half of the
    time that GDAL takes for the same size."""
    from isal import isal_zlib

    bands, blocks = coding.bands(rgba), []
    for top in range(0, rgba.shape[0], BLOCK):
        for left in range(0, rgba.shape[1], BLOCK):
            block = np.ascontiguousarray(bands[top:top + BLOCK, left:left + BLOCK])
            change, n = block.reshape(BLOCK, -1).copy(), block.shape[2]
            np.subtract(block.reshape(BLOCK, -1)[:, n:], block.reshape(BLOCK, -1)[:, :-n], out=change[:, n:])
            blocks.append(isal_zlib.compress(change, 2))
    return blocks


def _encoded(rgba: np.ndarray, coding: Coding) -> list[bytes]:
    """Blocks by GDAL's own codecs."""
    from rasterio.io import MemoryFile

    with _gdal(), MemoryFile() as memory:
        with memory.open(width=rgba.shape[1], height=rgba.shape[0], **coding.profile) as data:
            data.write(np.moveaxis(coding.bands(rgba), -1, 0))
        view = memory.getbuffer()
        tags = tiff.read_tags(view)
        where = zip(tags[tiff.OFFSETS].values, tags[tiff.COUNTS].values, strict=True)
        return [bytes(view[int(a):int(a) + int(n)]) for a, n in where]


@contextlib.contextmanager
def _gdal() -> Iterator[None]:
    """GDAL without its notes on what is not georeferenced yet, and with a small cache."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings(), rasterio.Env(GDAL_CACHEMAX=32 * 2**20):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@dataclass(frozen=True)
class TileFolder:
    """The finished tiles of a mosaic, one file each. plan: a word for all that the tiles depend on. One run at a time has it."""

    out: Path
    plan: str
    _locks: list[IO[str]] = field(default_factory=list, repr=False, compare=False)

    @property
    def folder(self) -> Path:
        """Beside the file to be."""
        return self.out.parent / f".{self.out.name}.parts"

    def open(self) -> frozenset[int]:
        """Make the folder, drop what another plan has left; gives the tiles that are there already, whole.

        Raises BadProject while another run works in it.
        """
        self._lock()
        about = self.folder / "plan"
        try:
            same = about.read_text() == self.plan
        except (OSError, ValueError):
            same = False
        if not same:
            for old in self.folder.iterdir():
                if old.name != "lock":
                    shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink(missing_ok=True)
            write_atomic(about, lambda stream: stream.write(self.plan.encode()))
        done = set()
        for path in self.folder.glob("*.tile"):
            if path.stem.isdigit() and self._sound(path):
                done.add(int(path.stem))
            else:
                path.unlink(missing_ok=True)
        return frozenset(done)

    def _lock(self) -> None:
        """Have the folder alone, as long as this process lives or until `release`."""
        try:
            import fcntl
        except ImportError:  # a system without such locks
            self.folder.mkdir(parents=True, exist_ok=True)
            return
        while True:
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                handle = open(self.folder / "lock", "a")
            except FileNotFoundError:  # another run has finished just now
                continue
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.path.samestat(os.fstat(handle.fileno()), os.stat(self.folder / "lock")):
                    self._locks.append(handle)
                    return
            except BlockingIOError:
                handle.close()
                raise BadProject(f"{self.out}: another run is making this mosaic now; wait until it has finished, or give this "
                                 "one another name") from None
            except FileNotFoundError:
                pass
            handle.close()

    def release(self) -> None:
        """Let other runs have the folder."""
        while self._locks:
            self._locks.pop().close()

    def keep(self, part: Part) -> None:
        """A finished tile, whole or not at all."""
        pieces = (*part.blocks, *part.overview, part.quarter.tobytes())
        crc = 0
        for piece in pieces:
            crc = zlib.crc32(piece, crc)
        head = {"blocks": [len(b) for b in part.blocks], "overview": [len(b) for b in part.overview],
                "bytes": sum(map(len, pieces)), "crc": crc, "note": part.note}
        handle, temporary = tempfile.mkstemp(dir=self.folder, prefix=".tile.")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(json.dumps(head).encode() + b"\n")
                stream.writelines(pieces)
            os.replace(temporary, self._path(part.number))
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise

    def head(self, index: int) -> dict[str, Any] | None:
        """What is known of a tile, None where no photo shows anything."""
        try:
            with open(self._path(index), "rb") as stream:
                line = stream.readline()
                head = json.loads(line)
                return {**head, "start": len(line)} if head["blocks"] else None
        except FileNotFoundError:
            return None

    def read(self, index: int, first: int, size: int) -> bytes:
        """Bytes of a tile's payload."""
        with open(self._path(index), "rb") as stream:
            stream.readline()
            stream.seek(first, os.SEEK_CUR)
            return stream.read(size)

    def quarter(self, index: int) -> np.ndarray:
        """(256, 256, 4) of a tile, empty where there is none."""
        head = self.head(index)
        if head is None:
            return np.zeros((BLOCK // 2, BLOCK // 2, 4), np.uint8)
        start = sum(head["blocks"]) + sum(head["overview"])
        raw = self.read(index, start, head["bytes"] - start)
        return np.frombuffer(raw, np.uint8).reshape(BLOCK // 2, BLOCK // 2, 4)

    def remove(self) -> None:
        """All of it, once the mosaic is there."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, index: int) -> Path:
        return self.folder / f"{index:07d}.tile"

    def _sound(self, path: Path) -> bool:
        try:
            with open(path, "rb") as stream:
                head = json.loads(stream.readline())
                payload = stream.read()
            return len(payload) == head["bytes"] and zlib.crc32(payload) == head["crc"]
        except (OSError, ValueError, KeyError, TypeError):
            return False


class _Level(NamedTuple):
    """One resolution, or its mask: size [px], blocks down and across, and where each block's bytes come from."""

    width: int
    height: int
    rows: int
    columns: int
    blocks: list[tuple[Path | None, int, int]]  # file (None: the empty block), first byte of its payload, size
    mask: bool = False


def write_cog(folder: TileFolder, grid: Grid, tiles: tuple[int, int], half: Callable[[np.ndarray], np.ndarray],
              coding: Coding = PLAIN, out: Path | None = None) -> None:
    """The mosaic from its finished tiles, atomically: bands as the coding has them, overviews down to one block, CRS, position.

    out: another file than the folder is made for.
    """
    levels = _levels(folder, grid, tiles, half, coding)
    empty = encode(np.zeros((BLOCK, BLOCK, 4), np.uint8), coding)
    total = sum(n for level in levels for _, _, n in level.blocks) + 24 * sum(len(level.blocks) for level in levels) + 2**16
    big = total > 4_000_000_000
    kind = tiff.LONG8 if big else tiff.LONG
    common = {False: _common_tags(grid, coding), True: _mask_tags()}
    all_tags = []
    for k, level in enumerate(levels):
        zeros, small = Tag(kind, (0,) * len(level.blocks)), level.width < grid.shape[1] or level.height < grid.shape[0]
        tags = {**common[level.mask], tiff.WIDTH: Tag(tiff.LONG, (level.width,)), tiff.HEIGHT: Tag(tiff.LONG, (level.height,)),
                tiff.OFFSETS: zeros, tiff.COUNTS: zeros, tiff.SUBFILE: Tag(tiff.LONG, (4 * level.mask + small,))}
        all_tags.append(tags if k == 0 else {n: t for n, t in tags.items() if n not in tiff.GEO})

    def write(stream: BinaryIO) -> None:
        head, places = tiff.directories(all_tags, big)
        stream.write(head)
        nothing = []
        for block in empty:
            nothing.append((stream.tell(), len(block)))
            stream.write(block)
        for k in range(len(levels) - 1, -1, -1):
            offsets, counts = _copy(stream, levels[k], nothing[levels[k].mask])
            for number, values in ((tiff.OFFSETS, offsets), (tiff.COUNTS, counts)):
                stream.seek(places[k][number])
                stream.write(tiff.packed(kind, values))
            stream.seek(0, os.SEEK_END)

    write_atomic(out or folder.out, write)


def _copy(stream: BinaryIO, level: _Level, empty: tuple[int, int]) -> tuple[list[int], list[int]]:
    """A level's blocks, one after the other; gives where they lie and how long they are."""
    offsets, counts = [], []
    for path, first, size in level.blocks:
        if path is None:
            offsets.append(empty[0])
            counts.append(empty[1])
            continue
        offsets.append(stream.tell())
        counts.append(size)
        with open(path, "rb") as source:
            source.seek(first)
            stream.write(source.read(size))
    return offsets, counts


def _mask_tags() -> dict[int, Tag]:
    """Tags of a mask of single bits, deflated."""
    one = {tiff.BITS: 1, tiff.COMPRESSION: 8, tiff.PHOTOMETRIC: 4, tiff.SAMPLES: 1, tiff.PLANAR: 1, tiff.TILE_WIDTH: BLOCK,
           tiff.TILE_HEIGHT: BLOCK}
    return {n: Tag(tiff.SHORT, (v,)) for n, v in one.items()}


def _common_tags(grid: Grid, coding: Coding) -> dict[int, Tag]:
    """Tags that all directories share, those of the place taken from what GDAL writes for the same grid."""
    import rasterio
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    with _gdal(), MemoryFile() as memory:
        with memory.open(width=BLOCK, height=BLOCK, crs=None if grid.crs == "local" else rasterio.CRS.from_user_input(grid.crs),
                         transform=Affine(*grid.affine), nodata=coding.nodata, **coding.profile) as data:
            data.write(np.zeros((coding.profile["count"], BLOCK, BLOCK), np.uint8))
        tags = tiff.read_tags(memory.getbuffer())
    wanted = (tiff.BITS, tiff.COMPRESSION, tiff.PHOTOMETRIC, tiff.SAMPLES, tiff.PLANAR, tiff.PREDICTOR, tiff.TILE_WIDTH,
              tiff.TILE_HEIGHT, tiff.EXTRA, tiff.SAMPLE_FORMAT, tiff.JPEG_TABLES, tiff.SUBSAMPLING, tiff.NODATA, *tiff.GEO)
    return {**{n: tags[n] for n in wanted if n in tags}, tiff.SOFTWARE: Tag(tiff.ASCII, b"Collinea\0")}


def _levels(folder: TileFolder, grid: Grid, tiles: tuple[int, int], half: Callable[[np.ndarray], np.ndarray],
            coding: Coding) -> list[_Level]:
    """Full resolution and all overviews, each followed by its mask where there are masks; overviews from the second on are made
    here, block row after block row."""
    height, width = grid.shape
    heads = [folder.head(k) for k in range(tiles[0] * tiles[1])]
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    levels = []
    for mask in (False, True)[:1 + coding.masked]:
        full: list[tuple[Path | None, int, int]] = []
        for r in range(rows):
            for c in range(columns):
                k, b = (r // 2) * tiles[1] + c // 2, 2 * (r % 2) + c % 2 + 4 * mask
                h = heads[k]
                full.append((None, 0, 0) if h is None else (folder._path(k), h["start"] + sum(h["blocks"][:b]), h["blocks"][b]))
        levels.append(_Level(width, height, rows, columns, full, mask))
    if max(height, width) <= BLOCK:
        return levels
    for mask in (False, True)[:1 + coding.masked]:
        first: list[tuple[Path | None, int, int]]
        first = [(None, 0, 0) if h is None else (folder._path(k), h["start"] + sum(h["blocks"]) + sum(h["overview"][:mask]),
                                                 h["overview"][mask]) for k, h in enumerate(heads)]
        levels.append(_Level(-(-width // 2), -(-height // 2), *tiles, first, mask))
    path = folder.folder / "overviews"
    with open(path, "wb") as stream:
        shape = tiles
        makers: list[_Maker] = []
        while max(levels[-1].width, levels[-1].height) > BLOCK:
            shape = -(-shape[0] // 2), -(-shape[1] // 2)
            last = levels[-1]
            new = [_Level(-(-last.width // 2), -(-last.height // 2), *shape, [], mask)
                   for mask in (False, True)[:1 + coding.masked]]
            levels += new
            makers.append(_Maker(new, path, stream, half, coding))
        if makers:
            _fill_levels(folder, tiles, makers)
    return levels


@dataclass
class _Maker:
    """One overview being written, a row of its blocks at a time."""

    levels: list[_Level]  # and its mask, if any
    path: Path
    stream: BinaryIO
    half: Callable[[np.ndarray], np.ndarray]
    coding: Coding
    waiting: np.ndarray | None = None

    def row(self, picture: np.ndarray) -> np.ndarray:
        """A row of blocks, (BLOCK, columns * BLOCK, 4), goes into the file; gives it at half the resolution."""
        for c in range(self.levels[0].columns):
            block = picture[:, c * BLOCK:(c + 1) * BLOCK]
            if not block[..., 3].any():
                for level in self.levels:
                    level.blocks.append((None, 0, 0))
                continue
            for level, data in zip(self.levels, encode(np.ascontiguousarray(block), self.coding), strict=True):
                level.blocks.append((self.path, self.stream.tell(), len(data)))
                self.stream.write(data)
        return self.half(np.ascontiguousarray(picture))

    def add(self, strip: np.ndarray, last: bool) -> np.ndarray | None:
        """Half a row of blocks, (BLOCK / 2, any, 4); with the other half (or at the end) it becomes a row, given halved."""
        wide = np.zeros((BLOCK, self.levels[0].columns * BLOCK, 4), np.uint8)
        if self.waiting is None:
            if not last:
                self.waiting = strip
                return None
            wide[:BLOCK // 2, :strip.shape[1]] = strip
        else:
            wide[:BLOCK // 2, :self.waiting.shape[1]] = self.waiting
            wide[BLOCK // 2:, :strip.shape[1]] = strip
            self.waiting = None
        return self.row(wide)


def _fill_levels(folder: TileFolder, tiles: tuple[int, int], makers: list[_Maker]) -> None:
    """The second overview from the tiles' quarters, every further one from the one before."""
    for i in range(tiles[0]):
        strip: np.ndarray | None = np.concatenate([folder.quarter(i * tiles[1] + j) for j in range(tiles[1])], axis=1)
        end = i == tiles[0] - 1
        for maker in makers:
            strip = maker.add(strip, end)
            if strip is None:
                break


def to_picture(raster: Path, out: Path, scale: str) -> None:
    """A GeoTIFF as PNG (with alpha) or JPEG (white where nothing is seen), the scale told in its description. Atomic.

    Raises Unsupported for pictures too large for these formats; the position goes into the world file beside it.
    """
    import rasterio
    from PIL import Image, PngImagePlugin

    with _gdal(), rasterio.open(raster) as data:
        if max(data.width, data.height) > 65000 or data.width * data.height > LARGEST_PICTURE:
            raise Unsupported(f"{out}: {data.width} x {data.height} pixels are too many for a {out.suffix[1:].upper()}; write a "
                              ".tif or give a larger --gsd")
        rgba = np.moveaxis(data.read(), 0, -1)
    if out.suffix.lower() == ".png":
        told = PngImagePlugin.PngInfo()
        told.add_text("Description", scale)
        write_atomic(out, lambda stream: Image.fromarray(rgba).save(stream, "PNG", pnginfo=told, compress_level=3))
        return
    rgb = np.where(rgba[..., 3:] > 0, rgba[..., :3], 255).astype(np.uint8)
    write_atomic(out, lambda stream: Image.fromarray(rgb).save(stream, "JPEG", quality=92, comment=scale))


def to_preview(raster: Path, out: Path, longest: int = 900) -> None:
    """A small PNG of a mosaic, transparent where nothing is seen, at most `longest` px long. Atomic."""
    import rasterio
    from PIL import Image
    from rasterio.enums import Resampling

    with _gdal(), rasterio.open(raster) as data:
        factor = min(1.0, longest / max(data.width, data.height))
        shape = (max(1, round(factor * data.height)), max(1, round(factor * data.width)))
        bands = [1, 2, 3] if data.count >= 3 else [1, 1, 1]
        rgb = data.read(bands, out_shape=(3, *shape), resampling=Resampling.average)
        rgba = np.moveaxis(np.concatenate([rgb, data.dataset_mask(out_shape=shape)[None]]), 0, -1)
    write_atomic(out, lambda stream: Image.fromarray(rgba).save(stream, "PNG"))


def no_space(error: OSError) -> bool:
    """Whether a disk is full."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def full_disk(out: Path, error: OSError, done: int, total: int) -> Unsupported:
    """What to say then."""
    free = f"({shutil.disk_usage(out.parent).free / 2**20:.0f} MB free)"
    why = {errno.EDQUOT: f"the quota is used up {free}", errno.EFBIG: "a file may not grow as large here (a limit of the system)"}
    said = why.get(error.errno or 0, f"the disk is full {free}")
    return Unsupported(f"{out}: {said}; {done} of {total} tiles are kept beside it, make room and run the same command again to "
                       "go on with the rest")
