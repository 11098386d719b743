"""Large blocks by the orthogonal model: its normal equations, Newton's steps and its statistics, sparse.

An image's rays are made parallel about the middle of its points, so that every observation depends on every point of its image:
G = L + a b^T, L of the observation's own image and point, a (2,) by the depth of the middle, b (u,) what moves that depth. With
the depth as one more unknown d = b^T x of the image, and y = a^T P (L x + a d) that ties it, everything is local again:

    | L^T P L   L^T P a   b |         G^T P J of Newton's step and of the statistics: the same with the derivatives J (local
    | a^T P L   a^T P a  -1 |         by themselves) on the right side, and d = 0.
    | b^T         -1      0 |

The sandwich Q = A^-1 M A^-T, A = G^T P J, M = G^T P S P G, is in the inverse of one symmetric matrix, twice as large:

    | M   A |^-1     | 0      A^-T |
    | A^T 0 |     =  | A^-1   -Q   |

whose entries are made where the matrix is not zero. Reference: docs/formulas.md 3.6 and 3.7; Takahashi, Fagan & Chin 1973.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...adjustment.schur import Pattern, Reduced
from ...cameras import project_derivatives
from ...geometry import Exterior, skew
from .compiled import Compiled
from .datum import motions, pins
from .network import Network

NODE = 8
"""Unknowns of an image: six of its pose, the depth d of the middle, and y."""
D, Y = 6, 7


class Sparse:
    """What the systems of one network share: who sees what, which images share points, the kernels."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self.compiled = Compiled(network)
        live = int(network.start[network.live])  # observations of unknown points that are eliminated; they come first
        self.image, self.point = network.image[:live].astype(np.int64), network.point[:live]
        self.start = network.start[:network.live + 1]
        self.rows = tuple(np.flatnonzero(network.image == i) for i in range(len(network.images)))
        self.eliminated = tuple(rows[:np.searchsorted(rows, live)] for rows in self.rows)

    @cached_property
    def kernels(self) -> Any:
        from ...adjustment import _kernels

        return _kernels

    @cached_property
    def lut(self) -> np.ndarray:
        """(m, m) block of each pair of images, -1 for none."""
        return self.compiled.lut

    def pattern(self, size: int) -> Pattern:
        """Which images share points, in blocks of some size."""
        return replace(self.compiled.pattern, size=size)

    def by_image(self, t: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(m, s, k) sum over the observations of every image of t (o, s, q) times what their points have, right (n, q, k)."""
        out = np.zeros((len(self.rows), t.shape[1], right.shape[2]))
        for i, rows in enumerate(self.eliminated):
            out[i] = np.tensordot(t[rows], right[self.point[rows]], ((0, 2), (0, 1)))
        return out

    def images_of(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(m, s, k) sum over the observations of every image of left^T right, left (o, r, s), right (o, r, k)."""
        out = np.empty((len(self.rows), left.shape[2], right.shape[2]))
        for i, rows in enumerate(self.rows):
            out[i] = np.tensordot(left[rows], right[rows], ((0, 1), (0, 1)))
        return out

    def points_of(self, values: np.ndarray) -> np.ndarray:
        """(n, ...) sum over the observations of every eliminated point of values (o, ...)."""
        return np.add.reduceat(values[:len(self.image)], self.start[:-1]) if len(self.image) else values[:0]


@dataclass(frozen=True)
class Local:
    """By what each observation touches itself: image (o, r, s), point (o, r, q), border (o, r, b), its places `at` (b,) in a
    wider one."""

    image: np.ndarray
    point: np.ndarray
    border: np.ndarray
    at: np.ndarray


@dataclass(frozen=True)
class System:
    """A symmetric system over images (m nodes of s), points (n of q) and a border (k). diagonal (m, s, s), between (o, s, q) of
    every observation, own (n, q, q), image_border (m, s, k), point_border (n, q, k), corner (k, k)."""

    sparse: Sparse
    diagonal: np.ndarray
    between: np.ndarray
    own: np.ndarray
    image_border: np.ndarray
    point_border: np.ndarray
    corner: np.ndarray

    @cached_property
    def inverse(self) -> np.ndarray:
        """(n, q, q) inverses of the points' blocks. Raises numpy.linalg.LinAlgError."""
        return np.linalg.inv(self.own)

    @cached_property
    def turned(self) -> np.ndarray:
        """(o, s, q) T = E V^-1."""
        return self.between @ self.inverse[self.sparse.point]

    @cached_property
    def reduced(self) -> Reduced:
        """Without its points. Raises numpy.linalg.LinAlgError."""
        sparse = self.sparse
        p = sparse.pattern(self.diagonal.shape[1])
        blocks = np.zeros((len(p.row), p.size, p.size))
        blocks[sparse.lut[np.arange(p.count), np.arange(p.count)]] = self.diagonal
        sparse.kernels.eliminate(sparse.start, sparse.image, self.between, self.turned, sparse.lut, blocks)
        border = self.image_border - sparse.by_image(self.turned, self.point_border)
        corner = self.corner - np.tensordot(self.point_border, self.inverse @ self.point_border, ((0, 1), (0, 1)))
        n, k = p.count * p.size, len(corner)
        return Reduced(p, blocks, border.reshape(n, k), (corner + corner.T) / 2, np.zeros(n), np.zeros(k), definite=False)

    def solve(self, images: np.ndarray, points: np.ndarray, border: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unknowns (m, s, r), (n, q, r), (k, r) for right sides of the same shapes. Raises numpy.linalg.LinAlgError."""
        sparse = self.sparse
        g = images - sparse.by_image(self.turned, points)
        h = border - np.tensordot(self.point_border, self.inverse @ points, ((0, 1), (0, 1)))
        x, z = self.reduced.solve(g.reshape(-1, g.shape[2]), h)
        x = x.reshape(g.shape)
        rest = points - self.point_border @ z - sparse.points_of(np.swapaxes(self.between, 1, 2) @ x[sparse.image])
        return x, self.inverse @ rest, z

    def quadratic(self, y: Local) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(o, r, r) Y K^-1 Y^T of the observations, and of the inverse K^-1 the blocks of every image (m, s, s), of every point
        (n, q, q), of images with the border (m, s, k) and of the border (k, k). Raises numpy.linalg.LinAlgError."""
        sparse = self.sparse
        z, across, corner = self.reduced.inverse()
        m, s = self.diagonal.shape[:2]
        across = across.reshape(m, s, len(corner))
        spread = np.zeros(self.turned.shape)  # K^-1, images with points, sign turned
        sparse.kernels.spread(sparse.start, sparse.image, sparse.lut, z, self.turned, spread)
        t = np.swapaxes(self.point_border, 1, 2) @ self.inverse  # (n, k, q)
        spread += across[sparse.image] @ t[sparse.point]
        border = corner @ t + sparse.points_of(np.swapaxes(across, 1, 2)[sparse.image] @ self.turned)
        points = self.inverse + np.swapaxes(t, 1, 2) @ border + sparse.points_of(np.swapaxes(self.turned, 1, 2) @ spread)
        images = z[sparse.lut[np.arange(m), np.arange(m)]]
        i, n = sparse.network.image, len(sparse.image)
        mixed = y.image @ across[:, :, y.at][i] @ np.swapaxes(y.border, 1, 2)
        out = y.image @ images[i] @ np.swapaxes(y.image, 1, 2)
        out += y.border @ corner[np.ix_(y.at, y.at)] @ np.swapaxes(y.border, 1, 2)
        mixed[:n] -= (y.image[:n] @ spread + y.border[:n] @ border[:, y.at][sparse.point]) @ np.swapaxes(y.point[:n], 1, 2)
        out[:n] += y.point[:n] @ points[sparse.point] @ np.swapaxes(y.point[:n], 1, 2)
        return out + mixed + np.swapaxes(mixed, 1, 2), images, points, across, corner


@dataclass(frozen=True)
class Known:
    """What is in the normal equations beside the image observations and the depths of points: image (m, 8, 8), image_border
    (m, 8, k), border_image (m, k, 8), own (n, 3, 3), point_border (n, 3, k), corner (k, k)."""

    image: np.ndarray
    image_border: np.ndarray
    border_image: np.ndarray
    own: np.ndarray
    point_border: np.ndarray
    corner: np.ndarray


class Equations:
    """The normal equations of an `OrthogonalBundle` at x, in unknowns scaled to a unit diagonal."""

    def __init__(self, problem: Any, x: np.ndarray) -> None:
        self.problem, self.x, self.sparse = problem, x, problem.sparse
        self.images = problem.parallel(x)
        self.v, p = problem.image_rows(x, self.images)
        self.factor = problem.factor(self.v, p)
        self.p = p * self.factor[:, None, None]
        local, b, b_point = self._local()
        self._gather(local, b, b_point)

    def _local(self) -> tuple[Local, np.ndarray, np.ndarray]:
        """L with a in its place (o, 2, 8), and b of images and border (m, 6 + f), of points (o, 3)."""
        problem, net = self.problem, self.problem.network
        m, f, live = net.sizes
        o = len(net.image)
        mm = np.zeros((o, 2, NODE + 3 + f))
        b, b_point = np.zeros((m, 6 + f)), np.zeros((o, 3))
        k, by_pixel = np.empty(o), np.empty((o, 2, 2))
        for i, q in enumerate(self.images):
            rows, of, mat, s = q.rows, net.point[q.rows], q.exterior.m, q.scale
            mean = q.interior.c / s
            mm[rows, :, :3] = -s * mat[:2]
            mm[rows, :, 3:6] = -s * skew(np.column_stack([q.uv, q.ahead - mean]))[:, :2]
            mm[rows, :, D] = s / mean * q.uv
            b[i, :3], b[i, 3:6] = -mat[2], -skew(np.concatenate([q.uv.mean(axis=0), [-mean]]))[2]
            mm[rows[of < live], :, NODE:NODE + 3] = s * mat[:2]
            b_point[rows[of < live]] = mat[2] / len(rows)
            held = np.flatnonzero((of >= live) & (of < net.unknown))
            for row, columns in zip(rows[held], net.point_columns[of[held]] - 6 * m, strict=True):
                mm[row, :, NODE + 3 + columns] = (s * mat[:2]).T
                b[i, 6 + columns] += mat[2] / len(rows)
            camera = net.camera[i]
            if net.count[camera]:
                mm[rows, :, NODE + 3 + net.tie[net.first[camera]]] = -(problem.frozen.by_c[rows] if problem.frozen else q.by_c)
            k[rows], by_pixel[rows] = q.k, q.by_pixel
        if problem.frozen:
            k, by_pixel = problem.frozen.k, problem.frozen.by_pixel
        px = np.linalg.solve(k[:, None, None] * by_pixel, mm)
        return Local(px[:, :, :NODE], px[:, :, NODE:NODE + 3], px[:, :, NODE + 3:], np.arange(f)), b, b_point

    def _gather(self, local: Local, b: np.ndarray, b_point: np.ndarray) -> None:
        """Scale, gradient and right side, and all that is known of the derivatives, scaled."""
        problem, net, sparse, x = self.problem, self.problem.network, self.sparse, self.x
        m, f, live = net.sizes
        n, i = len(sparse.image), net.image
        a = local.image[:, :, D]
        touched = np.concatenate([local.image[:, :, :6], local.border], axis=2) + a[:, :, None] * b[i][:, None]
        weighed, pv = self.p @ touched, (self.p @ self.v[..., None])[..., 0]
        by_depth = sparse.images_of(a[:, :, None], np.stack([(self.p @ a[..., None])[..., 0], pv], axis=2))[:, 0]  # a P a, a P v
        pull = sparse.images_of(touched, pv[..., None])[..., 0]  # (m, 6 + f) G^T P v
        square = np.zeros((m, 6 + f))
        np.add.at(square, i, np.einsum("oau,oau->ou", touched, weighed))
        lp, bp = local.point[:n], b_point[:n]
        two = np.swapaxes(lp, 1, 2) @ (self.p[:n] @ np.concatenate([lp, a[:n, :, None]], axis=2))  # (n, 3, 4)
        own = np.einsum("ocC->oc", two[:, :, :3] * np.eye(3)) + 2 * two[:, :, 3] * bp + bp**2 * by_depth[sparse.image, :1]
        # weighted coordinates, priors, and what touches the border only
        weight = net.weight[:live]
        misfit = np.where(weight > 0, weight * (net.known - net.split(x)[2])[:live], 0.0)
        (images, *_), (mis, d) = net.prior_arrays, problem.prior_rows(x)
        wide = np.zeros((len(images), 6, 6 + f))
        wide[:, :, :6] = d
        for row, image in enumerate(images):
            if (at := net.shift_columns[image]) is not None:
                wide[row][:, 6 + at] = d[row, :, :3]
        more, border = net.border_rows(x) if net.extras.count else (np.zeros(0), np.zeros((0, f)))
        square[images] += np.einsum("rau,rau->ru", wide, wide)
        pull[images] += np.einsum("rau,ra->ru", wide, mis)
        border_square = square[:, 6:].sum(axis=0) + (border**2).sum(axis=0)
        border_pull = pull[:, 6:].sum(axis=0) + border.T @ more
        point_square = sparse.points_of(own) + weight
        point_pull = sparse.points_of(np.einsum("oac,oa->oc", lp, pv[:n]) + bp * by_depth[sparse.image, 1:]) + misfit
        diagonal = np.concatenate([square[:, :6].ravel(), border_square, point_square.ravel()])
        self.scale = np.sqrt(np.maximum(diagonal, max(float(diagonal.max(initial=0.0)) * 1e-24, np.finfo(float).tiny)))
        self.gradient = np.concatenate([pull[:, :6].ravel(), border_pull, point_pull.ravel()])
        depth = np.sqrt(np.maximum(by_depth[:, :1], np.finfo(float).tiny))
        self.by_image = np.concatenate([self.scale[:6 * m].reshape(m, 6), depth, 1 / depth], axis=1)
        self.by_border, self.by_point = self.scale[6 * m:6 * m + f], self.scale[6 * m + f:].reshape(live, 3)
        self.left = self.scaled(local)
        wide[:, :, :6] /= self.by_image[images, None, :6]
        wide[:, :, 6:] /= self.by_border
        self.d = (images, wide, mis, border / self.by_border, more, weight, misfit)
        self.b = np.concatenate([b[:, :6] / self.by_image[:, :6], b[:, 6:] / self.by_border], axis=1) * depth
        self.b_point = bp / self.by_point[sparse.point] * depth[sparse.image]
        self.pv = pv

    def scaled(self, local: Local) -> Local:
        """In scaled unknowns."""
        net, n = self.problem.network, len(self.sparse.image)
        point = local.point.copy()
        point[:n] /= self.by_point[self.sparse.point][:, None]
        point[n:] = 0.0
        return Local(local.image / self.by_image[net.image][:, None], point, local.border / self.by_border, local.at)

    @cached_property
    def along(self) -> np.ndarray:
        """(m, 3, f) how the centres go with the border in `retract`."""
        net = self.problem.network
        m, f, _ = net.sizes
        out = np.zeros((m, 3, f))
        for i, p in enumerate(self.images):
            if net.count[net.camera[i]]:
                out[i, :, net.tie[net.first[net.camera[i]]]] = p.exterior.m[2] / p.scale
        return out

    def exact(self, along_c: bool) -> Local:
        """The derivatives of the residuals' own model, scaled; along_c: by steps of c that take the camera with them."""
        net = self.problem.network
        m, f, live = net.sizes
        poses, _, points = net.split(self.x)
        o, interiors = len(net.image), net.interiors_at(self.x)
        image, point, border = np.zeros((o, 2, NODE)), np.zeros((o, 2, 3)), np.zeros((o, 2, f))
        for i, rows in enumerate(self.sparse.rows):
            exterior, camera, of = Exterior.from_vector(poses[i]), net.camera[i], net.point[rows]
            at = project_derivatives(interiors[camera], exterior, points[of])
            image[rows, :, :3], image[rows, :, 3:6], point[rows] = at.centre, at.rotation, at.point
            if net.count[camera]:
                border[rows, :, net.tie[net.first[camera]]] = at.interior[:, :, net.which[net.first[camera]]]
            if along_c:
                border[rows] += at.centre @ self.along[i]
            held = np.flatnonzero((of >= live) & (of < net.unknown))
            for row, columns in zip(held, net.point_columns[of[held]] - 6 * m, strict=True):
                border[rows[row], :, columns] = at.point[row].T
        return self.scaled(Local(image, point, border, np.arange(f)))

    def known(self, exact: bool, damping: float, along_c: bool = False) -> tuple[Known, Known]:
        """What ties the depths, holds the datum and is given otherwise, and of that what is observed. exact: d is left out;
        along_c: priors, too, by steps of c that take the camera with them."""
        net, inner = self.problem.network, self.problem.inner
        m, f, live = net.sizes
        images, wide, _, border, _, weight, _ = self.d
        k = inner.count if inner else 0
        size = f + 2 * k
        seen = Known(np.zeros((m, NODE, NODE)), np.zeros((m, NODE, size)), np.zeros((m, size, NODE)), np.zeros((live, 3, 3)),
                     np.zeros((live, 3, size)), np.zeros((size, size)))
        square = np.swapaxes(wide, 1, 2) @ wide
        seen.image[images, :6, :6] += square[:, :6, :6]
        seen.image_border[images, :6, :f] += square[:, :6, 6:]
        seen.border_image[images, :f, :6] += square[:, 6:, :6]
        seen.corner[:f, :f] = square[:, 6:, 6:].sum(axis=0) + border.T @ border
        seen.own[:, np.arange(3), np.arange(3)] = weight / self.by_point**2
        whole = Known(*(a.copy() for a in vars(seen).values()))
        if along_c:
            carried = (wide[:, :, :3] * self.by_image[images, None, :3]) @ self.along[images] / self.by_border
            whole.image_border[images, :6, :f] += np.swapaxes(wide[:, :, :6], 1, 2) @ carried
            whole.corner[:f, :f] += np.tensordot(wide[:, :, 6:], carried, ((0, 1), (0, 1)))
        whole.image[:, :6, Y] = self.b[:, :6]
        whole.border_image[:, :f, Y] = self.b[:, 6:]
        whole.image[:, D, Y] = -1.0
        if exact:
            whole.image[:, Y, D] = 1.0
        else:
            whole.image[:, Y, :6], whole.image[:, Y, D] = self.b[:, :6], -1.0
            whole.image_border[:, Y, :f] = self.b[:, 6:]
        whole.image[:, np.arange(6), np.arange(6)] += damping
        whole.own[:, np.arange(3), np.arange(3)] += damping
        whole.corner[np.arange(f), np.arange(f)] += damping
        if inner:
            h = inner.rows_of(net, motions(net, self.x)) / self.scale
            h /= np.linalg.norm(h, axis=1, keepdims=True)
            whole.point_border[:, :, f:f + k] = h[:, 6 * m + f:].T.reshape(live, 3, k)
            whole.corner[f:f + k, :f], whole.corner[:f, f:f + k] = h[:, 6 * m:6 * m + f], h[:, 6 * m:6 * m + f].T
            first, second, axis = pins(net, self.x)
            pinned = [(first, c) for c in range(6)] + ([(second, axis)] if k == 7 else [])
            for at, (image, c) in enumerate(pinned, f + k):  # added, and taken away again at the end of the elimination
                whole.image[image, c, c] += 1.0
                whole.image_border[image, c, at] = whole.border_image[image, at, c] = whole.corner[at, at] = 1.0
        return whole, seen

    def right_side(self, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(m, 8, 1), (n, 3, 1) and (size, 1) of the normal equations."""
        sparse, left, pv = self.sparse, self.left, self.pv[..., None]
        images, wide, mis, border, more, _, misfit = self.d
        f, n = len(self.by_border), len(sparse.image)
        g = sparse.images_of(left.image, pv)
        h = np.zeros((size, 1))
        h[:f, 0] = np.einsum("oaf,oa->f", left.border, self.pv) + border.T @ more
        pull = np.einsum("rau,ra->ru", wide, mis)
        g[images, :6, 0] += pull[:, :6]
        h[:f, 0] += pull[:, 6:].sum(axis=0)
        q = sparse.points_of(np.swapaxes(left.point[:n], 1, 2) @ pv[:n])
        return g, q + (misfit / self.by_point)[..., None], h

    def single(self, damping: float) -> System:
        """G^T P G with everything that is given."""
        known = self.known(False, damping)[0]
        return self._summed(self.left, self.p, known.image, known.image_border, ((Y, 0),), known.own, known.point_border,
                            known.corner)

    def double(self, exact: bool, along_c: bool = False) -> tuple[System, Local]:
        """The system of M and A twice as large, A = G^T P J (exact; along_c as in `exact`) or G^T P G, and what the observations
        are in it."""
        a, m = self.known(exact, 0.0, along_c)
        one, two = self.left, self.exact(along_c) if exact else self.left
        y = Local(_beside(one.image, two.image), _beside(one.point, two.point), _beside(one.border, two.border),
                  np.concatenate([one.at, len(a.corner) + two.at]))
        middle = np.zeros((len(self.p), 4, 4))
        middle[:, :2, :2] = self.p @ self.p * (self.problem.network.sigma**2)[:, None, None]
        middle[:, :2, 2:] = middle[:, 2:, :2] = self.p
        depths = ((NODE + Y, 0),) if exact else ((NODE + Y, 0), (Y, 3))
        return self._summed(
            y, middle, _twice(m.image, a.image, np.swapaxes(a.image, 1, 2)),
            _twice(m.image_border, a.image_border, np.swapaxes(a.border_image, 1, 2)), depths, _twice(m.own, a.own, a.own),
            _twice(m.point_border, a.point_border, a.point_border), _twice(m.corner, a.corner, a.corner.T)), y

    def _summed(self, y: Local, weight: np.ndarray, image: np.ndarray, image_border: np.ndarray,
                depths: tuple[tuple[int, int], ...], own: np.ndarray, point_border: np.ndarray, corner: np.ndarray) -> System:
        """What is known with the sums of Y^T weight Y over the observations; depths: places in image and point of the
        derivatives of the middle's depth by its points."""
        sparse, n = self.sparse, len(self.sparse.image)
        by_image, by_border = weight @ y.image, weight @ y.border
        of_point = np.swapaxes(y.point[:n], 1, 2)
        between = np.swapaxes(of_point @ by_image[:n], 1, 2)
        for row, column in depths:
            between[:, row, column:column + 3] += self.b_point
        image_border[:, :, y.at] += sparse.images_of(y.image, by_border)
        point_border[:, :, y.at] += sparse.points_of(of_point @ by_border[:n])
        corner[np.ix_(y.at, y.at)] += np.tensordot(y.border, by_border, ((0, 1), (0, 1)))
        return System(sparse, image + sparse.images_of(y.image, by_image), between,
                      own + sparse.points_of(of_point @ (weight[:n] @ y.point[:n])), image_border, point_border, corner)

    def unscaled(self, images: np.ndarray, points: np.ndarray, border: np.ndarray) -> np.ndarray:
        """(u, r) unknowns of scaled images (m, 6, r), points (n, 3, r) and border (f, r)."""
        r = images.shape[2]
        return np.concatenate([images.reshape(-1, r), border, points.reshape(-1, r)]) / self.scale[:, None]


def _beside(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """(o, 4, 2 n): one (o, 2, n) in the first rows and columns, two in the last."""
    return _twice(one, np.zeros_like(one), np.zeros_like(one), two)


def _twice(m: np.ndarray, a: np.ndarray, back: np.ndarray, last: np.ndarray | None = None) -> np.ndarray:
    """The block matrix | m a | back last |, last zero where not given."""
    r, c = m.shape[-2:]
    out = np.zeros((*m.shape[:-2], 2 * r, 2 * c))
    out[..., :r, :c], out[..., :r, c:], out[..., r:, :c] = m, a, back
    if last is not None:
        out[..., r:, c:] = last
    return out


@dataclass(frozen=True)
class SparseNormal:
    """The normal equations as the engine asks for them. turn: largest rotation of an image in one step [rad], None for any; aim:
    a step that is known beforehand."""

    equations: Equations
    turn: float | None = None
    aim: np.ndarray | None = None

    @property
    def gradient(self) -> np.ndarray:
        return self.equations.gradient

    @property
    def scale(self) -> np.ndarray:
        return self.equations.scale

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        if self.aim is not None:
            return self.aim, np.zeros(0)
        made = self.equations
        try:
            system = made.single(damping)
            x, points, border = system.solve(*made.right_side(len(system.corner)))
        except np.linalg.LinAlgError:
            return np.full(len(made.gradient), np.nan), np.zeros(0)
        dx = made.unscaled(x[:, :6], points, border[:len(made.by_border)])[:, 0]
        if self.turn is not None:
            m = len(x)
            turned = float(np.linalg.norm(dx[:6 * m].reshape(m, 6)[:, 3:], axis=1).max(initial=0.0))
            dx = dx * min(1.0, self.turn / max(turned, 1e-300))
        return dx, np.zeros(0)


def aim(made: Equations) -> np.ndarray:
    """(u,) Newton's step to the fixed point, in the tangent of `retract`; NaN where it is not determined."""
    try:
        system, _ = made.double(True, along_c=True)
        k = len(system.corner) // 2
        right = (np.concatenate([r, np.zeros_like(r)], axis=-2) for r in made.right_side(k))
        x, points, border = system.solve(*right)
    except np.linalg.LinAlgError:
        return np.full(len(made.gradient), np.nan)
    return made.unscaled(x[:, NODE:NODE + 6], points[:, 3:], border[k:k + len(made.by_border)])[:, 0]


def left_free(made: Equations, null: float) -> np.ndarray:
    """(u, r) scaled directions that the normal equations leave free beyond the datum, by inverse iteration: those whose
    eigenvalue is below `null` times the largest, which is about the number of an image's unknowns."""
    net = made.problem.network
    m, f, live = net.sizes
    system = made.single(null)
    rng, size = np.random.default_rng(0), len(system.corner)
    y = rng.standard_normal((len(made.scale), min(6, 6 * m)))
    z = y
    for _ in range(4):
        y = np.linalg.qr(z)[0]
        g, h = np.zeros((m, NODE, y.shape[1])), np.zeros((size, y.shape[1]))
        g[:, :6], h[:f] = y[:6 * m].reshape(m, 6, -1), y[6 * m:6 * m + f]
        x, points, border = system.solve(g, y[6 * m + f:].reshape(live, 3, -1), h)
        z = made.unscaled(x[:, :6], points, border[:f]) * made.scale[:, None]
    values, turn = np.linalg.eigh((z.T @ y + y.T @ z) / 2)
    return y @ turn[:, values > 0.05 / null]


__all__ = ["Equations", "Local", "Sparse", "SparseNormal", "System", "aim", "left_free"]
