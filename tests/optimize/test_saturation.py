"""Fits of formulas that saturate: a slope of exactly 0 outweighs an infinite one, and a real infinity is located."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from tests.draws import mostly_slow

X = np.linspace(-5.0, 5.0, 101)
P = np.append(np.linspace(0.5, 3.0, 51), [1.0, 1.0])


@pytest.mark.parametrize("steep", [20.0, 200.0])
def test_a_logistic_function_is_fitted_from_a_steep_start(steep):
    y = 1 / (1 + np.exp(-2.5 * (X - 0.7)))
    result = kf.calibrate("y = 1/(1 + exp(-k*(x - c)))", {"x": X, "y": y}, {"k": steep, "c": 0.0}, "y")
    assert result.converged
    assert [p.value for p in result.parameters.parameters] == pytest.approx([2.5, 0.7], rel=1e-9)


SOFTPLUS = np.logaddexp(0, 3 * (X - 1))


@pytest.mark.parametrize("steep", mostly_slow([300.0, 2e4], [2e4]))
@pytest.mark.parametrize(
    ("formula", "y", "start", "truth"),
    [
        ("y = a*log(1 + exp(k*(x - c)))", 2 * SOFTPLUS, {"a": 1.0, "c": 0.0}, [2, 3, 1]),
        ("y = a*log10(exp(k*(x - c)) + 1)", 2 * SOFTPLUS / np.log(10), {"a": 1.0, "c": 0.0}, [2, 3, 1]),
        ("y = log(exp(k*x + a) + exp(-c*x))", np.logaddexp(2 * X + 1, -X), {"a": 0.0, "c": 2.0}, [1, 2, 1]),
        ("y = a*log(cosh(k*(x - c)))", 1.5 * np.log(np.cosh(2 * (X - 1))), {"a": 1.0, "c": 0.0}, [1.5, 2, 1]),
    ],
    ids=["softplus", "base 10", "sum of two", "cosh"],
)
def test_the_logarithm_of_exponentials_is_fitted_from_a_steep_start(formula, y, start, truth, steep):
    result = kf.calibrate(formula, {"x": X, "y": y}, start | {"k": steep}, "y")
    assert result.converged
    assert np.isfinite(result.quality[0].rmse_before)
    assert [result.parameters[name].value for name in "akc"] == pytest.approx(truth, rel=1e-6)


@pytest.mark.parametrize("text", ["log(1 + exp(z))", "log(exp(z) + exp(-z) + 2)", "log10(exp(z))", "log(cosh(z))"])
def test_stable_forms_have_the_values_and_slopes_of_the_original(text):
    """Also at z = 0, where the two forms of the larger and the smaller term meet."""
    z = np.array([-1e4, -30.0, -1.0, 0.0, 1e-3, 1.0, 19.9, 20.1, 600.0, 1e4])
    sizes = np.abs(z)
    value, slope = {
        "log(1 + exp(z))": (np.logaddexp(0, z), (1 + np.tanh(z / 2)) / 2),
        "log(exp(z) + exp(-z) + 2)": (2 * np.logaddexp(z / 2, -z / 2), np.tanh(z / 2)),
        "log10(exp(z))": (z / np.log(10), np.full(z.size, 1 / np.log(10))),
        "log(cosh(z))": (sizes + np.log1p(np.exp(-2 * sizes)) - np.log(2), np.tanh(z)),
    }[text]
    model = kf.formula(f"y = {text.replace('z', '(z + a)')}", parameters=["a"])
    parameters = kf.ParameterSet([kf.Scalar("a", 0.0)])
    problem = Problem(model, (kf.Dataset.of("d", {"z": z}),), parameters, (kf.Criterion("y", 0.0),))
    residual, jacobian = LeastSquaresObjective(CompiledProblem(problem)).rows(np.zeros(1))
    np.testing.assert_allclose(np.sort(residual), np.sort(value), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(np.sort(jacobian[:, 0]), np.sort(slope), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(
    "formula", ["y = sqrt(max(1 - (p0/max(p, p0))^k, 0))", "y = max(1 - (p0/max(p, p0))^k, 0)^0.5"]
)
def test_the_flow_of_a_nozzle_is_fitted_with_samples_without_flow(formula):
    y = np.sqrt(np.maximum(1 - (1 / np.maximum(P, 1)) ** 0.28, 0))
    result = kf.calibrate(formula, {"p": P, "y": y}, {"k": 0.5, "p0": 1.2}, "y")
    assert result.converged
    assert result.parameters["k"].value == pytest.approx(0.28, rel=1e-6)
    assert result.parameters["p0"].value == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(
    ("formula", "node"), [("y = a*sqrt(p - x)", "y"), ("head = p - x\nroot = sqrt(head)\ny = a*root", "root")]
)
def test_a_derivative_that_is_not_finite_is_named_with_its_sample(formula, node):
    x = np.linspace(0.0, 4.0, 41)
    result = kf.calibrate(formula, kf.Dataset.of("bench", {"x": x, "m": x}), {"p": 4.0, "a": 1.0}, "m", node="y")
    assert result.status == "failed"
    assert f"The derivative of {node} is not finite at sample 41 of bench." in result.message


def test_a_derivative_in_a_loop_is_named_with_its_sample():
    u = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
    data = kf.Dataset.of("bench", {"u": u, "m": u}, time=np.arange(5.0))
    result = kf.calibrate("root = sqrt(k - u)\ny = prev(y, 0)/2 + root", data, {"k": 3.0}, "m", node="y")
    assert result.status == "failed"
    assert "The derivative of root is not finite at sample 3 of bench." in result.message
