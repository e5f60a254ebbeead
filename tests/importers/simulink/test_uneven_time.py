"""Blocks that integrate, in models that take the step of the data, on uneven time: plain loops."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.integration import SOLVERS
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported

COUNT = 41
RNG = np.random.default_rng(2)
U = RNG.normal(size=COUNT)
TIMES = {
    "alternating": np.concatenate([[0.0], np.cumsum(np.resize([0.4, 0.02], COUNT - 1))]),
    "two rasters": np.union1d(np.arange(0.0, 4.0, 0.1), np.arange(0.0, 4.0, 0.13))[:COUNT],
    "a long step": np.where(np.arange(COUNT) > 20, 1.8, 0.0) + 0.1 * np.arange(COUNT),
}
every_time = pytest.mark.parametrize(
    "time",
    [pytest.param(time, id=name, marks=[pytest.mark.slow][: name != "alternating"]) for name, time in TIMES.items()],
)


def discrete(kind, folder, special=None, **parameters):
    """One block in a model whose discrete blocks inherit the step of the data."""
    drawn = alone(kind, special=special, model=Model(step="auto", solver="FixedStepDiscrete"), **parameters)
    model = imported(drawn, folder)
    assert model.step is None
    return model


def simulated(model, time):
    return kf.simulate(model, {"time": time, "u1": U}, {})["y1"].values


def steps(time):
    """The steps before and after each sample; the first and the last equal their neighbours."""
    own = np.diff(time)
    return np.append(own[:1], own), np.append(own, own[-1:])


def trapezoids(time, x, start):
    return start + np.concatenate([[0.0], np.cumsum(np.diff(time) * (x[1:] + x[:-1]) / 2)])


@every_time
@pytest.mark.parametrize("setting", ["Output", "State (most efficient)"])
def test_a_discrete_integrator_takes_the_step_of_its_method(time, setting, tmp_path):
    before, after = steps(time)
    x = 2 * U
    as_output = setting == "Output"
    expected = {
        "Forward Euler": 1 + np.concatenate([[0.0], np.cumsum(after * x)[:-1]]),
        "Backward Euler": 1 + np.cumsum(np.where(np.arange(COUNT) == 0, not as_output, 1) * before * x),
        "Trapezoidal": trapezoids(time, x, 1.0 if as_output else 1 + before[0] * x[0] / 2),
    }
    for method, values in expected.items():
        model = discrete("DiscreteIntegrator", tmp_path, gainval="2", InitialCondition="1", SampleTime="-1",
                         IntegratorMethod=f"Integration: {method}", InitialConditionSetting=setting)  # fmt: skip
        np.testing.assert_allclose(simulated(model, time), values, rtol=1e-12, atol=1e-12, err_msg=method)


@every_time
def test_limits_of_a_discrete_integrator(time, tmp_path):
    model = discrete("DiscreteIntegrator", tmp_path, gainval="4", SampleTime="-1", LimitOutput="on",
                     UpperSaturationLimit="0.3", LowerSaturationLimit="-0.2")  # fmt: skip
    x, expected = 0.0, []
    for step, u in zip(steps(time)[1], U, strict=True):
        expected.append(x)
        x = min(max(x + step * 4 * u, -0.2), 0.3)
    np.testing.assert_allclose(simulated(model, time), expected, atol=1e-12)


@every_time
def test_a_discrete_derivative_divides_by_the_step_that_ended(time, tmp_path):
    model = discrete("Reference", tmp_path, special="Discrete Derivative", gainval="2")
    expected = 2 * np.diff(U, prepend=0.0) / steps(time)[0]
    np.testing.assert_allclose(simulated(model, time), expected, rtol=1e-10, atol=1e-10)


def controller(folder, **parameters):
    gains = {"P": "0", "I": "2", "D": "0.3", "N": "1.5"} | parameters
    return discrete("Reference", folder, special="PID 1dof", TimeDomain="Discrete-time", SampleTime="-1", **gains)


@every_time
@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
def test_the_integral_of_a_controller(time, method, tmp_path):
    before, after = steps(time)
    expected = {
        "Forward Euler": np.concatenate([[0.0], np.cumsum(after * 2 * U)[:-1]]),
        "Backward Euler": np.cumsum(before * 2 * U),
        "Trapezoidal": trapezoids(time, 2 * U, before[0] * U[0]),
    }
    model = controller(tmp_path, Controller="PI", IntegratorMethod=method)
    np.testing.assert_allclose(simulated(model, time), expected[method], rtol=1e-12, atol=1e-12)


@every_time
@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
def test_the_filtered_derivative_of_a_controller(time, method, tmp_path):
    """Compute f at a sample from that at the sample before: y = N (D u - f), f' = y."""
    before = steps(time)[0]
    n, f, y_last, expected = 1.5, 0.0, 0.0, []
    for k, d in enumerate(0.3 * U):
        if method == "Forward Euler":
            f += before[k] * y_last if k else 0.0
            y = n * (d - f)
        else:
            share = 1.0 if method == "Backward Euler" else 0.5
            begun = f + ((1 - share) * before[k] * y_last if k else 0.0)
            y = n * (d - begun) / (1 + n * share * before[k])
            f = begun + share * before[k] * y
        y_last = y
        expected.append(y)
    model = controller(tmp_path, Controller="PD", FilterMethod=method)
    np.testing.assert_allclose(simulated(model, time), expected, rtol=1e-11, atol=1e-12)


@every_time
def test_the_unfiltered_derivative_of_a_controller(time, tmp_path):
    model = controller(tmp_path, Controller="PD", UseFilter="off")
    expected = 0.3 * np.diff(U, prepend=0.0) / steps(time)[0]
    np.testing.assert_allclose(simulated(model, time), expected, rtol=1e-10, atol=1e-10)


A, B, C, D = [[0.0, 1.0], [-2.0, -0.6]], [0.0, 1.5], [1.0, 0.2], 0.1
CONTINUOUS = {
    "Integrator": ({"InitialCondition": "0.5"}, [[0.0]], [1.0], [1.0], 0.0, [0.5]),
    "TransferFcn": ({"Numerator": "[3]", "Denominator": "[1 0.8 2]"},
                    [[-0.8, -2.0], [1.0, 0.0]], [1.0, 0.0], [0.0, 3.0], 0.0, [0.0, 0.0]),
    "StateSpace": ({"A": "[0 1; -2 -0.6]", "B": "[0; 1.5]", "C": "[1 0.2]", "D": "0.1", "InitialCondition": "[1; -1]"},
                   A, B, C, D, [1.0, -1.0]),
}  # fmt: skip


@every_time
@pytest.mark.parametrize("kind", CONTINUOUS)
@pytest.mark.parametrize("solver", mostly_slow(list(SOLVERS), ["ode3"]))
def test_continuous_blocks_reach_the_next_sample(time, kind, solver, tmp_path):
    fields, a, b, c, d, x = CONTINUOUS[kind]
    # start and stop are infinite, so that no step follows from them
    drawn = alone(kind, model=Model(solver=solver, step="auto", stop="inf"), **fields)
    model = imported(drawn, tmp_path)
    assert (model.step, model.solver) == (None, solver)
    a, b, c, x, method, expected = *map(np.array, (a, b, c, x)), SOLVERS[solver], []
    for step, u in zip(steps(time)[1], U, strict=True):
        expected.append(c @ x + d * u)
        stages = []
        for row in method.rows:
            stages.append(a @ (x + step * sum((w * s for w, s in zip(row, stages, strict=False)), 0 * x)) + b * u)
        x = x + step * sum(w * s for w, s in zip(method.weights, stages, strict=True))
    np.testing.assert_allclose(simulated(model, time), expected, rtol=1e-10, atol=1e-10)


def test_a_model_with_sample_times_refuses_uneven_data(tmp_path):
    model = imported(alone("DiscreteIntegrator", SampleTime="0.1"), tmp_path)
    with pytest.raises(kf.InputError, match=r"the model's step is 0.1 s, but the samples are 0.02 to 0.4 s apart"):
        simulated(model, TIMES["alternating"])
