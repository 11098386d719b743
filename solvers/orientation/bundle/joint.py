"""All points of a bundle together: their joint covariance, and the bundle as an epoch of a monitored network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...adjustment import Trace, iterate
from ...block import Block
from ...errors import DegenerateGeometry
from ...geometry import LocalFrame
from ..deformation import Epoch
from ..words import bad_fit
from .adjust import prepare_bundle
from .given import BundleRequest
from .orthogonal import OrthogonalBundle
from .orthogonal_statistics import propagated
from .problem import Bundle
from .statistics import undetermined

LARGEST = 4000
"""Unknowns up to which the covariance of all points together is made."""


def joint_covariance(problem: Bundle, x: np.ndarray) -> np.ndarray:
    """(3 n, 3 n) a-priori covariance of all unknown points together, m^2, of a bundle of either model.

    Raises DegenerateGeometry where something is not determined, or the network is too large.
    """
    m, f, live = problem.network.sizes
    if 6 * m + f + 3 * live > LARGEST:
        raise DegenerateGeometry(f"{live} points are too many for the covariance of all of them together (about "
                                 f"{(LARGEST - 6 * m - f) // 3} are possible); keep the targets alone in observations.csv")
    if isinstance(problem, OrthogonalBundle):
        q = propagated(problem, x)[4]
    else:
        try:
            q = problem.linear(x).normal().covariance()
        except np.linalg.LinAlgError:
            raise DegenerateGeometry(undetermined(problem, x)) from None
    return q[6 * m + f:, 6 * m + f:]


def free_epoch(block: Block, request: BundleRequest, name: str, begin: Trace | None = None,
               frame: LocalFrame | None = None) -> tuple[Epoch, LocalFrame, tuple[str, ...]]:
    """A block adjusted as a free network, as an epoch in a local frame (its own, or the one given), that frame, and what to know.

    begin: a bundle's trace of the same block, whose end is the start. Raises PhotogrammetryError, also where the adjustment does
    not converge or leaves something free that a comparison would take for movement.
    """
    start = prepare_bundle(block, replace(request, datum="free", compiled=False))
    x0, net, problem = start.x0, start.problem.network, start.problem
    if begin is not None and begin.converged and begin.last.x.shape == x0.shape \
            and (begin.manifest.get("images"), begin.manifest.get("points")) == (list(net.images), list(net.points)):
        x0 = problem.inner.restored(net, begin.last.x) if problem.inner else begin.last.x
    if isinstance(problem, OrthogonalBundle) and problem.extra:
        raise DegenerateGeometry(f"{name}: the orthogonal model of two images leaves depths as the start values have them; "
                                 "compare with --model perspective, or take a third image")
    trace = Trace(tuple(iterate(problem, x0, start.options)), start.manifest)
    if not trace.converged:
        raise DegenerateGeometry(f"{name}: the adjustment did not converge ({trace.last.stop} after {trace.iterations} "
                                 "iterations); look at it with collinea adjust first")
    x = trace.last.x
    xyz = start.data.frame.to_map(net.split(x)[2])
    frame = frame or start.data.frame
    sigma0 = float(np.sqrt(2 * trace.last.cost / problem.dof)) if problem.dof > 0 else float("nan")
    epoch = Epoch(name, net.points, frame.to_local(xyz), joint_covariance(problem, x), sigma0, problem.dof)
    return epoch, frame, (*start.warnings, *bad_fit(trace.last.cost, problem.dof))


__all__ = ["free_epoch", "joint_covariance"]
