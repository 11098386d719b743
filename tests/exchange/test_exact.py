"""Rotations and t = -R C with all their digits."""

from decimal import Decimal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solvers import BadTable
from solvers.geometry import closest_rotation
from solvers.io.exchange import exact
from solvers.io.exchange.conventions import quaternion_as

TURNS = Rotation.from_quat(np.random.default_rng(3).normal(size=(60, 4)))


def test_rotations_are_those_of_another_library() -> None:
    for turn in TURNS[:20]:
        x, y, z, w = turn.as_quat()
        m = turn.as_matrix()
        np.testing.assert_allclose(exact.floats(exact.of_quaternion([2 * w, 2 * x, 2 * y, 2 * z])), m, atol=1e-15)
        np.testing.assert_allclose(exact.floats(exact.of_vector(turn.as_rotvec())), m, atol=1e-15)
        rough = m + 1e-5 * np.arange(9).reshape(3, 3)
        np.testing.assert_allclose(exact.floats(exact.of_matrix(rough)), closest_rotation(rough), atol=1e-15)
    np.testing.assert_array_equal(exact.floats(exact.of_vector([0.0, 0.0, 0.0])), np.eye(3))


def test_rows_are_orthogonal_to_all_digits() -> None:
    for rows in (exact.of_quaternion([0.1, -0.7, 0.3, 0.2]), exact.of_vector([2.0, -1.0, 1.7]),
                 exact.of_matrix(TURNS[0].as_matrix())):
        for i in range(3):
            for j in range(3):
                dot = sum((a * b for a, b in zip(rows[i], rows[j], strict=True)), Decimal(0))
                assert abs(dot - (1 if i == j else 0)) < Decimal("1e-26")


@pytest.mark.parametrize("north", [5_334_100.3, 9_834_100.1, 16_000_000.7])
def test_a_centre_comes_back_through_text_and_float64(north: float) -> None:
    """Text loses nothing; float64 at most a unit in the last place of the centre."""
    rng = np.random.default_rng(5)
    for turn in TURNS:
        at = np.array([333_210.7, north, 1412.3]) + rng.uniform(-999, 999, 3)
        q = quaternion_as(turn.as_matrix())
        digits = [Decimal(exact.text(v)) for v in exact.translation(exact.of_quaternion(q), at)]
        np.testing.assert_array_equal(exact.centre(exact.of_quaternion(q), digits), at)
        kept = exact.kept_quaternion(q, at)
        assert np.abs(kept - q).max() < 1e-14
        t = [float(v) for v in exact.translation(exact.of_quaternion(kept), at)]
        off = np.abs(exact.centre(exact.of_quaternion(kept), t) - at)
        assert off.max() < (1e-9 if north < 1e7 else 2e-9)


def test_no_rotation() -> None:
    with pytest.raises(BadTable, match="quaternion"):
        exact.of_quaternion([0.0, 0.0, 0.0, 0.0])
    with pytest.raises(BadTable, match="rotation vector"):
        exact.of_vector([1e9, 0.0, 0.0])
