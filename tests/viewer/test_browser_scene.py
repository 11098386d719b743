"""The pixels of the scene in a real browser: everything stands where projection says, in the colours of the legend, at 4K too."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.browser import ViserPage
from tests.viewer.sessions import (
    HEAVY,
    Session,
    act,
    camera_arrived,
    camera_path,
    demo_session,
    downloaded,
    expected_pixels,
    settle,
)
from viewer_app import theme
from viewer_app.actions import Show
from viewer_app.app import App
from viewer_app.flying import Fly
from viewer_app.ground import site, symbol_size
from viewer_app.scene import scene
from viewer_app.values import PointCloud, Scene, Segments

pytestmark = [pytest.mark.browser, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("scene") / "demo", drawn=True) as made:
        yield made


def test_the_demo_opens(session: Session) -> None:
    app, v = session
    state = app.state
    v.wait_nodes(
        "/ground/terrain",
        "/points/control",
        "/images/" + state.image + "/orthogonal/plane",
        *(camera_path(app, m, i.name) for m in ("perspective", "orthogonal") for i in state.block.images),
    )
    v.page.get_by_role("table", name="Orientation").wait_for()
    assert v.page.get_by_text(f"{len(state.control())} control points on").is_visible()
    assert all(s.orientation is None or s.orientation.trace.converged for s in state.work.solutions.values())
    act(app, v, *(Show(name, False) for name in HEAVY))  # seen once; what follows needs no beauty


def boxes(v: ViserPage, what: str) -> np.ndarray:
    """Left, top, right, bottom (n, 4) px of the labels that are drawn: "words" or "names"."""
    drawn = v.page.evaluate("() => window.collineaLabels.drawn()")
    return np.array([d["box"] for d in drawn if d["shown"] and d["words"] == (what == "words")]).reshape(-1, 4)


def clashes(found: np.ndarray) -> int:
    """How many pairs of boxes (n, 4) lie over each other by more than a tenth of a pixel."""
    low, high = np.maximum(found[:, None, :2], found[None, :, :2]), np.minimum(found[:, None, 2:], found[None, :, 2:])
    over = (high - low > 0.1).all(axis=2)
    return int(np.triu(over, 1).sum())


def test_words_follow_the_theme_are_never_hidden_and_names_make_room(session: Session) -> None:
    """Through the very picture: boxes and letters in the theme's colours; scale and exaggerations between the panels; no two
    labels over each other while the camera turns, and few of them come and go."""
    app, v = session
    act(app, v, Show("labels", True))
    v.page.wait_for_function("() => collineaLabels.works() && collineaLabels.drawn().filter(d => d.words).length > 3")
    for dark in (True, False):
        act(app, v, Show("dark", dark))
        picture = np.asarray(v.wait_still(tolerance=0.05, timeout=120), float)
        for left, top, right, bottom in boxes(v, "words"):  # letters stand in the middle of a box whose edge is plain
            inside = picture[int(top) + 3 : int(bottom) - 2, int(left) + 3 : int(right) - 2, :3].mean(axis=2)
            assert (inside.max() > 190 and np.median(inside) < 130) if dark else (inside.min() < 80 and np.median(inside) > 180)
    size = v.page.evaluate("() => [window.__viserMutable.canvas.clientWidth, window.__viserMutable.canvas.clientHeight]")
    panel = v.page.evaluate("() => window.collineaLabels.panels()")
    assert len(panel) == 1 and panel[0][0] == 12
    orbit = "a => window.__viserMutable.cameraControl.rotate(a, 0, false)"
    drawn_at = "f => window.__viserTestpoints.rendererInfo.render.frame > f"
    turned, states = 12, []
    for _ in range(turned):
        words, names = boxes(v, "words"), boxes(v, "names")
        assert len(names) >= 6 and clashes(np.vstack([words, names])) == 0
        on = (words[:, 2] > 0) & (words[:, 0] < size[0]) & (words[:, 3] > 0) & (words[:, 1] < size[1])
        assert on.sum() >= 3 and (words[on, :2] >= 0).all() and (words[on, 2:] <= size).all()
        assert clashes(np.vstack([words[on], panel])) == 0
        states.append(v.page.evaluate("() => window.collineaLabels.drawn().filter(d => !d.words).map(d => d.shown)"))
        frame = v.page.evaluate("() => window.__viserTestpoints.rendererInfo.render.frame")
        v.page.evaluate(orbit, 0.01)
        v.page.wait_for_function(drawn_at, arg=frame)
    alike = [np.array(s) for s in states if len(s) == len(states[0])]
    flips = np.abs(np.diff(alike, axis=0)).sum(axis=0)
    assert len(alike) > turned / 2 and flips.max() <= 2 and flips.sum() < 0.05 * np.size(alike)
    v.page.evaluate(orbit, -0.01 * turned)
    act(app, v, Show("labels", False))


def measured_points(app: App, v: ViserPage) -> tuple[np.ndarray, np.ndarray]:
    """Distances (k,) px from where points should be to where their symbols are drawn, and their largest error of colour (k,)."""
    expected = expected_pixels(app, v)
    picture = np.asarray(v.wait_still(tolerance=0.05, timeout=120), float)
    apart = np.linalg.norm(expected[:, None] - expected[None], axis=-1) + np.diag(np.full(len(expected), np.inf))
    rows, cols = np.mgrid[: picture.shape[0], : picture.shape[1]]
    distances, colours = [], []
    for (x, y), nearest in zip(expected, apart.min(axis=1), strict=True):
        around = np.hypot(cols + 0.5 - x, rows + 0.5 - y) < min(nearest / 2, 18)
        error = np.abs(picture[..., :3] - np.array(theme.CONTROL)).max(axis=-1)
        drawn = around & (picture[..., 3] > 250) & (error < 40)
        if nearest < 12 or not around.any():
            continue
        distances.append(np.hypot(cols[drawn].mean() + 0.5 - x, rows[drawn].mean() + 0.5 - y) if drawn.sum() > 8 else np.inf)
        colours.append(error[around & (picture[..., 3] > 250)].min(initial=np.inf))
    return np.array(distances), np.array(colours)


def test_points_appear_where_projection_says_and_in_their_colour(points_only: Session) -> None:
    app, v = points_only
    act(app, v, Fly("points", ""))
    distances, colours = measured_points(app, v)
    assert (
        len(distances) >= 3
        and np.linalg.matrix_rank(expected_pixels(app, v) - expected_pixels(app, v).mean(axis=0), tol=5.0) == 2
    )
    assert distances.max() < 3.0 and colours.max() <= 2.0


def test_every_colour_of_the_legend_is_seen_as_it_says(points_only: Session) -> None:
    """Within 2/255, drawn as lines are and as points are."""
    app, v = points_only
    honest = scene(app.state)
    low, high = site(app.state)
    colours = list(theme.legend().items())
    at = np.linspace(low, high, len(colours))
    ends = np.stack([at, at + np.array([0.3, -0.3, 0]) * (high - low)[:2].max()], axis=1)
    camera = next(iter(app.server.get_clients().values())).camera
    before, middle = (np.array(camera.position), np.array(camera.look_at)), ends.mean(axis=(0, 1))
    camera.position, camera.look_at = middle + np.array([0, -1.0, 2.0]) * (high - low)[:2].max(), middle
    lines: Scene = {f"/line/{name}": Segments(ends[None, k], colour, 7.0) for k, (name, colour) in enumerate(colours)}
    dots = PointCloud(at, np.array([colour for _, colour in colours], np.uint8), 0.05 * float((high - low)[:2].max()))
    v.wait_until(lambda: np.allclose(camera.look_at, middle, atol=1e-3) and camera_arrived(app, v), "the camera")
    try:
        for drawn, least in ((lines, 20), (Scene({"/dots": dots}), 200)):
            app._painter.paint(drawn)
            settle(app, v)
            v.wait_nodes(*drawn)
            picture = np.asarray(v.wait_still(tolerance=0.05, timeout=120), float)
            for name, colour in colours:
                error = np.abs(picture[..., :3] - np.array(colour)).max(axis=-1)[picture[..., 3] > 250]
                assert (error <= 2).sum() > least, (name, error.min())
    finally:
        camera.position, camera.look_at = before
        app._painter.paint(honest)
        settle(app, v)
        v.wait_until(lambda: np.allclose(camera.look_at, before[1], atol=1e-3) and camera_arrived(app, v), "the camera")


def test_the_size_of_a_point_follows_its_distance(points_only: Session) -> None:
    app, v = points_only
    camera = next(iter(app.server.get_clients().values())).camera
    before = np.array(camera.position), np.array(camera.look_at)
    points = app.state.block.points
    xyz = app.state.assets.frame.to_local(points.xyz)
    apart = np.linalg.norm(xyz[:, None] - xyz[None], axis=-1) + np.diag(np.full(len(xyz), np.inf))
    k = max((j for j, r in enumerate(points.role) if r == "control"), key=lambda j: apart[j].min())  # the loneliest
    order = [j for j, r in enumerate(points.role) if r == "control"].index(k)
    way, sizes = (before[0] - before[1]) / np.linalg.norm(before[0] - before[1]), []
    for wanted in (48, 24):  # px
        distance = symbol_size(app.state) * camera.image_height / 2 / np.tan(camera.fov / 2) / wanted
        camera.position, camera.look_at = xyz[k] + distance * way, xyz[k]
        v.wait_until(lambda: np.allclose(camera.look_at, xyz[k]) and camera_arrived(app, v), "the camera")
        picture = np.asarray(v.wait_still(tolerance=0.05, timeout=120), float)
        at = expected_pixels(app, v)[order]
        rows, cols = np.mgrid[: picture.shape[0], : picture.shape[1]]
        off = np.hypot(cols + 0.5 - at[0], rows + 0.5 - at[1])
        error = np.abs(picture[..., :3] - np.array(theme.CONTROL)).max(axis=-1)
        sizes.append(off[(off < 1.6 * wanted) & (picture[..., 3] > 250) & (error < 40)].max())
    camera.position, camera.look_at = before
    v.wait_until(lambda: np.allclose(camera.look_at, before[1]) and camera_arrived(app, v), "the camera")
    assert 40 < sizes[0] < 60 and 20 < sizes[1] < 32


def test_that_measurement_fails_when_the_y_axis_is_flipped(points_only: Session) -> None:
    app, v = points_only
    honest = scene(app.state)
    symbols = honest["/points/control"]
    assert isinstance(symbols, Segments)
    flipped = replace(symbols, points=symbols.points * np.array([1.0, -1.0, 1.0]))
    app._painter.paint({**honest, "/points/control": flipped})
    settle(app, v)
    try:
        distances, _ = measured_points(app, v)
        assert not (distances < 3.0).all() and np.median(distances) > 3.0
    finally:
        app._painter.paint(honest)
        settle(app, v)


def test_the_scene_is_a_picture_in_4k(session: Session) -> None:
    app, v = session
    with Image.open(io.BytesIO(downloaded(app, v, "Picture as PNG", "png"))) as picture:
        assert picture.size == (3840, 2160) and len(picture.convert("RGB").resize((96, 54)).getcolors(10_000) or ()) > 20
