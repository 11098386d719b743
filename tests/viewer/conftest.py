"""A small site made by hand: a tilted camera over sixteen points in four groups, with check points, a photo and known truth.

And what every module with a `session` (sessions.py) shares.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points
from solvers.cameras import project
from solvers.geometry import LocalFrame
from tests.viewer.sessions import POINTS_ONLY, Session, act, settle
from viewer_app.actions import Show
from viewer_app.loading import first_state
from viewer_app.state import Assets, Photo, State, Terrain, Work

CAMERA = Interior(35.0, pixel_mm=0.0039, width=6000, height=4000)
ORIGIN = np.array([500100.0, 5400200.0, 120.0])


def make_block(seed: int = 3, sigma: float = 0.5) -> tuple[Block, dict[str, Exterior]]:
    """Two tilted images over 16 points (4 groups, 3 of them check points) at UTM-size coordinates, noise seeded."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-90, 90, 4), np.linspace(-60, 60, 4))
    local = np.stack([x.ravel(), y.ravel(), rng.uniform(-15, 15, 16)], axis=1)
    names = tuple(f"G{i:02d}" for i in range(1, 17))
    role = tuple("check" if i in (5, 10, 15) else "control" for i in range(16))
    points = Points(names, local + ORIGIN, np.full((16, 3), np.nan), role, tuple(f"group {'ABCD'[i // 4]}" for i in range(16)))
    truth = {
        "left": Exterior.from_angles(0.08, -0.12, 0.4, np.array([-40.0, -20.0, 300.0]) + ORIGIN),
        "right": Exterior.from_angles(-0.1, 0.15, -0.2, np.array([55.0, 25.0, 310.0]) + ORIGIN),
    }
    pixels = np.concatenate([project(CAMERA, e, points.xyz) for e in truth.values()]) + rng.normal(0, sigma, (32, 2))
    inside = CAMERA.inside(pixels)
    image, point = np.repeat([0, 1], 16), np.tile(np.arange(16), 2)
    observations = Observations(image[inside], point[inside], pixels[inside], np.full(int(inside.sum()), sigma))
    return Block(
        "Hand-made", "local", {"uav": CAMERA}, (Image("left", "uav"), Image("right", "uav")), points, observations
    ), truth


def make_state(photo: Path | None = None) -> State:
    block, truth = make_block()
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame)
    x, y = np.meshgrid(np.linspace(-110, 110, 12), np.linspace(-80, 80, 9))
    vertices = np.stack([x.ravel(), y.ravel(), 6 * np.sin(x.ravel() / 40) - 20], axis=1)
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    terrain = Terrain(vertices, faces, np.full((len(vertices), 3), 190, np.uint8))
    local = {name: e.shifted(frame.origin) for name, e in truth.items()}
    photos = {}
    if photo is not None:
        from viewer_app.loading import PANE

        assert PANE >= 1000
        from PIL import Image as Picture

        pixels = np.asarray(Picture.open(photo))
        photos = {"left": Photo(photo, pixels[::3, ::3], pixels, (pixels.shape[1], pixels.shape[0]))}
    return replace(first_state(State(Work(block), Assets(None, frame, photos, terrain, truth=local), "left")), image="left")


def flat(state: State) -> State:
    """The same without terrain."""
    return replace(state, assets=replace(state.assets, terrain=None))


@pytest.fixture(autouse=True)
def nothing_goes_wrong(request: pytest.FixtureRequest, caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """After every test with a browser: neither page nor viewer had an error, and the page asked nobody else for anything."""
    session = request.getfixturevalue("session") if "session" in request.fixturenames else None
    yield
    if session is not None:
        app, v = session
        settle(app, v)
        assert v.log.errors == [] and v.log.external == []
        assert [r.getMessage() for r in caplog.get_records("call") if r.name == "collinea" and r.levelname == "ERROR"] == []


@pytest.fixture
def points_only(session: Session) -> Iterator[Session]:
    """A session whose scene shows the points alone."""
    app, v = session
    before = app.state.view
    act(app, v, *(Show(name, False) for name in POINTS_ONLY))
    yield app, v
    act(app, v, *(Show(name, getattr(before, name)) for name in POINTS_ONLY))


@pytest.fixture(scope="session")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of 1000 x 667 file pixels for a format of 6000 x 4000."""
    from PIL import Image as Picture

    rng = np.random.default_rng(1)
    coarse = rng.integers(90, 170, (67, 100, 3), dtype=np.uint8)
    path = tmp_path_factory.mktemp("photo") / "left.png"
    Picture.fromarray(coarse).resize((1000, 667), resample=3).save(path)
    return path


@pytest.fixture
def state() -> State:
    return make_state()
