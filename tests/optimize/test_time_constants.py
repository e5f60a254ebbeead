"""Parameters that are time constants have a natural bound, and fits that press against it come to their end."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.problem.problem import bound_time_constants
from kennfeld.optimize.problem.setup import ProblemSetup

U = np.repeat(np.random.default_rng(0).normal(size=40), 50)
M = U + np.random.default_rng(1).normal(0.0, 0.01, U.size)
DATA = kf.Dataset.of("drive", {"u": U, "m": M}, time=0.1 * np.arange(U.size))


def lag(**attributes):
    return kf.Curve("Lag", [-1.0, 0.0, 1.0], [0.5, 0.5, 0.5], **attributes)


def lower(text, *parameters, **options):
    bounded = bound_time_constants(
        ProblemSetup(text, DATA, kf.ParameterSet(parameters), "m", node="y", **options).problem()
    )
    return np.broadcast_to(bounded.parameters[parameters[0].name].lower, parameters[0].values.shape).tolist()


@pytest.mark.parametrize("start", [0.5, 20.0, -1.0])
def test_the_time_constant_of_a_missing_lag_is_fitted_to_zero(start):
    result = kf.calibrate("y = PT1(u, T)", DATA, {"T": start}, "m")
    assert result.converged
    assert result.parameters["T"].value == pytest.approx(0.0, abs=1e-3)
    assert result.parameters["T"].value >= 0
    assert "rejected" not in result.message


def test_a_start_below_zero_is_moved_with_a_message():
    result = kf.calibrate("y = PT1(u, T)", DATA, {"T": -1.0}, "m")
    assert "start" in result.message
    assert not np.isfinite(result.cost_before)


def test_a_curve_that_ends_at_zero_does_not_stop_the_other_values():
    result = kf.calibrate("y = PT1(u, Lag(u))", DATA, kf.ParameterSet([lag()]), "m")
    assert result.converged
    assert np.all(result.parameters["Lag"].values >= 0)
    assert result.quality[0].rmse_after == pytest.approx(0.01, rel=0.05)


def test_narrower_bounds_of_the_user_stay():
    assert lower("y = PT1(u, Lag(u))", lag(lower=[-1.0, 0.2, -np.inf])) == [0.0, 0.2, 0.0]


def test_a_table_with_another_use_has_no_bounds():
    assert lower("y = PT1(u, Lag(u)) + Lag(2 * u)", lag()) == [-np.inf] * 3


def test_a_part_of_a_time_constant_has_no_bounds():
    assert lower("y = PT1(u, Lag(u) + 1)", lag()) == [-np.inf] * 3


def test_locked_values_have_no_bounds():
    assert lower("y = PT1(u, Lag(u))", lag(locked=[True, False, False])) == [-np.inf, 0.0, 0.0]


def test_negative_parameters_keep_their_bounds():
    assert lower("y = PT1(u, Lag(u))", lag(upper=[-1.0, 1.0, 1.0])) == [-np.inf] * 3


def test_parameters_that_are_not_fitted_keep_their_bounds():
    assert lower("y = PT1(u, Lag(u)) + a", lag(), kf.Scalar("a", 1.0), free=["a"]) == [-np.inf] * 3


def test_a_time_constant_of_0_that_reproduces_the_data_has_converged():
    for seed in (3, 4):
        u = np.random.default_rng(seed).normal(size=300)
        result = kf.calibrate("y = PT1(u, T)", {"time": 0.1 * np.arange(300), "u": u, "m": u}, {"T": 1.0}, "m")
        assert result.converged
        assert result.cost_after < 1e-20
