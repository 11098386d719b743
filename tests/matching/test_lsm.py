"""Least squares matching: exact on exact data, honest about its precision, and a refusal where nothing can be found."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter

from solvers.errors import Unsupported
from solvers.matching import LsmOptions, Status, match_lsm, match_ncc, prepare

SHAPE = np.array([[1.03, 0.05], [-0.04, 0.98]])


def waves(seed: int, count: int = 60, sigma: float = 1.6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A band-limited texture that can be sampled exactly anywhere: wave vectors, amplitudes, phases."""
    rng = np.random.default_rng(seed)
    k = rng.normal(0, 1 / (sigma * np.sqrt(2)), (count, 2))
    return k, rng.normal(0, 20 / np.sqrt(count / 2), count), rng.uniform(0, 7, count)


def render(texture: tuple, shape: np.ndarray, shift: np.ndarray, size: int = 260) -> np.ndarray:
    """Image whose pixel q shows the texture at inv(shape) (q - shift): the conjugate of p is shape p + shift."""
    k, a, phase = texture
    row, col = np.mgrid[0:size, 0:size]
    q = np.stack([col.ravel(), row.ravel()], 1) - shift
    p = q @ np.linalg.inv(shape).T
    return (120 + np.cos(p @ k.T + phase) @ a).reshape(size, size)


def pair(seed: int, noise: float = 0.0, shape: np.ndarray = SHAPE, shift: tuple[float, float] = (-3.3, 7.7)):
    texture, move = waves(seed), np.array(shift)
    rng = np.random.default_rng(seed + 1)
    left = render(texture, np.eye(2), np.zeros(2)) + rng.normal(0, noise, (260, 260))
    right = 0.8 * render(texture, shape, move) + 15 + rng.normal(0, noise * 0.8, (260, 260))
    g = np.arange(45.0, 215, 12)
    at = np.stack(np.meshgrid(g, g), -1).reshape(-1, 2)
    return left.astype(np.float32), right.astype(np.float32), at, at @ shape.T + move


def test_exact_data_is_matched_to_a_thousandth_of_a_pixel_with_its_affine_and_gain():
    left, right, at, truth = pair(1)
    r = match_lsm(left, right, at, truth + np.array([0.4, -0.3]), options=LsmOptions(step=1e-4))
    assert r.ok.all()
    assert np.sqrt(np.mean((r.pixel - truth) ** 2)) < 1e-3
    assert np.abs(r.shape - SHAPE).max() < 2e-3
    assert np.abs(r.radiometric[:, 1] + 1 - 1 / 0.8).max() < 5e-3
    assert r.score.min() > 0.9999


def test_noise_stays_near_the_cramer_rao_bound_and_the_reported_sigmas_tell_it():
    left, right, at, truth = pair(2, noise=3.0)
    r = match_lsm(left, right, at, truth + 0.3, shape=SHAPE)
    assert r.ok.all()
    error = r.pixel - truth
    bound = np.array([bound_of(left_exact, 3.0) for left_exact in windows(2, at)])
    ratio = np.sqrt((error**2).mean() / bound.mean())
    assert 0.85 < ratio < 1.2
    assert 0.85 < np.sqrt((r.sigma**2).mean() / (error**2).mean()) < 1.15
    normal = np.linalg.solve(r.covariance, error[..., None])[..., 0]
    chi = (error * normal).sum(1)
    assert abs(chi.mean() - 2) < 0.5


@pytest.mark.parametrize("scale", [0.85, 1.0, 1.15])
def test_sigmas_hold_at_any_scale_and_where_one_photo_is_softer(scale: float):
    shape, error, sigma = scale * np.eye(2), [], []
    sharp, other, at, truth = pair(9, 0.0, shape, (130 - 130 * scale, 130 - 130 * scale))
    soft = gaussian_filter(other, 0.4)
    rng = np.random.default_rng(10)
    for _ in range(4):
        left, right = sharp + rng.normal(0, 4, sharp.shape), soft + rng.normal(0, 4, soft.shape)
        r = match_lsm(left, right, at, truth + 0.2, shape=shape)
        error.append(r.pixel - truth)
        sigma.append(r.sigma)
    ratio = np.sqrt(np.nanmean(np.square(sigma)) / np.nanmean(np.square(error)))
    assert 0.92 < ratio < 1.09


def windows(seed: int, at: np.ndarray):
    exact = render(waves(seed), np.eye(2), np.zeros(2))
    return [exact[int(r) - 11 : int(r) + 12, int(c) - 11 : int(c) + 12] for c, r in at]


def bound_of(window: np.ndarray, noise: float) -> float:
    """Cramer-Rao bound of the shift, mean variance of both coordinates, all eight parameters free, both images noisy."""
    gy, gx = np.gradient(window)
    gx, gy, g = gx[1:-1, 1:-1].ravel(), gy[1:-1, 1:-1].ravel(), window[1:-1, 1:-1].ravel()
    v, u = (a.ravel() for a in np.mgrid[-10:11, -10:11])
    j = np.stack([gx, gx * u, gx * v, gy, gy * u, gy * v, np.ones_like(g), g], 1)
    q = np.linalg.inv(j.T @ j)
    moved = SHAPE @ q[np.ix_([0, 3], [0, 3])] @ SHAPE.T
    return 2 * noise**2 * np.trace(moved) / 2


def test_correlation_first_pulls_in_from_ten_pixels():
    left, right, at, truth = pair(3, noise=1.0)
    turn = np.linspace(0, 2 * np.pi, len(at))
    start = truth + 10 * np.stack([np.cos(turn), np.sin(turn)], 1)
    r = match_lsm(left, right, at, start, search=12)
    assert r.ok.mean() > 0.98
    assert np.linalg.norm(r.pixel - truth, axis=1)[r.ok].max() < 0.3


@pytest.mark.parametrize(("turn", "scale"), [(90, 1.0), (180, 0.7), (-45, 1.4), (137, 0.9)])
def test_a_known_affine_makes_any_rotation_and_scale_matchable(turn: float, scale: float):
    a = np.radians(turn)
    shape = scale * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    centre = np.array([130.0, 130.0])
    left, right, at, truth = pair(4, 1.0, shape, tuple(centre - shape @ centre))
    inside = ((truth > 60) & (truth < 200)).all(1) & ((at > 60) & (at < 200)).all(1)
    r = match_lsm(left, right, at[inside], truth[inside] + [4, -5], search=10, shape=shape @ [[1.02, 0.02], [-0.02, 0.99]])
    assert r.ok.mean() > 0.97
    assert np.sqrt(np.nanmean((r.pixel - truth[inside]) ** 2)) < 0.05


def test_windows_without_texture_or_with_an_edge_only_are_refused_with_the_reason():
    rng = np.random.default_rng(5)
    row, col = np.mgrid[0:120, 0:120].astype(float)
    at = np.array([[60.0, 60.0]])
    edge = 90 + 40 * np.tanh((0.8 * (col - 60) + 0.6 * (row - 60)) / 2)
    scenes = {Status.NO_TEXTURE: np.full((120, 120), 90.0), Status.EDGE_ONLY: edge}
    for status, scene in scenes.items():
        for noise in (0.0, 2.0):
            a, b = (np.round(scene + rng.normal(0, noise, scene.shape)).astype(np.uint8) for _ in range(2))
            r = match_lsm(a, b, at, at + 0.25)
            assert r.status[0] == status
            assert np.isnan(r.pixel).all() and np.isnan(r.sigma).all()
            assert Status(r.status[0]).reason


def test_repetitive_texture_is_refused_or_right():
    rng = np.random.default_rng(6)
    row, col = np.mgrid[0:300, 0:300].astype(float)
    scene = 120 + 40 * np.cos(2 * np.pi * col / 8) * np.cos(2 * np.pi * row / 8)
    left, right = (scene + rng.normal(0, 2, scene.shape) for _ in range(2))
    at = rng.integers(60, 240, (200, 2)).astype(float)
    start = at + rng.uniform(-8, 8, at.shape)
    for r in (match_lsm(left, right, at, start, search=12), match_ncc(left, right, at, start)):
        wrong = r.ok & ~(np.linalg.norm(r.pixel - at, axis=1) < 1)
        assert wrong.sum() == 0
        assert (r.status == Status.NOT_UNIQUE).mean() > 0.7
        assert np.isin(r.status, (Status.NOT_UNIQUE, Status.AT_BORDER)).mean() > 0.95


@pytest.mark.parametrize("window", [21, 15, 11])
def test_bricks_and_dots_are_refused_or_right(window: int):
    rng = np.random.default_rng([12, window])
    row, col = np.mgrid[0:260, 0:260].astype(float)
    course = np.floor(row / 8)
    bricks = np.where(((col + (course % 2) * 9) % 18 < 1.5) | (row % 8 < 1.5), 180.0, 100.0)
    dots = np.zeros((260, 260))
    dots[8::13, 8::15] = 900.0
    for scene in (gaussian_filter(bricks, 0.8), 120 + gaussian_filter(dots, 1.5)):
        left, right = (np.round(scene + rng.normal(0, 2, scene.shape)) for _ in range(2))
        at = rng.integers(60, 200, (200, 2)).astype(float)
        r = match_lsm(left, right, at, at + rng.uniform(-8, 8, at.shape), window, search=12)
        assert (r.ok & ~(np.linalg.norm(r.pixel - at, axis=1) < 1)).sum() <= 1


def test_a_misled_correlation_does_not_lose_what_adjusting_finds():
    shape, centre = 1.15 * np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]]), np.array([130.0, 130.0])
    left, right, at, truth = pair(13, 2.0, shape, tuple(centre - shape @ centre))
    inside = ((truth > 40) & (truth < 220)).all(1)
    plain, searched = (match_lsm(left, right, at[inside], truth[inside] + [0.4, -0.3], search=s) for s in (0, 10))
    for r in (plain, searched):
        assert r.ok.mean() > 0.99 and np.nanmax(np.linalg.norm(r.pixel - truth[inside], axis=1)) < 0.5


def test_a_dot_that_turns_about_itself_is_uncertain():
    """One dot beside the middle of a small window: noise turns the window about it, in steps that hardly shrink."""
    rng, wrong, found, square = np.random.default_rng(18), 0, 0, 0.0
    for spacing in (11, 15):
        dots = np.zeros((300, 300))
        dots[8::spacing, 8 :: spacing + 1] = 900.0
        scene = 120 + gaussian_filter(dots, 1.5)
        left, right = (np.round(scene + rng.normal(0, 2, scene.shape)) for _ in range(2))
        at = rng.integers(40, 260, (500, 2)).astype(float)
        r = match_lsm(left, right, at, at + rng.uniform(-1, 1, at.shape), window=11)
        wrong += (r.ok & ~(np.linalg.norm(r.pixel - at, axis=1) < 1)).sum()
        found += r.ok.sum()
        square += np.nansum(((r.pixel - at) / r.sigma) ** 2) / 2
    assert found > 300 and wrong <= 0.005 * 1000
    assert square / found < 1.7


def test_points_that_tell_their_shape_tell_how_far_off_that_of_others_may_be():
    """A dot beside the middle of its window does not tell that it is turned: where all others are, its place is less sure."""
    turned = np.array([[0.98, 0.12], [-0.12, 0.98]])
    left, right, at, truth = pair(19, noise=1.0, shape=turned, shift=(10.0, 15.0))
    row, col = np.mgrid[:260, :260].astype(float)
    rng, middle = np.random.default_rng(20), np.array([129.0, 129.0])
    for image, place in ((left, middle), (right, turned @ middle + [10, 15])):
        dot = place + (np.eye(2) if image is left else turned) @ [1.2, -0.9]
        blank = 120 + 90 * np.exp(-((col - dot[0]) ** 2 + (row - dot[1]) ** 2) / 18) + rng.normal(0, 1, col.shape)
        near = np.hypot(col - place[0], row - place[1]) < 25
        image[near] = blank[near]
    where = turned @ middle + [10, 15]
    far = np.linalg.norm(at - middle, axis=1) > 45
    alone = match_lsm(left, right, middle, where)
    together = match_lsm(left, right, np.vstack([at[far], middle]), np.vstack([truth[far], where]))
    assert alone.ok[0] and together.ok[-1] and together.kept[-1] < 6 and (together.kept[:-1] == 6).mean() > 0.9
    assert np.abs(together.pixel[-1] - alone.pixel[0]).max() < 1e-3
    off = np.linalg.norm(together.pixel[-1] - where)
    size, single = (float(np.sqrt((r.sigma[-1] ** 2).sum())) for r in (together, alone))
    assert size > 1.5 * single and 0.5 * size < off < 2 * size


def test_black_parts_beside_a_picture_have_no_correlation():
    """They hold the tails of the spline of what lies beside them: a millionth of a grey value, and well correlated."""
    rng = np.random.default_rng(16)
    col = np.mgrid[0:200, 0:200][1].astype(float)
    left, right = (np.clip(np.round(0.8 * (col - 100) + rng.normal(0, 2, col.shape)), 0, 255).astype(np.uint8) for _ in range(2))
    at = rng.integers([60, 50], [85, 150], (200, 2)).astype(float)
    for window in (11, 21):
        r = match_ncc(left, right, at, at + rng.uniform(-8, 8, at.shape), window, search=10)
        assert not r.ok.any() and np.nanmax(r.score, initial=0) <= 1 + 1e-6


@pytest.mark.parametrize(("window", "sigma"), [(11, 1.2), (15, 2.5), (21, 1.6)])
def test_the_noise_is_found_with_any_window_and_texture(window: int, sigma: float):
    texture, rng = waves(3, sigma=sigma), np.random.default_rng(17)
    shift = np.array([0.3, -0.4])
    exact = [render(texture, np.eye(2), v) for v in (np.zeros(2), shift)]
    g = np.arange(20.0, 240, window)
    at = np.stack(np.meshgrid(g, g), -1).reshape(-1, 2)
    variance = []
    for _ in range(3):
        left, right = (p + rng.normal(0, 2, p.shape) for p in exact)
        r = match_lsm(left, right, at, at + shift + 0.2, window)
        variance.append((r.noise[r.ok] ** 2).mean())
    assert 0.9 < np.mean(variance) / 8 < 1.13  # of both photos


def test_shaping_parameters_that_cannot_be_determined_are_dropped():
    rng = np.random.default_rng(7)
    row, col = np.mgrid[0:100, 0:100].astype(float)
    places = ((50, 50), (52.3, 48.6))
    left, right = (60 + 100 * np.exp(-((col - c) ** 2 + (row - r) ** 2) / 18) + rng.normal(0, 2, col.shape) for c, r in places)
    r = match_lsm(left, right, np.array([50.0, 50.0]), np.array([52.0, 49.0]))
    assert r.ok[0] and 2 <= r.kept[0] < 6  # a round dot does not tell its rotation
    assert np.abs(r.pixel[0] - [52.3, 48.6]).max() < 4 * r.sigma.max() < 0.2


def test_leaving_the_image_missing_data_and_nonsense_have_their_own_answers():
    left, right, at, truth = pair(8)
    assert match_lsm(left, right, np.array([5.0, 5.0]), truth[:1]).status[0] == Status.OUTSIDE
    assert match_lsm(left, right, at[:1], np.array([3.0, 100.0])).status[0] == Status.LEFT
    hole = right.copy()
    hole[100:110, 100:110] = np.nan
    assert match_lsm(left, hole, at[:1], np.array([105.0, 105.0])).status[0] == Status.LEFT
    assert match_lsm(hole, right, np.array([105.0, 105.0]), at[:1]).status[0] == Status.OUTSIDE
    with pytest.raises(Unsupported, match="odd"):
        match_lsm(left, right, at, truth, window=20)
    for bad in (np.zeros((2, 2)), np.eye(3)):
        with pytest.raises(Unsupported):
            match_lsm(left, right, at, truth, shape=bad)
    with pytest.raises(Unsupported, match="not finite"):
        match_lsm(left, right, at, np.full_like(at, np.nan))


def test_photos_prepared_once_threads_and_single_points_give_the_same():
    left, right, at, truth = pair(9, noise=1.0)
    whole = match_lsm(left, right, at, truth + 0.3)
    ready = match_lsm(prepare(left), prepare(right), at, truth + 0.3, workers=2)
    assert np.allclose(whole.pixel, ready.pixel, atol=1e-4)
    assert np.array_equal(whole.status, ready.status)
    one = match_lsm(left, right, at[7], truth[7] + 0.3)
    assert np.allclose(one.pixel[0], whole.pixel[7], atol=2e-3)
    far = match_lsm(np.pad(left, 1500), np.pad(right, 1500), at[[0, 190]] + 1500, truth[[0, 190]] + 1500.3)
    assert np.allclose(far.pixel - 1500, whole.pixel[[0, 190]], atol=2e-3)


def test_import_leaves_the_compiler_alone():
    code = "import sys, solvers.matching; print(sorted(set(sys.modules) & {'numba', 'cv2', 'scipy'}))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_of_windows_of_nearly_only_noise_no_sigma_is_made_that_is_none():
    """Where noise has nearly the slope of the texture, what is taken off for it could leave no covariance at all."""
    rng = np.random.default_rng(15)
    at = np.stack(np.meshgrid(np.arange(20.0, 380, 9), np.arange(20.0, 380, 9)), -1).reshape(-1, 2)
    refused, found = 0, 0
    for strength in (0.8, 1.2, 2.0):
        scene = gaussian_filter(rng.normal(0, 1, (400, 400)), 1.0)
        left, right = (100 + strength * 2 * scene / scene.std() + rng.normal(0, 2, scene.shape) for _ in range(2))
        r = match_lsm(left, right, at, at + 0.2, window=9)
        refused, found = refused + (~r.ok).sum(), found + r.ok.sum()
        assert (np.linalg.eigvalsh(r.covariance[r.ok]) > 0).all() and np.isfinite(r.sigma[r.ok]).all()
        assert np.isnan(r.sigma[~r.ok]).all()
    assert refused > 100 and found > 100


def test_points_between_the_pixels_are_matched_as_well_as_those_on_them():
    """Photos as sharp as pixels allow: a template between the pixels would be off by more than the noise moves it."""
    rng = np.random.default_rng(5)
    photo = 128 + 60 * gaussian_filter(rng.normal(0, 1, (360, 480)), 0.6)
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(photo), (0.3, -0.4))).real
    at = rng.uniform(30, [450, 330], (600, 2))
    left, right = (p + rng.normal(0, 2, p.shape) for p in (photo, moved))
    rms = []
    for points in (at, np.round(at)):
        r = match_lsm(left, right, points, points + rng.uniform(-0.5, 0.5, at.shape))
        assert r.ok.all()
        rms.append(np.sqrt(((r.pixel - (points + np.array([-0.4, 0.3]))) ** 2).mean()))
    assert rms[0] < 1.1 * rms[1]
