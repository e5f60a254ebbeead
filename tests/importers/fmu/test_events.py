"""Events of FMUs: changes of states at samples, and conditions on the time."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.graph.external_function import evaluate_points
from kennfeld.importers.fmu.importing import fmu
from tests.draws import mostly_slow
from tests.importers.fmu.lag_fmu import build, equations_of
from tests.importers.fmu.signals_fmu import build_signals

U, TAU = 3.0, 0.8


def reset_lag(count, step):
    """The lag with x(0) = 1 by the classic Runge-Kutta method; x > 2 at a sample sets it to 1."""
    z = -step / TAU
    growth = 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
    x = np.ones(count)
    for i in range(1, count):
        x[i] = U + (x[i - 1] - U) * growth
        x[i] = 1.0 if x[i] > 2.0 else x[i]
    return x


def simulated(path, step, **values):
    count = round(2.0 / step) + 1
    data = {"time": np.arange(count) * step, "u": np.full(count, U)}
    return kf.simulate(fmu(path, step=step), data, {"tau": TAU, **values})["y"].values


@pytest.fixture(params=[2, pytest.param(3, marks=pytest.mark.slow)])
def jumping(request, tmp_path):
    return build(tmp_path, request.param, "-DSTATE_EVENT", indicators=1)


@pytest.mark.slow
def test_an_event_changes_states_at_the_next_sample(jumping):
    y = simulated(jumping, 0.1)
    np.testing.assert_allclose(y - y[0] + 1.0, reset_lag(21, 0.1), rtol=1e-12)


def test_errors_of_events_shrink_with_the_step(jumping):
    period = TAU * np.log(2.0)  # from 1 to 2
    exact = U - 2.0 * np.exp(-(np.arange(21) * 0.1 % period) / TAU)
    off = [
        np.mean(np.abs((y - y[0] + 1.0)[:: len(y) // 20] - exact))
        for y in (simulated(jumping, 0.1), simulated(jumping, 0.001))
    ]
    assert off[1] < 0.02 * off[0]


def test_slopes_at_an_event_are_those_of_the_new_states(jumping):
    function = next(
        node.payload.function
        for node in fmu(jumping).graph.nodes
        if node.op == "external" and "load_events" in node.payload.function.loader
    )
    points = np.array([[0.0, x, U, TAU, 1.2, *range(6)] for x in (1.5, 2.5, 1.5)])
    results, slopes = evaluate_points(function, points)
    np.testing.assert_array_equal(results[:, 0], [1.5, 1.0, 1.5])
    np.testing.assert_array_equal(slopes[:, 0, 1], [1.0, 0.0, 1.0])
    assert not slopes[:, 0, 2:].any()


def test_a_step_goes_on_with_its_own_states(jumping):
    points = np.array([[0.0, x, U, TAU, 1.2, *range(6)] for x in (1.5, 2.5)])
    results, _ = evaluate_points(equations_of(jumping), points)
    np.testing.assert_allclose(results[:, 0], (U - points[:, 1]) / TAU)


def test_a_calibration_reports_that_slopes_ignore_moving_events(jumping):
    model = fmu(jumping, step=0.1)
    data = {"time": np.arange(41) * 0.1, "u": np.full(41, U)}
    data["m"] = kf.simulate(model, data, {"tau": 0.8})["y"].values
    result = kf.calibrate(model, data, {"tau": 1.4}, "m", free=["tau"])
    assert "along differences of whole simulations" in result.message
    assert "events move with parameters" in " ".join(finding.message for finding in result.warnings)
    assert result.cost_after < result.cost_before


@pytest.mark.slow
@pytest.mark.parametrize("version", mostly_slow([2, 3], [3]))
def test_conditions_on_the_time_follow_announced_events(tmp_path, version):
    path = build_signals(tmp_path, version, "-DTIME_EVENT")
    t = np.arange(21) * 0.1
    y = kf.simulate(fmu(path, step=0.1), {"time": t, **signals(version, len(t))}, {})["y"].values
    np.testing.assert_array_equal(y - 100.0, t >= 1.0)


@pytest.mark.parametrize("version", mostly_slow([2, 3], [2]))
def test_events_at_times_are_refused(tmp_path, version):
    other = '<CoSimulation modelIdentifier="signals"/>'
    path = build_signals(tmp_path, version, "-DCOUNTER", interfaces=other)
    with pytest.raises(InputError, match=r"has events at times.* Choose its co-simulation"):
        kf.simulate(fmu(path, step=1.0), {"time": np.arange(3.0), **signals(version, 3)}, {})


def signals(version, count):
    names = ["gear", "on", *(["narrow", "level"] if version == 3 else [])]
    return {"mode": np.ones(count), **{name: np.zeros(count) for name in names}}
