"""A large block of UAV photos without pictures: two grids across each other, as many images as one asks for."""

from __future__ import annotations

import numpy as np

from ..block import Block, Image, Observations
from ..cameras import Interior, project
from ..errors import BadProject
from ..geometry import Exterior
from .scene import Simulated, onboard, pose, survey

CAMERA = Interior(35.0, 0.02, -0.015, k1=-4e-6, pixel_mm=0.00392, width=6000, height=4000)
HEIGHT = 120.0
"""Of the first grid above the mean ground [m]; the second flies a quarter higher."""
MOST = 10_000
"""Images of the largest block."""
_MARGIN = 20.0
_KEPT = 0.6  # of the points in a photo, those that matching finds there
_RAYS = 12


def large_block(seed: int = 0, *, images: int = 500, points: int = 40, image_px: float = 0.3, control_m: float = 0.02,
                gps_m: float = 0.5, noise: float = 1.0) -> Simulated:
    """Double grid of near-vertical photos, overlaps 80 and 60 %, with GPS/IMU, control and check points; no photos are painted.

    points: tie points for each image, each seen by two to twelve; control: one for about 25 images, as many check points.
    gps_m: sigma of the priors [m], angles 1 degree. Raises BadProject for fewer than 12 or more than 10,000 images.
    """
    if not 12 <= images <= MOST:
        raise BadProject(f"a large block has 12 to {MOST:,} images, not {images}; smaller ones: uav_block")
    flight, places, errors, priors = (np.random.default_rng(s) for s in np.random.SeedSequence([seed, 500]).spawn(4))
    exteriors, size = _fly(images, flight)
    marks = max(4, images // 25)
    xyz = _ground(places.uniform(-0.15, 1.15, (images * points, 2)) * size)
    corners = [[0, 0], [0, 1], [1, 0], [1, 1]]
    marked = _ground(np.concatenate([corners, places.uniform(0.02, 0.98, (2 * marks - 4, 2))]) * size)
    xyz = np.concatenate([marked, xyz]).round(4)
    seen = _observed(exteriors, xyz, 2 * marks, image_px, noise, errors)
    kept, point = np.unique(seen.point, return_inverse=True)
    xyz = xyz[kept]
    roles = ("control",) * int((kept < marks).sum()) + ("check",) * int(((kept >= marks) & (kept < 2 * marks)).sum())
    roles += ("tie",) * (len(kept) - len(roles))
    names = tuple(f"{ {'control': 'G', 'check': 'C', 'tie': 'T'}[role] }{k:06d}" for k, role in enumerate(roles))
    truth = {f"I{k + 1:05d}": e for k, e in enumerate(exteriors)}
    block = Block(
        name="Large block", crs="local", cameras={"uav": CAMERA},
        images=tuple(Image(n, "uav", None, onboard(e, gps_m, 1.0, noise, priors)) for n, e in truth.items()),
        points=survey(names, xyz, roles, control_m, noise, errors),
        observations=Observations(seen.image, point, seen.pixel, seen.sigma), image_px=image_px,
        control_m=(control_m, control_m, control_m))
    return Simulated(block, truth, xyz, {"uav": CAMERA})


def _fly(images: int, rng: np.random.Generator) -> tuple[list[Exterior], np.ndarray]:
    """Orientations of both grids, strips to and fro, shaken by the wind; and the extent (2,) m of the centres."""
    step = np.array([CAMERA.width, CAMERA.height]) * CAMERA.pitch / CAMERA.c * HEIGHT * [0.4, 0.2]
    first = (images + 1) // 2
    rows = max(2, round(np.sqrt(first * step[1] / step[0])))  # strips, so that the block is about square
    each = -(-first // rows)
    size = step * [rows - 1, each - 1]
    plan = [(s * step[0], (k if s % 2 == 0 else each - 1 - k) * step[1], HEIGHT, 180.0 * (s % 2))
            for s in range(rows) for k in range(each)][:first]
    left = images - first
    across = max(2, round(np.sqrt(left * size[1] / size[0])))
    along = -(-left // across)
    plan += [((k if s % 2 == 0 else along - 1 - k) * size[0] / max(along - 1, 1), s * size[1] / (across - 1), 1.25 * HEIGHT,
              90.0 + 180.0 * (s % 2)) for s in range(across) for k in range(along)][:left]
    out = []
    for x, y, z, kappa in plan:
        omega, phi, turn = rng.normal(0, [2.5, 2.5, 4.0])
        out.append(pose(omega, phi, (kappa + turn + 180) % 360 - 180, np.array([x, y, z]) + rng.normal(0, [1.5, 1.5, 1.0])))
    return out, size


def _ground(xy: np.ndarray) -> np.ndarray:
    """Points (n, 3) m on gentle hills, from places (n, 2)."""
    return np.column_stack([xy, 6 * (np.sin(xy[:, 0] / 40) * np.cos(xy[:, 1] / 55) + 1)])


def _observed(exteriors: list[Exterior], xyz: np.ndarray, marked: int, sigma: float, noise: float,
              rng: np.random.Generator) -> Observations:
    """Observations, image by image, of the points in at least two images; tie points in twelve at most."""
    from scipy.spatial import KDTree

    tree, image, point = KDTree(xyz[:, :2]), [], []
    reach = 0.5 * float(np.hypot(*(np.array([CAMERA.width, CAMERA.height]) * CAMERA.pitch))) / CAMERA.c + 0.15
    for i, e in enumerate(exteriors):
        near = np.array(tree.query_ball_point(e.centre[:2], reach * e.centre[2]), int)
        near = near[CAMERA.inside(project(CAMERA, e, xyz[near]), -_MARGIN)]
        near = near[(near < marked) | (rng.random(len(near)) < _KEPT)]
        image.append(np.full(len(near), i))
        point.append(near)
    image, point = np.concatenate(image), np.concatenate(point)
    order = np.lexsort((rng.random(len(point)), point))
    rank = np.empty(len(point), int)
    rank[order] = np.arange(len(point)) - np.searchsorted(point[order], point[order])
    ok = (rank < _RAYS) | (point < marked)
    ok &= np.bincount(point[ok], minlength=len(xyz))[point] >= 2
    image, point = image[ok], point[ok]
    order = np.lexsort((point, image))
    image, point = image[order], point[order]
    ends = np.searchsorted(image, np.arange(len(exteriors) + 1))
    pixel = np.concatenate([project(CAMERA, e, xyz[point[a:b]]) for e, a, b in zip(exteriors, ends, ends[1:], strict=False)])
    pixel = np.round(pixel + noise * sigma * rng.standard_normal(pixel.shape), 3) if noise else pixel
    return Observations(image, point, pixel, np.full(len(image), float(sigma)))
