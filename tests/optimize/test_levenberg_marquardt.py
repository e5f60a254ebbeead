from itertools import pairwise

import numpy as np
import pytest

from kennfeld.native import Cholesky
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, Stop, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows
from tests.draws import mostly_slow


class Residuals:
    """A sum of squares of given residuals, as the solver sees it; by rows (`small`) or by normal equations."""

    def __init__(self, residuals, jacobian, small=True):
        self.residuals, self.jacobian, self.uses_qr = residuals, jacobian, small
        self.supports_acceleration = small
        self.supports_secant = True
        self.target_squares = 0.0
        self.tried = []

    def cost(self, values):
        self.tried.append(values.copy())
        with np.errstate(all="ignore"):
            return float(np.sum(self.residuals(values) ** 2))

    def residual(self, values):
        with np.errstate(all="ignore"):
            return self.residuals(values)

    def rows(self, values):
        with np.errstate(all="ignore"):
            return self.residuals(values), self.jacobian(values)

    def normal(self, values):
        residual, jacobian = self.rows(values)
        return jacobian.T @ residual, jacobian.T @ jacobian

    def mean_curvature(self, diagonal):
        return np.zeros_like(diagonal)

    def cholesky(self, size):
        return Cholesky(size)


def rosenbrock(small=True, scale=(1.0, 1.0)):
    s = np.array(scale)
    return Residuals(
        lambda p: np.array([10 * (p[1] / s[1] - (p[0] / s[0]) ** 2), 1 - p[0] / s[0]]),
        lambda p: np.array([[-20 * p[0] / s[0] ** 2, 10 / s[1]], [-1 / s[0], 0.0]]),
        small,
    )


def linear(matrix, right, small=True):
    return Residuals(lambda p: matrix @ p - right, lambda p: matrix.copy(), small)


def descend(objective, start, limits=None, **settings):
    start = np.array(start, dtype=float)
    return levenberg_marquardt(objective, start, limits or LinearLimits.none(start.size), SolverSettings(**settings))


both_paths = pytest.mark.parametrize("small", [True, False], ids=["rows", "normal equations"])


@both_paths
def test_the_valley_of_rosenbrock_is_followed_to_its_end(small):
    end = descend(rosenbrock(small), [-1.2, 1.0])
    assert end.status == "converged"
    np.testing.assert_allclose(end.values, 1.0, rtol=1e-6)


@both_paths
@pytest.mark.parametrize("scale", mostly_slow([(1e-6, 1e6), (1e8, 1e-3), (1e-10, 1e-10)], 1))
def test_the_result_does_not_depend_on_the_units_of_the_values(small, scale):
    end = descend(rosenbrock(small, scale), np.array([-1.2, 1.0]) * scale)
    assert end.status == "converged"
    np.testing.assert_allclose(end.values / scale, 1.0, rtol=1e-6)


@both_paths
@pytest.mark.parametrize("unit", mostly_slow([1e-12, 1e12], 1))
def test_the_result_does_not_depend_on_the_unit_of_the_residuals(small, unit):
    plain = rosenbrock(small)
    other = Residuals(lambda p: unit * plain.residuals(p), lambda p: unit * plain.jacobian(p), small)
    first, second = descend(plain, [-1.2, 1.0]), descend(other, [-1.2, 1.0])
    assert second.status == "converged"
    np.testing.assert_allclose(second.values, first.values, rtol=1e-6)


def test_a_large_target_far_from_the_start_is_reached():
    x = np.linspace(0, 3, 41)
    target = 1e12 * np.exp(-x)
    model = Residuals(
        lambda p: p[0] * np.exp(p[1] * x) - target,
        lambda p: np.stack([np.exp(p[1] * x), p[0] * x * np.exp(p[1] * x)], axis=1),
    )
    end = descend(model, [1.0, 0.0])
    assert end.status != "converged" or end.values == pytest.approx([1e12, -1.0], rel=1e-6)


def test_both_paths_end_at_the_same_cost():
    random = np.random.default_rng(0)
    x = random.standard_normal(40)
    y = 2 * np.tanh(x - 0.3) + 0.01 * random.standard_normal(40)
    ends = [
        descend(
            Residuals(
                lambda p: p[0] * np.tanh(p[1] * x + p[2]) - y,
                lambda p: np.stack(
                    [
                        np.tanh(p[1] * x + p[2]),
                        p[0] * x / np.cosh(p[1] * x + p[2]) ** 2,
                        p[0] / np.cosh(p[1] * x + p[2]) ** 2,
                    ],
                    axis=1,
                ),
                small,
            ),
            [1.0, 0.5, 0.1],
        )
        for small in (True, False)
    ]
    assert ends[0].cost == pytest.approx(ends[1].cost, rel=1e-7)


@both_paths
def test_a_matrix_without_full_rank_still_reaches_the_least_cost(small):
    random = np.random.default_rng(1)
    matrix = random.standard_normal((30, 3)) @ random.standard_normal((3, 8))
    right = random.standard_normal(30)
    least = np.sum((matrix @ np.linalg.lstsq(matrix, right, rcond=None)[0] - right) ** 2)
    end = descend(linear(matrix, right, small), np.zeros(8))
    assert end.status == "converged"
    assert end.cost == pytest.approx(least, rel=1e-8)


@both_paths
def test_values_without_an_effect_keep_their_start_bit_for_bit(small):
    matrix = np.random.default_rng(2).standard_normal((20, 5))
    matrix[:, [1, 4]] = 0.0
    end = descend(linear(matrix, np.ones(20), small), np.full(5, 0.1))
    assert end.values[[1, 4]].tolist() == [0.1, 0.1]


@both_paths
def test_problems_with_more_values_than_residuals_are_solved(small):
    matrix = np.random.default_rng(3).standard_normal((3, 10))
    end = descend(linear(matrix, np.array([1.0, 2.0, 3.0]), small), np.zeros(10))
    assert end.status == "converged"
    assert end.cost <= 1e-15


@both_paths
def test_a_start_without_error_has_converged(small):
    end = descend(linear(np.eye(2), np.ones(2), small), [1.0, 1.0])
    assert (end.status, end.cost, end.iterations) == ("converged", 0.0, 0)


def test_a_problem_without_a_free_value_ends_at_once():
    at = np.array([1.0, 2.0])
    end = descend(linear(np.eye(2), np.zeros(2)), at, LinearLimits(at, at))
    assert (end.status, end.message) == ("converged", "No value is free to move.")
    assert end.values.tolist() == [1.0, 2.0]


def test_a_start_that_is_not_finite_has_failed():
    end = descend(Residuals(lambda p: np.log(p), lambda p: np.diag(1 / p)), [-1.0])
    assert end.status == "failed"
    assert "start" in end.message


def test_a_derivative_that_is_not_finite_has_failed():
    end = descend(Residuals(lambda p: p - 1, lambda p: np.array([[np.inf]])), [3.0])
    assert end.status == "failed"
    assert "derivative" in end.message


def test_reaching_the_iteration_limit_of_a_descent_is_a_status():
    end = descend(rosenbrock(), [-1.2, 1.0], max_iterations=3)
    assert (end.status, end.iterations) == ("max_iterations", 3)
    assert "max_iterations" in end.message


@pytest.mark.parametrize("interruption", [Stop, KeyboardInterrupt])
def test_a_request_to_stop_keeps_the_best_values(interruption):
    steps = []

    def report(line, values):
        steps.append((line.cost, values.copy()))
        if line.iteration == 4:
            raise interruption

    end = levenberg_marquardt(rosenbrock(), np.array([-1.2, 1.0]), LinearLimits.none(2), SolverSettings(), report)
    assert (end.status, end.iterations) == ("stopped", 4)
    assert end.cost == steps[-1][0] == min(cost for cost, _ in steps)
    assert np.array_equal(end.values, steps[-1][1])


def test_another_error_of_the_callback_is_passed_on():
    def report(line, values):
        raise RuntimeError("disk full")

    with pytest.raises(RuntimeError, match="disk full"):
        levenberg_marquardt(rosenbrock(), np.array([-1.2, 1.0]), LinearLimits.none(2), SolverSettings(), report)


@both_paths
def test_trial_steps_to_undefined_values_are_rejected(small):
    objective = Residuals(lambda p: np.log(p) + 3, lambda p: np.diag(1 / p), small)
    costs = []
    end = levenberg_marquardt(
        objective, np.array([5.0]), LinearLimits.none(1), SolverSettings(), lambda line, values: costs.append(line.cost)
    )
    assert end.status == "converged"
    assert end.values == pytest.approx([np.exp(-3)], rel=1e-6)
    assert all(np.isfinite(costs))


@both_paths
def test_the_cost_falls_with_every_accepted_step(small):
    costs = []
    levenberg_marquardt(
        rosenbrock(small),
        np.array([-1.2, 1.0]),
        LinearLimits.none(2),
        SolverSettings(),
        lambda line, values: costs.append(line.cost),
    )
    assert all(later < earlier for earlier, later in pairwise(costs))


@both_paths
@pytest.mark.parametrize("seed", mostly_slow(range(8), 3))
def test_the_solution_within_bounds_is_that_of_scipy(small, seed):
    from scipy.optimize import lsq_linear

    random = np.random.default_rng([seed, 3])
    matrix, right = random.standard_normal((60, 25)), 3 * random.standard_normal(60)
    lower, upper = -random.uniform(0.01, 0.3, 25), random.uniform(0.01, 0.3, 25)
    limits = LinearLimits(lower, upper)
    end = descend(linear(matrix, right, small), np.zeros(25), limits, tolerance=1e-12)
    judge = lsq_linear(matrix, right, (lower, upper), method="bvls", tol=1e-14)
    assert end.cost == pytest.approx(2 * judge.cost, rel=1e-9)


@both_paths
@pytest.mark.parametrize("seed", mostly_slow(range(12), 4))
def test_equalities_and_bounds_hold_at_every_iterate(small, seed):
    random = np.random.default_rng([seed, 4])
    matrix, right = random.standard_normal((40, 12)), 5 * random.standard_normal(40)
    start = random.uniform(-0.1, 0.1, 12)
    rows = random.standard_normal((2, 12))
    limits = LinearLimits(np.full(12, -0.2), np.full(12, 0.2), LinearRows.of(rows, rows @ start, rows @ start))
    objective = Residuals(lambda p: np.sinh(matrix @ p) - right, lambda p: np.cosh(matrix @ p)[:, None] * matrix, small)
    iterates = []
    levenberg_marquardt(objective, start, limits, SolverSettings(), lambda line, values: iterates.append(values.copy()))
    assert iterates
    for values in iterates:
        assert np.all((values >= limits.lower) & (values <= limits.upper))
        assert limits.violation(values) <= 1e-9


def test_a_locked_value_never_moves_at_any_trial():
    objective = rosenbrock()
    limits = LinearLimits(np.array([-np.inf, 0.3]), np.array([np.inf, 0.3]))
    end = descend(objective, [-1.2, 0.3], limits)
    assert {values[1] for values in objective.tried} == {0.3}
    assert end.status == "converged"


def test_powell_singular_function_is_solved():
    def residuals(p):
        a, b, c, d = p
        return np.array([a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2])

    def jacobian(p):
        a, b, c, d = p
        k = 2 * 10**0.5 * (a - d)
        return np.array(
            [[1, 10, 0, 0], [0, 0, 5**0.5, -(5**0.5)], [0, 2 * (b - 2 * c), -4 * (b - 2 * c), 0], [k, 0, 0, -k]]
        )

    end = descend(Residuals(residuals, jacobian), [3.0, -1.0, 0.0, 1.0], max_iterations=500, tolerance=1e-15)
    assert end.cost <= 1e-20


def test_the_helical_valley_is_solved():
    def residuals(p):
        angle = np.arctan2(p[1], p[0]) / (2 * np.pi)
        return np.array([10 * (p[2] - 10 * angle), 10 * (np.hypot(p[0], p[1]) - 1), p[2]])

    def jacobian(p):
        square, root = p[0] ** 2 + p[1] ** 2, np.hypot(p[0], p[1])
        k = 100 / (2 * np.pi * square)
        return np.array([[k * p[1], -k * p[0], 10], [10 * p[0] / root, 10 * p[1] / root, 0], [0, 0, 1]])

    end = descend(Residuals(residuals, jacobian), [-1.0, 0.0, 0.0])
    assert end.values == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


@both_paths
@pytest.mark.parametrize("factor", [1.0, 10.0])
def test_problems_with_large_residuals_are_solved(small, factor):
    """Brown and Dennis; the Gauss-Newton matrix misses most of the curvature here."""
    t = np.arange(1, 21) / 5

    def parts(p):
        return p[0] + t * p[1] - np.exp(t), p[2] + p[3] * np.sin(t) - np.cos(t)

    def jacobian(p):
        first, second = parts(p)
        return 2 * np.stack([first, first * t, second, second * np.sin(t)], axis=1)

    objective = Residuals(lambda p: parts(p)[0] ** 2 + parts(p)[1] ** 2, jacobian, small)
    end = descend(objective, factor * np.array([25.0, 5.0, -5.0, -1.0]))
    assert end.status == "converged"
    assert end.cost == pytest.approx(85822.20162635, rel=1e-8)


@pytest.mark.slow
def test_overflow_in_trial_steps_does_not_warn():
    x = np.linspace(0, 3, 10)
    model = Residuals(lambda p: np.exp(p[0] * x) - 5.0, lambda p: (x * np.exp(p[0] * x))[:, None])
    end = descend(model, [100.0], max_iterations=2000)
    assert end.status == "converged"
    assert end.cost < model.cost(np.array([0.0]))


@pytest.mark.parametrize("small", [True, False])
def test_a_descent_from_values_that_fit_exactly_converges(small):
    """A predicted decrease of the size of rounding errors is not a failure."""
    random = np.random.default_rng(0)
    for _ in range(30):
        matrix, truth = random.normal(size=(8, 4)), random.normal(size=4)
        objective = linear(matrix, matrix @ truth, small)
        end = descend(objective, descend(objective, np.zeros(4)).values)
        assert end.status == "converged"
        near = descend(objective, truth + 1e-15 * random.normal(size=4))
        assert near.status == "converged"


def test_a_value_near_a_lower_cost_is_not_a_minimum():
    objective = Residuals(lambda p: p - 1, lambda p: -np.eye(1))  # the derivative has the wrong sign
    assert descend(objective, [1.2]).status == "failed"


def test_an_end_at_a_kink_is_doubted_only_if_its_slopes_promise_enough():
    def side(values):
        return np.where(values >= 0, 1.0, -1.0)

    def end(doubtful):
        kinked = Residuals(
            lambda p: np.array([1 + 0.1 * abs(p[0]), p[0], 5.0]),
            lambda p: np.array([0.1 * side(p), [1.0], [0.0]]),
        )
        return descend(kinked, [1.0], doubtful_promise=doubtful)

    always, more, less = end(0.0), end(1e-4), end(1e-3)
    for result in (always, more, less):
        assert result.status == "converged"
        assert result.cost == pytest.approx(26.0, rel=1e-6)
        assert 1e-4 < result.certificate.predicted_decrease < 1e-3
    assert more.evaluations == always.evaluations
    assert less.evaluations < 0.6 * always.evaluations


@pytest.mark.parametrize(("target", "status"), [(1.0, "converged"), (1e-13, "failed")])
def test_residuals_as_small_as_the_rounding_of_the_targets_converge(target, status):
    # the output hardly depends on the value, so that |J p| does not tell its rounding
    objective = Residuals(lambda p: 1e-15 * (1 + np.abs(p)), lambda p: np.full((1, 1), 1e-15))
    objective.target_squares = target**2
    assert descend(objective, [1e-9]).status == status


def test_the_curvature_along_a_step_needs_no_derivatives():
    problem, calls = rosenbrock(), []
    slopes = problem.jacobian
    problem.jacobian = lambda values: calls.append(values) or slopes(values)
    result = descend(problem, [-1.2, 1.0])
    assert result.status == "converged"
    assert len(calls) == result.iterations + 1
