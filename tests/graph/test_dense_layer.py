"""Dense layers in the graph: their parameters and slopes."""

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block
from kennfeld.graph import GraphBuilder
from kennfeld.graph.dense_layer import ACTIVATIONS, DenseLayer, evaluate_layer
from kennfeld.graph.lookup_lowering import lower_lookups


def network(layer):
    b = GraphBuilder()
    return b.finish({"y": b.dense(layer, b.input("u"), b.input("v"))[1]})


def test_the_weights_of_a_layer_are_a_parameter_of_two_axes():
    graph = network(DenseLayer("W", 2, 3))
    assert dict(graph.parameters) == {"W": 2}
    assert graph.layers == {"W"}


@pytest.mark.parametrize(
    ("parameters", "message"),
    [([], "whose weights are not in the parameter set"), ([Block("W", np.ones((2, 3)))], r"must have shape \(3, 3\)")],
)
def test_weights_that_are_missing_or_of_another_shape_are_refused(parameters, message):
    with pytest.raises(ArgumentError, match=message):
        lower_lookups(network(DenseLayer("W", 2, 3)), ParameterSet(parameters))


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_slopes_are_those_of_finite_differences(activation):
    layer = DenseLayer("W", 1, 1, activation, 0.4)
    z, h = np.array([[-3.0], [-0.2], [0.3], [2.5]]), 1e-6
    values = np.array([[1.0], [0.0]])
    up, down = (evaluate_layer(layer, values, z + step)[0] for step in (h, -h))
    np.testing.assert_allclose(evaluate_layer(layer, values, z)[1], (up - down) / (2 * h), atol=1e-9)
