"""The datum found anew in every iteration: the block carried, as a whole, to where its priors and its control say it is.

Images do not see place, attitude and scale of the world. Where priors are weak beside the images (GPS to metres, tie points to
half a pixel), damping holds these seven directions back for many iterations, and steps along them bend the block. Both end where
every step is followed by the similarity that suits priors and control best: no image residual changes, the cost falls further,
and the minimum is the same one. Reference: Golub & Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...adjustment import Dense, Options, solve
from ...geometry import exp
from .datum import motions, moved
from .problem import Bundle

MOST = 2.0
"""Change of scale in one step beyond which the block is taken to have no shape yet that priors could judge."""
CARRY = Options(max_iterations=30, damping=1e-6, step_tolerance=1e-6, cost_tolerance=1e-13)


@dataclass(frozen=True)
class Datum:
    """Place, attitude and scale of a bundle as a problem of its own: x is the bundle's, the tangent (7,) that of `motions`, the
    cost that of priors, control and all else that knows the world. No image is asked."""

    bundle: Bundle

    @property
    def dof(self) -> int:
        return 0

    def cost(self, x: np.ndarray) -> float:
        return self.bundle.given_cost(x)

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def normal(self, x: np.ndarray) -> Dense:
        net, g = self.bundle.network, motions(self.bundle.network, x)
        m, f, live = net.sizes
        n, c = np.nonzero(net.weight[:live] > 0)
        root = np.sqrt(net.weight[n, c])
        rows, (v, d) = net.prior_arrays[0], self.bundle.prior_rows(x)
        border_v, border = net.border_rows(x) if net.extras.count else (np.zeros(0), np.zeros((0, f)))
        a = np.concatenate([root[:, None] * g[net.point_columns[n, c]], (d @ g[:6 * m].reshape(m, 6, 7)[rows]).reshape(-1, 7),
                            border @ g[6 * m:6 * m + f]])
        return Dense(a.T @ a, a.T @ np.concatenate([root * (net.known - net.split(x)[2])[n, c], v.ravel(), border_v]))

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        net, r, scale = self.bundle.network, exp(dx[3:6]), float(np.exp(dx[6]))
        middle = net.split(x)[2].mean(axis=0)
        return moved(net, x, scale, r, middle + dx[:3] - scale * r @ middle)


class Carried(Bundle):
    """A bundle whose every step ends with the similarity that suits its priors and its control best."""

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return self.carried(super().retract(x, dx))

    def carried(self, x: np.ndarray) -> np.ndarray:
        """x, carried to where priors and control want it as a whole."""
        with np.errstate(all="ignore"):  # of a block that would be carried out of sight
            last = solve(Datum(self), x, CARRY).last
        return last.x if np.isfinite(last.cost) and 1 / MOST < self._size(last.x) / max(self._size(x), 1e-300) < MOST else x

    def _size(self, x: np.ndarray) -> float:
        """Extent of the projection centres [m]."""
        at = self.network.split(x)[0][:, :3]
        return float(np.linalg.norm(at - at.mean(axis=0)))


__all__ = ["Carried", "Datum"]
