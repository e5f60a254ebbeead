"""Weights of samples: what they say about the noise, against repeated measurements."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.domain.criteria import Region
from kennfeld.optimize import Problem, run
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.noise import classes, groups, rescore
from tests.draws import few_or_many, mostly_slow
from tests.optimize.repetitions import FEW, agree, counts, own_targets

SIZE = 400
RANDOM = np.random.default_rng(0)
X = RANDOM.uniform(0, 5, SIZE)
W = 10 ** RANDOM.uniform(-1, 1, SIZE)
GRID = np.arange(6.0)
TEXT = "m = C(x) + k * sin(7 * x)"
TRUTH = kf.ParameterSet([kf.Curve("C", GRID, 3 * np.sin(GRID)), kf.Scalar("k", 1.0)])
CLEAN = np.interp(X, GRID, 3 * np.sin(GRID)) + np.sin(7 * X)
EVEN = np.ones(SIZE)


def problem(spread, seed=1, channels=None, **criterion):
    y = CLEAN + spread * np.random.default_rng(seed).standard_normal(SIZE)
    data = kf.Dataset.of("d", {"x": X, "y": y, "w": W} | (channels or {}))
    criteria = (kf.Criterion("m", "y", **criterion),)
    return Problem(kf.formula(TEXT, parameters=["C", "k"]), (data,), TRUTH, criteria)


def repeated(posed, spread, count):
    """Values from many measurements of noise `spread`, in the order of the parameters."""
    compiled = CompiledProblem(posed)
    targets = own_targets(compiled)
    objective, limits = LeastSquaresObjective(compiled), linear_limits(posed, compiled.values)
    start, rng, ends = compiled.values.pack(TRUTH)[: compiled.values.free], np.random.default_rng(7), []
    for _ in range(count):
        targets[:] = CLEAN + spread * rng.standard_normal(SIZE)
        compiled.samples.wanted.reread()
        ends.append(levenberg_marquardt(objective, start, limits, SolverSettings(tolerance=1e-6)).values)
    order = [compiled.values.offsets[name] + np.arange(TRUTH[name].size) for name in posed.free_names]
    return np.array(ends)[:, np.concatenate(order)]


WHERE = Region("x < 2.5", 5.0)
CASES = {
    "weights that say how good": (0.5 / np.sqrt(W), {"weight_channel": "w"}),
    "weights that say how much it matters": (0.5 * EVEN, {"weight_channel": "w"}),
    "a region that matters more": (0.5 * EVEN, {"regions": (WHERE,)}),
    "a region that is better": (0.5 / np.sqrt(np.where(X < 2.5, 5.0, 1.0)), {"regions": (WHERE,)}),
    "scaled and weighted": (0.5 / np.sqrt(W), {"weight_channel": "w", "scale": 3.0, "weight": 20.0}),
    "outliers judged before their weight": (
        0.5 / np.sqrt(W),
        {"weight_channel": "w", "loss": "huber", "delta": 0.4},
    ),
}


@pytest.mark.slow
@counts
@pytest.mark.parametrize(
    "name",
    mostly_slow(CASES, ["a region that matters more"]),
)
def test_weighted_fits_scatter_as_predicted(name, count):
    spread, criterion = CASES[name]
    predicted = np.mean(
        [
            run(problem(spread, seed, **criterion), kf.Options()).trust.covariance()
            for seed in range(2 if count == FEW else 6)
        ],
        axis=0,
    )
    assert agree(predicted, repeated(problem(spread, **criterion), spread, count)) == 7


HEAVY = np.exp(RANDOM.normal(0, 1.5, SIZE))  # a tenth of the samples has most of the weight
STATED = {"importance": EVEN, "accuracy": 1 / np.sqrt(HEAVY), "something between": HEAVY**-0.25}


def line(spread, rows, seed):
    rng = np.random.default_rng(seed)
    x = X[rows] - 2.5
    columns = {"x": x, "w": HEAVY[rows], "y": 1 + 2 * x + 0.5 * spread[rows] * rng.standard_normal(x.size)}
    criteria = [kf.Criterion("m", "y", weight_channel="w")]
    return kf.calibrate("m = a + b * x", columns, {"a": 0.0, "b": 0.0}, criteria=criteria)


@pytest.mark.parametrize("stated", STATED)
def test_weights_that_vary_continuously_give_the_sandwich_form(stated):
    """For noise s and weights w, (J'wJ)^-1 J'w s^2 w J (J'wJ)^-1."""
    spread = STATED[stated]
    jacobian = np.stack([EVEN, X - 2.5], axis=1)
    inverse = np.linalg.inv(jacobian.T @ (HEAVY[:, None] * jacobian))
    middle = jacobian.T @ ((HEAVY * 0.5 * spread)[:, None] ** 2 * jacobian)
    expected = np.sqrt(np.diag(inverse @ middle @ inverse))
    result = line(spread, slice(None), 3)
    assert [float(result.trust.deviation[name]) for name in "ab"] == pytest.approx(expected, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("count", [20, 60])
@pytest.mark.parametrize("stated", STATED)
def test_two_deviations_cover_the_truth_with_weights_that_vary_continuously(stated, count):
    fits = [line(STATED[stated], np.arange(seed, seed + count), seed) for seed in range(0, 300, 4)]
    errors = [
        float(r.parameters[n].value - t) / float(r.trust.deviation[n]) for r in fits for n, t in (("a", 1), ("b", 2))
    ]
    assert np.mean(np.abs(errors) < 2) > 0.9  # 0.94 with the t distribution of 18 degrees of freedom


def deviations(trust):
    return np.concatenate([np.ravel(trust.deviation[name]) for name in trust.deviation])


@pytest.mark.slow
@few_or_many(st.floats(1e-6, 1e6), st.floats(1e-3, 1e3), few=2, many=10)
def test_only_the_ratios_of_weights_matter(factor, scale):
    spread = 0.5 / np.sqrt(W)
    plain = run(problem(spread, weight_channel="w"), kf.Options()).trust
    other = problem(spread, channels={"w": W * factor}, weight_channel="w", scale=scale)
    scaled = run(other, kf.Options()).trust
    assert deviations(scaled) == pytest.approx(deviations(plain), rel=1e-5)
    assert scaled.noise["m"] == pytest.approx(plain.noise["m"], rel=1e-5)


def test_samples_of_weight_0_do_not_count():
    """The same as if they had not been recorded, whatever was measured there."""
    spread, scored = 0.5 / np.sqrt(W), RANDOM.random(SIZE) < 0.6
    y = CLEAN + spread * np.random.default_rng(1).standard_normal(SIZE)
    channels = {"w": np.where(scored, W, 0.0), "y": np.where(scored, y, 1e3)}
    weighted = run(problem(spread, channels=channels, weight_channel="w"), kf.Options()).trust
    data = kf.Dataset.of("d", {"x": X[scored], "y": y[scored], "w": W[scored]})
    model = kf.formula(TEXT, parameters=["C", "k"])
    fewer = run(Problem(model, (data,), TRUTH, (kf.Criterion("m", "y", weight_channel="w"),)), kf.Options()).trust
    assert deviations(weighted) == pytest.approx(deviations(fewer), rel=1e-6)
    assert weighted.noise["m"] == pytest.approx(fewer.noise["m"], rel=1e-9)
    assert weighted.samples["C"].tolist() == fewer.samples["C"].tolist()


def test_equal_weights_do_not_change_the_trust():
    plain = run(problem(0.5 * EVEN), kf.Options()).trust
    for channels, more in (({"w": 7 * EVEN}, {"weight_channel": "w"}), ({}, {"regions": (Region("x < 99", 7.0),)})):
        weighted = run(problem(0.5 * EVEN, channels=channels, **more), kf.Options()).trust
        assert deviations(weighted) == pytest.approx(deviations(plain), rel=1e-6)
        assert weighted.noise == pytest.approx(plain.noise, rel=1e-9)


@pytest.mark.slow
def test_the_noise_is_that_of_a_sample_of_mean_weight():
    w = np.where(X < 2.5, 4.0, 1.0)
    problems = [problem(0.6 / np.sqrt(w), seed, {"w": w}, weight_channel="w") for seed in range(8)]
    noise = np.mean([run(each, kf.Options()).trust.noise["m"] for each in problems])
    share = float(np.mean(X < 2.5))
    assert noise == pytest.approx(np.sqrt(share * 0.3**2 + (1 - share) * 0.6**2), rel=0.04)


def test_few_samples_of_a_weight_have_the_noise_of_the_others():
    """Three samples of weight 100 cannot tell their noise; it is a tenth of that of the others."""
    w = np.where(np.arange(SIZE) < 3, 100.0, 1.0)
    posed = problem(0.5 / np.sqrt(w), channels={"w": w}, weight_channel="w")
    estimate = run(posed, kf.Options()).trust.estimate
    few, many = (variance.unit for variance in estimate.variances)
    assert [few, many] == pytest.approx([0.25, 0.25], rel=0.2)
    assert few == pytest.approx(many, rel=1e-2)


def test_the_persistence_of_errors_does_not_depend_on_the_weights():
    rng = np.random.default_rng(5)
    noise = np.zeros(4000)
    for k in range(1, noise.size):
        noise[k] = 0.9 * noise[k - 1] + rng.normal()
    w = np.where(np.arange(noise.size) % 2, 1.0, 4.0)
    data = kf.Dataset.of("d", {"y": noise / np.sqrt(w), "w": w}, time=0.1 * np.arange(noise.size))
    trust = kf.calibrate("m = a", data, {"a": 0.0}, criteria=[kf.Criterion("m", "y", weight_channel="w")]).trust
    assert trust.persistence["m"] == pytest.approx(19, rel=0.3)


@settings(deadline=None, max_examples=80)
@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=60))
def test_each_sample_is_in_one_class(weights):
    w = np.array(weights)
    weight_classes = classes(w)
    assert len(weight_classes) <= 8
    inside = np.array([(w > above) & (w <= most) for above, most in weight_classes])
    assert np.all(inside.sum(axis=0) == 1)
    assert np.all(inside.any(axis=1))


@pytest.mark.parametrize("text", [TEXT, "m = PT1(C(x) + k * sin(7 * x), 0.1)"], ids=["no memory", "memory"])
def test_the_groups_add_up_to_the_whole(text):
    data = kf.Dataset.of("d", {"x": X, "y": CLEAN, "w": W}, time=0.1 * np.arange(SIZE))
    other = kf.Dataset.of("e", {"x": X[:90], "y": CLEAN[:90], "w": W[:90]}, time=0.1 * np.arange(90), weight=3.0)
    criteria = (kf.Criterion("m", "y", weight_channel="w"), kf.Criterion("m", 1.0, 0.5))
    compiled = CompiledProblem(Problem(kf.formula(text, parameters=["C", "k"]), (data, other), TRUTH, criteria))
    score_groups = groups(compiled.problem, lambda bound: np.zeros((2, bound.count)), compiled.weighting)
    assert len(score_groups) == 18
    full = compiled.values.pack(TRUTH)
    whole = compiled.sums.normal(full).matrix.copy()
    parts = [compiled.sums_over(rescore(compiled, {group: 1.0})).normal(full).matrix.copy() for group in score_groups]
    assert np.sum(parts, axis=0) == pytest.approx(whole, rel=1e-9, abs=1e-9)
    doubled = compiled.sums_over(rescore(compiled, dict.fromkeys(score_groups, 2.0))).normal(full).matrix
    assert doubled == pytest.approx(2 * whole, rel=1e-9, abs=1e-9)
