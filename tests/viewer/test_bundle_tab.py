"""The Bundle tab in a real browser on the demo: choose, run, step, read, keep; waits on state and never on time."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.viewer.sessions import Session, act, demo_session, until
from viewer_app import bundle_tasks
from viewer_app.actions import Show
from viewer_app.app import App
from viewer_app.bundle_state import Bundle
from viewer_app.bundle_work import bundle_work

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("bundle") / "demo") as (app, v):
        v.open_tab("Bundle")
        v.page.get_by_role("button", name="Run bundle", exact=True).wait_for()
        yield app, v


def room(app: App) -> Bundle:
    return app.state.room(Bundle)


def finished(app: App) -> bool:
    return not room(app).task and (room(app).result is not None or bool(room(app).error))


def test_a_bundle_is_run_drawn_and_stepped(session: Session) -> None:
    app, v = session
    act(app, v, Show("ellipsoids", True))
    v.click_button("Run bundle")
    until(app, v, lambda: finished(app), "the bundle", 200)
    assert room(app).error == "" and room(app).result is not None
    v.page.get_by_role("status", name="Bundle").get_by_text("39 points").wait_for()
    v.wait_nodes("/bundle/images", "/bundle/points", "/bundle/vectors/check", "/bundle/chosen/camera")
    tree = v.page.evaluate("() => Object.keys(window.__viserSceneTree.getState())")
    assert not [n for n in tree if n.startswith("/images/DSC") and n.endswith("camera")]  # drawn in place of those
    for name in ("Bundle images", "Bundle points", "Variance components"):
        assert v.page.get_by_role("table", name=name).count() == 1
    v.page.get_by_text("ellipsoids: 95 % (factor 2.796, χ² with 3 degrees of freedom), a priori from the given").wait_for()
    v.wait_nodes("/bundle/scale/vectors", "/bundle/scale/ellipsoids")
    heat = v.page.get_by_role("img", name="Correlations of the exterior orientation")
    heat.wait_for()
    rows = room(app).steps
    v.hotkey("Home")
    v.wait_until(lambda: app.state.row == 0, "the first row")
    v.page.get_by_text(f"standard errors hold for row {rows} alone").wait_for()
    heat.wait_for(state="detached")
    v.hotkey("End")
    v.wait_until(lambda: app.state.row == rows, "the last row")
    heat.wait_for()


def held_up(gate: Path, *arguments: Any) -> Iterator[Any]:
    """The bundle's work, which after its first iteration waits for a file."""
    for value in bundle_work(*arguments):
        yield value
        while isinstance(value, str) and "left" in value and not gate.exists():
            time.sleep(0.05)
            yield value


def test_stop_keeps_the_last_row_and_one_goes_on_from_it(
    session: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    app, v = session
    monkeypatch.setattr(bundle_tasks, "bundle_work", partial(held_up, tmp_path / "gate"))
    v.click_button("Run bundle")
    status = v.page.get_by_role("status", name="Bundle")
    v.page.get_by_text(re.compile(r"Iteration 1, σ0 .* s each, at most \d+ s left")).wait_for(timeout=200_000)
    assert room(app).steps == 1 and app.state.row == 1
    v.click_button("Stop bundle")
    until(app, v, lambda: not room(app).task, "the end of the work")
    v.page.get_by_text("Stopped; row 1 is kept, without standard errors.").wait_for()
    assert room(app).steps == 1 and room(app).result is None and status.count() <= 1
    v.wait_nodes("/bundle/images", "/bundle/points")
    v.hotkey("Home")
    v.wait_until(lambda: app.state.row == 0, "row 0")
    v.hotkey("End")
    v.wait_until(lambda: app.state.row == 1, "the row kept")
    monkeypatch.undo()
    v.click_button("Continue bundle")
    until(app, v, lambda: finished(app), "the bundle", 200)
    assert room(app).error == "" and room(app).result is not None and room(app).base == 1 < room(app).steps


def test_a_click_in_a_table_chooses_and_flies(session: Session) -> None:
    app, v = session
    if room(app).result is None:
        v.click_button("Run bundle")
        until(app, v, lambda: finished(app), "the bundle", 200)
    v.page.get_by_role("table", name="Bundle images").get_by_text("DSC00233", exact=True).click()
    v.wait_until(lambda: app.state.image == "DSC00233", "the image")
    v.page.get_by_text("Residuals in DSC00233").wait_for()
    v.page.get_by_role("table", name="Bundle points").get_by_text("C03", exact=True).click()
    v.wait_until(lambda: app.state.point == "C03", "the point")


def test_free_parameters_give_their_correlations_and_an_impossible_datum_a_sentence(session: Session) -> None:
    app, v = session
    v.page.get_by_text("Free interior parameters", exact=True).click()
    v.set_checkbox("Free c", True)
    until(app, v, lambda: room(app).free == ("c",), "the parameter")
    v.set_checkbox("Free k1", True)
    until(app, v, lambda: room(app).free == ("c", "k1"), "the parameters")
    v.click_button("Run bundle")
    until(app, v, lambda: finished(app) and len(getattr(room(app).result, "freed", ())) == 2, "the calibration", 200)
    v.page.get_by_role("img", name="Correlations of the interior orientation").wait_for()
    v.page.get_by_role("table", name="Interior of nex").get_by_text("k1").wait_for()
    v.page.get_by_role("img", name="Joint correlations of exterior and interior orientation").wait_for()
    v.click_button("Set bundle aside")
    v.wait_until(lambda: room(app).held is not None, "the bundle set aside")
    v.page.get_by_role("table", name="Two bundles").get_by_text("c, k1").first.wait_for()
    v.wait_nodes("/bundle/held")
    v.click_button("Put it away")
    v.wait_until(lambda: room(app).held is None, "it put away")
    v.choose("Projection", "orthogonal")
    until(app, v, lambda: room(app).model == "orthogonal", "the projection")
    v.click_button("Run bundle")
    v.wait_until(lambda: finished(app) and bool(room(app).error), "the refusal", 200)
    v.page.get_by_role("alert").get_by_text("orthogonal").wait_for()
