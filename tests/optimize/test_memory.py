"""Delays, and values to fit, that no memory could hold."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.validation import delay_findings, matrix_findings

DATA = {"time": [0.0, 0.1, 0.2], "x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}
TEXT = "u = 2 * x\ny = k * x + delay(u, {steps}, 0)"
REFUSED = r"line 2: a delay of 1000000000 steps needs 24 GB of memory\. Use a shorter delay"


def test_a_calibration_is_refused():
    with pytest.raises(kf.InputError, match=REFUSED):
        kf.calibrate(TEXT.format(steps=10**9), kf.Dataset.of("d", DATA), {"k": 1.0}, target="m")


def test_a_simulation_is_refused():
    with pytest.raises(kf.InputError, match="needs 16 GB of memory"):
        kf.simulate(TEXT.format(steps=10**9), kf.Dataset.of("d", DATA), {"k": 1.0})


def test_a_delay_longer_than_the_data_is_accepted():
    simulation = kf.simulate(TEXT.format(steps=100_000), kf.Dataset.of("d", DATA), {"k": 1.0})
    np.testing.assert_array_equal(simulation["y"].values, DATA["x"])


def test_a_number_of_many_digits_is_abbreviated():
    with pytest.raises(kf.InputError, match=r"a delay of 1e\+300 steps needs"):
        kf.simulate(TEXT.format(steps="1e300"), kf.Dataset.of("d", DATA), {"k": 1.0})


def test_a_delay_is_too_long_sooner_with_many_values():
    model = formula(TEXT.format(steps=10**7), parameters=["k"])
    assert delay_findings(model, 10) == []
    assert len(delay_findings(model, 100)) == 1


def test_a_calibration_of_too_many_values_is_refused():
    curve = kf.Curve("C", np.arange(50_000.0), np.ones(50_000))
    with pytest.raises(kf.InputError, match=r"50000 free values need matrices of 20 GB\. Use fewer breakpoints"):
        kf.calibrate("y = C(x)", DATA, kf.ParameterSet([curve]), target="m")


def test_a_large_table_that_is_not_fitted_is_accepted():
    curve = kf.Curve("C", np.arange(50_000.0), np.ones(50_000))
    start = kf.ParameterSet([curve, kf.Scalar("k", 1.0)])
    assert kf.calibrate("y = k * x * C(x)", DATA, start, target="m", free=["k"]).converged


def test_a_curve_of_many_thousand_values_is_allowed():
    assert matrix_findings("parameters", 10_000) == []
