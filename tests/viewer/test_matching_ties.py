"""Tie points found and placed from the Matching tab in a real browser: the scene turns to them, their colours have a legend."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers.block import Observations, Points
from solvers.io import read_project, write_project
from tests.browser import require_chromium, viser_page
from viewer_app.app import App
from viewer_app.matching_actions import ColourTies
from viewer_app.matching_state import Matching

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]
DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"


def flight(folder: Path) -> Path:
    """Three photos of the demo with their positions and angles only: no points, no measurements."""
    block, nothing = read_project(DEMO), np.empty((0, 3))
    none = Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))
    images = tuple(replace(i, file=str((DEMO / str(i.file)).resolve())) for i in block.images[:3])
    write_project(replace(block, images=images, points=Points((), nothing, nothing, ()), observations=none, surface={}), folder)
    return folder


def test_tie_points_are_found_placed_coloured_and_looked_at(tmp_path: Path) -> None:
    require_chromium()
    with App(flight(tmp_path / "p")) as app, viser_page(app.port, size=(1150, 760), drawn=False) as v:
        v.page.set_default_timeout(60_000)
        v.wait_until(app.settled, "the viewer to settle", 100)
        v.open_tab("Matching")
        v.page.locator("#collinea-left").wait_for()

        def room() -> Matching:
            return app.state.room(Matching)

        v.click_button("Find tie points")
        v.wait_until(lambda: room().task == "" and "tie" in app.state.block.points.role, "the tie points", 120)
        ties = sum(role == "tie" for role in app.state.block.points.role)
        assert ties > 100
        v.page.get_by_text(f"{ties} tie points").first.wait_for()
        v.wait_until(app.settled, "the viewer to settle", 60)
        before = np.array(app.server.initial_camera.look_at)
        v.click_button("Place tie points")
        v.wait_until(lambda: room().task == "" and room().network is not None, "the bundle", 120)
        network = room().network
        assert network is not None and len(network.exteriors) == 3 and "NOT converged" not in network.words
        v.wait_nodes("/ties/points")
        v.wait_until(app.settled, "the viewer to settle", 60)
        after, middle = np.array(app.server.initial_camera.look_at), np.median(network.xyz, axis=0)
        assert np.linalg.norm(after - middle) < 0.8 * np.linalg.norm(before - middle)
        app.emit(ColourTies("residual"))
        v.wait_until(lambda: room().colour == "residual", "the colours")
        v.page.get_by_text("px and more").wait_for()
        assert v.log.errors == [] and v.log.external == []
