"""Descents whose slopes say nothing about whole simulations: they go on by wide differences, or the result says so."""

import numpy as np
import pytest

import kennfeld as kf
from tests.optimize.trajectory_functions import lag_function, reset_function

TIME = 0.1 * np.arange(200)
INPUTS = {"time": TIME, "u": np.where(np.sin(TIME) > -0.5, 2.0, 0.3)}
TRUTH = {"k": 13.0, "T": 1.2, "limit": 14.0}


@pytest.fixture
def resetting():
    return kf.formula("y = reset(u)", functions=[reset_function()])


def fitted(model, start, target, **options):
    return kf.calibrate(model, INPUTS | {"m": target}, start, "m", **options)


@pytest.mark.slow
def test_a_fit_continues_if_events_hide_the_slope(resetting):
    target = kf.simulate(resetting, INPUTS, TRUTH)["y"].values
    options = kf.Options(max_iterations=1000)
    result = fitted(resetting, {"k": 8.0, "T": 1.5, "limit": 10.0}, target, options=options)
    assert result.converged
    assert result.cost_after < 0.7 * result.cost_before
    assert abs(result.parameters["limit"].value - 10.0) > 0.1
    assert "along differences of whole simulations" in result.message
    assert "events move with parameters" in " ".join(finding.message for finding in result.warnings)


def test_a_fit_without_events_uses_its_own_slopes():
    model = kf.formula("y = lag.y(u)", functions=[lag_function()])
    target = kf.simulate(model, INPUTS, {"k": 1.3, "T": 0.6})["y"].values
    target = target + 0.05 * np.random.default_rng(1).standard_normal(TIME.size)
    result = fitted(model, {"k": 2.0, "T": 1.0}, target)
    assert result.converged
    assert not result.warnings
    assert "differences" not in result.message


RELAY = "y = PT1(k*hysteresis(u, on, off), T)"


def test_thresholds_without_a_slope_have_the_warning_of_the_check():
    target = kf.simulate(RELAY, INPUTS, {"k": 3.0, "on": 1.0, "off": 0.5, "T": 0.8})["y"].values
    result = fitted(RELAY, {"k": 2.0, "on": 1.95, "off": 0.25, "T": 1.0}, target)
    [finding] = [warning for warning in result.warnings if "jumps" in warning.message]
    assert finding.message == "y (>=, <=) jumps depending on on, off; derivatives do not account for that"
    assert finding.remedy == 'Write method = "global", and bounds for on, off.'


def test_thresholds_without_effect_on_the_cost_have_no_warning():
    target = kf.simulate(RELAY, INPUTS, {"k": 3.0, "on": 1.0, "off": 0.7, "T": 0.8})["y"].values
    target = target + 0.05 * np.random.default_rng(1).standard_normal(TIME.size)
    start = {"k": 2.0, "on": 1.0, "off": 0.7, "T": 1.0}
    assert not fitted(RELAY, start, target, free=["k", "T"]).warnings
