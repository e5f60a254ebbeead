"""Values that a search leads towards infinity."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem
from kennfeld.optimize.ends.runaways import find_runaways
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from tests.draws import mostly_slow

X = np.linspace(0, 10, 100)
BELL = 3 * np.exp(-(((X - 4) / 1.2) ** 2)) + 0.05 * np.random.default_rng(0).normal(size=X.size)


def warnings_on_effects(result):
    return [warning for warning in result.warnings if "effect" in warning.message]


def bell(h, m, s):
    return kf.calibrate("y = h*exp(-((x - m)/s)^2)", {"x": X, "q": BELL}, {"h": h, "m": m, "s": s}, target="q")


def test_a_bell_that_became_an_exponential_slope_has_a_warning_that_names_its_values():
    """From m = 16.5, the tail of a bell 1e15 away follows the data better than any near them."""
    start = kf.ParameterSet([kf.Scalar("h", 12.0), kf.Scalar("m", 16.5), kf.Scalar("s", 1.3)])
    model = kf.formula("y = h*exp(-((x - m)/s)^2)", parameters=["h", "m", "s"])
    data = kf.Dataset.of("d", {"x": X, "q": BELL})
    compiled = CompiledProblem(Problem(model, (data,), start, (kf.Criterion("y", "q"),)))
    end = compiled.values.pack(
        kf.ParameterSet(
            [kf.Scalar("h", 1.303634777e21), kf.Scalar("m", -1.159452821e15), kf.Scalar("s", -1.65513645600e14)]
        )
    )
    objective = LeastSquaresObjective(compiled)
    (warning,) = find_runaways(compiled, objective, objective.start, end)
    assert "h to 1.3e+21, m to -1.16e+15, s to -1.66e+14, where they have no effects of their own" in warning.message
    assert "Set bounds" in warning.remedy


def test_a_recovered_bell_has_no_warning():
    result = bell(1.0, 5.0, 2.0)
    assert result.parameters["m"].value == pytest.approx(4, abs=0.05)
    assert not result.warnings


@pytest.mark.parametrize(
    ("text", "target", "start", "truth"),
    [("y = x/r", X / 1e10, {"r": 1.0}, 1e10), ("y = r*x^2", 1e12 * X**2, {"r": 0.0}, 1e12)],
    ids=["a resistance", "a stiffness"],
)
def test_a_large_value_with_an_effect_of_its_own_has_no_warning(text, target, start, truth):
    result = kf.calibrate(text, {"x": X, "q": target}, start, target="q")
    assert result.parameters["r"].value == pytest.approx(truth)
    assert not warnings_on_effects(result)


def fitted_lag(noise, time_constant, **start):
    """A fit of a lag to noise that passed one, from starts at which an integrator lies nearer."""
    u = noise.normal(size=300)
    time = 0.1 * np.arange(u.size)
    lagged = kf.simulate("y = PT1(u, T)", {"time": time, "u": u}, {"T": time_constant})["y"].values
    data = {"time": time, "u": u, "q": 3 * lagged + 2}
    return kf.calibrate("y = PT1(k*u, T) + b", data, start, target="q")


def test_a_lag_that_remains_an_integrator_has_a_warning():
    u = np.random.default_rng(2).normal(size=300)
    time = 0.1 * np.arange(u.size)
    lagged = kf.simulate("y = PT1(u, T)", {"time": time, "u": u}, {"T": 0.5})["y"].values
    start = kf.ParameterSet([kf.Scalar("k", 0.1), kf.Scalar("T", 50.0), kf.Scalar("b", 100.0)])
    data = kf.Dataset.of("d", {"u": u, "q": 3 * lagged + 2}, time=time)
    model = kf.formula("y = PT1(k*u, T) + b", parameters=["k", "T", "b"])
    compiled = CompiledProblem(Problem(model, (data,), start, (kf.Criterion("y", "q"),)))
    objective = LeastSquaresObjective(compiled)
    end = kf.ParameterSet([kf.Scalar("k", -1.0e7), kf.Scalar("T", 2.1e8), kf.Scalar("b", -3.27e6)])
    (warning,) = find_runaways(compiled, objective, objective.start, compiled.values.pack(end))
    assert "k to -1e+07, b to -3.27e+06, where they have no effects of their own" in warning.message


@pytest.mark.parametrize("seed", mostly_slow([0, 9], [9]))
def test_a_lag_that_became_an_integrator_is_searched_again_with_its_start(seed):
    """With the seed 9, the time constant became 1e106, where it has no effect at all."""
    start = {"k": -1.0, "T": 2.0, "b": 1.0} if seed == 0 else {"k": 0.1, "T": 50.0, "b": 100.0}
    result = fitted_lag(np.random.default_rng(seed), 0.0, **start)
    assert result.parameters["k"].value == pytest.approx(3)
    assert result.parameters["T"].value == pytest.approx(0, abs=1e-9)
    assert not warnings_on_effects(result)


def test_values_with_similar_effects_have_no_warning_if_noise_hardly_moves_them():
    x = 1000 + 1e-3 * X
    target = 1e3 * x - 1e6 + 1e-9 * np.random.default_rng(0).normal(size=x.size)
    result = kf.calibrate("y = a + b*x", {"x": x, "q": target}, {"a": 1.0, "b": 1.0}, target="q")
    assert result.parameters["a"].value == pytest.approx(-1e6)
    assert not warnings_on_effects(result)


@pytest.mark.parametrize(
    ("text", "x", "target", "start"),
    [
        ("y = a + b*x", X + 1.7e9, 3 * X, {"a": 1.0, "b": 1.0}),
        ("y = a + b*x + c*x^2 + d*x^3", X + 1e4, 1e-3 * (X - 5) ** 3, {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0}),
    ],
    ids=["a line over seconds since 1970", "a cubic far from 0"],
)
def test_a_large_offset_that_data_determine_has_no_warning(text, x, target, start):
    target = target + 1e-3 * np.random.default_rng(0).normal(size=x.size)
    result = kf.calibrate(text, {"x": x, "q": target}, start, target="q")
    assert abs(result.parameters["a"].value) > 1e8
    assert not warnings_on_effects(result)


def test_a_table_that_shares_a_size_with_a_factor_has_no_warning():
    """Their fit is as good wherever they are; the trust names the combination."""
    x = np.linspace(0, 10, 1000)
    target = 700 * x + 0.1 * np.random.default_rng(0).normal(size=x.size)
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 10, 80), np.full(80, 1e-3)), kf.Scalar("k", 1e-3)])
    result = kf.calibrate("y = C(x)*k*x", {"x": x, "q": target}, start, target="q")
    assert result.parameters["k"].value > 1.0
    assert not warnings_on_effects(result)
    assert result.trust.directions
