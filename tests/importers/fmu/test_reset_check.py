"""Instances that are not as new after a reset, for model exchange; `test_trajectories` has those for co-simulation."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.importers.fmu.fmu_archive import digest_of
from kennfeld.importers.fmu.importing import fmu
from kennfeld.importers.fmu.instance import load_instance
from kennfeld.importers.fmu.reset_check import is_repeated
from tests.draws import mostly_slow
from tests.importers.fmu.lag_fmu import build

STEP, COUNT = 0.1, 50
LIFT, TAU = 0.35, 0.7
DATA = {"time": np.arange(COUNT) * STEP, "u": np.full(COUNT, 3.0)}


def lag_with_lift(k):
    """Return y of the lag with its lift above x = 1.2, with a step of Euler's method."""
    x = 3.0 + (k - 3.0) * (1 - STEP / TAU) ** np.arange(COUNT)
    return k * x + np.where(x > 1.2, LIFT, 0.0) + sum(n * (10 * (n // 3 + 1) + n % 3 + 1) for n in range(6))


@pytest.fixture(params=mostly_slow([2, 3], [2]))
def forgetful(request, tmp_path):
    return build(tmp_path, request.param, "-DLIFT", "-DLOST_START", lift=True)


def test_a_start_value_that_a_reset_loses_holds_in_each_trajectory(forgetful):
    model = fmu(forgetful, solver="ode1")
    for k in (1.0, 1.1, 1.0):
        y = kf.simulate(model, DATA, {"tau": TAU, "k": k})["y"].values
        np.testing.assert_allclose(y, lag_with_lift(k), rtol=1e-12)


def test_a_calibration_is_not_misled_by_a_start_value_that_a_reset_loses(forgetful):
    data = {**DATA, "target": lag_with_lift(1.0)}
    result = kf.calibrate(fmu(forgetful, solver="ode1"), data, {"tau": 1.3}, "target", free=["tau"])
    assert result.parameters["tau"].value == pytest.approx(TAU, rel=1e-6)


@pytest.mark.parametrize(("options", "resets"), [(("-DLIFT",), True), (("-DLIFT", "-DLOST_START"), False)])
def test_an_instance_is_replaced_only_if_a_reset_is_not_enough(tmp_path, options, resets):
    path = build(tmp_path, 2, *options, lift=True)
    assert load_instance(str(path), digest_of(path)).resets == resets


def test_nan_is_repeated_by_nan_alone():
    new = np.array([1.0, np.nan, np.inf])
    assert is_repeated(new, new, new.copy())
    assert is_repeated(np.array([[1e6, 1.0], [0.0, 1.0]]), np.array([[1e6, 1.0], [1e-4, 1.0]]))
    assert not is_repeated(new, new, np.array([1.0, 2.0, np.inf]))
    assert not is_repeated(new, np.array([np.nan, np.nan, np.inf]))
