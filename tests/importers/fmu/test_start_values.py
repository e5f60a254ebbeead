"""Values of states at the start of an FMU as parameters."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.importers.fmu.importing import fmu
from tests.draws import mostly_slow
from tests.importers.fmu.lag_fmu import build

STEP, COUNT = 0.1, 50
DATA = {"time": np.arange(COUNT) * STEP, "u": np.full(COUNT, 3.0)}


@pytest.fixture(scope="module", params=mostly_slow([2, 3], [3]))
def settable(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("lag"), request.param, "-DSTART", start='start="1.5"')


def test_the_description_states_the_value(settable):
    assert fmu(settable).carried["x.start"].value == 1.5
    y = kf.simulate(fmu(settable), DATA, {})["y"].values
    assert y[0] == pytest.approx(1.5 + sum(k * (10 * (k // 3 + 1) + k % 3 + 1) for k in range(6)))


def test_a_trajectory_begins_at_the_value(settable):
    first, second = (kf.simulate(fmu(settable), DATA, {"x.start": x})["y"].values for x in (1.0, 2.0))
    np.testing.assert_allclose(second - first, np.exp(-DATA["time"] / 2.0), rtol=1e-6)


def test_start_values_are_fitted_if_asked(settable):
    target = kf.simulate(fmu(settable), DATA, {"x.start": 2.5, "tau": 1.1})["y"].values
    data = {**DATA, "target": target}
    for asked, expected in ((False, 1.5), (True, 2.5)):
        result = kf.calibrate(fmu(settable, fit_starts=asked), data, {}, "target", free=["x.start", "tau"])
        assert result.parameters["x.start"].value == pytest.approx(expected, rel=1e-7)
    assert result.parameters["tau"].value == pytest.approx(1.1, rel=1e-7)


def test_a_state_without_exact_initial_value_has_none(tmp_path):
    assert "x.start" not in fmu(build(tmp_path, 2)).carried
