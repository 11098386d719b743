"""Composition: every blend shows the land where it is, without borders, ghosts or gaps; tones are evened out jointly."""

import numpy as np
import pytest

from solvers import Exterior
from solvers.errors import Unsupported
from solvers.geometry import Grid
from solvers.mosaic import ComposeOptions, Ground, Placed, compose, composition, render
from solvers.mosaic.gain import solve_tones
from solvers.mosaic.survey import survey_of

from .land import CAMERA, FLAT, FRAME, Album, hills, land, offset, strip
from .land import at as place


def mosaic(photos, album, ground=FLAT, **options) -> tuple[np.ndarray, Grid]:
    """The whole mosaic, for small ones."""
    made = composition(photos, ground, ComposeOptions(**options), album.small)
    rows, columns = made.canvas.grid.shape
    whole = np.zeros((rows, columns, 4), np.uint8)
    for job in made.jobs():
        t = job.tile
        whole[t.top:t.top + t.height, t.left:t.left + t.width] = render(job, album.window)
    return whole, made.canvas.grid


def centres(grid: Grid) -> np.ndarray:
    col, row = np.meshgrid(np.arange(grid.shape[1]), np.arange(grid.shape[0]))
    return grid.to_map(np.stack([col, row], -1))


BLENDS = [("none", False), ("average", False), ("feather", False), ("feather", True), ("multiband", False), ("multiband", True)]


@pytest.fixture(scope="module")
def photos():
    return strip(3)


@pytest.fixture(scope="module")
def album(photos):
    return Album(photos, FLAT)


@pytest.mark.parametrize(("blend", "seams"), BLENDS)
def test_a_pixel_is_where_its_coordinates_say(photos, album, blend, seams):
    whole, grid = mosaic(photos, album, blend=blend, seams=seams, side=256)
    at, seen = centres(grid), whole[..., 3] == 255
    assert np.abs(offset(whole[..., :3].astype(float), at, seen, grid.affine[0])).max() < 0.02
    error = np.abs(whole[..., :3] - land(at)).max(-1)
    assert error[seen].max() < 25 and error[seen].mean() < 4  # nothing dark at any edge
    shown = np.any([CAMERA.inside(p.pixels(FLAT.local(at))) for p in photos], axis=0)
    assert (seen == shown).mean() > 0.9999 and (whole[~seen] == 0).all()


def test_it_does_not_matter_how_it_is_cut_into_tiles(photos, album):
    for blend, worst in (("feather", 1), ("none", 0), ("multiband", 2)):
        small, _ = mosaic(photos, album, blend=blend, side=128)
        large, _ = mosaic(photos, album, blend=blend, side=512)
        assert (small[..., 3] == large[..., 3]).mean() > 0.9999  # at photo edges, to the accuracy of the lattice
        differ = np.abs(small.astype(int) - large).max(-1) > worst
        assert differ.mean() < 2e-4, blend


def test_over_hills_neighbours_agree_and_on_a_plane_they_do_not(photos):
    surface = hills()
    bumpy = Album(photos, Ground(FRAME, surface))
    whole, grid = mosaic(photos, bumpy, Ground(FRAME, surface), blend="average")
    at, seen = centres(grid), whole[..., 3] == 255
    assert np.abs(offset(whole[..., :3].astype(float), at, seen, grid.affine[0])).max() < 0.05
    assert np.abs(whole[..., :3] - land(at)).max(-1)[seen].mean() < 6
    plain, grid = mosaic(photos, bumpy, blend="average")
    assert np.abs(plain[..., :3] - land(centres(grid))).max(-1)[plain[..., 3] == 255].mean() > 15


def test_what_moves_is_shown_once_or_not_at_all_but_never_as_a_ghost(photos):
    spots = {name: FRAME.origin[:2] + np.array([17.0 + 3.0 * k, 2.0]) for k, name in enumerate(["p0", "p1", "p2"])}

    def drive(name, picture):  # a bright car, 1.5 m wide, somewhere else in every photo
        photo = next(p for p in photos if p.name == name)
        for dx in np.arange(-0.75, 0.76, 0.1):
            for dy in np.arange(-0.75, 0.76, 0.1):
                col, row = np.round(photo.pixels(FLAT.local(spots[name] + np.array([dx, dy])))).astype(int)
                if 0 <= col < 400 and 0 <= row < 300:
                    picture[row, col] = 255
        return picture

    cars = Album(photos, FLAT, drive)
    for blend in ("none", "feather", "multiband"):
        whole, grid = mosaic(photos, cars, blend=blend, seams=True)
        off = whole[..., :3].min(-1).astype(float) - land(centres(grid)).min(-1)
        ghost = (off > 40) & (off < 70) & (whole[..., 3] == 255)
        solid = ((whole[..., :3].min(-1) > 240) & (land(centres(grid)).min(-1) < 200)).sum()
        assert ghost.sum() < 12, blend
        assert solid < 60 * 2
    plain, grid = mosaic(photos, cars, blend="average")
    assert ((plain[..., :3].min(-1) - land(centres(grid)).min(-1)) > 30).sum() > 60  # the mean of all does ghost


def test_exposure_and_vignetting_are_solved_jointly(photos):
    exposure, k2 = {"p0": 0.15, "p1": -0.1, "p2": -0.05}, -0.35
    col, row = np.meshgrid(np.arange(400), np.arange(300))
    r2 = ((col - 199.5) ** 2 + (row - 149.5) ** 2) / (400**2 + 300**2) * 4

    def darker(name, picture):
        return np.clip(picture * np.exp(exposure[name] + k2 * r2)[..., None] * 0.8, 0, 255).astype(np.uint8)

    dim = Album(photos, FLAT, darker)
    made = composition(photos, FLAT, ComposeOptions(), dim.small)
    solved = solve_tones(survey_of(photos, FLAT, made.canvas, dim.small), 3, (0, 0, 0))
    found = np.array([t.exposure for t in solved.tones])
    assert found - found.mean() == pytest.approx(list(exposure.values()), abs=0.01) and found.mean() > -1e-9
    v = np.array(solved.tones[0].vignetting)
    r = np.linspace(0, 0.9, 20)[:, None] ** np.array([2, 4, 6])
    assert np.abs(r @ v - k2 * r[:, 0]).max() < 0.03
    assert solved.after < 0.3 * solved.before
    plain, grid = mosaic(photos, dim, blend="average")
    even, _ = mosaic(photos, dim, blend="average", gain=True)
    truth, seen = land(centres(grid)) * 0.8 * np.exp(-found.mean()), plain[..., 3] == 255
    assert np.abs(even[..., :3] - truth)[seen].mean() < 0.4 * np.abs(plain[..., :3] - truth)[seen].mean()


def test_a_canvas_beyond_sane_bounds_is_refused_at_once(photos):
    lost = Placed("lost", CAMERA, Exterior(place(photos[0]).m, np.array([4e5, 0.0, 100.0])))
    with pytest.raises(Unsupported, match="'lost' reaches"):
        composition([*photos, lost], FLAT)
    with pytest.raises(Unsupported, match=r"--gsd of at least 0\.00"):
        composition(photos, FLAT, ComposeOptions(gsd=1e-5))


def test_the_tiles_come_one_by_one(photos, album):
    tiles = compose(photos, FLAT, album.window, ComposeOptions(side=128))
    tile, rgba = next(tiles)
    assert rgba.shape == (tile.height, tile.width, 4)
    assert sum(1 for _ in tiles) > 5
