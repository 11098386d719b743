"""How a recording opens in rerun: the block in space, per image its photo, curves and normal matrix, and the log."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import theme
from .replay import ELEMENTS, Replay
from .rerun_shown import EVERYTHING, LAYERS, Shown

if TYPE_CHECKING:
    import rerun.blueprint as rrb


APPLICATION = "collinea"
"""What rerun calls the program; blueprints belong to it."""


TABS = 24
"""Images with a tab of their own at most: the chosen one and the next."""
SWITCHES = 100
"""Hidden entities that can be switched on in rerun, at most; more are left out."""


def part(name: str) -> str:
    """A name as one part of an entity path."""
    import rerun as rr

    return rr.escape_entity_path_part(name.replace("/", "_"))


def blueprint(replays: Sequence[Replay], site: np.ndarray, shown: Shown = EVERYTHING) -> rrb.Blueprint:
    """site (n, 3) m: the known points, which the 3D view looks at. It opens at the last row, with what the scene shows."""
    import rerun.blueprint as rrb

    images = list(dict.fromkeys(r.image for r in replays))
    first = images.index(shown.image) if shown.image in images else 0
    images = images[first:] + images[:first]
    tabs: list[Any] = [_image(name, [r for r in replays if r.image == name], shown) for name in images[:TABS]]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_space(replays, site, shown), rrb.TextLogView(origin="/log", name="Log"), row_shares=[3, 1]),
            rrb.Tabs(*tabs, rrb.TextDocumentView(origin="/about", name="About"), active_tab=0),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline="iteration", fps=2.0, play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def as_bytes(made: rrb.Blueprint) -> bytes:
    """A blueprint as an open page of rerun's viewer takes it: it holds from now on."""
    with tempfile.TemporaryDirectory(prefix="collinea-") as folder:
        path = Path(folder) / "layout.rbl"
        made.save(APPLICATION, path)
        return path.read_bytes()


def hide(paths: Iterable[str]) -> Any:
    """Overrides of a view by which entities, and what is below them, begin hidden."""
    import rerun.blueprint as rrb

    return {path: rrb.EntityBehavior(visible=False) for path in paths}


def unnamed(shown: Shown) -> Any:
    """Overrides of a view by which the known points' names are not written where the scene does not write them."""
    import rerun as rr

    return {f"/points/{kind}": rr.Points3D.from_fields(show_labels=False) for kind in ("control", "check")
            if "labels" in shown.hidden}


def hidden_in_space(replays: Sequence[Replay], shown: Shown) -> list[str]:
    """Entities that begin hidden because the scene does not show them: layers that are switched off, rays of images that are not
    the chosen one."""
    found = []
    for name in dict.fromkeys(r.image for r in replays):
        found += [f"/images/{part(name)}/{layer}" for layer in LAYERS if layer in shown.hidden]
    for r in replays:
        if "rays" in shown.hidden or shown.image not in ("", r.image):
            found.append(f"/images/{part(r.image)}/{r.model}/rays")
    return found


def _space(replays: Sequence[Replay], site: np.ndarray, shown: Shown) -> rrb.Spatial3DView:
    import rerun.blueprint as rrb

    seen = np.concatenate([site, *[r.exterior(r.rows[-1]).centre[None] for r in replays]])
    low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else (np.full(3, -1.0), np.ones(3))
    target, reach = (low + high) / 2, 1.0 * max(float(np.linalg.norm(high - low)), 1e-3)
    eye = rrb.EyeControls3D(position=target + reach * np.array([0.4, -0.65, 0.75]), look_target=target, eye_up=(0, 0, 1))
    photos = [f"- /images/{part(name)}/photo/**" for name in dict.fromkeys(r.image for r in replays)]
    hidden = hidden_in_space(replays, shown)
    left_out = [f"- {path}/**" for path in hidden] if len(hidden) > SWITCHES else []
    overrides = unnamed(shown) if left_out else hide(hidden) | unnamed(shown)
    return rrb.Spatial3DView(origin="/", name="Block", contents=["/images/**", "/points/**", *photos, *left_out],
                             background=theme.background(shown.dark), eye_controls=eye, overrides=overrides)


def _image(name: str, replays: Sequence[Replay], shown: Shown) -> rrb.Vertical:
    import rerun.blueprint as rrb

    camera = replays[0].camera
    width, height, room = camera.width, camera.height, 0.06 * camera.width
    hidden = [f"/images/{part(name)}/photo/{r.model}" for r in replays if r.model in shown.hidden]
    if "residuals" in shown.hidden:
        hidden += [f"/images/{part(name)}/photo/{r.model}/residuals" for r in replays]
    bounds = rrb.VisualBounds2D(x_range=[-room, width + room], y_range=[-room, height + room])
    photo = rrb.Spatial2DView(origin=f"/images/{part(name)}/photo", name=f"{name}: observed, projected", visual_bounds=bounds,
                              background=theme.background(shown.dark), overrides=hide(hidden))
    mapping = rrb.TensorScalarMapping(colormap="CyanToYellow", mag_filter="Nearest")
    matrices = [rrb.TensorView(origin=f"/normal/{part(name)}/{r.model}", name=f"{r.model}: {' '.join(ELEMENTS)}",
                               scalar_mapping=mapping) for r in replays]
    position, attitude = (_curves(replays, k, t) for k, t in (("position", "X Y Z minus final [m]"),
                                                              ("attitude", "omega phi kappa minus final [deg]")))
    return rrb.Vertical(
        photo,
        rrb.Tabs(
            _curves(replays, "log10", "Convergence (log10)"),
            rrb.Horizontal(position, attitude, name="Elements"),
            rrb.Horizontal(*matrices, name="Normal matrix"),
            active_tab=0,
        ),
        row_shares=[3, 2],
        name=name,
    )


def _curves(replays: Sequence[Replay], kind: str, title: str) -> rrb.TimeSeriesView:
    import rerun.blueprint as rrb

    paths = [f"/plots/{part(r.image)}/{r.model}/{kind}" for r in replays]
    return rrb.TimeSeriesView(origin="/plots", contents=paths, name=title, plot_legend=rrb.PlotLegend(corner="RightTop"))
