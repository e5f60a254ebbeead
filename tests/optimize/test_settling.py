from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.dataset import Settling
from kennfeld.optimize import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from tests.draws import few_or_many, mostly_slow
from tests.optimize.reference_settling import held_output

U = np.array([0.5, 1.5, 2.0, 3.0, 0.1, 2.7])
MODELS = {
    "PT1": "y = PT1(a * u, b + 0.3, 0.2)",
    "first value of the input": "y = PT1(a * u + sin(t), b + 0.3)",
    "first value of a parameter": "y = PT1(u, 0.7, a) + b",
    "delay": "y = delay(a * u + t, 3, b * u) + b",
    "memory of a memory": "x = prev(a * u + x / 2, b)\ny = x + delay(x, 2, u)",
    "state from a state": "x = integrator(a * u - x, u)\ny = integrator(x * b, x + 1)",
    "clock alone": "y = a * u * t + b / dt",
    "relay": "on = hysteresis(t, 0.35, 0.1)\ny = a * on + b * prev(on, 0) * u",
}
UNSETTLED = "y = PT1(a * u, b, 0) + log(t - 0.65)"  # no number before 0.7 s
by_model_and_window = pytest.mark.parametrize(
    ("text", "average"),
    [
        pytest.param(
            text,
            average,
            id=f"{name}-{average}",
            marks=() if average == 0.3 or name == "state from a state" else pytest.mark.slow,
        )
        for name, text in MODELS.items()
        for average in (0.0, 0.3, 1.0)
    ],
)


def points(average=0.0, target=0.0, **attributes):
    return kf.Dataset.of(
        "points", {"u": U, "z": np.full(U.size, target)}, settling=Settling(1.0, average, 0.1), **attributes
    )


def values(a=0.8, b=0.4):
    return kf.ParameterSet([kf.Scalar("a", a), kf.Scalar("b", b)])


def problem(text, *datasets, loss="square", target="z"):
    model = kf.formula(text, parameters=["a", "b"])
    return Problem(model, datasets, values(), (kf.Criterion("y", target, loss=loss, delta=0.5),))


@by_model_and_window
def test_a_point_counts_with_the_mean_of_its_window(text, average):
    """Against each point simulated by itself, by the reference interpreter."""
    expected = np.array([held_output(text, u, values(), 11)[-max(round(average / 0.1), 1) :].mean() for u in U])
    data = points(average)
    assert kf.simulate(kf.formula(text, parameters=["a", "b"]), data, values())["y"].values == pytest.approx(expected)
    for loss, cost in (("square", expected**2), ("soft_l1", 0.5 * (np.sqrt(1 + (expected / 0.5) ** 2) - 1))):
        objective = LeastSquaresObjective(CompiledProblem(problem(text, data, loss=loss)))
        assert objective.cost(objective.start) == pytest.approx(cost.sum(), rel=1e-12)


@by_model_and_window
def test_the_derivative_of_the_mean_is_exact(text, average):
    objective = LeastSquaresObjective(CompiledProblem(problem(text, points(average))))
    at = objective.start
    gradient, matrix = (part.copy() for part in objective.normal(at))
    residual, jacobian = objective.rows(at)
    np.testing.assert_allclose(jacobian.T @ residual, gradient, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(jacobian.T @ jacobian, matrix, rtol=1e-10, atol=1e-12)
    for i, h in enumerate(1e-6 * np.eye(2)):
        slope = (objective.cost(at + h) - objective.cost(at - h)) / 2e-6
        assert 2 * gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-7)


@few_or_many(
    few=8,
    many=50,
    text=st.sampled_from(sorted(MODELS.values())),
    seconds=st.floats(0.1, 3),
    share=st.floats(0, 1),
    step=st.floats(0.05, 0.1),
    count=st.integers(1, 150),
)
def test_fit_and_simulation_have_the_same_values(text, seconds, share, step, count):
    """The sums run many points as one piece, the simulation each by itself."""
    settling = Settling(seconds, share * seconds, step)
    u = np.linspace(0.1, 3, count)
    data = kf.Dataset.of("points", {"u": u, "z": np.cos(u)}, settling=settling)
    posed = problem(text, data)
    objective = LeastSquaresObjective(CompiledProblem(posed))
    shown = kf.simulate(posed.model, data, values())["y"].values
    assert shown.size == count
    assert objective.cost(objective.start) == pytest.approx(np.sum((shown - np.cos(u)) ** 2), rel=1e-9)


@pytest.mark.parametrize("average", mostly_slow([0.0, 0.1, 0.3], [0.3]))
def test_nan_before_the_window_has_no_effect(average):
    test_a_point_counts_with_the_mean_of_its_window(UNSETTLED, average)
    test_the_derivative_of_the_mean_is_exact(UNSETTLED, average)


def test_time_constant_and_gain_are_recovered_from_points_that_have_not_settled():
    u = np.linspace(1, 5, 30)
    truth = {"a": 2.0, "T": 1.7}
    text = "y = PT1(a * u, T * u / 3, 0)"
    data = kf.Dataset.of("points", {"u": u}, settling=Settling(2.0, 0.5, 0.05))
    measured = kf.simulate(text, data, truth)["y"]
    data = data.with_channels(replace(measured, name="z"))
    result = kf.calibrate(text, data, {"a": 1.0, "T": 1.0}, target="z")
    assert [result.parameters[name].value for name in truth] == pytest.approx(list(truth.values()), rel=1e-6)
    assert result.quality[0].samples == 30


def test_points_and_recordings_are_fitted_together():
    text = MODELS["PT1"]
    drive = kf.Dataset.of("drive", {"u": np.sin(np.arange(40)), "z": np.cos(np.arange(40))}, time=0.1 * np.arange(40))
    for average in (0.0, 0.4):
        both = LeastSquaresObjective(CompiledProblem(problem(text, points(average, 1.0), drive)))
        alone = [LeastSquaresObjective(CompiledProblem(problem(text, data))) for data in (points(average, 1.0), drive)]
        assert both.cost(both.start) == pytest.approx(sum(one.cost(one.start) for one in alone), rel=1e-12)
        gradient = both.normal(both.start)[0].copy()
        np.testing.assert_allclose(gradient, sum(one.normal(one.start)[0].copy() for one in alone), rtol=1e-9)


@pytest.mark.slow
def test_held_points_are_fitted_by_the_continuation():
    """Smoothed lookups see the same samples."""
    u = np.linspace(0.2, 3.8, 20)
    start = kf.ParameterSet([kf.Curve("C", range(5), [0.0, 1, 2, 1, 0]), kf.Curve("D", range(5), [0.0, 1, 2.5, 3, 4])])
    truth = start.with_parameters(start["C"].with_values([0.5, 1, 3, 1, 2]))
    text, data = "y = PT1(C(D(u)), 0.4, 0)", kf.Dataset.of("points", {"u": u}, settling=Settling(1.0, 0.3, 0.1))
    data = data.with_channels(replace(kf.simulate(text, data, truth)["y"], name="z"))
    result = kf.calibrate(text, data, start, target="z")
    assert "exact" in {line.stage for line in result.trace}
    assert result.quality[0].rmse_after < 1e-3 * result.quality[0].rmse_before


def test_a_target_node_is_averaged():
    text = "y = PT1(a * u, b, 0)\nother = t * u"
    objective = LeastSquaresObjective(CompiledProblem(problem(text, points(0.5), target="other")))
    shown = kf.simulate(kf.formula(text, parameters=["a", "b"]), points(0.5), values())
    assert objective.cost(objective.start) == pytest.approx(
        np.sum((shown["y"].values - shown["other"].values) ** 2), rel=1e-12
    )


def test_points_without_an_input_a_target_or_a_score_are_excluded():
    u, z = U.copy(), np.full(U.size, 1.0)
    u[1], z[3] = np.nan, np.nan
    scored = np.arange(U.size) != 4
    data = kf.Dataset.of("points", {"u": u, "z": z}, settling=Settling(1.0, 0.2, 0.1), scored=scored)
    posed = problem(MODELS["PT1"], data)
    objective = LeastSquaresObjective(CompiledProblem(posed))
    rest = kf.Dataset.of("points", {"u": U[[0, 2, 5]], "z": np.ones(3)}, settling=Settling(1.0, 0.2, 0.1))
    expected = LeastSquaresObjective(CompiledProblem(problem(MODELS["PT1"], rest)))
    assert objective.cost(objective.start) == pytest.approx(expected.cost(expected.start), rel=1e-12)
    with pytest.warns(kf.InputWarning, match="1 of 6 samples is not simulated: u has no value at sample 2"):
        assert kf.simulate(posed.model, data, values())["y"].values.size == 5


def test_weights_are_those_of_the_points():
    w = np.arange(U.size, dtype=float)
    data = points(0.3, 1.0).with_channels(kf.Channel("w", w))
    model = kf.formula(MODELS["PT1"], parameters=["a", "b"])
    posed = Problem(model, (data,), values(), (kf.Criterion("y", "z", weight_channel="w"),))
    objective = LeastSquaresObjective(CompiledProblem(posed))
    shown = kf.simulate(model, data, values())["y"].values
    assert objective.cost(objective.start) == pytest.approx(np.sum(w * (shown - 1) ** 2), rel=1e-12)


def test_points_of_a_model_without_memory_are_not_held():
    result = kf.calibrate("y = a * u", points(0.5).with_channels(kf.Channel("z", 3 * U)), {"a": 1.0}, target="z")
    assert result.parameters["a"].value == pytest.approx(3.0)


def test_the_step_may_be_that_of_the_model():
    data = replace(points(0.2), settling=Settling(1.0, 0.2))
    text = MODELS["PT1"]
    expected = kf.simulate(text, points(0.2), values())["y"].values
    assert kf.simulate(f"{text}\nstep 0.1", data, values())["y"].values == pytest.approx(expected, rel=1e-15)
    with pytest.raises(kf.InputError, match="neither the dataset nor the model defines one"):
        kf.simulate(text, data, values())


def test_a_dataset_without_points_has_no_samples():
    empty = kf.Dataset.of("points", {"u": [np.nan], "z": [1.0]}, settling=Settling(1.0, 0.2, 0.1))
    with pytest.warns(kf.InputWarning, match="1 of 1 samples is not simulated: u has no value at sample 1"):
        assert kf.simulate(MODELS["PT1"], empty, values())["y"].values.size == 0


@pytest.mark.parametrize(
    "settling", [(0.0,), (-1.0,), (np.inf,), (np.nan,), (1.0, 2.0), (1.0, -0.1), (1.0, 0.0, 0.0), (1.0, 0.0, 2.0)]
)
def test_a_settling_is_checked_at_construction(settling):
    with pytest.raises(ArgumentError, match="of a settling must be"):
        Settling(*settling)


def test_points_with_time_stamps_are_refused():
    with pytest.raises(ArgumentError, match="without time stamps"):
        kf.Dataset.of("points", {"u": U}, time=np.arange(U.size), settling=Settling(1.0))


@pytest.mark.parametrize("average", mostly_slow([0.0, 0.4], [0.4]))
def test_limits_of_outputs_hold_at_the_last_sample_of_a_point(average):
    data = points(average, 2.5)
    text = "y = PT1(a * u, 0.2, 0)"
    free = kf.calibrate(text, data, {"a": 1.0}, target="z")
    limited = kf.calibrate(text, data, {"a": 1.0}, target="z", limits={"y": (-np.inf, 2.0)})
    last = replace(data, settling=Settling(1.0, 0.0, 0.1))
    ends = [kf.simulate(text, last, result.parameters)["y"].values.max() for result in (free, limited)]
    assert ends[0] > 2.1
    assert ends[1] == pytest.approx(2.0, rel=1e-5)
