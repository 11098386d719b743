"""Weight functions of robust estimation: how much of its weight an observation keeps, by its standardized residual.

Each takes t >= 0, the residual over its standard deviation, and gives a factor in (0, 1].
Reference: Huber 1964; Cauchy (Lorentz); Krarup, Juhl & Kubik 1980 (the Danish method).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def huber(t: np.ndarray, k: float = 1.5) -> np.ndarray:
    """1 up to k, then k / t: every residual keeps its sign but not its size."""
    return np.where(t <= k, 1.0, k / np.maximum(t, k))


def cauchy(t: np.ndarray, k: float = 2.385) -> np.ndarray:
    """1 / (1 + (t/k)^2): 95 % efficient for normal errors."""
    return 1.0 / (1.0 + (t / k) ** 2)


def danish(t: np.ndarray, k: float = 3.0) -> np.ndarray:
    """1 up to k, then exp(1 - (t/k)^2): gross errors lose all weight."""
    return np.where(t <= k, 1.0, np.exp(1.0 - np.minimum((t / k) ** 2, 700.0)))


LOSSES: dict[str, Callable[[np.ndarray], np.ndarray]] = {"huber": huber, "cauchy": cauchy, "danish": danish}


def huber_cost(t: np.ndarray, k: float = 1.5) -> np.ndarray:
    """What Huber's weights minimise: t^2 / 2 up to k, then a straight line."""
    return np.where(t <= k, t**2 / 2, k * t - k**2 / 2)


def cauchy_cost(t: np.ndarray, k: float = 2.385) -> np.ndarray:
    """What Cauchy's weights minimise."""
    return k**2 / 2 * np.log1p((t / k) ** 2)


def danish_cost(t: np.ndarray, k: float = 3.0) -> np.ndarray:
    """What the Danish weights minimise: t^2 / 2 up to k, never more than k^2."""
    return np.where(t <= k, t**2 / 2, k**2 / 2 * (2.0 - danish(t, k)))


COSTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"huber": huber_cost, "cauchy": cauchy_cost, "danish": danish_cost}
"""The same functions as costs: d cost / d t = weight(t) t."""
