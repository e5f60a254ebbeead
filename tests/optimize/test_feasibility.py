"""Limits hold at the end of every fit, whether or not the data determine the values that they tie."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Pin, Shape
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.multistart import run
from tests.draws import mostly_slow
from tests.optimize.constrained_fits import curve_fit, least_cost, map_fit

HOLDS = 1e-9


def seeds(unmarked, count):
    """The first few seeds, and the others up to a count for `-m slow`."""
    return [*range(unmarked), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(unmarked, count))]


def test_a_rising_curve_with_few_data_rises():
    data = {"x": [0.98, 2.96, 0.96], "z": [-0.35, -2.31, -0.19]}
    start = kf.ParameterSet([kf.Curve("C", range(4), [0] * 4)])
    result = kf.calibrate("m = C(x)", data, start, "z", constraints=[Shape("C", 0, "slope", lower=0)])
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["C"].values, np.mean(data["z"]), atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(1, 20))
@pytest.mark.parametrize("draw", [curve_fit, map_fit])
def test_random_fits_within_limits_agree_with_cvxpy(draw, seed):
    random = np.random.default_rng([seed, 13])
    for _ in range(3):
        fit = draw(random)
        result = fit.result
        assert result.status == "converged"
        assert fit.violation(result.parameters) <= HOLDS
        assert result.cost_after <= fit.least_cost + 1e-6 * np.sum(fit.data["z"] ** 2)


def test_a_rising_map_with_an_empty_corner_rises():
    random = np.random.default_rng(4)
    x, y = random.uniform(0, 11, (2, 1600))
    covered = (x < 6) | (y < 6)
    x, y = x[covered], y[covered]
    z = 3 * np.sqrt(x) + y**1.5 / 4 + random.normal(0, 1, x.size)
    start = kf.ParameterSet([kf.Map("C", range(12), range(12), np.zeros((12, 12)))])
    rising = [Shape("C", 0, "slope", lower=0.0), Shape("C", 1, "slope", lower=0.0)]
    result = kf.calibrate("m = C(x, y)", {"x": x, "y": y, "z": z}, start, "z", constraints=rising)
    values = result.parameters["C"].values
    assert result.status == "converged"
    assert min(np.diff(values, axis=0).min(), np.diff(values, axis=1).min()) >= -HOLDS * values.max()


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_the_factors_of_a_product_respect_limits_of_very_different_sizes(seed):
    random = np.random.default_rng([seed, 14])
    u, v = random.uniform(0, 5, (2, 12))
    z = 1e5 * (1 + u) * (1 - 0.1 * v) * random.uniform(0.5, 1.5, 12)
    start = kf.ParameterSet([kf.Curve("A", range(6), [1e5] * 6), kf.Curve("B", range(6), [1.0] * 6)])
    limits = [Shape("A", 0, "slope", lower=0.0), Shape("B", 0, "slope", lower=-np.inf, upper=0.0)]
    result = kf.calibrate(
        "m = A(u)*B(v)", {"u": u, "v": v, "z": z}, start, "z", constraints=limits, pins=[Pin("B", (0,), 1.0)]
    )
    A, B = (result.parameters[name].values for name in "AB")
    assert result.status == "converged"
    assert np.diff(A).min() >= -HOLDS * np.abs(A).max()
    assert np.diff(B).max() <= HOLDS * np.abs(B).max()
    assert B[0] == pytest.approx(1.0, rel=HOLDS)


@pytest.mark.parametrize(
    "data", [{"offset": 2.0, "slope": 0.0}, {"offset": 2.0, "slope": 1.0}, {"offset": -99.0, "slope": 1.0}]
)
@pytest.mark.parametrize("unit", mostly_slow([1.0, 1e-7, 1e7], [1e-7]))
def test_a_curve_that_limits_force_to_zero_does_not_hold_the_others_at_their_start(unit, data):
    random = np.random.default_rng(1)
    x, u = np.array([0.0, 1.0, 2.0, 3.0] * 3), random.uniform(0, 3, 12)
    z = data["offset"] - x + data["slope"] * u
    forced = kf.Curve("A", range(4), [0] * 4, locked=[True, False, False, False])
    result = kf.calibrate(
        f"m = {1 / unit!r}*A(x) + {unit!r}*B(u)",
        {"x": x, "u": u, "z": z},
        kf.ParameterSet([forced, kf.Curve("B", range(4), [0] * 4)]),
        "z",
        constraints=[Shape("A", 0, "slope", lower=0.0)],
    )
    alone = kf.calibrate("m = B(u)", {"u": u, "z": z}, kf.ParameterSet([kf.Curve("B", range(4), [0] * 4)]), "z")
    A = result.parameters["A"].values
    assert result.status == "converged"
    assert np.diff(A).min() >= -HOLDS * np.abs(A).max()
    assert result.cost_after <= alone.cost_after * (1 + 1e-6)


def test_a_pin_of_an_extreme_size_gives_a_result_without_a_warning():
    start = kf.ParameterSet([kf.Curve("C", range(3), [0.0] * 3)])
    result = kf.calibrate("m = C(x)", {"x": [0.0, 1.0], "z": [1.0, 2.0]}, start, "z", pins=[Pin("C", (2.0,), 1e308)])
    assert result.parameters["C"].values[2] == pytest.approx(1e308)


@pytest.mark.parametrize(("unit", "smoothness"), [(1e3, 1e6), pytest.param(1e4, 1e2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", mostly_slow(range(2), 1))
def test_limits_do_not_slow_a_fit_whose_smoothness_outweighs_its_data(seed, unit, smoothness):
    """The slopes of a table, which smoothness leaves to the data, have a tiny share of the curvature."""
    random = np.random.default_rng([seed, 15])
    x, y = (np.cumsum(random.uniform(0.1, 1, size)) for size in (6, 2))
    data = {name: random.uniform(axis[0], axis[-1], 30) for name, axis in (("u", x), ("x", x), ("y", y))}
    start = kf.ParameterSet([kf.Map("B", x, y, np.zeros((6, 2))), kf.Curve("A", x, np.zeros(6))])
    problem = ProblemSetup(
        f"m = A(u) + B(x, y) / {unit}",
        data | {"z": random.normal(0, 1, 30)},
        start,
        "z",
        smoothness=smoothness,
        constraints=[Shape("A", 0, "slope", lower=0.0), Shape("B", 0, "slope", lower=0.0)],
        pins=[Pin("A", (float(x[3]),), -1.3)],
    ).problem()
    result = run(problem, kf.Options(continuation="off"))
    assert result.status == "converged"
    assert result.iterations < 50
    assert result.cost_after <= least_cost(problem) * (1 + 1e-6)
