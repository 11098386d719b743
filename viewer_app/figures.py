"""What the figures beside the iterations show: which one is chosen, and the numbers in it; pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solvers import Exterior

from .acting import Action, handles
from .state import Solution, State

CONVERGENCE, ELEMENTS, CORRELATION, RESIDUALS = "convergence", "elements − final", "correlation", "residuals on the photo"
FIGURES = (CONVERGENCE, ELEMENTS, CORRELATION, RESIDUALS)
NAMES = ("X", "Y", "Z", "ω", "φ", "κ")


@dataclass(frozen=True)
class Figure:
    """Which figure is shown."""

    name: str = CONVERGENCE


@dataclass(frozen=True)
class ChooseFigure(Action):
    """name: one of FIGURES, or "" for the next one."""

    name: str = ""


@handles(ChooseFigure)
def _choose(state: State, action: ChooseFigure) -> State:
    shown = state.room(Figure).name
    name = action.name or FIGURES[(FIGURES.index(shown) + 1) % len(FIGURES)]
    return state.with_room(Figure(name)) if name in FIGURES else state


def to_final(solution: Solution) -> np.ndarray:
    """(rows, 6) m and degrees: elements of exterior orientation minus those of the last row, angles the short way round."""
    poses = [Exterior.from_vector(row.x) for row in solution.rows]
    elements = np.array([[*e.centre, *np.degrees(e.angles)] for e in poses]).reshape(-1, 6)
    difference = elements - elements[-1:]
    difference[:, 3:] = (difference[:, 3:] + 180.0) % 360.0 - 180.0
    return difference


def correlation(solution: Solution) -> np.ndarray | None:
    """(6, 6) of X, Y, Z, omega, phi, kappa from the solution's own covariance; None before it has ended."""
    if solution.orientation is None:
        return None
    covariance = solution.orientation.covariance[:6, :6]
    sigma = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    return np.clip(covariance / np.outer(sigma, sigma), -1.0, 1.0)
