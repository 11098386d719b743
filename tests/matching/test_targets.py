"""Targets: centres of rendered dots and rings, no false ones, numbering from coded corners."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from solvers.errors import DegenerateGeometry, Unsupported
from solvers.matching import find_targets, number_targets
from solvers.matching.codes import code_sectors

OVER = 4  # samples a pixel side


def view(pattern, matrix: np.ndarray, size: tuple[int, int], noise: float = 1.0, seed: int = 0) -> np.ndarray:
    """Photo of a plane: matrix maps plane to pixels; pattern(x, y) is its brightness 0..1; box pixels, lens blur, noise."""
    cols, rows = size
    row, col = (np.mgrid[0 : rows * OVER, 0 : cols * OVER] + 0.5) / OVER - 0.5
    p = np.stack([col, row, np.ones_like(col)], -1) @ np.linalg.inv(matrix).T
    fine = pattern(p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]).astype(float)
    grey = gaussian_filter(fine.reshape(rows, OVER, cols, OVER).mean((1, 3)), 0.6)
    return np.clip(np.round(30 + 190 * grey + np.random.default_rng(seed).normal(0, noise, grey.shape)), 0, 255).astype(np.uint8)


def to_pixel(matrix: np.ndarray, plane: np.ndarray) -> np.ndarray:
    p = np.column_stack([plane, np.ones(len(plane))]) @ matrix.T
    return p[:, :2] / p[:, 2:]


TILTED = np.array([[40.0, 6.0, 60.0], [-5.0, 38.0, 70.0], [0.012, 0.016, 1.0]])
GRID = np.array([(x, y) for y in range(6) for x in range(7)], float)


@pytest.mark.parametrize("dark", [True, False])
def test_dots_are_found_all_and_only_with_their_centres(dark: bool):
    radius = 0.22

    def dots(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        near = (np.abs(x - 3) < 3.5) & (np.abs(y - 2.5) < 3)
        inside = near & (np.hypot(x - np.round(x), y - np.round(y)) < radius)
        bar = (np.abs(y + 0.9) < 0.06) & (x > 0) & (x < 5)  # not a target
        return (inside | bar) != dark

    photo = view(dots, TILTED, (330, 320))
    found = find_targets(photo)
    assert len(found) == len(GRID)
    truth = to_pixel(TILTED, GRID)
    nearest = np.linalg.norm(found.pixel[:, None] - truth, axis=2).argmin(1)
    assert len(set(nearest)) == len(GRID)
    error = found.pixel - truth[nearest]
    shifted = error - eccentric(radius)[nearest]  # an ellipse's centre is not the centre's image
    assert np.sqrt((shifted**2).mean()) < 0.02
    assert np.sqrt(np.nanmean((found.centroid - found.pixel) ** 2)) < 0.05
    assert 0.5 < np.sqrt((shifted**2).mean()) / np.sqrt((found.sigma**2).mean()) < 1.8
    assert (np.sign(found.contrast) == (-1 if dark else 1)).all()


def eccentric(radius: float) -> np.ndarray:
    """Centre of each dot's ellipse minus the image of its centre, exactly: polar of the line at infinity."""
    out = []
    inverse = np.linalg.inv(TILTED)
    for x, y in GRID:
        circle = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - radius**2]])
        conic = inverse.T @ circle @ inverse
        out.append(np.linalg.solve(conic[:2, :2], -conic[:2, 2]) - to_pixel(TILTED, np.array([[x, y]]))[0])
    return np.array(out)


@pytest.mark.parametrize("dark", [True, False])
def test_concentric_rings_are_centred_to_two_hundredths_of_a_pixel(dark: bool):
    centres = np.array([(1.0, 1.0), (4.0, 1.2), (2.4, 3.6), (5.0, 4.0)])

    def rings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        mark = np.zeros(x.shape, bool)
        for cx, cy in centres:
            r = np.hypot(x - cx, y - cy)
            mark |= ((r > 0.75) & (r < 1.0)) | ((r > 0.3) & (r < 0.52))
        return mark != dark

    photo = view(rings, TILTED, (330, 300), seed=1)
    found = find_targets(photo, kind="ring")
    assert len(found) == 4
    truth = to_pixel(TILTED, centres)
    nearest = np.linalg.norm(found.pixel[:, None] - truth, axis=2).argmin(1)
    assert np.sqrt(((found.pixel - truth[nearest]) ** 2).mean()) < 0.02
    assert (found.edges >= 3).all()


def test_rings_of_few_pixels_are_found_and_their_sigma_is_honest():
    """Lines of 2.6 px: only the ring's own mean tells them apart."""
    places = np.array([(x, y) for y in range(4) for x in range(5)], float)
    matrix = np.array([[44.0, 2.0, 40.3], [-1.5, 43.0, 42.8], [0, 0, 1]])

    def rings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r = np.hypot(x - np.round(x), y - np.round(y))
        inside = [np.clip((edge - r) * 44 * OVER + 0.5, 0, 1) for edge in (0.082, 0.14, 0.2)]  # by the share of a sample
        return 1 - inside[0] + inside[1] - inside[2]

    found = find_targets(view(rings, matrix, (270, 230), noise=2.0), "ring")
    truth = to_pixel(matrix, places)
    nearest = np.linalg.norm(found.pixel[:, None] - truth, axis=2).argmin(1)
    assert len(found) >= len(truth) and len(set(nearest)) == len(truth)
    error = np.array([found.pixel[nearest == k][0] - truth[k] for k in range(len(truth))])
    assert np.sqrt((error**2).mean()) < 0.02 and 0.4 < np.sqrt((error**2).mean() / (found.sigma**2).mean()) < 1.8


def sheet(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """10 x 10 dots of radius 0.12, code rings of 4, 3, 2, 1 sectors around four of them."""
    near = (np.abs(x - 4.5) < 5) & (np.abs(y - 4.5) < 5)
    mark = near & (np.hypot(x - np.round(x), y - np.round(y)) < 0.12)
    for sectors, (row, col) in {4: (1, 1), 3: (1, 8), 2: (8, 1), 1: (8, 8)}.items():
        r, turn = np.hypot(x - col, y - row), np.arctan2(y - row, x - col) % (2 * np.pi)
        length = np.radians(180) if sectors == 1 else np.radians(45)
        mark |= (r > 0.34) & (r < 0.5) & (turn % (2 * np.pi / 4) < length if sectors == 4 else np.zeros(x.shape, bool))
        for k in range(sectors if sectors < 4 else 0):
            mark |= (r > 0.34) & (r < 0.5) & ((turn - k * np.pi / 2) % (2 * np.pi) < length)
    return ~mark


@pytest.mark.parametrize("turn", [20, 200])
def test_dots_number_themselves_from_four_coded_corners(turn: int):
    a = np.radians(turn)
    rotate = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    centred = np.array([[1, 0, -4.5], [0, 1, -4.5], [0, 0, 1.0]])
    matrix = np.array([[40.0, 0, 260], [0, 40, 260], [0.0001, 0.0002, 1]]) @ rotate @ centred
    photo = view(sheet, matrix, (520, 520), seed=2)
    found = number_targets(photo, find_targets(photo))
    names = {str(n): p for n, p in zip(found.label, found.pixel, strict=True)}
    assert len(names) == 100 == len(found)
    for row, col in ((0, 0), (9, 3), (4, 7), (1, 8)):
        assert np.linalg.norm(names[f"{row}-{col}"] - to_pixel(matrix, np.array([[col, row]], float))[0]) < 0.1


def test_a_code_seen_twice_is_where_the_dots_come_to_lie_on_the_grid():
    def doubled(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The sheet and, beside it, a second dot with the code of two sectors."""
        r, turn = np.hypot(x - 10.6, y - 4.4), np.arctan2(y - 4.4, x - 10.6) % (np.pi / 2)
        second = (turn < np.radians(45)) & (np.arctan2(y - 4.4, x - 10.6) % (2 * np.pi) < np.pi)
        return sheet(x, y) & ~((r < 0.12) | ((r > 0.34) & (r < 0.5) & second))

    matrix = np.array([[36.0, 0, 70], [0, 36, 90], [0.0001, 0.0002, 1]])
    photo = view(doubled, matrix, (500, 500), seed=4)
    found = find_targets(photo)
    assert len(found) == 101 and (code_sectors(photo, found) == 2).sum() == 2
    label = number_targets(photo, found).label
    stray = np.linalg.norm(found.pixel - to_pixel(matrix, np.array([[10.6, 4.4]]))[0], axis=1).argmin()
    assert (label != "").sum() == 100 and label[stray] == ""


def test_a_lamp_and_a_curtain_do_not_hide_a_ring():
    def rings(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        r = np.hypot(x, y)
        return ~((r < 10) | ((r > 14) & (r < 18)) | ((r > 22) & (r < 26)))

    matrix = np.array([[1.0, 0, 240], [0, 1.0, 240], [0, 0, 1]])
    photo = view(rings, matrix, (480, 480), seed=5)
    photo[:190], photo[300:] = 255, 5
    found = find_targets(photo, kind="ring")
    assert len(found) == 1 and found.edges[0] >= 3 and np.abs(found.pixel[0] - 240).max() < 0.05


def test_nothing_is_found_in_texture_and_the_refusals_say_why():
    noise = gaussian_filter(np.random.default_rng(3).normal(size=(300, 300)), 3)
    photo = np.clip(120 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    assert len(find_targets(photo, kind="ring")) == 0
    empty = find_targets(np.full((100, 100), 128, np.uint8))
    assert len(empty) == 0 and empty.pixel.shape == (0, 2)
    with pytest.raises(Unsupported, match="dot"):
        find_targets(photo, kind="cross")
    with pytest.raises(DegenerateGeometry, match="not seen"):
        number_targets(photo, empty)
