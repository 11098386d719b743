"""What the commands mosaic and rectify say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def mosaic_text(done: Mapping[str, Any], out: str) -> str:
    """A few lines on a mosaic."""
    used = [i for i in done["images"] if i["used"]]
    unit = done["unit"]
    lines = [f"{done['kind']} mosaic of {len(used)} of {len(done['images'])} photos, {done['register']} registration, tie points "
             f"within {done['rms_px']:.2f} px rms"]
    held = done["check_ties"]
    if held:
        lines.append(f"check ties (held out): {held['count']} observations, median {held['median_px']:.2f} px, 90 % within "
                     f"{held['p90_px']:.2f} px")
    sigma = [i["sigma"] for i in used if i["sigma"] == i["sigma"]]
    if sigma:
        lines.append(f"predicted standard error of places: {min(sigma):.3g} to {max(sigma):.3g} {unit}")
    if done["check_rms_m"] is not None:
        lines.append(f"check points: {done['check_rms_m']:.3f} m rms")
    seams = done["seams"]
    if seams["places"]:
        lines.append(f"seams: neighbours fit within {seams['rms']:.2f} px rms at {seams['places']} places")
    lines += [f"left out: {i['name']}: {i['why']}" for i in done["images"] if not i["used"]]
    lines += list(done["notes"])
    lines += [f"warning: {w}" for w in done["warnings"]]
    lines.append(f"{out}: {done['width']} x {done['height']} px of {done['gsd']:.4g} {unit}")
    return "\n".join(lines)


def rectify_text(done: Mapping[str, Any], out: str) -> str:
    """A few lines on a rectified photo."""
    col, row = done["isocentre"]
    plane = done["plane"]
    lines = [f"image {done['image']}: tilt {done['tilt_deg']:.3f} degrees, isocentre at col {col:.1f}, row {row:.1f} "
             f"({done['isocentre_gsd_m']:.4g} m a pixel there), {done['height_m']:.2f} m above the plane",
             f"plane: z = {plane['z0']:.3f} m (local), {done['plane_from']}",
             f"distortion: {'removed' if done['distortion_removed'] else 'none known'}", done["orientation_from"]]
    if done["horizon_in_photo"]:
        lines.append("warning: the horizon of the plane lies in the photo")
    lines.append(f"{out}: {done['width']} x {done['height']} px of {done['gsd']:.4g} {done['unit']}")
    return "\n".join(lines)
