"""The viewer in a real browser, on the demo project: one server, one browser, waits on state and never on time."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from solvers.cameras import project
from solvers.orientation import Monoplotted
from tests.browser import ViserPage
from tests.viewer.sessions import (
    Session,
    act,
    camera_arrived,
    camera_path,
    canvas_width,
    demo_session,
    downloaded,
    expected_pixels,
    framed,
    has_pose,
    keys_work,
    photo_drawn,
    settle,
    until,
)
from viewer_app import theme, tones
from viewer_app.actions import ChooseImage, ChoosePoint, ForgetSpots, Show, Speed, Step, UseOnly, UsePoints
from viewer_app.app import App
from viewer_app.desktop import Desktop, SizePhoto
from viewer_app.figures import CORRELATION, ELEMENTS, FIGURES, ChooseFigure
from viewer_app.flying import Fly
from viewer_app.looking import Looking, looked_through
from viewer_app.paint_viser import frustum_pose
from viewer_app.panels.widgets import css
from viewer_app.photo_view import ShowWhole, ZoomToMark, percent, window
from viewer_app.picking import pick
from viewer_app.scene import frustum_depth, scene, sight, vector_scale
from viewer_app.spots import plotted
from viewer_app.state import COMPARED
from viewer_app.values import Segments
from viewer_app.widths import EDGE, FULL, OVER

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("viewer") / "demo") as made:
        yield made


# -- where things stand


def test_frustums_stand_where_the_solution_is(session: Session) -> None:
    app, v = session
    for model in ("perspective", "orthogonal"):
        v.wait_until(lambda model=model: has_pose(app, v, camera_path(app, model)), f"the {model} frustum")


def test_map_coordinates_arrive_to_a_millimetre(session: Session) -> None:
    """UTM metres have seven digits before the point: what the browser holds, plus the origin, is the solver's centre."""
    app, v = session
    frame = app.state.assets.frame
    for model in ("perspective", "orthogonal"):
        path = camera_path(app, model)
        v.wait_until(lambda path=path: has_pose(app, v, path), "the frustum")
        solution, shown = app.state.solution(model), v.pose(path)
        assert solution and solution.orientation and shown
        centre = solution.orientation.exterior.centre
        assert centre[1] > 1e6 and np.abs(frame.to_map(np.array([shown["position"]]))[0] - centre).max() < 1e-3


# -- stepping


def test_stepping_changes_the_frustum(session: Session) -> None:
    app, v = session
    path = camera_path(app)
    act(app, v, Step("last"))
    before = v.pose(path)
    v.click_button("|◀")
    v.wait_until(lambda: app.state.row == 0 and has_pose(app, v, path), "row 0")
    after = v.pose(path)
    assert before and after and np.linalg.norm(np.subtract(before["position"], after["position"])) > 1e-3
    v.click_button("▶")
    v.wait_until(lambda: app.state.row == 1 and has_pose(app, v, path), "row 1")
    v.click_button("◀")
    v.wait_until(lambda: app.state.row == 0 and v.pose(path) == after, "back in row 0")
    v.click_button("▶|")
    v.wait_until(lambda: app.state.row == app.state.last_row and has_pose(app, v, path), "the last row")


LOOKS = "() => [...window.__viserMutable.camera.position, ...window.__viserMutable.camera.quaternion]"
FRAMES = """n => new Promise(done => { const frame = () => window.__viserTestpoints.rendererInfo.render.frame, end = frame() + n;
  const look = () => { window.__viserMutable.requestRender(); frame() >= end ? done() : requestAnimationFrame(look); };
  look(); })"""
"""Resolves when so many pictures more were drawn."""


def test_keys_step_too(session: Session) -> None:
    app, v = session
    act(app, v, Step("last"))
    v.hotkey("Home")
    v.wait_until(lambda: app.state.row == 0, "Home")
    v.hotkey("ArrowRight")
    v.wait_until(lambda: app.state.row == 1, "the right arrow")
    v.hotkey("ArrowLeft")
    v.wait_until(lambda: app.state.row == 0, "the left arrow")
    looked = v.page.evaluate(LOOKS)
    for key in ("ArrowRight", "ArrowLeft"):  # held, which turns viser's camera
        v.page.keyboard.down(key)
        v.page.evaluate(FRAMES, 5)
        v.page.keyboard.up(key)
    assert v.page.evaluate(LOOKS) == looked
    act(app, v, Step("first"))
    speed = app.state.speed
    v.row("Rows / second").get_by_role("slider").focus()
    v.page.keyboard.press("ArrowRight")
    v.wait_until(lambda: app.state.speed == speed + 0.5, "the slider's own key")
    v.page.keyboard.press("ArrowLeft")
    until(app, v, lambda: app.state.speed == speed, "the slider's own key back")
    assert app.state.row == 0 and v.page.evaluate(LOOKS) == looked
    v.page.evaluate("() => document.activeElement.blur()")
    act(app, v, Speed(0.5))
    v.hotkey("Space")
    v.wait_until(lambda: app.state.playing, "play")
    v.hotkey("Space")
    v.wait_until(lambda: not app.state.playing, "pause")
    assert app.state.row < app.state.last_row
    act(app, v, Speed(speed), Step("first"))
    v.hotkey("Space")
    v.wait_until(lambda: app.state.row > 0, "play")
    v.hotkey("End")
    v.wait_until(lambda: app.state.row == app.state.last_row and not app.state.playing, "End")


def test_the_slider_and_the_plots_choose_a_row(session: Session) -> None:
    app, v = session
    act(app, v, Step("last"))
    v.set_slider("Iteration", 2)
    v.wait_until(lambda: app.state.row == 2, "row 2")
    mark = v.page.locator("svg[aria-label^='σ0'] line[data-now]")
    v.wait_until(lambda: mark.get_attribute("data-now") == "2", "the mark in the plot")
    v.page.locator("svg[aria-label^='cost'] rect[data-value='1']").click()
    v.wait_until(lambda: app.state.row == 1 and mark.get_attribute("data-now") == "1", "row 1")
    marks = v.page.locator("svg line[data-now]")
    assert [m.get_attribute("data-now") for m in marks.all()] == ["1", "1", "1"]  # σ0, cost, step
    act(app, v, Step("last"))


def test_scrubbing_reads_the_trace_and_solves_nothing(session: Session) -> None:
    app, v = session
    v.open_tab("Iterations")
    settle(app, v)
    handed = [lane._number for lane in app._jobs._lanes.values()]
    traces = app.state.work.solutions
    path = camera_path(app)
    poses = []
    for row in (0, 3, 1, 2, app.state.last_row):
        v.set_slider("Iteration", row)
        v.wait_until(lambda row=row: app.state.row == row and has_pose(app, v, path), f"row {row}")
        poses.append(v.pose(path)["position"])  # type: ignore[index]
    for figure in (CORRELATION, ELEMENTS, FIGURES[0]):
        act(app, v, ChooseFigure(figure), Step("first"), Step("next"), Step("last"))
    assert len({tuple(p) for p in poses}) > 3  # it was seen
    assert app.state.work.solutions is traces and [lane._number for lane in app._jobs._lanes.values()] == handed


def test_play_goes_at_the_speed_chosen_and_stops_at_the_end(session: Session) -> None:
    app, v = session
    v.open_tab("Iterations")
    act(app, v, Step("first"))
    before = app.state.speed
    v.set_slider("Rows / second", 20)
    until(app, v, lambda: app.state.speed == 20, "the speed")
    v.click_button("▶❙❙")
    v.wait_until(lambda: app.state.row == app.state.last_row and not app.state.playing, "the end")
    v.set_slider("Rows / second", before)
    until(app, v, lambda: app.state.speed == before, "the old speed")


def names_drawn(v: ViserPage) -> set[str]:
    """The nodes of the page's scene that are names of points and images."""
    nodes = v.page.evaluate("() => Object.keys(window.__viserSceneTree.getState())")
    return {n for n in nodes if n.startswith("/points/names/") or (n.startswith("/images/") and n.endswith("/label"))}


def test_names_and_terrain_are_switched_on_and_off(session: Session) -> None:
    app, v = session
    state, terrain = app.state, app.state.assets.terrain
    assert terrain is not None and not state.view.labels and not state.view.terrain  # the session draws neither
    v.open_tab("Scene")
    v.set_checkbox("Names", True)
    v.set_checkbox("Terrain", True)
    images = {f"/images/{i.name}/label" for i in state.block.images}
    until(app, v, lambda: app.state.view.labels and app.state.view.terrain, "the boxes")
    wanted = {n for n in scene(app.state) if n.startswith("/points/names/")} | images
    assert len(wanted) > len(images) + 5
    v.wait_until(lambda: names_drawn(v) == wanted, "every name")
    v.wait_nodes("/ground/terrain")
    heights = v.page.evaluate(
        """() => { const at = []; window.__viserMutable.nodeRefFromName['/ground/terrain'].traverse(o => {
            const p = o.geometry?.attributes?.position?.array; for (let i = 2; i < p?.length; i += 3) at.push(p[i]); });
            return at; }""")
    of_dem = terrain.vertices[:, 2]
    assert len(heights) >= len(of_dem) and np.isclose(np.ptp(heights), np.ptp(of_dem), atol=1e-3) and np.ptp(of_dem) > 1
    v.set_checkbox("Names", False)
    v.set_checkbox("Terrain", False)
    v.wait_until(lambda: not names_drawn(v) and v.visible("/ground/terrain") is None, "neither")
    v.open_tab("Iterations")


PROPS = """([node, name]) => { const found = window.__viserSceneTree.getState()[node].message.props[name];
            return typeof found === 'number' ? found : Array.from(found); }"""
"""What the page's scene holds of a node."""


def points_of(v: ViserPage, node: str) -> np.ndarray:
    """Ends (n, 2, 3) of a node's lines, as the page holds them."""
    return np.array(v.page.evaluate("""n => { const bytes = window.__viserSceneTree.getState()[n].message.props.points;
        return Array.from(bytes instanceof Float32Array ? bytes : new Float32Array(bytes.buffer, bytes.byteOffset)); }""", node),
        np.float32).reshape(-1, 2, 3)


def test_cameras_and_points_are_drawn_as_the_legend_says(session: Session) -> None:
    """Grey start, blue perspective, orange orthogonal, dashed as printed, green by GPS, thin truth; circle and triangle."""
    app, v = session
    at = f"/images/{app.state.image}"
    colours = {"initial": theme.INITIAL, "perspective": theme.PERSPECTIVE, "orthogonal": theme.ORTHOGONAL,
               "as_printed": theme.ORTHOGONAL, "georeferenced": theme.GEOREFERENCED, "truth": theme.foreground(False)}
    v.wait_nodes(*(f"{at}/{name}/camera" for name in colours), "/points/control", "/points/check")
    for name, colour in colours.items():
        drawn = v.page.evaluate(PROPS, [f"{at}/{name}/camera", "colors" if name == "as_printed" else "color"])
        assert tuple(drawn[:3]) == tones.sent(colour), name
    thick = {name: v.page.evaluate(PROPS, [f"{at}/{name}/camera", "thickness"]) for name in colours}
    assert thick["truth"] == min(thick.values()) < thick["perspective"]
    dashes = points_of(v, f"{at}/as_printed/camera")
    assert len(dashes) > 5 * 8  # of eight edges
    roles = app.state.block.points.role
    assert len(points_of(v, "/points/control")) == (3 + 24) * roles.count("control")  # a cross in a circle
    assert len(points_of(v, "/points/check")) == (3 + 3) * roles.count("check")  # a cross in a triangle
    v.open_tab("Legend")
    legend = v.page.get_by_role("list", name="Legend")
    drawn = legend.locator("[stroke]").evaluate_all("all => all.map(e => e.getAttribute('stroke'))")
    assert {css(c) for c in theme.legend().values()} <= set(drawn)
    v.open_tab("Iterations")


def test_the_difference_of_the_models_is_seen(session: Session) -> None:
    """Rays converge in the perspective centre, the orthogonal bundle is parallel and ends in the average plane; the difference of
    the centres is drawn as exaggerated as it says."""
    app, v = session
    at, before = f"/images/{app.state.image}", app.state.view.labels
    act(app, v, Show("labels", True), Step("last"))
    one, two = app.state.exterior("perspective"), app.state.exterior("orthogonal")
    assert one and two
    v.wait_nodes(f"{at}/perspective/rays", f"{at}/orthogonal/parallel", f"{at}/orthogonal/rays", f"{at}/orthogonal/plane",
                 f"{at}/difference", f"{at}/perspective/residuals")
    converging, parallel = points_of(v, f"{at}/perspective/rays"), points_of(v, f"{at}/orthogonal/parallel")
    assert np.allclose(converging[:, 0], one.centre, atol=1e-3)
    assert np.linalg.matrix_rank(np.ptp(converging, axis=1), tol=1.0) == 3
    ways = parallel[:, 1] - parallel[:, 0]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    assert len(ways) == len(converging) > 10 and np.abs(np.abs(ways @ ways[0]) - 1).max() < 1e-5
    feet = points_of(v, f"{at}/orthogonal/rays")[:, 1].astype(float)
    middle = feet.mean(axis=0)
    assert np.linalg.svd(feet - middle)[1][2] < 1e-2  # m: they lie in one plane
    assert np.abs((feet - middle) @ ways[0]).max() < 1e-2  # across the bundle
    v.wait_until(lambda: "drawn × " in written(v, f"{at}/difference_label"), "the words")
    factor = float(written(v, f"{at}/difference_label").split("drawn × ")[1])
    arrow = points_of(v, f"{at}/difference")[0]
    assert factor > 10 and np.allclose(arrow, [one.centre, one.centre + factor * (two.centre - one.centre)], atol=1e-2)
    residuals, seen = points_of(v, f"{at}/perspective/residuals"), sight(app.state, "perspective")
    assert seen is not None
    assert np.allclose(residuals[:, 1] - residuals[:, 0], vector_scale(app.state) * seen.vectors, atol=1e-2)
    act(app, v, Show("labels", before))


def written(v: ViserPage, node: str) -> str:
    """What a label of the scene says."""
    return v.page.evaluate("n => window.__viserSceneTree.getState()[n]?.message?.props?.text ?? ''", node)


def test_what_is_exaggerated_is_written_in_the_scene_beside_a_scale_bar(session: Session) -> None:
    app, v = session
    before = app.state.view
    act(app, v, Show("labels", True), Show("ellipsoids", True))
    v.wait_nodes("/ground/grid", "/ground/north", "/ground/scale")
    v.open_tab("Scene")
    v.set_slider("Residuals ×", 120)
    v.set_slider("Ellipsoids ×", 30)
    until(app, v, lambda: (app.state.view.vectors, app.state.view.ellipsoid) == (120, 30), "both sliders")
    v.wait_until(lambda: "m\nresiduals × 120\n95 % ellipsoids × 30" in written(v, "/ground/scale_label"), "the words")
    bar = points_of(v, "/ground/scale")
    assert np.isclose(np.ptp(bar[0], axis=0).max(), float(written(v, "/ground/scale_label").split(" m")[0]), rtol=1e-5)
    solution = app.state.solution("perspective")
    assert solution and solution.orientation
    axes = 2.7955 * 30 * np.sqrt(np.linalg.eigvalsh(solution.orientation.covariance[:3, :3]))  # 95 %, three degrees of freedom
    drawn = v.page.evaluate(PROPS, [camera_path(app).replace("camera", "ellipsoid"), "scale"])
    assert np.allclose(sorted(drawn), axes, rtol=1e-4)
    v.open_tab("Orientation")
    v.page.get_by_text("Ellipsoids of the centres: 95 %, factor 2.795").wait_for()
    words = v.page.get_by_role("status", name="Messages").inner_text()
    assert "a priori from the given standard errors, drawn × 30; redundancy of the adjustment " in words
    assert f"adjustment {solution.orientation.dof}" in words
    line, tab = v.box(v.page.get_by_text("drawn: residuals × 120")), v.box(v.page.get_by_role("tab", name="Orientation"))
    assert tab["y"] > line["y"] + line["height"] + 2  # the line over the tabs does not touch them
    v.open_tab("Photo")
    v.set_slider("Photo vectors ×", 20)
    until(app, v, lambda: app.state.view.photo_vectors == 20, "the photo's slider")
    v.page.get_by_text("residual × 20 ·").wait_for()
    v.open_tab("Legend")
    v.page.get_by_text("residuals on the ground × 120 · residuals on the photo × 20 · 95 % ellipsoids × 30").wait_for()
    act(app, v, *(Show(n, getattr(before, n)) for n in ("vectors", "ellipsoid", "photo_vectors", "labels", "ellipsoids")))
    assert app.state.view == before
    v.open_tab("Iterations")


def test_two_runs_are_stepped_on_one_slider(session: Session) -> None:
    app, v = session
    v.open_tab("Iterations")
    settle(app, v)
    path, kept = camera_path(app), app.state.exterior("perspective")
    v.set_checkbox("Keep this run", True)
    v.wait_nodes(path.replace("/camera", "/kept"))
    act(app, v, UseOnly(app.state.control()[12:]))
    now = app.state.exterior("perspective")
    assert kept and now and np.linalg.norm(kept.centre - now.centre) > 1e-3
    shown = v.pose(path.replace("/camera", "/kept"))
    assert shown and np.allclose(shown["position"], frustum_pose(kept)[1], atol=1e-3)  # where it was
    v.page.get_by_text("perspective kept row").wait_for()
    act(app, v, Step("first"))
    v.page.get_by_text("perspective kept row 0").wait_for()
    v.set_checkbox("Keep this run", False)
    v.page.get_by_text("perspective kept row").wait_for(state="detached")
    act(app, v, Step("last"), UsePoints(""))
    assert not app.state.work.off and v.pose(path.replace("/camera", "/kept")) is None


# -- choosing control


def test_a_click_on_a_row_switches_the_point_and_solves_again(session: Session) -> None:
    app, v = session
    name = app.state.control()[2]
    old, revision = app.state.solution("perspective"), app.state.work.revision
    v.page.locator(f"tr[data-point='{name}']").click()
    until(app, v, lambda: name in app.state.work.off, "the point to be off")
    new = app.state.solution("perspective")
    assert old and new and new.orientation and new.revision > revision and name not in new.orientation.points
    v.wait_until(lambda: has_pose(app, v, camera_path(app)), "the new frustum")
    v.wait_until(lambda: v.page.locator(f"tr[data-point='{name}']").inner_text().startswith("☐"), "the box of its row")
    v.hotkey("Control+z")
    v.wait_until(lambda: name not in app.state.work.off and app.state.solution("perspective") is old, "undo")


def test_a_click_on_the_marker_switches_the_point_too(points_only: Session) -> None:
    app, v = points_only
    points = app.state.block.points
    left, top, coarse = v.page.evaluate(
        """() => { const c = window.__viserMutable.canvas, b = c.getBoundingClientRect();
            return [b.left, b.top, b.width / c.width]; }""")
    pixels = expected_pixels(app, v) * coarse + [left, top]
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1) + np.diag(np.full(len(pixels), np.inf))
    names = [n for n, r in zip(points.names, points.role, strict=True) if r == "control"]
    on_canvas = "([x, y]) => document.elementFromPoint(x, y)?.tagName === 'CANVAS'"
    free = [j for j in np.argsort(-apart.min(axis=1)) if v.page.evaluate(on_canvas, pixels[j].tolist())]
    v.click_at(*pixels[free[0]])
    name = names[free[0]]
    until(app, v, lambda: app.state.work.off == {name}, "the point to be off")
    v.open_tab("Orientation")
    table = v.page.get_by_role("table", name="Residuals of the point")  # in every image, at once
    of, j = app.state.block.observations, app.state.block.point_index(name)
    assert table.locator("tbody tr").count() == len(np.unique(of.image[of.point == j])) > 1
    v.click_button("Switch point on or off")
    until(app, v, lambda: not app.state.work.off, "the point to be on")
    v.click_button("Make point control or check")
    until(app, v, lambda: app.state.block.points.role[j] == "check", "the check point")
    solution = app.state.solution("perspective")
    assert solution and solution.orientation and name not in solution.orientation.points
    for _ in range(3):
        v.hotkey("Control+z")
    v.wait_until(lambda: not app.state.work.off and app.state.block.points.role[j] == "control", "undo")


def test_a_cluster_is_chosen_by_its_group(session: Session) -> None:
    app, v = session
    points = app.state.block.points
    group = sorted(set(points.group) - {""})[0]
    v.open_tab("Compare")
    v.choose("Cluster", group)
    until(app, v, lambda: 0 < len(app.state.control()) < points.role.count("control"), "the cluster")
    assert {points.group[points.names.index(n)] for n in app.state.control()} == {group}
    v.open_tab("Orientation")
    assert v.page.get_by_label("GCPs used", exact=True).input_value() == group
    solution = app.state.solution("perspective")
    assert solution and (solution.orientation or solution.error)
    v.choose("GCPs used", "all")
    v.wait_until(lambda: not app.state.work.off, "all points")


def test_too_few_points_are_a_sentence(session: Session) -> None:
    app, v = session
    points = app.state.block.points
    act(app, v, UseOnly(app.state.control()[:4]))
    for name in app.state.control()[2:]:
        v.page.locator(f"tr[data-point='{name}']").evaluate("e => e.click()")
        v.wait_until(lambda name=name: name in app.state.work.off, f"{name} to be off")
    assert len(app.state.control()) == 2
    v.page.get_by_text("No perspective solution.").wait_for()
    act(app, v, UsePoints(""))
    assert len(app.state.control()) == points.role.count("control")


def test_another_image_is_chosen(session: Session) -> None:
    app, v = session
    first, other = app.state.image, app.state.block.images[-1].name
    v.choose("Image", other)
    v.wait_until(lambda: app.state.image == other, "the other image")
    v.wait_nodes(f"/images/{other}/perspective/rays")
    act(app, v, ChooseImage(first))
    assert app.state.image == first


# -- two people


def test_a_second_browser_sees_and_changes_the_same_state(session: Session) -> None:
    app, v = session
    act(app, v, Step("first"))
    page = v.page.context.new_page()
    try:
        page.set_viewport_size({"width": 900, "height": 500})
        page.goto(f"http://127.0.0.1:{app.port}/?fixedDpr=1")
        second = ViserPage(page, v.log)
        second.wait_connected()
        v.wait_until(lambda: has_pose(app, second, camera_path(app)), "the frustum in the second browser")
        assert app.state.row == 0 and second.pose(camera_path(app)) == v.pose(camera_path(app))
        keys_work(second)
        second.hotkey("End")
        v.wait_until(
            lambda: app.state.row == app.state.last_row and has_pose(app, v, camera_path(app)),
            "the last row in the first browser",
        )

        def words() -> list[str]:
            return [p.page.get_by_role("table", name="Orientation").inner_text() for p in (v, second)]

        v.wait_until(lambda: "±" in words()[0] and len(set(words())) == 1, "the same table in both browsers")
    finally:
        page.close()
        v.page.bring_to_front()


# -- measuring


def test_a_point_is_measured_on_the_photo_to_half_a_pixel(session: Session) -> None:
    app, v = session
    state = app.state
    name = state.control()[0]
    j, i = state.block.point_index(name), state.block.image_index(state.image)
    of = state.block.observations
    target = of.pixel[(of.image == i) & (of.point == j)][0] + [7.0, -5.0]
    act(app, v, ChoosePoint(name))
    v.open_tab("Photo")
    photo_drawn(app, v)
    camera = state.block.camera_of(state.image)
    picture = v.page.get_by_role("img", name="Photo " + state.image)
    picture.wait_for()
    box = v.box(picture)
    at = {"x": (target[0] + 0.5) / camera.width * box["width"], "y": (target[1] + 0.5) / camera.height * box["height"]}
    picture.click(position=at)  # type: ignore[arg-type]
    v.wait_until(lambda: app.state.mark is not None, "the mark")
    magnifier = v.page.get_by_role("img", name="Magnifier")
    magnifier.wait_for()
    factor = camera.width / state.assets.photos[state.image].size[0]
    for _ in range(2):  # the magnifier is centred anew on every click
        mark = app.state.mark
        assert mark
        if np.abs(np.array([mark.col, mark.row]) - target).max() < 0.1 * factor:
            break  # a click there would not move it
        v.wait_until(
            lambda mark=mark: f"col {mark.col:.2f}" in v.page.locator("div:has(> svg[aria-label=Magnifier])").inner_text(),
            "the magnifier",
        )
        box, inner = v.box(magnifier), magnifier.locator("circle")
        at = [float(inner.get_attribute(c) or "nan") for c in ("cx", "cy")] + (target - [mark.col, mark.row]) / factor
        x, y = np.clip(at / 49, 0.02, 0.98) * box["width"]
        magnifier.click(position={"x": float(x), "y": float(y)})
        until(app, v, lambda mark=mark: app.state.mark != mark, "the mark to move")
    mark = app.state.mark
    assert mark and np.abs(np.array([mark.col, mark.row]) - target).max() < 0.5 * factor
    v.click_button("Place mark")
    v.wait_until(lambda: app.state.mark is None and app.state.block is not state.block, "the observation")
    now = app.state.block.observations
    assert np.allclose(now.pixel[(now.image == i) & (now.point == j)][0], [mark.col, mark.row]) and len(now) == len(of)
    v.hotkey("Control+z")
    v.wait_until(lambda: app.state.block is state.block, "undo")
    v.open_tab("Iterations")


def test_the_photo_is_zoomed_to_800_percent_and_a_mark_set_to_a_tenth_of_a_pixel(session: Session) -> None:
    app, v = session
    v.open_tab("Photo")
    state, name = app.state, app.state.control()[1]
    j = state.block.point_index(name)
    row = next(r for r in state.block.seen_in(state.image) if state.block.observations.point[r] == j)
    act(app, v, ChoosePoint(name))
    photo_drawn(app, v)
    received = v.log.bytes_received
    v.click_button("800 %")
    until(app, v, lambda: percent(app.state) > 799, "the zoom")
    v.page.locator("[data-percent]", has_text="800 %").wait_for()
    picture = v.page.get_by_role("img", name="Photo ")
    assert 0 < v.log.bytes_received - received < 1_000_000  # the part that is seen, not the photo
    box, shown = v.box(picture), window(app.state)
    assert shown.width < box["width"] / 7
    target = state.block.observations.pixel[row] + [3.3, -2.4]
    u, w = shown.place(*target)
    v.page.mouse.click(box["x"] + u * box["width"], box["y"] + w * box["height"])
    v.wait_until(lambda: app.state.mark is not None, "the mark")
    mark = app.state.mark
    assert mark and np.abs(np.array([mark.col, mark.row]) - target).max() <= 0.1
    v.click_button("Drop mark")
    v.wait_until(lambda: app.state.mark is None, "the mark to go")
    v.click_button("whole")
    v.wait_until(lambda: window(app.state).width == state.block.camera_of(state.image).width, "the whole photo")
    v.open_tab("Iterations")


def test_the_photo_takes_as_much_of_the_page_as_one_wants(session: Session) -> None:
    """On a large screen: it grows at a key, is sent as fine as it is shown, never 5 MB; all stays in sight; marks to 0.1 px."""
    app, v = session
    name, before = app.state.control()[2], v.page.viewport_size
    assert before
    v.open_tab("Iterations")
    v.page.set_viewport_size({"width": 2560, "height": 1440})
    v.wait_until(lambda: 0 <= 2560 - FULL - canvas_width(v) < 10, "the wider panel")
    act(app, v, ChoosePoint(name))
    v.hotkey("v")  # opens the tab; the photo is as large as it was left
    picture = v.page.get_by_role("img", name="Photo ")
    picture.wait_for()
    photo_drawn(app, v)
    large, received = v.box(picture), v.log.bytes_received
    assert app.state.room(Desktop).photo == "large" and large["width"] > 1200
    v.hotkey("v")
    until(app, v, lambda: app.state.room(Desktop).photo == "whole scene", "the whole scene")
    photo_drawn(app, v)
    whole = v.box(picture)
    assert whole["width"] > large["width"] + 150 and whole["height"] > 0.7 * 1440 and 2560 - FULL - whole["width"] < 250
    last = v.box(v.page.get_by_role("button", name="Drop mark"))
    assert whole["y"] > 0 and last["y"] + last["height"] < 1440  # nothing has to be scrolled to
    v.wait_until(lambda: sent_width(v) >= 1500, "all pixels of the photo's file")
    act(app, v, ZoomToMark())
    shown = window(app.state)
    assert percent(app.state) == pytest.approx(800) and shown.width == pytest.approx(whole["width"] / 8, abs=0.01)
    state = app.state
    j = state.block.point_index(name)
    row = next(r for r in state.block.seen_in(state.image) if state.block.observations.point[r] == j)
    target = state.block.observations.pixel[row] + [-31.3, 22.6]
    u, w = shown.place(*target)
    v.page.mouse.click(whole["x"] + u * whole["width"], whole["y"] + w * whole["height"])
    until(app, v, lambda: app.state.mark is not None, "the mark")
    mark, magnifier = app.state.mark, v.box(v.page.get_by_role("img", name="Magnifier"))
    assert mark and np.abs(np.array([mark.col, mark.row]) - target).max() <= 0.1
    assert v.box(picture) == whole  # the photo has not moved under the pointer
    middle = whole["x"] + whole["width"] / 2
    assert middle < magnifier["x"] < whole["x"] + whole["width"] - magnifier["width"]  # in the photo, far from the mark
    assert v.log.bytes_received - received < 5_000_000
    v.click_button("Drop mark")
    v.hotkey("v")
    until(app, v, lambda: app.state.room(Desktop).photo == "small", "the small photo")
    photo_drawn(app, v)
    assert v.box(picture)["width"] == OVER - EDGE
    act(app, v, ShowWhole(), SizePhoto("large"), ChoosePoint(None))
    v.open_tab("Iterations")
    v.page.set_viewport_size(before)
    v.wait_until(lambda: framed(app, v), "the view beside the panels")


def sent_width(v: ViserPage) -> int:
    """Pixels across the picture that the browser was sent of the photo."""
    return v.page.evaluate(
        """async () => { const image = new Image();
            image.src = getComputedStyle(document.documentElement).getPropertyValue('--collinea-photo').slice(4, -1);
            await image.decode();
            return image.naturalWidth; }""")


def test_wheel_and_shift_drag_move_about_the_photo(session: Session) -> None:
    app, v = session
    v.open_tab("Photo")
    photo_drawn(app, v)
    camera = app.state.block.camera_of(app.state.image)
    picture = v.page.get_by_role("img", name="Photo ")
    box = v.box(picture)
    picture.hover(position={"x": 0.6 * box["width"], "y": 0.4 * box["height"]})  # waits until it lies still
    place = photo_place(app, v, 0.6 * camera.width, 0.4 * camera.height)
    v.page.mouse.wheel(0, -240)
    until(app, v, lambda: window(app.state).width < camera.width, "the zoom")
    shown = window(app.state)
    assert np.hypot(*np.subtract(shown.pixel(0.6, 0.4), (0.6 * camera.width, 0.4 * camera.height))) < camera.width / 100
    v.page.keyboard.down("Shift")
    v.page.mouse.down()
    v.page.mouse.move(place[0] - 60, place[1] - 20, steps=4)
    v.page.mouse.up()
    v.page.keyboard.up("Shift")
    v.wait_until(lambda: window(app.state).left > shown.left, "the photo to move")
    assert app.state.mark is None and not app.state.work.off
    v.click_button("whole")
    v.wait_until(lambda: window(app.state).width == camera.width, "the whole photo")
    v.open_tab("Iterations")


def photo_place(app: App, v: ViserPage, col: float, row: float) -> tuple[float, float]:
    """Where a pixel of the chosen photo is on the page."""
    camera, box = app.state.block.camera_of(app.state.image), v.box(v.page.get_by_role("img", name="Photo "))
    return box["x"] + (col + 0.5) / camera.width * box["width"], box["y"] + (row + 0.5) / camera.height * box["height"]


def test_a_click_gives_ground_coordinates(session: Session) -> None:
    """A click on a measured control point's image: its ground coordinates, to what half a pixel of the page allows."""
    app, v = session
    v.open_tab("Photo")
    photo_drawn(app, v)
    v.choose("A click", "gives ground coordinates")
    until(app, v, lambda: app.state.click == "monoplot" and app.state.assets.surface is not None, "the mode")
    block, name = app.state.block, app.state.control()[0]
    j = block.point_index(name)
    row = next(r for r in block.seen_in(app.state.image) if block.observations.point[r] == j)
    picture = v.page.get_by_role("img", name="Photo ")
    v.page.get_by_text("click for ground coordinates").wait_for()
    v.page.mouse.click(*photo_place(app, v, *block.observations.pixel[row]))
    until(app, v, lambda: len(app.state.spots) == 1, "the place")
    [(_, place)] = plotted(app.state)
    assert isinstance(place, Monoplotted)
    reach = block.camera_of(app.state.image).width / v.box(picture)["width"]  # photo px in one page px
    ground_pixel = 300 * 0.0039 / 35
    assert np.linalg.norm(place.ground[:2] - block.points.xyz[j, :2]) < 1.5 * reach * ground_pixel
    v.wait_nodes("/spots/1/cross", "/spots/1/ellipse")
    assert f"{place.ground[0]:.3f}" in v.page.get_by_role("table", name="Ground coordinates").inner_text()
    assert app.state.mark is None
    act(app, v, ForgetSpots())
    v.choose("A click", "measures the point")
    v.wait_until(lambda: app.state.click == "measure" and not app.state.spots, "the mode")


# -- comparing


def test_a_rectangle_on_the_photo_chooses_control_and_all_solutions_stand_beside_each_other(session: Session) -> None:
    app, v = session
    v.open_tab("Photo")
    photo_drawn(app, v)
    block, image = app.state.block, app.state.image
    picture = v.page.get_by_role("img", name="Photo ")
    picture.wait_for()
    camera = block.camera_of(image)
    edge = 0.55 * camera.width
    of = block.observations
    at = {block.points.names[of.point[r]]: of.pixel[r] for r in block.seen_in(image, ("control",))}
    tolerance = camera.width / 100
    left, near = ({n for n, p in at.items() if p[0] < edge + d} for d in (-tolerance, tolerance))
    picture.hover(position={"x": 20, "y": 20})  # waits until it lies still
    v.page.mouse.move(*photo_place(app, v, 20, 20))
    v.page.mouse.down()
    for x in (0.2 * camera.width, edge):
        v.page.mouse.move(*photo_place(app, v, x, camera.height - 20))
    v.page.mouse.up()
    until(app, v, lambda: app.state.work.off, "the rectangle")
    assert left <= set(app.state.control()) <= near and app.state.mark is None
    v.open_tab("Compare")
    v.set_checkbox("Draw all", True)
    v.wait_nodes(f"/images/{image}/one_pass/camera", f"/images/{image}/with_prior/camera", f"/images/{image}/as_printed/camera",
                 f"/images/{image}/difference/with_prior")
    settle(app, v)
    table = v.page.get_by_role("table", name="Solutions compared")
    words = table.inner_text()
    assert all(model in words for model in COMPARED) and "±" in words
    errors = v.page.get_by_role("table", name="Predicted and actual error").inner_text()
    assert "actual" in errors and "predicted" in errors
    said = [float(d) for d in re.findall(r"Δ ([+-][\d.]+)", words)]
    one, two = app.state.exterior("perspective"), app.state.exterior("orthogonal")
    assert one and two and len(said) == 6 * (len(COMPARED) - 1)
    assert np.allclose(said[:: len(COMPARED) - 1][:3], two.centre - one.centre, atol=0.006)
    advice = v.page.get_by_role("note", name="Advice")
    assert advice.inner_text().startswith("Advice: ") and advice.locator("li").count() >= 1
    act(app, v, Step("first"))  # one slider steps all of them
    v.wait_until(lambda: "±" not in table.inner_text(), "row 0 in the table")
    act(app, v, Step("last"), Show("compared", False))
    v.set_text("Names of GCPs", "G0*")
    v.click_button("Use these points")
    v.wait_until(lambda: set(app.state.control()) == {n for n in at if n.startswith("G0")}, "the points named")
    act(app, v, UsePoints(""))
    assert not app.state.work.off
    v.open_tab("Iterations")
    v.open_tab("Orientation")


# -- figures, and through a photo


def test_figures_of_the_solution_are_chosen_in_the_panel(session: Session) -> None:
    app, v = session
    v.open_tab("Iterations")
    v.choose("Figure", CORRELATION)
    for model in ("perspective", "orthogonal"):
        heat = v.page.get_by_role("img", name=f"Correlation, {model}")
        heat.wait_for()
        drawn = [float(r) for r in heat.locator("[data-r]").evaluate_all("all => all.map(e => e.dataset.r)")]
        solution = app.state.solution(model)
        assert solution and solution.orientation
        c = solution.orientation.covariance
        assert np.allclose(np.reshape(drawn, (6, 6)), c / np.sqrt(np.outer(np.diag(c), np.diag(c))), atol=1e-4)
    v.hotkey("p")
    drawn = v.page.get_by_role("img", name=f"Residuals on the photo {app.state.image}")
    drawn.wait_for()
    assert drawn.locator("[data-residual]").count() >= 2 * len(app.state.control()) * 0.8
    v.choose("Figure", ELEMENTS)
    for name in ("|X − final| m", "|Y − final| m", "|Z − final| m", "|ω − final| °", "|φ − final| °"):
        v.page.get_by_role("img", name=name).locator("line[data-now]").wait_for(state="attached")
    v.page.get_by_role("img", name="|κ − final| °").locator("rect").first.click()
    v.wait_until(lambda: app.state.row == 0, "row 0")
    act(app, v, Step("last"))
    v.choose("Figure", FIGURES[0])
    v.page.get_by_role("img", name="σ0").wait_for()


def test_one_looks_through_a_frustum_and_returns(session: Session) -> None:
    app, v = session
    image = app.state.image
    v.wait_until(lambda: camera_arrived(app, v), "the browser's camera")
    camera = next(iter(app.server.get_clients().values())).camera
    before = np.array(camera.position), camera.fov
    v.hotkey("l")
    v.wait_nodes("/through")
    exterior = app.state.exterior("perspective")
    assert exterior is not None
    v.wait_until(lambda: looked_through(app.state) == image, "the photo over the scene")
    v.wait_until(lambda: np.allclose(camera.position, exterior.centre, atol=1e-3), "the eye in the perspective centre")
    settle(app, v)
    v.wait_until(lambda: camera_arrived(app, v), "the page's own camera")
    block = app.state.block
    # a measured point of the ground and its image lie over each other
    rows = block.seen_in(image, ("control",))
    xyz = app.state.assets.frame.to_local(block.points.xyz[block.observations.point[rows]])
    drawn = np.array([v.project(p) for p in xyz])
    pixel = block.observations.pixel[rows]
    scale = np.linalg.lstsq(np.column_stack([pixel, np.ones(len(pixel))]), drawn, rcond=None)[0]
    off = np.column_stack([pixel, np.ones(len(pixel))]) @ scale - drawn
    assert np.abs(off).max() < 1.0  # px of the screen
    v.open_tab("Scene")
    v.set_slider("Photo opacity", 0.25)
    material = """() => { let seen = null; window.__viserMutable.nodeRefFromName['/through']?.traverse(
        o => { seen = o.material?.opacity ?? seen; }); return seen; }"""
    v.wait_until(lambda: abs((v.page.evaluate(material) or 0) - 0.25) < 1e-6, "a paler photo")
    v.set_slider("Photo opacity", 0.6)
    until(app, v, lambda: app.state.room(Looking).opacity == 0.6, "the photo as before")
    v.open_tab("Iterations")
    v.hotkey("Escape")
    v.wait_until(lambda: np.allclose(camera.position, before[0], atol=1e-3), "the way back")
    v.wait_until(lambda: abs(camera.fov - before[1]) < 1e-6, "the field of view")
    v.wait_until(lambda: not looked_through(app.state), "no photo over the scene")
    v.wait_until(lambda: camera_arrived(app, v), "the page's own camera")
    other, place = clickable(app, v)
    v.click_at(*place)
    until(app, v, lambda: looked_through(app.state) == other, "the frustum clicked to be looked through")
    v.hotkey("Escape")
    v.wait_until(lambda: not looked_through(app.state) and np.allclose(camera.position, before[0], atol=1e-3), "the way back")
    act(app, v, ChooseImage(image))


def clickable(app: App, v: ViserPage) -> tuple[str, tuple[float, float]]:
    """An image other than the chosen one whose picture in the scene no panel covers, and where its middle is on the page."""
    camera = next(iter(app.server.get_clients().values())).camera
    for name in (i.name for i in app.state.block.images if i.name != app.state.image):
        exterior = app.state.exterior("perspective", name)
        assert exterior is not None
        middle = exterior.centre - frustum_depth(app.state) * exterior.m[2]
        meant = pick(app.state, np.array(camera.position), middle - camera.position, 0.0)
        place = v.project(middle)
        on_canvas = v.page.evaluate("([x, y]) => document.elementFromPoint(x, y)?.tagName === 'CANVAS'", place)
        if on_canvas and meant == Fly("through", name):
            return name, place
    raise AssertionError("no frustum is to be seen")


# -- ways out


def test_the_scene_is_downloaded_as_glb(session: Session) -> None:
    import trimesh

    app, v = session
    loaded: Any = trimesh.load(io.BytesIO(downloaded(app, v, "Scene as GLB", "glb")), file_type="glb")
    assert camera_path(app) in loaded.graph.nodes
    loaded = trimesh.load(io.BytesIO(downloaded(app, v, "Scene as PLY", "ply")), file_type="ply")
    assert len(loaded.faces) > 20 and np.isfinite(loaded.vertices).all()
    centres = np.array([e.centre for m in ("perspective", "orthogonal") if (e := app.state.exterior(m))])
    assert np.linalg.norm(loaded.vertices[:, None] - centres, axis=2).min(axis=0).max() < 1e-2  # metres from the scene's origin


def test_saving_writes_what_was_edited(session: Session) -> None:
    from solvers.io import read_project

    app, v = session
    v.open_tab("Project")
    v.click_button("Save project")
    v.wait_until(lambda: app.state.message.startswith("Saved in "), "the message")
    assert app.state.assets.folder is not None
    again = read_project(app.state.assets.folder)
    assert np.array_equal(again.observations.pixel, app.state.block.observations.pixel)


def corner(v: ViserPage) -> np.ndarray:
    """Mean colour (3,) of a small piece of the page's empty background, as a person sees it."""
    from io import BytesIO

    from PIL import Image

    shot = v.page.screenshot(clip={"x": 4, "y": 4, "width": 12, "height": 12})
    return np.asarray(Image.open(BytesIO(shot)).convert("RGB"), float).mean(axis=(0, 1))


def test_dark_and_light(session: Session) -> None:
    app, v = session
    v.open_tab("Project")
    v.wait_until(lambda: corner(v).min() > 240, "a light page")
    v.set_checkbox("Dark", True)
    v.wait_until(lambda: app.state.view.dark and corner(v).max() < 60, "a dark page")
    truth = f"/images/{app.state.image}/truth/camera"
    v.wait_until(lambda: tuple(v.page.evaluate(PROPS, [truth, "color"])) == tones.sent(theme.foreground(True)), "a light truth")
    v.set_checkbox("Dark", False)
    v.wait_until(lambda: not app.state.view.dark and corner(v).min() > 240, "a light page")


def test_the_run_opens_in_rerun_beside_the_scene(session: Session) -> None:
    app, v = session
    v.open_tab("Project")
    v.click_button("Open in rerun")
    frame: Any = v.page.locator("iframe[title=rerun]")
    frame.wait_for()
    address = frame.get_attribute("src")
    assert address.startswith(("http://127.0.0.1:", "http://localhost:"))
    v.wait_until(lambda: any(f.url.startswith(address.split("?")[0]) for f in v.page.frames), "rerun's page")
    origin = address.split("/?")[0]
    v.wait_until(lambda: f"{origin}/recording.rrd" in v.log.answered, "rerun to start and fetch the recording", 200)
    inside = [url for url in v.log.requests if not url.startswith(f"http://127.0.0.1:{app.port}/")]
    assert all(url.startswith((origin, "data:", "blob:", f"ws://127.0.0.1:{app.port}")) for url in inside)  # and nobody else
    v.open_tab("Close")
    v.click_button("Close rerun")
    frame.wait_for(state="detached")


def test_a_damaged_message_of_a_page_does_no_harm(session: Session) -> None:
    app, v = session
    act(app, v, Step("last"))
    before = app.state.work
    for text in ("", "[]", json.dumps(["point", "../../etc/passwd", "1"]), json.dumps(["row", "999999999", "1"])):
        v.page.evaluate(
            "([uuid, value]) => window.__viserMutable.sendMessage({type: 'GuiUpdateMessage', uuid, updates: {value}})",
            [app._wire._box._impl.uuid, text],
        )
    v.page.evaluate(
        "([uuid, value]) => window.__viserMutable.sendMessage({type: 'GuiUpdateMessage', uuid, updates: {value}})",
        [app._wire._box._impl.uuid, json.dumps(["row", "0", "1"])],
    )
    v.wait_until(lambda: app.state.row == 0, "row 0")
    assert app.state.work is before
    act(app, v, Step("last"))


def test_projection_of_the_frustum_is_that_of_the_solver(session: Session) -> None:
    """The drawn ray of each used point leads through its observed pixel."""
    app, _ = session
    rays = scene(app.state)[f"/images/{app.state.image}/perspective/rays"]
    exterior = app.state.exterior("perspective")
    assert isinstance(rays, Segments) and exterior is not None
    block = app.state.block
    pixels = project(block.camera_of(app.state.image), exterior, rays.points[:, 1])
    rows = block.seen_in(app.state.image, ("control",))
    assert np.allclose(pixels, block.observations.pixel[rows], atol=1e-5)
