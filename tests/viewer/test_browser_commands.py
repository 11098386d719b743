"""Every control is explained and reachable by keyboard; the state outlives browsers and restarts. Real browser."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from rerun.chunk import RrdReader

from tests.browser import PATIENCE, ViserPage
from tests.viewer.sessions import (
    COARSE,
    DEMO,
    HEAVY,
    Session,
    act,
    camera_path,
    canvas_width,
    demo_session,
    downloaded,
    has_pose,
    keys_work,
    settle,
    until,
)
from viewer_app.acting import CHOICES
from viewer_app.actions import (
    Aim,
    ChoosePoint,
    Clicking,
    ForgetSpots,
    Place,
    Plot,
    Set,
    Show,
    Speed,
    Step,
    SwitchPoint,
    Undo,
    UseOnly,
)
from viewer_app.actions_points import EditPoint, SwitchRole
from viewer_app.app import App
from viewer_app.bridge import controls
from viewer_app.bundle_actions import FreeParameter, SetBundle
from viewer_app.bundle_state import Bundle
from viewer_app.desktop import Desktop, SizePanel, SizePhoto, typed
from viewer_app.epochs import DrawEllipsoids, Exaggerate
from viewer_app.figures import ELEMENTS, ChooseFigure
from viewer_app.kept_run import KeepRun, kept_of
from viewer_app.lists import ShowRows, SortBy
from viewer_app.looking import Opacity
from viewer_app.matching_actions import LookAt, Pair, Tune
from viewer_app.mosaic_actions import Choose, Look
from viewer_app.panels.widgets import QUIET
from viewer_app.photo_view import ZoomPhoto
from viewer_app.session import to_json
from viewer_app.tabs import tabs
from viewer_app.widths import SCENE

UNIT = re.compile(r"×|°|%|\b(m|mm|px|pixels?|metres|rows?|per second|epochs?|factor|no unit)\b", re.IGNORECASE)
pytestmark = [pytest.mark.browser, pytest.mark.timeout(200)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("commands") / "demo", size=(1150, 760)) as made:
        yield made


def commands(app: App) -> dict[str, Any]:
    return {h.label: h for h in app.server.gui._command_handle_from_uuid.values()}  # type: ignore[attr-defined]


def palette(v: ViserPage, words: str) -> None:
    """Run a command as people do: Ctrl+K, some letters, Enter."""
    v.hotkey("Control+k")
    box = v.page.get_by_placeholder("Search").or_(v.page.locator("input[type=search]")).first
    box.wait_for()
    box.fill(words)
    v.page.get_by_text(words, exact=True).last.wait_for()
    v.page.keyboard.press("Enter")


def test_every_control_has_a_label_and_a_hint_and_every_number_a_unit(session: Session) -> None:
    app, _ = session
    seen = 0
    for handle in controls(app.server.gui):
        props: Any = handle._impl.props  # type: ignore[attr-defined]
        if props.label == "wire":
            continue
        seen += 1
        assert props.label.strip() and props.hint and len(props.hint) > 10, props.label
        if isinstance(handle, viser.GuiSliderHandle | viser.GuiNumberHandle):
            assert UNIT.search(f"{props.label} {props.hint}"), props.label
    assert seen > 100


def test_every_control_has_a_label_of_its_own_and_its_own_command(session: Session) -> None:
    """A button one of its name; anything else one for each thing that can be done with it: "Label: what"."""
    app, _ = session
    every = [h.label for h in app.server.gui._command_handle_from_uuid.values()]  # type: ignore[attr-defined]
    assert len(set(every)) == len(every)
    found: Any = [h for h in controls(app.server.gui) if h._impl.props.label != "wire"]
    kinds = [(type(h).__name__, h._impl.props.label) for h in found]
    assert len(set(kinds)) == len(kinds) > 100
    actions = {c.label for tab in tabs() for c in tab.commands}
    for handle in found:
        props: Any = handle._impl.props
        label = props.label
        if isinstance(handle, viser.GuiButtonGroupHandle):
            wanted = {f"{label}: {option}" for option in props.options}
        elif handle._impl.is_button and not isinstance(handle, viser.GuiUploadButtonHandle):
            wanted = {label}
        else:
            ends = {viser.GuiCheckboxHandle: ("on or off",), viser.GuiDropdownHandle: ("next",), viser.GuiTextHandle: ("type",),
                    viser.GuiUploadButtonHandle: ("choose a file",), viser.GuiSliderHandle: ("more", "less"),
                    viser.GuiNumberHandle: ("more", "less")}  # fmt: skip
            wanted = {f"{label}: {end}" for end in ends[type(handle)]}
        assert wanted <= set(every) | actions, label


def test_one_button_of_a_tab_stands_out(session: Session) -> None:
    """What one mostly comes for, and beside it only what takes over a result that waits; all other buttons are grey."""
    app, _ = session
    found: Any = [h for h in controls(app.server.gui) if isinstance(h, viser.GuiButtonHandle)]
    assert {h.color for h in found} == {None, QUIET}
    standing = [(app.tab_of.get(h._impl.uuid, ""), h.label) for h in found if h.color is None]
    waiting = {"Accept all found", "Accept conjugate point"}
    mains = [tab for tab, label in standing if label not in waiting]
    assert len(set(mains)) == len(mains) and {"Photo", "Bundle", "Mosaic", "Matching", "Project"} <= set(mains)


def test_the_palette_steps_and_switches(session: Session) -> None:
    app, v = session
    act(app, v, Step("last"))
    palette(v, "First row")
    v.wait_until(lambda: app.state.row == 0, "the first row")
    before = app.state.view.rays
    palette(v, "Rays: on or off")
    until(app, v, lambda: app.state.view.rays is not before, "the rays")
    v.open_tab("Scene")
    v.wait_until(lambda: v.page.get_by_label("Rays", exact=True).is_checked() is not before, "the box")
    act(app, v, Show("rays", before))
    palette(v, "Image: next")
    v.wait_until(lambda: app.state.image != app.state.block.images[0].name, "the next image")
    palette(v, "Residuals ×: more")
    v.wait_until(lambda: app.state.view.vectors > 200, "longer vectors")
    palette(v, "Last row")
    v.wait_until(lambda: app.state.row == app.state.last_row, "the last row")


def test_a_text_box_is_reached_by_the_palette(session: Session) -> None:
    app, v = session
    v.open_tab("Orientation")
    palette(v, "Names of GCPs: type")
    box = v.row("Names of GCPs").get_by_role("textbox")
    v.wait_until(lambda: box.count() == 1 and box.evaluate("e => e === document.activeElement"), "the focus in the box")
    names = app.state.control()[:5]
    v.page.keyboard.type(" ".join(names))
    v.page.keyboard.press("Enter")
    v.wait_until(lambda: any(getattr(h, "value", None) == " ".join(names) for h in controls(app.server.gui)), "the names typed")
    palette(v, "Use these points")
    until(app, v, lambda: set(app.state.control()) == set(names), "the points named")
    act(app, v, Undo())
    assert not app.state.work.off
    v.open_tab("Orientation")


def test_a_map_is_handed_over_and_nothing_else(session: Session, tmp_path: Path) -> None:
    app, v = session
    folder = app.state.assets.folder
    assert folder is not None
    wrong, right = tmp_path / "wrong.tif", tmp_path / "a map.tif"
    wrong.write_text("<script>alert(1)</script>")
    right.write_bytes((DEMO / "dem.tif").read_bytes())
    v.open_tab("Mosaic")
    v.page.get_by_text("Map under the mosaic", exact=True).click()
    v.upload("Hand over a map", wrong)
    v.wait_until(lambda: "wrong.tif is no TIFF" in app.state.message, "the refusal")
    assert not (folder / "maps").exists()
    with v.page.expect_file_chooser() as chooser:
        palette(v, "Hand over a map: choose a file")
    chooser.value.set_files(right)
    v.wait_until(lambda: (folder / "maps" / "a_map.tif").is_file(), "the map in the project")
    assert (folder / "maps" / "a_map.tif").read_bytes() == right.read_bytes()
    v.page.get_by_text("There is no finished mosaic yet").wait_for()
    box = v.row("Map file").get_by_role("textbox")
    v.wait_until(lambda: box.input_value() == "maps/a_map.tif", "its name in the box, for Compare with map")
    v.open_tab("Orientation")


def test_a_hundred_edits_of_all_tabs_are_undone_and_redone_by_key(session: Session) -> None:
    app, v = session
    names, of = app.state.control()[:6], app.state.block.observations
    col, row = of.pixel[0] + 3.0
    edits = [*map(SwitchPoint, names), *(EditPoint(names[0], f, "0.25") for f in ("sX", "sY", "sZ")), SwitchRole(names[1]),
             Aim(float(col), float(row), names[0]), Place(), Set("robust", True), UseOnly(names[2:]),
             *(Plot(50.0 + n, 60.0) for n in range(30)), ForgetSpots(),
             *(FreeParameter("k1", n % 2 == 0) for n in range(20)), *(SetBundle("datum", d) for d in ("both", "free") * 5),
             *(Tune("threshold", 0.3 + n / 50) for n in range(16)), *(Choose("gsd", n / 10) for n in range(1, 15))]

    def content() -> str:
        work = to_json(app.state, app._keeper.disk)["work"]
        return json.dumps([{**work, "rooms": 0}, {n: repr(get(app.state)) for n, (get, _) in CHOICES.items()}])

    depth, before = len(app.state.past), content()
    act(app, v, *edits)
    count, after = len(app.state.past) - depth, content()
    assert count == len(edits) - 1 > 100  # to aim is no edit
    for _ in range(count):
        v.hotkey("Control+z")
    until(app, v, lambda: len(app.state.past) == depth, "all taken back")
    assert content() == before and len(app.state.future) == count
    for _ in range(count):
        v.hotkey("Control+y")
    until(app, v, lambda: len(app.state.past) == depth + count, "all brought back")
    assert content() == after
    act(app, v, *[Undo()] * count)
    assert content() == before


def test_leaving_and_coming_back_loses_nothing(session: Session) -> None:
    app, v = session
    name = app.state.control()[0]
    act(app, v, Step("first"), SwitchPoint(name))
    state = app.state
    v.page.reload()
    v.wait_connected()
    v.wait_nodes(camera_path(app))
    v.wait_until(lambda: has_pose(app, v, camera_path(app)), "the frustum")
    assert app.state is state and name in app.state.work.off
    v.wait_until(lambda: v.page.locator(f"tr[data-point='{name}']").inner_text().startswith("☐"), "the point's row")
    keys_work(v)
    v.hotkey("Control+z")
    v.wait_until(lambda: name not in app.state.work.off, "undo")
    act(app, v, Step("last"))


def test_the_tables_are_handed_over(session: Session) -> None:
    app, v = session
    with zipfile.ZipFile(io.BytesIO(downloaded(app, v, "Tables as CSV", "tables.zip"))) as tables:
        assert {"points.csv", "images.csv", "orientations.csv", "residuals.csv", "iterations.csv"} <= set(tables.namelist())


def test_the_recording_is_handed_over(session: Session, tmp_path: Path) -> None:
    app, v = session
    path = tmp_path / "run.rrd"
    path.write_bytes(downloaded(app, v, "Recording as RRD", "rrd"))
    paths = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert {f"/images/{i.name}/{m}/camera" for i in app.state.block.images for m in ("perspective", "orthogonal")} <= paths


def test_the_replay_is_handed_over(session: Session) -> None:
    app, v = session
    page = downloaded(app, v, "Replay as HTML", "html")
    assert page.lstrip()[:15].lower() == b"<!doctype html>" and 1e5 < len(page) < 10e6


def test_the_project_is_handed_over_as_one_file(session: Session) -> None:
    app, v = session
    with zipfile.ZipFile(io.BytesIO(downloaded(app, v, "Project as ZIP", "zip"))) as archive:
        assert {"demo/project.toml", "demo/points.csv", "demo/observations.csv"} <= set(archive.namelist())


@contextlib.contextmanager
def another_page(v: ViserPage, port: int) -> Iterator[ViserPage]:
    """A further page in the same browser."""
    page = v.page.context.new_page()
    try:
        page.set_viewport_size({"width": 900, "height": 600})
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(f"http://127.0.0.1:{port}/?fixedDpr={COARSE:g}")
        other = ViserPage(page, v.log)
        other.wait_connected()
        yield other
    finally:
        page.close()
        v.page.bring_to_front()


CHOSEN = (ChoosePoint("G04"), EditPoint("G05", "sZ", "0.02"), Clicking("monoplot"), Plot(500.0, 600.0), Speed(7.5), KeepRun(),
          ChooseFigure(ELEMENTS), Opacity(0.3), SortBy("points", "Z"), ShowRows("G"), ZoomPhoto(6.0, 0.3, 0.4),
          Pair("left", "DSC00230"), LookAt("left", 2500.0, 1200.0, 900.0), Tune("threshold", 0.7), SetBundle("colour", "none"),
          SetBundle("datum", "both"), Choose("kind", "uncontrolled"), Look("click", "measure"), Exaggerate(50.0),
          DrawEllipsoids(False))
"""Of every tab something that is kept over a restart."""


def test_another_version_of_viser_shows_plain_tables_and_is_worked_by_ordinary_controls(
    session: Session, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of viser's private parts is touched then: no wire, no guard of values, no palette of controls."""
    folder = tmp_path_factory.mktemp("plain") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    monkeypatch.setattr("viewer_app.bridge.KNOWN", "0.9.")
    with App(folder) as app:
        assert not app._wire.works
        for name in HEAVY:
            app.emit(Show(name, False))
        with another_page(session[1], app.port) as v:
            v.wait_until(app.settled, "the viewer to settle", 200)
            table = v.page.get_by_role("table", name="Ground control points")
            table.wait_for()
            v.wait_nodes(camera_path(app))
            name = app.state.control()[0]
            row = table.locator(f"tr[data-point='{name}']")
            row.click()  # means nothing here
            assert table.locator("[onclick]").count() == 0
            v.open_tab("Points")
            points = v.page.get_by_role("table", name="Points", exact=True)
            points.wait_for()
            assert points.locator("input").count() == 0 and f"{app.state.block.points.xyz[0, 0]:.3f}" in points.inner_text()
            v.open_tab("Orientation")
            assert not app.state.work.off
            v.choose("Point", name)
            v.wait_until(lambda: app.state.point == name, "the point")
            v.click_button("Switch point on or off")
            v.wait_until(lambda: app.state.work.off == {name} and app.settled(), "the point to be off, and the solution")
            v.wait_until(lambda: row.inner_text().startswith("☐") and has_pose(app, v, camera_path(app)), "the page to follow")
            v.hotkey("Home")
            v.wait_until(lambda: app.state.row == 0 and has_pose(app, v, camera_path(app)), "row 0")


def test_a_restart_reconnects_and_restores_the_state(session: Session, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("restart") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    first = App(folder)
    try:
        for name in HEAVY:
            first.emit(Show(name, False))
        with another_page(session[1], first.port) as v:
            settle(first, v)
            point = first.state.control()[1]
            act(first, v, SwitchPoint(point), Show("rays", False), Show("vectors", 321.0), *CHOSEN)
            act(first, v, FreeParameter("c"), Step("first"), SizePanel("wide"), SizePhoto("small"))
            v.open_tab("Compare")
            v.set_text("Names of GCPs", "G0*")
            until(first, v, lambda: typed(first.state, "Names of GCPs") == "G0*", "words in a box")
            v.open_tab("Scene")
            until(first, v, lambda: first.state.room(Desktop).below == "Scene", "the tabs")
            eyes = first._eyes
            v.wait_until(lambda: bool(eyes.homes), "the first view")
            camera = next(iter(first.server.get_clients().values())).camera
            position = camera.position + np.array([3.0, -2.0, 1.0])
            camera.position = position
            v.wait_until(
                lambda: len(eyes.view) == 6 and np.allclose(eyes.view[:3], position, atol=1e-3), "the way to another view"
            )
            before, looked = first.state, eyes.view
            said = to_json(first._left_as(), first._keeper.disk)
            first.close()
            with App(folder, port=first.port) as second:
                assert second.port == first.port
                v.wait_until(lambda: len(second.server.get_clients()) == 1, "the browser to come back")
                settle(second, v)
                now = second.state
                assert now.work.off == before.work.off == {point} and now.view == before.view
                assert len(now.past) == len(before.past) == 7
                again = to_json(second._left_as(), second._keeper.disk)
                assert len(said["rooms"]) >= 9 and again["rooms"].keys() == said["rooms"].keys()
                assert {k: v for k, v in again["rooms"].items() if v != said["rooms"][k]} == {}, said["rooms"]
                assert again == said
                second_run = kept_of(now)["perspective"]
                assert (second_run.rows[-1].x == kept_of(before)["perspective"].rows[-1].x).all()
                assert now.row == 0 and now.image == before.image and now.view.vectors == 321
                assert now.room(Bundle).free == ("c",)
                assert (now.room(Desktop).panel, now.room(Desktop).photo) == ("wide", "small")
                v.wait_until(lambda: 0 <= SCENE - canvas_width(v) < 10, "the wide panel, as far as the page has room")
                assert second._eyes.view == looked and np.allclose(second.server.initial_camera.position, position, atol=1e-3)
                for tab in ("Compare", "Scene"):
                    v.page.get_by_role("tab", name=tab, exact=True, selected=True).wait_for()
                assert v.row("Names of GCPs").get_by_role("textbox").input_value() == "G0*"
                v.wait_until(lambda: has_pose(second, v, camera_path(second)), "the frustum")
                one, two = before.solution("perspective"), now.solution("perspective")
                assert one and two and one.orientation and two.orientation
                assert (one.orientation.exterior.vector == two.orientation.exterior.vector).all()
                keys_work(v)
                v.hotkey("Control+z")
                v.wait_until(lambda: second.state.room(Bundle).free == (), "undo after the restart")
                for _ in range(6):
                    v.hotkey("Control+z")
                v.wait_until(lambda: not second.state.work.off and not second.state.past, "undo of the edits before")
                begin = second.server.initial_camera
                v.hotkey("h")
                v.wait_until(lambda: np.linalg.norm(begin.position - position) > 1, "newcomers to begin at home again")
    finally:
        first.close()
