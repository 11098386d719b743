"""Ways out of a project: an offline page that replays the adjustment, a recording, a picture, tables, the scene, the archive."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

from solvers import BadProject

from .archive import project_zip
from .bundle_state import Bundle
from .bundle_tasks import adjusted_bundle
from .export_tables import tables
from .mosaic_state import Mosaic
from .replay_page import replay_html
from .state import MODELS, State


def recording(state: State, path: Path) -> None:
    """The rerun recording: of the bundle where it leads, else of every image's solutions, else of the mosaics, as they are shown.

    Raises PhotogrammetryError where there is none of them.
    """
    from solvers.io import read_truth

    from .paint_rerun import record
    from .rerun_bundle import record_bundle
    from .rerun_mosaic import record_mosaic
    from .rerun_shown import bundle_shown, shown

    room, folder = state.room(Bundle), state.assets.folder
    done = [s.orientation for i in state.block.images for m in MODELS if (s := state.solution(m, i.name)) and s.orientation]
    if room.rows and room.layout is not None and (room.leads or not done):
        record_bundle(path, *adjusted_bundle(state), bundle_shown(state))
    elif done:
        photos = {name: photo.pane for name, photo in state.assets.photos.items()}
        record(path, state.block, done, photos, (read_truth(folder) if folder else None) or {}, shown(state))
    elif state.room(Mosaic).made:
        record_mosaic(path, state)
    else:
        raise BadProject(f"{state.block.name}: there is no solution to record; measure points in an image, run a bundle or make "
                         "a mosaic first")  # fmt: skip


def tables_zip(state: State) -> bytes:
    """All tables in one file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in tables(state).items():
            file.writestr(name, text)
    return out.getvalue()


__all__ = ["project_zip", "recording", "replay_html", "tables", "tables_zip"]
