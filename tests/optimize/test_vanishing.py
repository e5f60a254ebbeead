"""Fits whose errors are too small to be squared."""

import numpy as np
import pytest

import kennfeld as kf

X = np.arange(1.0, 9.0)


@pytest.mark.parametrize(
    ("weight", "scale", "size"), [(1.0, 1e200, 1.0), (1e-300, 1e160, 1.0), (1.0, 1.0, 1e-200), (1e-160, 1e160, 1.0)]
)
def test_errors_that_vanish_in_the_cost_prevent_convergence(weight, scale, size):
    criterion = kf.Criterion("m", "z", weight=weight, scale=scale)
    result = kf.calibrate("m = k * x", {"x": X, "z": 3 * size * X}, {"k": 0.0}, criteria=[criterion])
    assert result.status == "failed"
    assert "squares of the errors underflow" in result.message


def test_a_start_that_is_exact_has_converged():
    assert kf.calibrate("m = k * x", {"x": X, "z": 3 * X}, {"k": 3.0}, target="z").converged


def test_a_fit_that_reaches_the_data_has_converged():
    result = kf.calibrate(
        "m = k * x", {"x": X, "z": 3 * X}, {"k": 1.0}, criteria=[kf.Criterion("m", "z", weight=1e-280)]
    )
    assert result.converged
    assert result.parameters["k"].value == pytest.approx(3.0)


def test_a_criterion_of_weight_zero_does_not_count():
    criteria = [kf.Criterion("m", "z"), kf.Criterion("m2", "z", weight=0.0)]
    result = kf.calibrate("m = k * x\nm2 = 2 * k * x", {"x": X, "z": 3 * X}, {"k": 3.0}, criteria=criteria)
    assert result.converged
