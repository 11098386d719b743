"""Data snooping names the point, and only when there is reason."""

import numpy as np

from solvers.orientation.words import snooping

NAMES = tuple(f"P{i}" for i in range(20))


def test_a_large_standardized_residual_is_named_with_its_point() -> None:
    w = np.random.default_rng(2).normal(0, 1, (20, 2))
    assert snooping(w, NAMES) == []
    w[7, 1] = -5.5
    (said,) = snooping(w, NAMES)
    assert "P7" in said and "row" in said and "5.5" in said


def test_unchecked_observations_are_left_out() -> None:
    assert snooping(np.full((20, 2), np.nan), NAMES) == []


def test_false_alarms_come_at_the_stated_level() -> None:
    rng = np.random.default_rng(3)
    alarms = sum(bool(snooping(rng.normal(0, 1, (20, 2)), NAMES)) for _ in range(3000))
    assert 10 <= alarms <= 55  # 1 % of 3000, three standard deviations and a little


def test_without_observations_there_is_nothing_to_snoop():
    assert snooping(np.empty((0, 2)), ()) == []
