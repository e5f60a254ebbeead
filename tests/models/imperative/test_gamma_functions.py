"""The gamma function and the logarithm of its size against Python's own, and their slopes against digamma."""

import math

import numpy as np
import pytest
from scipy.special import digamma

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.models.imperative.gamma_functions import gamma, log_gamma

X = np.array([-170.5, -20.3, -2.36, -0.5, 1e-300, 1e-3, 0.49, 0.5, 1.0, 1.46, 2.0, 3.0, 9.99, 10.0, 24.0, 170.6, 1e200])


def _values(function, x):
    b = GraphBuilder()
    node = function(b, np.array([[b.input("x")]])).item()
    return evaluate(b.finish({"y": node}), {"x": np.asarray(x)}, ParameterSet())["y"]


def test_both_agree_with_those_of_the_standard_library():
    np.testing.assert_allclose(_values(log_gamma, X), [math.lgamma(x) for x in X], rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(_values(gamma, X[:-1]), [math.gamma(x) for x in X[:-1]], rtol=2e-14)


def test_poles_and_infinity_are_those_of_c():
    x = [0.0, -0.0, -1.0, -2.0, math.inf, -math.inf, math.nan]
    np.testing.assert_array_equal(_values(log_gamma, x), [math.inf] * 6 + [math.nan])
    expected = [math.inf, -math.inf, math.nan, math.nan, math.inf, math.nan, math.nan]
    np.testing.assert_array_equal(_values(gamma, x), expected)


@pytest.mark.parametrize("x", [-2.36, 0.3, 1.46, 9.99, 24.0])
def test_slopes_are_those_of_digamma(x):
    b = GraphBuilder()
    nodes = {name: f(b, np.array([[b.lookup("p")]])).item() for name, f in (("l", log_gamma), ("g", gamma))}
    parameters = ParameterSet([Scalar("p", x)])
    low = lower_lookups(b.finish(nodes), parameters, ())
    line = differentiate(low.graph, list(low.graph.names.values()), ("p",))
    rows = Interpreter(low, parameters, ()).rows(line, {"p": 0}, {"x": np.zeros(1)}, (0,))
    expected = [digamma(x), digamma(x) * math.gamma(x)]
    np.testing.assert_allclose(rows.jacobian[0, :, 0], expected, rtol=1e-11)
