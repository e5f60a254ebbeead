"""Values whose effect is at the level of rounding: they keep their start, and are reported as undetermined."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective, _Sensitivity
from tests.draws import mostly_slow

RANDOM = np.random.default_rng(0)
COUNT = 1500
U = np.repeat(RANDOM.normal(size=COUNT // 50), 50)
NOISE = RANDOM.normal(0.0, 0.01, COUNT)
X, Z = RANDOM.uniform(1, 2, (2, 200))
RATIO = 3 * X / Z + RANDOM.normal(0.0, 0.01, 200)


def drive(warmup, text="y = PT1(2.5 * u, 0.5, 3.0)"):
    """A filtered signal of 0.1 s a sample, not scored before the warm-up is over; x0 fades by 1.2 a sample."""
    data = kf.Dataset.of("drive", {"u": U}, time=0.1 * np.arange(COUNT))
    wanted = kf.simulate(text, data, {})["y"].values + NOISE
    wanted[:warmup] = np.nan
    return data.with_channels(kf.Channel("m", wanted))


@pytest.mark.parametrize("warmup", [90, *(pytest.param(warmup, marks=pytest.mark.slow) for warmup in (130, 180)), 400])
@pytest.mark.parametrize(
    ("x0", "T"), [*(pytest.param(0.0, T, marks=pytest.mark.slow) for T in (1.0, 20.0)), (1.0, 20.0)]
)
def test_an_initial_state_without_effect_keeps_its_start_and_is_named(warmup, x0, T):
    result = kf.calibrate("y = PT1(k*u, T, x0)", drive(warmup), {"k": 1.0, "T": T, "x0": x0}, "m")
    assert result.converged
    assert result.parameters["x0"].value == x0
    assert result.parameters["k"].value == pytest.approx(2.5, abs=0.01)
    assert result.parameters["T"].value == pytest.approx(0.5, abs=0.01)
    assert not result.trust.informed["x0"]
    assert np.isinf(result.trust.deviation["x0"])
    assert "Not determined by data or smoothness, kept at their start values: 1 of x0" in result.message
    assert any("kept at its start value: x0" in str(direction) for direction in result.trust.directions)


@pytest.mark.parametrize("warmup", mostly_slow([40, 55, 70], [55]))
def test_an_initial_state_with_hardly_any_effect_does_not_run_away(warmup):
    result = kf.calibrate("y = PT1(k*u, T, x0)", drive(warmup), {"k": 1.0, "T": 1.0, "x0": 0.0}, "m")
    assert abs(result.parameters["x0"].value) < 5 * result.trust.deviation["x0"]
    assert result.trust.deviation["x0"] > 5


def test_an_initial_state_that_the_data_determine_is_recovered():
    result = kf.calibrate("y = PT1(k*u, T, x0)", drive(5), {"k": 1.0, "T": 1.0, "x0": 0.0}, "m")
    assert result.parameters["x0"].value == pytest.approx(3.0, abs=0.05)
    assert result.trust.informed["x0"]


def test_a_table_that_matters_only_during_the_warmup_keeps_its_start():
    text = "y = PT1(if(t < 1, C(u), k * u), 0.5)"
    start = kf.ParameterSet([kf.Curve("C", [-1.0, 0.0, 1.0], np.full(3, 0.5)), kf.Scalar("k", 1.0)])
    result = kf.calibrate(text, drive(300, "y = PT1(2.5 * u, 0.5)"), start, "m")
    assert result.parameters["C"].values.tolist() == [0.5, 0.5, 0.5]
    assert not result.trust.informed["C"].any()
    assert result.parameters["k"].value == pytest.approx(2.5, abs=0.01)


@pytest.mark.parametrize(
    "text",
    ["m = c * (k*x) / (k*z)", "m = c * (x/z + sin(k)^2 + cos(k)^2 - 1)", "m = c * x / z * exp(k) * exp(-k)"],
    ids=["ratio", "circle", "exponentials"],
)
@pytest.mark.parametrize("k", mostly_slow([1.0, 0.3, -2e-5], [0.3]))
def test_a_value_that_cancels_in_the_model_keeps_its_start(text, k):
    result = kf.calibrate(text, {"x": X, "z": Z, "t": RATIO}, {"c": 1.0, "k": k}, "t")
    assert result.converged
    assert result.parameters["k"].value == k
    assert result.parameters["c"].value == pytest.approx(3.0, abs=0.01)
    assert not result.trust.informed["k"]


@pytest.mark.parametrize("weight", [1e-17, 1e-15])
def test_a_grid_point_with_a_lookup_weight_of_rounding_size_keeps_its_start(weight):
    x = np.append(-RANDOM.uniform(0, 1, 100), weight)
    data = {"x": x, "t": 2 * x + RANDOM.normal(0.0, 0.1, 101)}
    result = kf.calibrate("m = C(x)", data, kf.ParameterSet([kf.Curve("C", [-1.0, 0.0, 1.0], np.zeros(3))]), "t")
    assert result.trust.informed["C"].tolist() == [True, True, False]
    assert result.parameters["C"].values[2] == 0.0


@pytest.mark.parametrize("scale", [1e-20, 1e20])
def test_a_value_of_any_size_is_fitted_if_the_data_determine_it(scale):
    data = {"x": X / scale, "t": 2 + 3 * X + RANDOM.normal(0.0, 0.01, 200)}
    for start in (0.0, 1.0, scale):
        result = kf.calibrate("m = a*x + b", data, {"a": start, "b": 1.0}, "t")
        assert result.converged
        assert result.parameters["a"].value == pytest.approx(3 * scale, rel=0.01)
        assert result.trust.informed["a"]


def test_values_that_start_at_1e20_times_their_size_are_fitted():
    data = {"x": X, "t": 1e-20 * X}
    result = kf.calibrate("m = a*x + b", data, {"a": 1e-19, "b": 1.0}, "t")
    assert result.parameters["a"].value == pytest.approx(1e-20, rel=1e-9)
    assert abs(result.parameters["b"].value) < 1e-30


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_criteria_whose_targets_differ_by_1e20_are_fitted_together(noise):
    t, s = 3 * X, 1e20 * X
    data = {"x": X, "t": t + noise * RANDOM.normal(size=200), "s": s * (1 + noise * RANDOM.normal(size=200))}
    criteria = [kf.Criterion("m", "t"), kf.Criterion("n", "s")]
    result = kf.calibrate("m = a*x\nn = b*x", data, {"a": 1.0, "b": 1.0}, criteria=criteria)
    assert result.parameters["a"].value == pytest.approx(3.0, rel=noise + 1e-9)
    assert result.parameters["b"].value == pytest.approx(1e20, rel=noise + 1e-9)


def test_the_deviation_of_a_value_does_not_depend_on_the_weight_of_its_criterion():
    data = {"x": X, "t": 3 * X + RANDOM.normal(0.0, 0.1, 200), "s": X + RANDOM.normal(0.0, 0.1, 200)}
    deviations = []
    for weight in (1.0, 1e-12, 1e-30):
        criteria = [kf.Criterion("m", "t"), kf.Criterion("n", "s", weight=weight)]
        result = kf.calibrate("m = a*x\nn = b*x", data, {"a": 1.0, "b": 5.0}, criteria=criteria)
        deviations.append(float(result.trust.deviation["b"]))
    assert deviations[1:] == pytest.approx([deviations[0]] * 2, rel=1e-6)


@pytest.mark.parametrize("values", [5, 80])
def test_slopes_count_as_zero_in_the_rows_and_in_the_sums_of_a_problem(values):
    """Problems of few values are solved by rows, larger ones by sums; both leave out what has faded."""
    table = kf.Curve("C", np.linspace(-3, 3, values), np.linspace(-3, 3, values))
    start = kf.ParameterSet([table, kf.Scalar("T", 0.5), kf.Scalar("x0", 1.0)])
    problem = ProblemSetup("y = PT1(C(u), T, x0)", drive(300), start, "m").problem()
    compiled = CompiledProblem(problem)
    objective = LeastSquaresObjective(compiled)
    at = compiled.values.offsets["x0"]
    assert objective.uses_qr == (values == 5)
    gradient, matrix = (sums.copy() for sums in objective.normal(objective.start))
    residual, jacobian = objective.rows(objective.start)
    assert objective.faint(objective.start)[at]
    assert not jacobian[:, at].any()
    assert not matrix[at].any()
    assert not gradient[at]
    assert jacobian.T @ residual == pytest.approx(gradient, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("missing", [[], range(40), range(300, 310), [*range(20), 500]])
def test_the_curvature_on_all_simulated_samples_is_that_of_scored_and_of_other_samples(missing):
    data, values = drive(0), {"k": 1.0, "T": 1.0, "x0": 0.5}
    measured = data["m"].values.copy()
    measured[list(missing)] = np.nan
    scored = CompiledProblem(ProblemSetup("y = PT1(k*u, T, x0)", data, values, "m").problem())
    partly = data.with_channels(kf.Channel("m", measured))
    compiled = CompiledProblem(ProblemSetup("y = PT1(k*u, T, x0)", partly, values, "m").problem())
    expected = scored.sums.normal(scored.start).matrix.diagonal() if len(missing) else np.zeros(3)
    assert _Sensitivity(compiled).everywhere(compiled.start) == pytest.approx(expected, rel=1e-12)


def test_samples_after_the_last_scored_one_are_not_simulated():
    data = drive(0)
    measured = data["m"].values.copy()
    measured[1200:] = np.nan
    ended = data.with_channels(kf.Channel("m", measured))
    compiled = CompiledProblem(ProblemSetup("y = PT1(k*u, 0.5)", ended, {"k": 1.0}, "m").problem())
    assert _Sensitivity(compiled).everywhere(compiled.start).tolist() == [0.0]
