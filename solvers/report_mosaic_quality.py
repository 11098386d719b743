"""What a report says of the latest mosaic: how it was made, how well it fits, how far its places can be believed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import report_figures as figures
from .report_document import Figure, Number, Part, Section, Source, Table
from .report_material import MOST_ROWS, Material, left

DRIFT = ("Tie points and seams tell how well neighbours fit, not how far the whole is bent or turned: a mosaic whose seams fit "
         "can still drift. The predicted standard error, and better check points, tell that.")
PHOTOS = ("Standard error: predicted, root mean square over the photo's corners, a priori. Yaw: what the photos' content says, "
          "minus what was recorded.")


def mosaic(m: Material) -> Section | None:
    """The quality of the mosaic, and a line for every photo."""
    if m.mosaic is None:
        return None
    source = Source(m.mosaic)
    images = source.get("images", [])
    parts: list[Part] = [Table(("what", "value"), _rows(m, source, images), "", DRIFT), *_picture(m, source)]
    turned = {h["image"]: h.get("correction_deg") for h in source.get("headings", [])}
    unit = source.get("unit", "m")
    rows = [(i["name"], "yes" if i.get("used", True) else f"no: {i.get('why', '')}", _sigma(source, images, k, "sigma", 2),
             _sigma(source, images, k, "sigma_px", 1), _turn(turned.get(i["name"]))) for k, i in enumerate(images[:MOST_ROWS])]
    if rows:
        header = ("photo", "used", f"standard error of places [{unit}]", "the same [px of the mosaic]", "yaw corrected by [°]")
        parts.append(Table(header, rows, "Photos of the mosaic", PHOTOS + left(len(images), "photos")))
    return Section("Mosaic", parts)


def _picture(m: Material, source: Source) -> list[Figure]:
    bounds = source.get("bounds")
    if m.picture is None or not bounds:
        return []
    unit = source.get("unit", "m")
    drawn = figures.mosaic(m.picture, [float(b) for b in bounds], unit)
    return [] if drawn is None else [Figure(drawn, f"The mosaic, reduced; coordinates in {unit}.")]


def _rows(m: Material, source: Source, images: Sequence[Any]) -> list[Sequence[Any]]:
    unit, used = source.get("unit", "m"), [k for k, i in enumerate(images) if i.get("used", True)]
    rows: list[Sequence[Any]] = [("run", m.mosaic_run)]
    if source.get("kind") is not None:
        rows.append(("kind and registration", f"{source.get('kind')}, {source.get('register', '–')}"))
    rows += [("size [px]", f"{source.get('width', '–')} × {source.get('height', '–')}")]
    if source.get("gsd") is not None:
        rows.append((f"size of a pixel [{unit}]", source.number("gsd", 4)))
    bounds = source.get("bounds")
    if bounds:
        rows.append((f"extent west, south, east, north [{unit}]", ", ".join(f"{v:.2f}" for v in bounds)))
    rows += [("photos used", f"{len(used)} of {len(images)}"), ("tie points, rms [px]", source.number("rms_px", 2))]
    held = source.get("check_ties")
    if held:
        rows += [("check ties, held out of the adjustment", str(held.get("count", "–"))),
                 ("check ties, rms [px]", source.number("check_ties.rms_px", 2)),
                 ("check ties, 90 % within [px]", source.number("check_ties.p90_px", 2))]
    seams = source.get("seams") or {}
    rows.append(("neighbours along the seams, rms [px]", source.number("seam_rms", 2)))
    if seams.get("places"):
        rows.append(("places compared along the seams", str(seams["places"])))
    sigma = [images[k].get("sigma") for k in used]
    known = [s for s in sigma if isinstance(s, int | float)]
    if known:
        rows.append((f"predicted standard error of places, photo by photo [{unit}]", f"{min(known):.3g} to {max(known):.3g}"))
    return rows + _checks(source)


def _checks(source: Source) -> list[Sequence[Any]]:
    check = source.get("check_rms_m")
    if isinstance(check, list):
        return [(f"check points, rms {c} [m]", source.number(f"check_rms_m.{k}")) for k, c in enumerate("XYZ"[:len(check)])]
    if check is not None:
        return [("check points, rms [m]", source.number("check_rms_m"))]
    return [("check points, rms [m]", "none measured")]


def _sigma(source: Source, images: Sequence[Any], k: int, key: str, decimals: int) -> Any:
    return source.number(f"images.{k}.{key}", decimals) if isinstance(images[k].get(key), int | float) else "–"


def _turn(degrees: Any) -> Any:
    return Number(float(degrees), 1) if isinstance(degrees, int | float) else "–"
