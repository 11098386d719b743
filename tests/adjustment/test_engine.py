"""The engine on small problems whose answer is known: rows, stop reasons, damping, constraints."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice

import numpy as np
import pytest

from solvers.adjustment import CONVERGED, Dense, Linear, Options, Trace, iterate, precision, solve
from tests.checks import check_jacobian, chi_square_band

T = np.linspace(0, 3, 12)


@dataclass(frozen=True)
class Decay:
    """y = a exp(-b t), the textbook curve; sigma 0.01. Residuals of 0 where y is exact."""

    y: np.ndarray = field(default_factory=lambda: 2.0 * np.exp(-0.7 * T))
    dof: int = len(T) - 2

    def linear(self, x: np.ndarray) -> Linear:
        e = np.exp(-x[1] * T)
        j = np.stack([e, -x[0] * T * e], axis=1)[:, None]
        return Linear((self.y - x[0] * e)[:, None], j, np.full((len(T), 1, 1), 1e4))

    def cost(self, x: np.ndarray) -> float:
        return self.linear(x).cost

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def normal(self, x: np.ndarray) -> Dense:
        return self.linear(x).normal()

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return x + dx


@dataclass(frozen=True)
class Circle:
    """The point on the circle |x| = r nearest to a target: two parameters, one constraint. As a constrained problem, or
    reparametrised by its angle (one parameter, none)."""

    target: np.ndarray
    r: float = 2.0
    by_angle: bool = False
    dof: int = 1

    def point(self, x: np.ndarray) -> np.ndarray:
        return self.r * np.array([np.cos(x[0]), np.sin(x[0])]) if self.by_angle else x

    def linear(self, x: np.ndarray) -> Linear:
        v, p = (self.target - self.point(x))[None], np.diag([4.0, 1.0])[None]
        if self.by_angle:
            return Linear(v, self.r * np.array([-np.sin(x[0]), np.cos(x[0])])[None, :, None], p)
        return Linear(v, np.eye(2)[None], p, 2 * x[None], -np.array([x @ x - self.r**2]))

    def cost(self, x: np.ndarray) -> float:
        return self.linear(x).cost

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0) if self.by_angle else np.array([x @ x - self.r**2])

    def normal(self, x: np.ndarray) -> Dense:
        return self.linear(x).normal()

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return x + dx


def noisy(seed: int = 1) -> Decay:
    return Decay(2.0 * np.exp(-0.7 * T) + 0.01 * np.random.default_rng(seed).standard_normal(len(T)))


START = np.array([1.0, 0.1])


def test_row_0_is_the_start_and_only_the_last_row_has_a_stop():
    trace = solve(noisy(), START, manifest={"problem": "decay"})
    first = trace.rows[0]
    assert first.index == 0 and np.array_equal(first.x, START) and np.isnan(first.step) and first.trials == 0
    assert first.cost == noisy().cost(START)
    assert [r.index for r in trace.rows] == list(range(len(trace)))
    assert all(r.stop is None for r in trace.rows[:-1]) and trace.last.stop in CONVERGED
    assert trace.manifest["problem"] == "decay" and trace.iterations == len(trace) - 1
    assert trace.column("x").shape == (len(trace), 2) and (np.diff(trace.column("cost")) <= 0).all()


def test_every_row_tells_its_own_x():
    problem = noisy()
    for row in iterate(problem, START):
        assert row.cost == pytest.approx(problem.cost(row.x), rel=1e-14)
        assert row.sigma0 == pytest.approx(np.sqrt(2 * row.cost / 10))


def test_next_is_one_step_and_asking_no_more_cancels():
    class Counting(Decay):
        asked = 0

        def normal(self, x: np.ndarray) -> Dense:
            Counting.asked += 1
            return super().normal(x)

    rows = iterate(Counting(noisy().y), START)
    next(rows)
    before = Counting.asked
    three = list(islice(rows, 2))
    assert before == 1 and Counting.asked == 3 and [r.index for r in three] == [1, 2]


def test_the_start_is_not_changed():
    start = START.copy()
    solve(noisy(), start)
    assert np.array_equal(start, START)


@pytest.mark.parametrize("stop, problem, options", [
    ("step", noisy(), Options(gradient_tolerance=0, cost_tolerance=0)),
    ("gradient", noisy(), Options(step_tolerance=0, cost_tolerance=0, gradient_tolerance=1e-6)),
    ("cost", noisy(), Options(step_tolerance=0, gradient_tolerance=0, cost_tolerance=1e-6)),
    ("max_iterations", noisy(), Options(max_iterations=2)),
])
def test_every_stop_reason_can_be_reached(stop, problem, options):
    trace = solve(problem, START, options)
    assert trace.last.stop == stop
    assert trace.converged == (stop != "max_iterations")
    if stop != "max_iterations":
        assert np.abs(trace.last.x - solve(problem, START).last.x).max() < 1e-4


def test_an_impossible_start_diverges_in_row_0():
    trace = solve(Decay(), np.array([np.inf, 0.0]))
    assert len(trace) == 1 and trace.last.stop == "diverged" and not trace.converged


def test_where_no_step_helps_it_says_diverged_and_keeps_the_last_good_x():
    class Wall(Decay):
        def cost(self, x: np.ndarray) -> float:
            return super().cost(x) if np.array_equal(x, START) else np.inf

    trace = solve(Wall(), START)
    assert trace.last.stop == "diverged" and np.array_equal(trace.last.x, START)


def test_undamped_steps_may_run_away_and_the_rows_stay_finite():
    class Away(Decay):
        def normal(self, x: np.ndarray) -> Dense:
            plain = super().normal(x)
            return Dense(plain.n, -1e6 * plain.gradient)

    trace = solve(Away(), START, Options.gauss_newton())
    assert trace.last.stop == "diverged"
    assert all(np.isfinite(r.cost) and np.isfinite(r.x).all() for r in trace.rows)


def test_a_singular_problem_does_not_raise_nan():
    class Flat(Decay):
        def linear(self, x: np.ndarray) -> Linear:
            plain = super().linear(x)
            return Linear(plain.v, plain.j[:, :, [0, 0]], plain.p)

    for options in (Options(), Options.gauss_newton(max_iterations=5)):
        assert all(np.isfinite(r.x).all() for r in solve(Flat(), np.array([1.0, 0.7]), options).rows)


def test_gauss_newton_and_levenberg_marquardt_agree():
    lm, gn = (solve(noisy(), np.array([1.8, 0.6]), o) for o in (Options(), Options.gauss_newton()))
    assert lm.converged and gn.converged
    assert np.abs(lm.last.x - gn.last.x).max() < 1e-9
    assert (gn.column("damping") == 0).all()


def test_damping_saves_a_start_from_which_plain_gauss_newton_runs_away():
    far = np.array([0.1, 6.0])
    assert not solve(Decay(), far, Options.gauss_newton()).converged or solve(Decay(), far, Options.gauss_newton()).last.cost > 1
    lm = solve(Decay(), far, Options(max_iterations=200))
    assert lm.converged and np.abs(lm.last.x - [2.0, 0.7]).max() < 1e-6


def test_exact_data_reach_round_off():
    trace = solve(Decay(), START)
    assert trace.converged and np.abs(trace.last.x - [2.0, 0.7]).max() < 1e-12


@pytest.mark.parametrize("start", [[2.0, 0.0], [0.3, 1.0], [5.0, 5.0]])
@pytest.mark.parametrize("options", [Options(), Options.gauss_newton(max_iterations=100)])
def test_constraints_by_bordering_equal_the_reparametrised_solution(start, options):
    target = np.array([2.1, 0.9])
    bordered = solve(Circle(target), np.array(start), options)
    angle = solve(Circle(target, by_angle=True), np.array([0.5]))
    assert bordered.converged, bordered.last.stop
    x = bordered.last.x
    assert abs(x @ x - 4.0) < 1e-9
    assert np.abs(x - Circle(target, by_angle=True).point(angle.last.x)).max() < 1e-7
    assert bordered.last.cost == pytest.approx(angle.last.cost, rel=1e-8)


def test_constrained_covariance_lies_along_the_constraint_and_equals_the_reparametrised_one():
    on_circle = 2 * np.array([np.cos(0.5), np.sin(0.5)])
    q = precision(Circle(on_circle).linear(on_circle)).covariance
    qa = precision(Circle(on_circle, by_angle=True).linear(np.array([0.5]))).covariance[0, 0]
    tangent = 2 * np.array([-np.sin(0.5), np.cos(0.5)])
    assert np.abs(q - qa * np.outer(tangent, tangent)).max() < 1e-12


def test_check_jacobian_finds_a_wrong_sign():
    class Wrong(Decay):
        def linear(self, x: np.ndarray) -> Linear:
            plain = super().linear(x)
            return Linear(plain.v, plain.j * [1, -1], plain.p)

    check_jacobian(noisy(), np.array([2.0, 0.7]))
    with pytest.raises(AssertionError):
        check_jacobian(Wrong(noisy().y), np.array([2.0, 0.7]))


def test_covariance_and_sigma0_of_the_engine_agree_with_scatter():
    q = precision(Decay().linear(np.array([2.0, 0.7]))).covariance
    errors, sums = [], []
    for seed in range(80):
        last = solve(noisy(seed), np.array([1.5, 0.5])).last
        gap = last.x - [2.0, 0.7]
        errors.append(gap @ np.linalg.solve(q, gap))
        sums.append(2 * last.cost)
    chi_square_band(np.array(errors), 2)
    chi_square_band(np.array(sums), 10)


def test_trace_is_a_value():
    trace = solve(noisy(), START)
    with pytest.raises(AttributeError):
        trace.rows = ()  # type: ignore[misc]
    assert isinstance(trace, Trace)
