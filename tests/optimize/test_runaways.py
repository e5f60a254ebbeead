"""Values that a search leads towards infinity."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.runaways import find_runaways

X = np.linspace(0, 10, 100)
BELL = 3 * np.exp(-(((X - 4) / 1.2) ** 2)) + 0.05 * np.random.default_rng(0).normal(size=X.size)


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


def test_a_bell_that_is_found_has_none():
    result = bell(1.0, 5.0, 2.0)
    assert result.parameters["m"].value == pytest.approx(4, abs=0.05)
    assert not result.warnings


@pytest.mark.parametrize(
    ("text", "target", "start", "truth"),
    [("y = x/r", X / 1e10, {"r": 1.0}, 1e10), ("y = r*x^2", 1e12 * X**2, {"r": 0.0}, 1e12)],
    ids=["a resistance", "a stiffness"],
)
def test_a_large_value_with_an_effect_of_its_own_has_none(text, target, start, truth):
    result = kf.calibrate(text, {"x": X, "q": target}, start, target="q")
    assert result.parameters["r"].value == pytest.approx(truth)
    assert not [w for w in result.warnings if "effect" in w.message]
