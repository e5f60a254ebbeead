"""Dense layers in machine code against the interpreter and finite differences."""

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Curve
from kennfeld.graph import GraphBuilder
from kennfeld.graph.dense_layer import ACTIVATIONS, DenseLayer
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.simulator import Simulator
from tests.native.models import case
from tests.native.reference import compiled

each = pytest.mark.parametrize("activation", ACTIVATIONS)
X = np.array([-2.0, -0.7, 0.4, 1.9])


def layer_of(outputs, activation="tanh", inputs=3):
    layer = DenseLayer("W", inputs, outputs, activation, 0.3)
    weights = Block("W", np.random.default_rng(outputs).standard_normal(layer.shape))
    b = GraphBuilder()
    nodes = b.dense(layer, *(b.input(f"x{i}") for i in range(inputs)))
    return b.finish({f"y{i}": node for i, node in enumerate(nodes)}), ParameterSet([weights])


def run_native(graph, parameters, columns):
    lowered = lower_lookups(graph, parameters)
    simulator = Simulator(lowered, [lowered.graph.names[name] for name in graph.names], parameters)
    return np.array(list(simulator.over(columns, columns["x0"].size, parameters, [0])))


@pytest.mark.parametrize(
    ("outputs", "activation"),
    [*((count, "tanh") for count in (1, 7, 8, 9, 31, 32, 64, 67)), *((45, activation) for activation in ACTIVATIONS)],
)
def test_outputs_are_those_of_the_interpreter_for_any_size(outputs, activation):
    graph, parameters = layer_of(outputs, activation)
    columns = {f"x{i}": np.random.default_rng(i).standard_normal(50) for i in range(3)}
    native = run_native(graph, parameters, columns)
    expected = np.array(list(evaluate(graph, columns, parameters).values()))
    np.testing.assert_allclose(native, expected, rtol=1e-14, atol=1e-14)


@each
def test_small_and_large_arguments_lose_no_digits(activation):
    graph, _ = layer_of(1, activation, inputs=1)
    parameters = ParameterSet([Block("W", [[1.0], [0.0]])])
    sizes = np.concatenate([10.0 ** np.arange(-300, 3, 0.5), [0.0, 709.0, 1e4, 1e300]])
    columns = {"x0": np.concatenate([sizes, -sizes])}
    native = run_native(graph, parameters, columns)
    expected = evaluate(graph, columns, parameters)["y0"]
    np.testing.assert_allclose(native[0], expected, rtol=2e-15, atol=1e-300)


@each
def test_nan_stays_nan(activation):
    graph, parameters = layer_of(9, activation, inputs=1)
    assert np.isnan(run_native(graph, parameters, {"x0": np.array([np.nan])})).all()


@each
def test_gradient_of_weights_and_of_maps_before_the_layer_is_that_of_finite_differences(activation):
    b, random = GraphBuilder(), np.random.default_rng(3)
    layers = DenseLayer("First", 2, 11, activation, 0.3), DenseLayer("Second", 11, 3, activation, 0.2)
    inner = b.dense(layers[0], b.lookup("C", b.input("u")), b.input("v"))
    y0, y1, y2 = b.dense(layers[1], *inner)
    graph = b.finish({"y": b.call("mul", y0, y1), "z": b.call("add", y2, inner[10])})
    blocks = [Block(layer.name, random.standard_normal(layer.shape)) for layer in layers]
    values = ParameterSet([Curve("C", X, random.standard_normal(4)), *blocks])
    model = compiled(case(graph, 60, free=("C", "First", "Second"), values=values))
    summed, flat = model.accumulator(), model.values
    gradient, h = 2 * summed.normal(flat).gradient.copy(), 1e-6
    for j in range(flat.size):
        up, down = flat.copy(), flat.copy()
        up[j], down[j] = flat[j] + h, flat[j] - h
        slope = (summed.cost(up) - summed.cost(down)) / (2 * h)
        assert gradient[j] == pytest.approx(slope, rel=1e-6, abs=1e-7 * np.max(np.abs(gradient))), j


def test_a_layer_whose_output_is_switched_off_passes_nothing_on():
    b = GraphBuilder()
    (y,) = b.dense(DenseLayer("W", 1, 1, "tanh"), b.call("log", b.lookup("C", b.input("u"))))
    graph = b.finish({"y": b.call("select", b.call("gt", b.input("v"), b.const(5.0)), y, b.lookup("C", b.input("u")))})
    values = ParameterSet([Curve("C", X, [-1.0, -2.0, -3.0, -1.5]), Block("W", [[0.5], [0.1]])])
    model = compiled(case(graph, 40, free=("C", "W"), values=values))
    normal = model.accumulator().normal(model.values)
    assert np.isfinite(normal.gradient).all()
    assert normal.gradient.any()
