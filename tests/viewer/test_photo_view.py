"""The photo pane's window: zoom keeps the place under the pointer, picks round-trip, the picture sent is small."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.viewer.conftest import make_state
from viewer_app.acting import update
from viewer_app.actions import Aim, ChooseImage, ChoosePoint
from viewer_app.panels.photo import _coded, _heard_in, _heard_pan, _heard_photo, _heard_size, photo_html
from viewer_app.panels.widgets import jpeg
from viewer_app.photo_view import (
    MOST,
    PANE_WIDTH,
    DrawnPhoto,
    PanPhoto,
    PhotoView,
    PyramidReady,
    ShowWhole,
    Window,
    ZoomPhoto,
    ZoomToMark,
    cut,
    make,
    percent,
    picture,
    tasks,
    window,
)
from viewer_app.state import Photo, State


@pytest.fixture
def shown(picture_state: State) -> State:
    return picture_state


@pytest.fixture(scope="module")
def picture_state(tmp_path_factory: pytest.TempPathFactory) -> State:
    from PIL import Image

    rng = np.random.default_rng(1)
    path = tmp_path_factory.mktemp("photo") / "left.png"
    pixels = np.asarray(Image.fromarray(rng.integers(60, 200, (60, 90, 3), dtype=np.uint8)).resize((3000, 2000), 3))
    Image.fromarray(pixels).save(path, compress_level=1)
    state = make_state()
    photo = Photo(path, pixels[::8, ::8], pixels[::3, ::3], (3000, 2000))
    return replace(state, assets=replace(state.assets, folder=path.parent, photos={"left": photo}))


def test_zooming_keeps_the_place_under_the_pointer(shown: State) -> None:
    rng = np.random.default_rng(3)
    state = shown
    for _ in range(200):
        u, v = rng.uniform(0.3, 0.7, 2)
        before = window(state).pixel(u, v)
        state = update(state, ZoomPhoto(float(rng.choice([1.5, 1.2, 1 / 1.3])), u, v))
        now, camera = window(state), state.block.camera_of("left")
        assert 0 <= now.left <= camera.width - now.width + 1e-6 and 0 <= now.top <= camera.height - now.height + 1e-6
        if 0 < now.left < camera.width - now.width and 0 < now.top < camera.height - now.height:
            assert np.allclose(now.pixel(u, v), before, atol=1e-6)


def test_picks_round_trip_to_a_millionth_of_a_pixel(shown: State) -> None:
    state = update(update(shown, ZoomPhoto(37.0, 0.3, 0.8)), PanPhoto(0.2, -0.1))
    rng = np.random.default_rng(4)
    for u, v in rng.uniform(0, 1, (500, 2)):
        assert np.allclose(window(state).place(*window(state).pixel(u, v)), (u, v), atol=1e-9)
        aim = _heard_photo(state, (u, v))
        assert isinstance(aim, Aim) and np.allclose(window(state).place(aim.col, aim.row), (u, v), rtol=0, atol=1e-9)


def test_eight_hundred_per_cent_around_the_point(shown: State) -> None:
    state = update(update(shown, ChoosePoint("G07")), ZoomToMark())
    assert percent(state) == pytest.approx(800) and window(state).width == PANE_WIDTH / 8
    block = state.block
    row = next(r for r in block.seen_in("left") if block.observations.point[r] == block.point_index("G07"))
    assert np.allclose(window(state).pixel(0.5, 0.5), block.observations.pixel[row], atol=1e-6)
    assert percent(update(state, ZoomPhoto(2.0))) == pytest.approx(1600)
    assert window(update(state, ShowWhole())).width == 6000 == window(update(state, ChooseImage("right"))).width


@pytest.mark.parametrize("action", [ZoomPhoto(float("nan")), ZoomPhoto(0.0), ZoomPhoto(1e9), ZoomPhoto(-2.0)])
def test_nonsense_changes_nothing(shown: State, action: ZoomPhoto) -> None:
    assert update(shown, action) is shown and _heard_in(shown, "x") is None and _heard_pan(shown, (0.1, 0.2)) is None


def test_the_pyramid_is_made_once_and_the_picture_then_is_sharp(shown: State) -> None:
    [task] = tasks(shown)
    assert list(make(*task.arguments))[-1] == 1.0 and list(make(*task.arguments)) == [1.0]
    ready = update(shown, PyramidReady("left"))
    assert not tasks(ready) and update(ready, PyramidReady("left")) is ready
    assert task.arrive(1.0) == PyramidReady("left")
    near = update(update(ready, ChoosePoint("G07")), ZoomToMark())
    photo = near.assets.photos["left"]
    part = cut(near, photo)
    assert part is not None and part[1] is not None
    sharp = picture(*part).astype(int)
    from PIL import Image

    pixels = np.asarray(Image.open(photo.path))
    shown_now = window(near)
    x, y = shown_now.left / 2, shown_now.top / 2  # the file has half the format
    sides = zip(sharp.shape[:2], (shown_now.height / 2, shown_now.width / 2), strict=True)
    ys, xs = ((np.arange(n) + 0.5) / n * side for n, side in sides)
    honest = pixels[np.floor(y + ys).astype(int)[:, None], np.floor(x + xs).astype(int)[None]]
    assert np.abs(sharp - honest).mean() < 6
    blurred = cut(replace(near, rooms={**near.rooms, PhotoView: replace(near.room(PhotoView), ready=())}), photo)
    assert blurred is not None and blurred[1] is None and picture(*blurred).size > 0


def test_a_wide_pane_is_sent_as_many_pixels_as_it_shows(shown: State) -> None:
    """The photo's file has 3000 x 2000 pixels for a format of 6000 x 4000, its small picture 1000 x 667."""
    photo = shown.assets.photos["left"]
    small = update(update(shown, PyramidReady("left")), DrawnPhoto(700.0))
    assert small.room(PhotoView).pane == 700 and cut(small, photo) is None  # the small picture will do
    wide = update(small, DrawnPhoto(1700.0))
    whole = cut(wide, photo)
    assert whole is not None and picture(*whole).shape == (1200, 1800, 3)
    near = cut(update(wide, ZoomPhoto(1.5)), photo)
    assert near is not None and 1700 <= picture(*near).shape[1] <= 1800
    dense = cut(update(small, DrawnPhoto(1000.0, 2.5)), photo)
    assert dense is not None and picture(*dense).shape[1] == MOST
    assert update(wide, DrawnPhoto(300.0)).room(PhotoView).sharp == 1700  # another browser may still be wide
    assert cut(update(shown, DrawnPhoto(1700.0)), photo) is None  # no pyramid yet: the small picture, at once


@pytest.mark.parametrize("action", [DrawnPhoto(10.0), DrawnPhoto(math.nan), DrawnPhoto(500.0, 0.0), DrawnPhoto(500.0, math.inf)])
def test_a_pane_of_no_size_changes_nothing(shown: State, action: DrawnPhoto) -> None:
    assert update(shown, action) is shown and _heard_size(shown, "x") is None
    assert _heard_size(shown, (0.05, 0.2)) == DrawnPhoto(500.0, 2.0)


def test_a_photo_hardly_larger_than_its_small_picture_is_prepared_when_it_is_looked_at_closely(shown: State) -> None:
    photo = replace(shown.assets.photos["left"], size=(1500, 1000))
    calm = replace(shown, assets=replace(shown.assets, photos={"left": photo}))
    assert not tasks(calm)
    assert len(tasks(update(calm, ZoomPhoto(2.0)))) == len(tasks(update(calm, DrawnPhoto(1400.0)))) == 1


def test_the_largest_picture_of_the_noisiest_photo_stays_below_five_megabytes(shown: State) -> None:
    noise = np.random.default_rng(7).integers(0, 256, (MOST * 2 // 3, MOST, 3), dtype=np.uint8)
    photo = replace(shown.assets.photos["left"], pane=noise)
    part = (photo, None, (6000, 4000), Window(0.0, 0.0, 6000.0, 4000.0), MOST)
    assert len(jpeg(picture(*part), 88)) > 5_000_000 > len(_coded(part)) > 1_000_000


def test_no_picture_is_large(shown: State) -> None:
    ready = update(shown, PyramidReady("left"))
    photo = ready.assets.photos["left"]
    for times in (1.01, 2.0, 5.0, 40.0, 99.0):
        part = cut(update(ready, ZoomPhoto(times)), photo)
        assert part is not None and len(jpeg(picture(*part), 88)) < 1_000_000


def test_the_svg_shows_the_window(shown: State) -> None:
    from viewer_app.bridge import Wire

    wire: Wire = object.__new__(Wire)
    wire.works = True
    text = photo_html(update(shown, ZoomPhoto(10.0)), wire)
    now = window(update(shown, ZoomPhoto(10.0)))
    assert f'viewBox="{now.left:.6f} {now.top:.6f} {now.width:.6f} {now.height:.6f}"' in text and "68 %" in text
    assert Path(shown.assets.photos["left"].path).exists()
