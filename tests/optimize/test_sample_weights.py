from dataclasses import replace

import numpy as np
import pytest
import scipy
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.criteria import Region
from kennfeld.optimize import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.project.steps import uncovered_values
from tests.draws import few_or_many
from tests.graph.random_graphs import LOSSES
from tests.native.reference import loss

RANDOM = np.random.default_rng(5)
X = np.linspace(0.0, 3.0, 60)
W = RANDOM.uniform(0, 3, 60)
Y = 2 * X + 1 + RANDOM.normal(0, 0.3, 60) + np.where(RANDOM.uniform(size=60) < 0.15, 6.0, 0.0)


def problem(criterion, data, text="m = a * x + b", start=(0.0, 0.0)):
    datasets = data if isinstance(data, tuple) else (data,)
    values = kf.ParameterSet([kf.Scalar("a", start[0]), kf.Scalar("b", start[1])])
    return Problem(kf.formula(text, parameters=["a", "b"]), datasets, values, (criterion,))


def line(**channels):
    return kf.Dataset.of("bench", {"x": X, "y": Y, "w": W} | channels)


@pytest.mark.parametrize("kind", LOSSES)
@pytest.mark.parametrize("text", ["m = a * x + b", "m = prev(a, 0) * x + b"], ids=["no memory", "memory"])
def test_a_weight_multiplies_the_loss_of_its_sample(kind, text):
    """Not the residual: a robust loss judges that as it is."""
    criterion = kf.Criterion("m", "y", 1.5, kind, delta=0.8, scale=2.0, weight_channel="w")
    objective = LeastSquaresObjective(CompiledProblem(problem(criterion, line(), text, (1.3, 0.4))))
    model = 1.3 * X + 0.4
    if "prev" in text:
        model[0] = 0.4
    values = objective.start
    expected = 1.5 * np.sum(W * loss((model - Y) / 2.0, kind, 0.8)[0])
    assert objective.cost(values) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", LOSSES)
def test_gradient_and_rows_are_those_of_the_weighted_cost(kind):
    criterion = kf.Criterion("m", "y", 1.5, kind, delta=0.8, scale=2.0, weight_channel="w")
    data = replace(line(), time=0.1 * np.arange(60))
    objective = LeastSquaresObjective(
        CompiledProblem(problem(criterion, data, "m = PT1(exp(a * x / 3), b)", (0.7, 0.4)))
    )
    values = objective.start
    gradient, matrix = (part.copy() for part in objective.normal(values))
    residual, jacobian = objective.rows(values)
    for i in range(2):
        h = np.eye(2)[i] * 1e-6
        slope = (objective.cost(values + h) - objective.cost(values - h)) / 2e-6
        assert 2 * gradient[i] == pytest.approx(slope, rel=1e-6)
    np.testing.assert_allclose(jacobian.T @ residual, gradient, rtol=1e-10)
    np.testing.assert_allclose(jacobian.T @ jacobian, matrix, rtol=1e-10)


@pytest.mark.parametrize("kind", LOSSES)
def test_a_weighted_fit_is_that_of_scipy(kind):
    result = kf.calibrate(
        "m = a * x + b",
        line(),
        {"a": 0.0, "b": 0.0},
        criteria=[kf.Criterion("m", "y", loss=kind, delta=0.5, scale=1.5, weight_channel="w")],
    )

    def gradient(p):
        r = (p[0] * X + p[1] - Y) / 1.5
        slope = W * loss(r, kind, 0.5)[1] * r
        return [np.sum(slope * X), np.sum(slope)]

    peer = scipy.optimize.least_squares(gradient, [1.0, 1.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    values = [result.parameters[name].value for name in "ab"]
    assert values == pytest.approx(peer.x, rel=1e-6)
    error = result.parameters["a"].value * X + result.parameters["b"].value - Y
    assert result.quality[0].rmse_after == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)


@pytest.mark.parametrize("kind", ["huber", "soft_l1"])  # of ours, those that scipy has
@pytest.mark.parametrize(
    ("delta", "scale"),
    [(0.5, 3.0), (1.0, 0.4), *(pytest.param(delta, 1.0, marks=pytest.mark.slow) for delta in (1.0, 0.3))],
)
def test_robust_losses_are_those_of_scipy(kind, delta, scale):
    """Their rho(z) with f_scale is ours with delta; their cost is half of ours."""
    x = np.linspace(0, 4, 80)
    y = 3 * np.exp(-0.6 * x) + 0.5 + np.random.default_rng(3).normal(0, 0.05, 80)
    y[::9] += 2.0
    peer = scipy.optimize.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * x) + p[2] - y) / scale,
        [1.0, 1.0, 0.0],
        loss=kind,
        f_scale=delta,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    result = kf.calibrate(
        "m = a * exp(-b * x) + c",
        {"x": x, "y": y},
        {"a": 1.0, "b": 1.0, "c": 0.0},
        criteria=[kf.Criterion("m", "y", loss=kind, delta=delta, scale=scale)],
        options=kf.Options(tolerance=1e-12),
    )
    assert result.converged
    assert result.cost_after == pytest.approx(2 * peer.cost, rel=1e-9)
    assert [result.parameters[name].value for name in "abc"] == pytest.approx(peer.x, rel=1e-4)
    square = kf.calibrate("m = a * exp(-b * x) + c", {"x": x, "y": y}, {"a": 1.0, "b": 1.0, "c": 0.0}, target="y")
    if delta * scale < 1:
        off = [abs(r.parameters["c"].value - 0.5) for r in (result, square)]
        assert off[0] < 0.5 * off[1]


@few_or_many(
    st.lists(st.integers(0, 3), min_size=60, max_size=60).filter(lambda counts: sum(map(bool, counts)) > 3),
    few=5,
    many=40,
)
def test_an_integer_weight_is_the_number_of_repetitions_of_a_sample(counts):
    often = np.repeat(np.arange(60), counts)
    for kind in ("square", "soft_l1"):
        criterion = kf.Criterion("m", "y", loss=kind, weight_channel="w")
        weighted = LeastSquaresObjective(CompiledProblem(problem(criterion, line(w=counts))))
        repeated = kf.Dataset.of("bench", {"x": X[often], "y": Y[often]})
        plain = LeastSquaresObjective(CompiledProblem(problem(kf.Criterion("m", "y", loss=kind), repeated)))
        assert weighted.cost(np.array([1.0, 2.0])) == pytest.approx(plain.cost(np.array([1.0, 2.0])), rel=1e-12)


def test_weights_of_zero_and_nan_exclude_a_sample_even_if_the_model_fails_there():
    x = np.array([1.0, 2.0, 3.0, -1.0, -2.0])
    data = {"x": x, "y": np.sqrt(np.abs(x)) * 2, "w": [1.0, 1.0, 1.0, 0.0, np.nan]}
    result = kf.calibrate("m = a * sqrt(x)", data, {"a": 1.0}, criteria=[kf.Criterion("m", "y", weight_channel="w")])
    assert result.parameters["a"].value == pytest.approx(2.0)
    assert result.quality[0].samples == 3
    assert result.quality[0].rmse_after < 1e-9


def test_samples_with_weight_zero_in_a_region_do_not_count_as_data():
    """Neither in the counts and errors, nor for lock = "no-data"."""
    data = kf.Dataset.of("bench", {"x": X, "y": np.where(X > 1.5, 2 * X, 99.0), "w": W})
    test = kf.Dataset.of("other", {"x": X, "y": 2 * X, "w": -W}, use="test")
    table = kf.ParameterSet([kf.Curve("C", [0.0, 1.0, 2.0, 3.0], np.zeros(4))])
    criterion = kf.Criterion("m", "y", regions=(Region("x <= 1.5 and w >= 0", 0.0),))
    model = kf.formula("m = C(x)")
    result = kf.calibrate(model, (data, test), table, criteria=[criterion])
    assert [row.samples for row in result.quality] == [int(np.sum(X > 1.5)), X.size]
    assert result.quality[0].rmse_after < 1e-6
    masks = uncovered_values(Problem(model, (data,), table, (criterion,)), ["C"])
    assert masks["C"].tolist() == [True, False, False, False]


def test_weights_of_dataset_criterion_and_regions_multiply():
    data = kf.Dataset.of("bench", {"x": X, "y": Y, "w": W, "v": X}, weight=2.0, weight_channel="v")
    regions = [Region("x > 1", 3.0), Region("x > 2 and w > 1", 0.5)]
    compiled = CompiledProblem(problem(kf.Criterion("m", "y", 1.5, weight_channel="w", regions=regions), data))
    weight = 2.0 * 1.5 * X * W * np.where(X > 1, 3.0, 1.0) * np.where((X > 2) & (W > 1), 0.5, 1.0)
    cost = LeastSquaresObjective(compiled).cost(np.array([1.0, 2.0]))
    order = {name: compiled.values.offsets[name] for name in "ab"}
    a, b = (np.array([1.0, 2.0])[order[name]] for name in "ab")
    assert cost == pytest.approx(np.sum(weight * (a * X + b - Y) ** 2), rel=1e-12)
    assert compiled.weights == pytest.approx(weight.sum(), rel=1e-12)


def test_a_dataset_without_weights_counts_each_sample_once():
    plain, weighted = (
        kf.Dataset.of("plain", {"x": X, "y": Y}),
        kf.Dataset.of("weighted", {"x": X, "y": Y, "v": W}, weight_channel="v"),
    )
    both = LeastSquaresObjective(CompiledProblem(problem(kf.Criterion("m", "y"), (plain, weighted))))
    alone = [
        LeastSquaresObjective(CompiledProblem(problem(kf.Criterion("m", "y"), data))) for data in (plain, weighted)
    ]
    at = np.array([1.0, 2.0])
    assert both.cost(at) == pytest.approx(sum(one.cost(at) for one in alone), rel=1e-12)


def test_a_weight_follows_its_sample_through_sorting_gaps_and_smoothing():
    """Samples are sorted by cell, and those without an input fall out."""
    x, inner = RANDOM.permutation(X), RANDOM.uniform(0, 2, 60)
    x[7] = np.nan
    y, w = np.sin(np.nan_to_num(x)), RANDOM.uniform(0, 2, 60)
    start = kf.ParameterSet([kf.Curve("C", [0, 1, 2, 3], [0.0, 1, 2, 1]), kf.Curve("D", [0, 1, 2], [0.0, 1, 2.5])])
    model = kf.formula("m = C(D(u)) + C(x)", parameters=["C", "D"])
    criterion = kf.Criterion("m", "y", weight_channel="w")
    posed = Problem(model, (kf.Dataset.of("d", {"x": x, "u": inner, "y": y, "w": w}),), start, (criterion,))
    exact = CompiledProblem(posed)
    got = kf.simulate(model, {"x": np.nan_to_num(x), "u": inner}, start)["m"].values
    expected = np.sum((w * (got - y) ** 2)[np.isfinite(x)])
    assert LeastSquaresObjective(exact).cost(exact.start) == pytest.approx(expected, rel=1e-12)
    smooth = CompiledProblem(posed, smooth_like=exact)
    smooth.set_width(1e-9)
    assert LeastSquaresObjective(smooth).cost(smooth.start) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("weight", "numbers"), [(np.nan, "NaN"), (np.inf, "NaN or infinite")])
@pytest.mark.parametrize("owner", ["dataset", "criterion"])
def test_weights_that_are_not_finite_are_counted_in_a_warning(weight, numbers, owner):
    weights = np.where(np.arange(60) % 20 == 3, weight, 1.0)
    data = kf.Dataset.of("bench", {"x": X, "y": Y, "w": weights}, weight_channel="w" if owner == "dataset" else "")
    criterion = kf.Criterion("m", "y", weight_channel="w" if owner == "criterion" else "")
    [finding] = kf.calibrate("m = a * x + b", data, {"a": 0.0, "b": 0.0}, criteria=[criterion]).warnings
    assert finding.message == f"w is {numbers} in 3 of 60 samples of dataset bench; these samples get weight 0"


def test_all_invalid_weights_are_reported_at_once():
    criteria = [
        kf.Criterion("m", "y", weight_channel="ww"),
        kf.Criterion("m", 1.0, weight_channel="bad", regions=[Region("x >", 1.0), Region("z > 1", 1.0)]),
        kf.Criterion("m", 2.0, regions=[Region("t > 1", 2.0)]),
    ]
    data = line(bad=np.where(X > 2, -1.0, 1.0))
    with pytest.raises(kf.InputError) as error:
        kf.calibrate("m = a * x + b", data, {"a": 0.0, "b": 0.0}, criteria=criteria)
    messages = [str(finding) for finding in error.value.findings]
    assert messages[0] == "criterion on m weight_channel: dataset bench has no channel ww. Did you mean w?"
    assert messages[1].startswith(
        "criterion on m weight_channel: 20 weights of bad in dataset bench are below 0 or infin"
    )
    assert "the first, -1, at sample 41" in messages[1]
    assert messages[2].startswith("criterion on m region 1")
    assert messages[3].startswith("criterion on m region 2: dataset bench has no channel z.")
    assert messages[4].startswith("criterion on m region 1: the condition requires time stamps")
    assert len(messages) == 5


def test_zero_weights_are_an_error_only_if_they_exclude_all_samples():
    empty, full = line(w=np.full(60, np.nan)), line()
    criteria = [kf.Criterion("m", "y", weight_channel="w")]
    with pytest.raises(kf.InputError, match="criterion on m: no training sample has a weight above 0"):
        kf.calibrate("m = a * x + b", empty, {"a": 0.0, "b": 0.0}, criteria=criteria)
    result = kf.calibrate(
        "m = a * x + b", [replace(empty, name="empty"), full], {"a": 0.0, "b": 0.0}, criteria=criteria
    )
    alone = kf.calibrate("m = a * x + b", full, {"a": 0.0, "b": 0.0}, criteria=criteria)
    assert result.cost_after == pytest.approx(alone.cost_after, rel=1e-12)
    regions = [Region("x >= 0", 0.0)]
    with pytest.raises(kf.InputError, match="no training sample has a weight above 0"):
        kf.calibrate("m = a * x", full, {"a": 0.0}, criteria=[kf.Criterion("m", "y", regions=regions)])


@pytest.mark.parametrize(("where", "weight"), [("", 1.0), ("x > 1", -1.0), ("x > 1", np.inf), ("x > 1", np.nan)])
def test_a_region_is_checked_at_construction(where, weight):
    with pytest.raises(ArgumentError):
        Region(where, weight)


def test_limits_of_outputs_hold_together_with_weights():
    data = line(v=W + 0.1)
    for weighed in (replace(data, weight_channel="v"), data):
        result = kf.calibrate("m = a * x + b", weighed, {"a": 0.0, "b": 0.0}, target="y", limits={"m": (0.0, 5.0)})
        assert result.converged
        a, b = (result.parameters[name].value for name in "ab")
        assert np.max(a * X + b) == pytest.approx(5.0, rel=1e-5)
