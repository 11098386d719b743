"""Positions of photos without or with onboard angles: geo.txt, DJI .MRK, and the EXIF and XMP of photos."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import BadTable
from ...geometry import Exterior, Onboard, photo_rotation
from ..crs import transformed, utm_zone
from ..geocentric import axes_at
from ..metadata import read_onboard
from ..photos import EXTENSIONS
from ..sniff import read_text
from ..telemetry import read_mrk, read_positions
from .options import NOTHING, Reading
from .scene import Exchange, Shot


def read_geo(path: Path, options: Reading = NOTHING) -> Exchange:
    """OpenDroneMap's geo.txt, or a table of positions with named columns. Raises BadTable."""
    return of_onboard("positions", path, read_positions(path, options.tell, options.crs), options)


def read_dji(path: Path, options: Reading = NOTHING) -> Exchange:
    """A DJI .MRK: positions in the order of the photos beside it, else numbered. Raises BadTable."""
    count = sum(1 for line in read_text(path).splitlines() if line.strip())
    photos = sorted(f for f in path.parent.iterdir() if f.suffix.lower() in EXTENSIONS)
    names = [p.stem for p in photos] if len(photos) == count else [f"{n + 1:04d}" for n in range(count)]
    return of_onboard("DJI .MRK", path, read_mrk(path, names), options)


def read_photos(photos: Sequence[Path], options: Reading = NOTHING) -> Exchange:
    """What EXIF and XMP of photos say. Raises BadTable where none has a position."""
    onboard = [read_onboard(p) for p in photos]
    if not any(o.lat is not None for o in onboard):
        raise BadTable(f"{photos[0]}: its EXIF has no position, and that of no other photo; give photos with GPS")
    return of_onboard("EXIF and XMP", photos[0].parent, onboard, options)


def of_onboard(kind: str, path: Path, rows: Sequence[Onboard], options: Reading = NOTHING) -> Exchange:
    """Onboard values as shots: positions in the crs or the UTM zone, rotations where attitudes are known."""
    known = [(o.lat, o.lon) for o in rows if o.lat is not None and o.lon is not None]
    if not known:
        raise BadTable(f"{path}: there is no position in it; give a file with latitude and longitude")
    crs = options.crs if options.crs not in (None, "local") else utm_zone(*np.median(np.array(known), axis=0))
    shots = []
    for o in rows:
        if o.lat is None or o.lon is None:
            shots.append(Shot(o.image))
            continue
        place = np.array([o.lon, o.lat, np.nan if o.height is None else o.height])
        centre = transformed(place[None], "EPSG:4326", str(crs))[0]
        sigma = None if o.sigma_m is None else np.array(o.sigma_m)
        shots.append(Shot(o.image, None, Exterior(_rotation(o, str(crs), centre), centre), None, sigma,
                          None if o.sigma_deg is None else np.radians(o.sigma_deg)))
    datum = {o.datum for o in rows if o.height is not None}
    heights = next(iter(datum)) if len(datum) == 1 else "unknown"
    said = tuple(dict.fromkeys(w for o in rows for w in o.stated))[:6]
    return Exchange(kind, path, str(crs), {}, tuple(shots), notes=(f"crs: {crs}", *said), heights=heights)


def _rotation(o: Onboard, crs: str, centre: np.ndarray) -> np.ndarray:
    if o.attitude is None or not np.isfinite(centre[:2]).all():
        return np.full((3, 3), np.nan)
    at = np.nan_to_num(centre)
    degrees = transformed(at[None], crs, "EPSG:4326")[0]
    east, north, up = axes_at("EPSG:4326", degrees)
    ned = np.stack([north, east, -up]) @ axes_at(crs, at).T
    return photo_rotation(np.radians(o.attitude), o.mount, ned)
