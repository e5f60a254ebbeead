"""Fits of formulas that saturate: a slope of exactly 0 outweighs an infinite one, and a real infinity is located."""

import numpy as np
import pytest

import kennfeld as kf

X = np.linspace(-5.0, 5.0, 101)
P = np.append(np.linspace(0.5, 3.0, 51), [1.0, 1.0])


@pytest.mark.parametrize("steep", [20.0, 200.0])
def test_a_logistic_function_is_fitted_from_a_steep_start(steep):
    y = 1 / (1 + np.exp(-2.5 * (X - 0.7)))
    result = kf.calibrate("y = 1/(1 + exp(-k*(x - c)))", {"x": X, "y": y}, {"k": steep, "c": 0.0}, "y")
    assert result.converged
    assert [p.value for p in result.parameters.parameters] == pytest.approx([2.5, 0.7], rel=1e-9)


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
