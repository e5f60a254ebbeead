"""Values that are too many for the matrix of a fit."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.data.matrix_memory import matrix_findings

DATA = {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}


def test_a_calibration_of_too_many_values_is_refused():
    curve = kf.Curve("C", np.arange(50_000.0), np.ones(50_000))
    with pytest.raises(kf.InputError, match=r"50000 values to fit need matrices of 20 GB\. Use fewer breakpoints"):
        kf.calibrate("y = C(x)", DATA, kf.ParameterSet([curve]), target="m")


def test_a_large_table_that_is_not_fitted_is_none_of_them():
    curve = kf.Curve("C", np.arange(50_000.0), np.ones(50_000))
    start = kf.ParameterSet([curve, kf.Scalar("k", 1.0)])
    assert kf.calibrate("y = k * x * C(x)", DATA, start, target="m", free=["k"]).converged


def test_a_curve_of_many_thousand_values_is_allowed():
    assert matrix_findings("parameters", 10_000) == []
