"""What the commands mosaic and rectify say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def mosaic_text(done: Mapping[str, Any], out: str) -> str:
    """A few lines on a mosaic."""
    used = [i for i in done["images"] if i["used"]]
    lines = [f"{done['kind']} mosaic of {len(used)} of {len(done['images'])} photos, {done['register']} registration, rms "
             f"{done['rms_px']:.2f} px"]
    lines += [f"left out: {i['name']}: {i['why']}" for i in done["images"] if not i["used"]]
    lines += [f"warning: {w}" for w in done["warnings"]]
    lines.append(f"{out}: {done['width']} x {done['height']} px")
    return "\n".join(lines)


def rectify_text(done: Mapping[str, Any], out: str) -> str:
    """A few lines on a rectified photo."""
    return f"{out}: {done['width']} x {done['height']} px"
