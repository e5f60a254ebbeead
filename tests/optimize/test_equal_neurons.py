"""Neurons with equal weights are counted, and a fit that starts from them warns."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.models.model import Model
from kennfeld.optimize import Problem, run
from kennfeld.optimize.ends.equal_neurons import equal_neurons
from tests.draws import mostly_slow

RANDOM = np.random.default_rng(0)
U, V = RANDOM.uniform(-1, 1, (2, 300))
TARGET = np.sin(2 * U) * V + 0.3 + 0.01 * RANDOM.standard_normal(300)
FIRST, LAST = RANDOM.standard_normal((3, 4)), RANDOM.standard_normal((5, 1))


def network(activation="tanh", written=""):
    """Two layers of 4 and 1 neurons; `written` is an operation between them."""
    b = GraphBuilder()
    hidden = b.dense(DenseLayer("first", 2, 4, activation), b.input("u"), b.input("v"))
    hidden = tuple(b.call(written, node) for node in hidden) if written else hidden
    (y,) = b.dense(DenseLayer("last", 4, 1), *hidden)
    return b.finish({"y": y}, {}, ("y",))


def weights(first, last, **attributes):
    return ParameterSet([Block("first", first, **attributes), Block("last", last)])


def fit(start, **settings):
    graph = network(**settings)
    model = Model(graph=graph, name="network", declared=graph.parameters)
    data = (kf.Dataset.of("bench", {"u": U, "v": V, "t": TARGET}),)
    return run(Problem(model, data, start, (kf.Criterion("y", "t"),)), kf.Options(continuation="off"))


def test_neurons_with_different_weights_are_not_counted():
    assert equal_neurons(network(), weights(FIRST, LAST)) == {}


def test_neurons_are_equal_if_those_that_use_them_do_so_by_equal_weights():
    first = FIRST[:, [0, 1, 1, 2]]
    assert equal_neurons(network(), weights(first, LAST)) == {}
    assert equal_neurons(network(), weights(first, LAST[[0, 1, 1, 2, 3]])) == {"first": (2, 4)}


def test_a_layer_that_uses_one_of_two_equal_neurons_distinguishes_them():
    b = GraphBuilder()
    hidden = b.dense(DenseLayer("hidden", 1, 2, "tanh"), b.input("x"))
    (short,) = b.dense(DenseLayer("short", 1, 1), hidden[0])
    (mixed,) = b.dense(DenseLayer("both", 2, 1), *hidden)
    graph = b.finish({"y": b.call("add", short, mixed)}, {}, ("y",))
    equal = [Block("hidden", np.array([[0.5, 0.5], [0.1, 0.1]])), Block("both", np.ones((3, 1)))]
    assert equal_neurons(graph, ParameterSet([*equal, Block("short", np.array([[2.0], [0.0]]))])) == {}
    assert equal_neurons(graph, ParameterSet([*equal, Block("short", np.zeros((2, 1)))])) == {"hidden": (2, 2)}


@pytest.mark.parametrize(("activation", "counts"), [("tanh", {"first": (4, 4)}), ("relu", {})])
def test_mirrored_neurons_are_equal_if_the_activation_is_odd(activation, counts):
    first = np.hstack([FIRST[:, :2], -FIRST[:, :2]])
    last = np.vstack([LAST[:2], -LAST[:2], LAST[-1:]])
    assert equal_neurons(network(activation), weights(first, last)) == counts


def test_equal_neurons_are_counted_if_their_activation_is_an_operation():
    ones = np.ones((3, 4)), np.ones((5, 1))
    assert equal_neurons(network("identity", "cos"), weights(*ones)) == {"first": (4, 4)}


def test_locked_layers_are_not_counted():
    assert equal_neurons(network(), weights(np.ones((3, 4)), np.ones((5, 1)), locked=True)) == {}


@pytest.mark.slow
def test_a_fit_from_equal_neurons_warns():
    warnings = fit(weights(np.full((3, 4), 0.1), np.full((5, 1), 0.1))).warnings  # neurons run away in equal numbers
    assert str(warnings[-1]).startswith("4 of 4 neurons of first start with equal weights: their derivatives are equal")


@pytest.mark.parametrize("activation", mostly_slow(["tanh", "relu", "sigmoid"], ["sigmoid"]))
def test_a_fit_of_a_network_at_zero_starts_from_different_weights(activation):
    result = fit(weights(np.zeros((3, 4)), np.zeros((5, 1))), activation=activation)
    assert "The search cannot tell neurons of first and last whose weights are 0 from each other." in result.message
    assert not result.warnings
    assert result.quality[0].r2_after > 0.5  # that of the best constant is 0
