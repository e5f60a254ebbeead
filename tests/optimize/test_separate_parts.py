"""Criteria of very different sizes, each with values of its own: fitted together as they are alone."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.optimize import Problem
from kennfeld.optimize.fit.separate_parts import separate_parts
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.sums.compiled import CompiledProblem
from tests.draws import mostly_slow

RANDOM = np.random.default_rng(2)
X = RANDOM.uniform(0, 5, 200)
PRESSURE = 1 + 0.3 * np.exp(0.4 * X) + 1e-3 * RANDOM.normal(size=X.size)
RATIO = 0.8 / (1 + np.exp(-1.7 * (X - 2.2))) + 1e-2 * RANDOM.normal(size=X.size)
LOGISTIC = "R = d/(1 + exp(-k*(x - m)))"
START = {"d": 0.08, "k": 0.68, "m": 16.8}


@pytest.mark.parametrize("size", mostly_slow([1e5, 1e9, 1e12], [1e12]))
def test_a_small_criterion_is_fitted_as_well_as_alone(size):
    alone = kf.calibrate(LOGISTIC, {"x": X, "q": RATIO}, START, target="q")
    together = kf.calibrate(
        f"P = a*exp(b*x) + c\n{LOGISTIC}",
        {"x": X, "p": size * PRESSURE, "q": RATIO},
        {"a": 0.1 * size, "b": 0.1, "c": 0.0} | START,
        criteria=[kf.Criterion("P", "p"), kf.Criterion("R", "q")],
    )
    assert alone.converged
    assert together.converged
    assert together.quality[1].rmse_after == pytest.approx(alone.quality[0].rmse_after, rel=1e-6)
    assert together.quality[0].rmse_after < 2e-3 * size
    assert together.trace[-1].cost == pytest.approx(together.cost_after)


def test_a_small_table_next_to_a_large_one_is_fitted_as_well_as_alone():
    grid, x = np.arange(40.0) / 4, RANDOM.uniform(0, 7, 800)
    small, noise = np.cos(x), RANDOM.normal(size=(2, x.size))
    start = kf.ParameterSet([kf.Curve("A", grid, 0 * grid), kf.Curve("B", grid, 0 * grid), kf.Scalar("s", 1.3)])
    columns = {"x": x, "p": 1e8 * (np.sin(x) + 1e-3 * noise[0]), "q": small + 1e-3 * noise[1]}
    criteria = [kf.Criterion("P", "p"), kf.Criterion("R", "q")]
    result = kf.calibrate("P = A(x)\nR = B(x*s) + s", columns, start, criteria=criteria)
    assert result.converged
    assert result.quality[1].rmse_after < 2e-2  # the linear interpolation of the cosine alone leaves 3e-3


@pytest.mark.parametrize(
    ("text", "criteria", "expected"),
    [
        ("P = a*x\nR = b*x", ("P", "R"), [("a",), ("b",)]),
        ("P = a*x\nR = b*x + a", ("P", "R"), [("b",)]),
        ("P = a*b*x\nR = b*x + a", ("P", "R"), []),
        ("P = a*x\nR = PT1(x, exp(b))", ("P", "R"), [("a",), ("b",)]),
        ("P = a*x\nR = b*x", ("R",), []),
    ],
    ids=["apart", "one shared", "all shared", "through a state", "one criterion"],
)
def test_parts_are_the_values_that_affect_some_criteria_only(text, criteria, expected):
    data = kf.Dataset.of("d", {"x": X, "q": RATIO}, time=np.arange(X.size))
    parameters = kf.ParameterSet([kf.Scalar("a", 1.0), kf.Scalar("b", 1.0)])
    model = kf.formula(text, parameters=["a", "b"])
    problem = Problem(model, (data,), parameters, tuple(kf.Criterion(name, "q") for name in criteria))
    layout = CompiledProblem(problem).values
    parts = separate_parts(problem, layout, linear_limits(problem, layout))
    assert [tuple(sorted(part.names)) for part in parts] == expected


@pytest.mark.parametrize("loss", ROBUST_LOSSES)
def test_an_outlier_that_hides_all_other_samples_is_named(loss):
    y = np.where(np.arange(X.size) == 7, 1e20, RATIO)
    criteria = [kf.Criterion("R", "q", loss=loss, delta=0.03)]
    result = kf.calibrate(LOGISTIC, {"x": X, "q": y}, {"d": 0.5, "k": 1.0, "m": 2.0}, criteria=criteria)
    assert result.status == "failed"
    assert "R has an error of 1e+20 in training" in result.message
    assert "where" in result.message
