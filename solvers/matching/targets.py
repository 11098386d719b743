"""Signalised points: round dots and concentric rings, centred to a few hundredths of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import Unsupported
from .patches import gray

RAYS = 48
"""Directions in which the edge of a target is measured."""
_INDEPENDENT = 2.5
"""px along an edge, between which its places err independently: small targets have fewer of them than rays."""
_SOFT = 0.7
"""px, smoothing before the edges of rings are measured: linear interpolation of sharp narrow lines errs by 0.04 px."""
_NARROW = (49, 25, 13)
"""px, sides of the surroundings of small rings."""


@dataclass(frozen=True)
class Targets:
    """N targets. pixel (N, 2) col, row of the centre (of the ellipse; for rings extrapolated to radius 0);
    sigma (N, 2) px; centroid (N, 2) weighted centroid, an independent check (NaN for rings); axes (N, 2) semi-axes of
    the ellipse, px, largest first; angle (N,) rad of the large axis from the column axis towards the row axis;
    contrast (N,) grey values, negative for dark targets on light; edges (N,) ellipses per target (1 for a dot);
    label (N,) names, "" while unnumbered."""

    pixel: np.ndarray
    sigma: np.ndarray
    centroid: np.ndarray
    axes: np.ndarray
    angle: np.ndarray
    contrast: np.ndarray
    edges: np.ndarray
    label: np.ndarray

    def __len__(self) -> int:
        return len(self.pixel)

    def eccentricity(self, c_px: float) -> np.ndarray:
        """(N,) px by which an ellipse's centre lies off the true centre of a tilted circle, c_px the principal distance in px.

        a^2 sin(t) cos(t) / c with cos(t) = b / a, on the optical axis, towards the nearer side of the circle; a single
        dot does not tell which side that is. Reference: Ahn, Warnecke & Kotowski 1999; Luhmann 2014.
        """
        a, b = self.axes.T
        return b * np.sqrt(np.maximum(a**2 - b**2, 0)) / c_px


@dataclass(frozen=True)
class TargetOptions:
    """What counts as a target."""

    least_diameter: float = 5.0  # px
    largest_diameter: float = 200.0  # px
    least_contrast: float = 12.0  # grey values
    flattest: float = 0.2  # small over large axis
    roundness: float = 0.03  # rms of the edge off its ellipse, in radii (and 0.12 px)


def find_targets(image: np.ndarray, kind: str = "dot", options: TargetOptions | None = None) -> Targets:
    """Targets of one kind in a photo: "dot" (filled circles) or "ring" (two or more concentric circles), dark on light or
    light on dark, ordered by row; dots unlike their neighbours in size or contrast are left out. A colour photo is measured in
    green: lateral chromatic aberration shifts red and blue edges by tenths of a pixel. `number_targets` gives labels.

    Raises Unsupported for another kind. Reference: Luhmann 2014, Close-range photogrammetry, 5.4.2.
    """
    import cv2

    options = options or TargetOptions()
    if kind not in ("dot", "ring"):
        raise Unsupported(f"targets of kind {kind!r}: give 'dot' or 'ring'")
    grey = _green(image)
    found = [t for dark in (True, False) for t in _blobs(grey, dark, options, holes=kind == "ring")]
    if kind == "ring":
        grey = cv2.GaussianBlur(grey, (0, 0), _SOFT)
    rows = [r for r in (_measure(grey, *blob, options, kind == "ring") for blob in found) if r is not None]
    if kind == "ring":
        rows = _apart(_concentric(rows))
    else:
        rows = _alike(_apart(rows))
    rows.sort(key=lambda r: (r.centre[1], r.centre[0]))
    return _targets(rows)


@dataclass(frozen=True)
class _Ellipse:
    centre: np.ndarray  # (2,) px
    covariance: np.ndarray  # (2, 2) px^2
    axes: tuple[float, float]  # px
    angle: float
    contrast: float
    centroid: np.ndarray
    edges: int = 1


def _blobs(grey: np.ndarray, dark: bool, options: TargetOptions, holes: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """Outlines of regions darker (lighter) than their surroundings that look like an ellipse: centre, covariance of their area.

    The surroundings of rings are taken wide and narrow: a lamp or a curtain near one of them does not hide it, and the lines of
    a small one are told apart by its own mean.
    """
    import cv2

    side = 2 * min(options.largest_diameter, min(grey.shape) / 8)
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8)
    contours = []
    sides = (side, side / 3, *(n for n in _NARROW if n < side / 4)) if holes else (side,)
    for wide in (int(n) | 1 for n in sides):
        surround = cv2.blur(smooth, (wide, wide), borderType=cv2.BORDER_REFLECT_101)
        step = (surround - smooth) if dark else (smooth - surround)
        mask = (step > max(options.least_contrast / 2, 4.0)).astype(np.uint8)
        contours += cv2.findContours(mask, cv2.RETR_CCOMP if holes else cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    blobs = []
    for contour in contours:
        m = cv2.moments(contour)
        area = m["m00"]
        if not np.pi / 4 * (options.least_diameter - 2) ** 2 < area < np.pi / 4 * options.largest_diameter**2:
            continue
        centre = np.array([m["m10"], m["m01"]]) / area
        spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / area
        det = float(np.linalg.det(spread))
        if det <= 0:
            continue
        least, most = np.linalg.eigvalsh(spread)
        if least < (0.8 * options.flattest) ** 2 * most or not 0.85 < area / (4 * np.pi * np.sqrt(det)) < 1.06:
            continue
        blobs.append((centre, spread))
    return blobs


def _measure(grey: np.ndarray, centre: np.ndarray, spread: np.ndarray, options: TargetOptions, ring: bool) -> _Ellipse | None:
    """Ellipse through the sub-pixel edge, or None where the edge is not an ellipse, too weak or cut by the photo's border."""
    edge = fit = None
    for _ in range(3):
        edge = _edge(grey, centre, 2 * _root(spread), ring)  # the root maps a unit circle to the ellipse
        fit = None if edge is None else _ellipse(edge[0])
        if fit is None:
            return None
        centre, spread = fit[:2]
    if edge is None or fit is None:
        return None
    (_, inside, outside), (_, _, cofactor, rms) = edge, fit
    values, axes = np.linalg.eigh(4 * spread)
    b, a = np.sqrt(values)
    contrast = float(np.median(inside - outside))
    if 2 * b < options.least_diameter * options.flattest or 2 * a < options.least_diameter or b < options.flattest * a:
        return None
    if abs(contrast) < options.least_contrast or rms > options.roundness * np.sqrt(a * b) + 0.12:
        return None
    if not ring and (np.std(outside) > 0.35 * abs(contrast) or np.std(inside) > 0.25 * abs(contrast)):
        return None
    angle = float(np.arctan2(axes[1, 1], axes[0, 1]))
    around = 2 * np.pi * np.sqrt(0.5 * (a * a + b * b))
    covariance = cofactor * max(rms, 0.02) ** 2 * max(1.0, RAYS * _INDEPENDENT / around)
    centroid = np.full(2, np.nan) if ring else _centroid(grey, centre, 2 * _root(spread))
    return _Ellipse(centre, covariance, (float(a), float(b)), angle, contrast, centroid)


def _edge(grey: np.ndarray, centre: np.ndarray, root: np.ndarray, ring: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """(m, 2) edge points where each ray crosses the mean of its inner and outer level, and the levels (RAYS,).

    The levels of a dot are taken well inside and outside; those of a ring, whose lines are narrow, 3 px off the edge.
    """
    import cv2

    turn = 2 * np.pi * np.arange(RAYS) / RAYS
    directions = np.stack([np.cos(turn), np.sin(turn)], 1) @ root.T  # (RAYS, 2) px, one radius
    shortest = float(np.linalg.norm(directions, axis=1).min())
    reach = 3 / shortest if ring else max(0.35, 2.5 / shortest)
    radii = np.linspace(1 - reach if ring else max(0.3, 0.8 - reach), 1 + reach, 40)
    places = centre + radii[None, :, None] * directions[:, None]
    rows, cols = grey.shape
    if (places < 1).any() or (places > np.array([cols, rows]) - 2).any():
        return None
    profile = cv2.remap(grey, places[..., 0].astype(np.float32), places[..., 1].astype(np.float32), cv2.INTER_LINEAR)
    inside, outside = profile[:, :6].mean(1), profile[:, -6:].mean(1)
    level = (inside + outside) / 2
    above = (profile > level[:, None]) == (inside > outside)[:, None]
    last = np.argmax(~above, 1)  # first sample beyond the edge
    ok = (last > 0) & (np.sign(inside - outside) == np.sign(np.median(inside - outside)))
    if ok.sum() < 0.9 * RAYS:
        return None
    k = last[ok]
    ray = np.flatnonzero(ok)
    before, after = profile[ray, k - 1], profile[ray, k]
    t = radii[k - 1] + (radii[k] - radii[k - 1]) * (level[ray] - before) / (after - before)
    return centre + t[:, None] * directions[ray], inside, outside


def _ellipse(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
    """Ellipse by least squares of the distances: centre, area covariance, cofactor of the centre, rms px; one edge point in ten
    may be an outlier."""
    middle = points.mean(0)
    size = float(np.sqrt(((points - middle) ** 2).sum(1).mean()))
    xy = (points - middle) / size
    weight, conic = np.ones(len(points)), None
    for _ in range(3):
        conic = _conic(xy, weight)
        if conic is None:
            return None
        radius, slope = _radius_and_slope(xy, *conic)
        distance = (radius - 1) / slope
        scatter = 1.4826 * np.median(np.abs(distance)) + 1e-9
        weight = np.where(np.abs(distance) < 4 * scatter, 1 / slope / 2, 0.0)
    used = weight > 0
    if conic is None or used.sum() < 0.85 * len(points):
        return None
    centre, q = conic
    arm = (xy - centre)[used]
    radius, slope = _radius_and_slope(xy[used], centre, q)
    normal = arm @ q / (radius * slope)[:, None]  # (m, 2) unit outward normals
    j = np.column_stack([normal, normal * arm, normal[:, 0] * arm[:, 1] + normal[:, 1] * arm[:, 0]])
    cofactor = np.linalg.inv(j.T @ j)[:2, :2]
    rms = float(np.sqrt((((radius - 1) / slope) ** 2).sum() / max(used.sum() - 5, 1))) * size
    return centre * size + middle, np.linalg.inv(q) * size**2 / 4, cofactor, rms


def _conic(xy: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Centre and matrix q of the ellipse (p - centre) q (p - centre) = 1, by weighted linear least squares; None for none."""
    x, y = xy.T
    design = np.stack([x * x, 2 * x * y, y * y, -2 * x, -2 * y], 1)
    a, b, c, *linear = np.linalg.lstsq(design * weight[:, None], weight, rcond=None)[0]
    q = np.array([[a, b], [b, c]])
    if not np.linalg.det(q) > 0 or a <= 0:
        return None
    centre = np.linalg.solve(q, linear)
    return centre, q / (1 + centre @ q @ centre)


def _radius_and_slope(xy: np.ndarray, centre: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) radii, 1 on the ellipse, and how fast they grow outwards."""
    d = xy - centre
    radius = np.sqrt(np.einsum("na,ab,nb->n", d, q, d))
    return radius, np.linalg.norm(d @ q, axis=1) / radius


def _centroid(grey: np.ndarray, centre: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Centroid weighted by the grey value's share between outside and inside level."""
    reach = np.ceil(np.abs(root).sum(1) * 1.5).astype(int) + 2
    c, r = np.round(centre).astype(int)
    rows, cols = grey.shape
    w = np.s_[max(0, r - reach[1]) : min(rows, r + reach[1] + 1), max(0, c - reach[0]) : min(cols, c + reach[0] + 1)]
    row, col = np.mgrid[w]
    d = np.stack([col - centre[0], row - centre[1]], -1) @ np.linalg.inv(root).T
    radius = np.linalg.norm(d, axis=-1)
    margin = max(0.25, 2 / np.linalg.norm(root, axis=0).min())
    ring, core = (radius > 1 + margin) & (radius < 1.5 + margin), radius < max(0.4, 1 - margin)
    patch = grey[w]
    if not ring.any() or not core.any():
        return np.full(2, np.nan)
    out = np.median(patch[ring])
    weight = np.where(radius < 1 + margin, (patch - out) / (np.median(patch[core]) - out), 0.0)
    return np.array([(weight * col).sum(), (weight * row).sum()]) / weight.sum()


def _root(matrix: np.ndarray) -> np.ndarray:
    """Symmetric square root."""
    values, vectors = np.linalg.eigh(matrix)
    return (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T


def _apart(rows: list[_Ellipse]) -> list[_Ellipse]:
    """One target a place: the largest of overlapping ellipses."""
    kept: list[_Ellipse] = []
    for row in sorted(rows, key=lambda r: -r.axes[0]):
        if all(np.linalg.norm(row.centre - k.centre) > max(row.axes[0], k.axes[0]) for k in kept):
            kept.append(row)
    return kept


def _alike(rows: list[_Ellipse]) -> list[_Ellipse]:
    """Targets like the six nearest others in size and contrast; everything while they are few."""
    while len(rows) >= 8:
        place = np.array([r.centre for r in rows])
        size = np.array([r.axes[0] for r in rows])
        contrast = np.array([r.contrast for r in rows])
        distance = np.linalg.norm(place[:, None] - place, axis=2)
        near = np.argsort(distance, 1)[:, 1:7]
        ratio = size / np.median(size[near], 1)
        depth = contrast / np.median(contrast[near], 1)
        bad = (ratio < 0.6) | (ratio > 1.6) | (depth < 0.5) | (depth > 2)
        if not bad.any():
            break
        rows = [r for r, b in zip(rows, bad, strict=True) if not b]
    return rows


def _green(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    return gray(image[..., 1] if image.ndim == 3 and image.shape[2] >= 3 else image)


def _concentric(rows: list[_Ellipse]) -> list[_Ellipse]:
    """Groups of two or more ellipses about one centre, the centre extrapolated to radius 0 (it moves with the radius squared)."""
    groups: list[list[_Ellipse]] = []
    for row in sorted(rows, key=lambda r: -r.axes[0]):
        for group in groups:
            first = group[0]
            if np.linalg.norm(row.centre - first.centre) < 0.15 * first.axes[1] and abs(_flat(row) - _flat(first)) < 0.15:
                if all(abs(row.axes[0] - g.axes[0]) > 0.05 * g.axes[0] + 0.5 for g in group):
                    group.append(row)
                break
        else:
            groups.append([row])
    return [_ring(group) for group in groups if len(group) >= 2]


def _flat(row: _Ellipse) -> float:
    return row.axes[1] / row.axes[0]


def _ring(group: list[_Ellipse]) -> _Ellipse:
    squares = np.array([g.axes[0] * g.axes[1] for g in group])
    weights = np.array([1 / np.trace(g.covariance) for g in group])
    centres = np.array([g.centre for g in group])
    outer = group[0]
    design = np.stack([np.ones(len(group)), squares / squares.max()], 1)
    tilted = _flat(outer) < 0.98 and squares.min() < 0.6 * squares.max()
    design = design if tilted else design[:, :1]
    cofactor = np.linalg.inv(design.T @ (design * weights[:, None]))
    centre = (cofactor @ design.T @ (centres * weights[:, None]))[0]
    shape = outer.covariance / np.trace(outer.covariance)
    return _Ellipse(centre, cofactor[0, 0] * shape, outer.axes, outer.angle, outer.contrast, np.full(2, np.nan), len(group))


def _targets(rows: list[_Ellipse]) -> Targets:
    return Targets(
        pixel=np.array([r.centre for r in rows]).reshape(-1, 2),
        sigma=np.sqrt(np.array([np.diag(r.covariance) for r in rows]).reshape(-1, 2)),
        centroid=np.array([r.centroid for r in rows]).reshape(-1, 2),
        axes=np.array([r.axes for r in rows]).reshape(-1, 2),
        angle=np.array([r.angle for r in rows]),
        contrast=np.array([r.contrast for r in rows]),
        edges=np.array([r.edges for r in rows], int),
        label=np.array([""] * len(rows), dtype="<U16"),
    )
