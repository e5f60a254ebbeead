import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native import simulator as module
from kennfeld.native.simulator import Simulator
from tests.native.models import MODELS, case


def simulated(model, starts=(0,)):
    low = lower_lookups(model.graph, model.parameters)
    simulator = Simulator(low, list(low.graph.names.values()), model.parameters)
    return simulator.over(model.columns, model.samples, model.parameters, starts)


def test_named_nodes_are_those_of_the_interpreter():
    for make in MODELS.values():
        model = case(make(), 70, (0, 1, 30))
        expected = evaluate(model.graph, model.columns, model.parameters, model.starts)
        np.testing.assert_allclose(simulated(model, model.starts), np.array(list(expected.values())), rtol=1e-11)


def test_results_do_not_depend_on_the_length_of_a_call(monkeypatch):
    for make in MODELS.values():
        model = case(make(), 70, (0, 1, 30))
        whole = simulated(model, model.starts)
        with monkeypatch.context() as patch:
            patch.setattr(module, "CHUNK", 4)
            np.testing.assert_array_equal(simulated(model, model.starts), whole)


def test_the_last_sample_alone_has_the_same_values(monkeypatch):
    for make in MODELS.values():
        model = case(make(), 70, (0,))
        low = lower_lookups(model.graph, model.parameters)
        simulator = Simulator(low, list(low.graph.names.values()), model.parameters)
        whole = simulator.over(model.columns, model.samples, model.parameters)
        for steps in (4096, 7):
            monkeypatch.setattr(module, "STEPS", steps)
            np.testing.assert_array_equal(simulator.last(model.columns, 70, model.parameters), whole[:, -1])


def test_a_simulation_in_steps_goes_on_where_it_stopped():
    for make in MODELS.values():
        model = case(make(), 70, (0,))
        low = lower_lookups(model.graph, model.parameters)
        simulator = Simulator(low, list(low.graph.names.values()), model.parameters)
        whole = simulator.over(model.columns, model.samples, model.parameters)
        steps = simulator.steps(model.columns, model.samples, model.parameters)
        steps.start(0)
        parts = [steps.over(first, min(first + 9, 70)) for first in range(0, 70, 9)]
        np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)


def test_a_simulation_of_no_samples_has_no_last_one():
    model = case(next(iter(MODELS.values()))(), 70, (0,))
    low = lower_lookups(model.graph, model.parameters)
    with pytest.raises(ArgumentError, match="count=0"):
        Simulator(low, [0], model.parameters).last(model.columns, 0, model.parameters)


def test_other_values_need_no_other_simulator():
    b = GraphBuilder()
    graph = b.finish({"y": b.call("mul", b.lookup("K"), b.input("x"))})
    one, two = (ParameterSet([Scalar("K", value)]) for value in (2.0, 3.0))
    low = lower_lookups(graph, one)
    simulator = Simulator(low, [low.graph.names["y"]], one)
    assert simulator.inputs == ("x",)
    assert simulator.over({"x": np.array([1.0, 2.0])}, 2, two).tolist() == [[3.0, 6.0]]
    assert simulator.over({"x": np.array([1.0, 2.0])}, 2, one).tolist() == [[2.0, 4.0]]


def test_a_root_may_be_asked_for_twice():
    b = GraphBuilder()
    low = lower_lookups(b.finish({"y": b.call("sin", b.input("x"))}), ParameterSet())
    y = low.graph.names["y"]
    run = Simulator(low, [y, y], ParameterSet()).over({"x": np.array([0.0])}, 1, ParameterSet())
    assert run.tolist() == [[0.0], [0.0]]


def test_data_need_not_be_contiguous():
    b = GraphBuilder()
    low = lower_lookups(b.finish({"y": b.call("add", b.input("x"), b.input("z"))}), ParameterSet())
    data = np.arange(12.0).reshape(3, 4).T[:2]
    run = Simulator(low, [low.graph.names["y"]], ParameterSet()).over({"x": data[0], "z": data[1]}, 3, ParameterSet())
    assert run[0].tolist() == (data[0] + data[1]).tolist()


def test_other_breakpoints_of_a_free_axis_need_no_other_simulator():
    b = GraphBuilder()
    graph = b.finish({"y": b.lookup("C", b.input("x"))})
    start = ParameterSet([Curve("C", Axis([0, 1, 4], name="A", free=True), [0.0, 1.0, 5.0])])
    low = lower_lookups(graph, start)
    simulator = Simulator(low, [low.graph.names["y"]], start)
    x = np.array([-1.0, 0.5, 2.5, 3.5, 9.0])
    for axis in (Axis([0, 3, 4], name="A", free=True), Axis([0, 2, 3])):  # as a fit leaves it, and as a file holds it
        moved = ParameterSet([Curve("C", axis, [0.0, 1.0, 5.0])])
        expected = evaluate(graph, {"x": x}, moved)["y"]
        np.testing.assert_allclose(simulator.over({"x": x}, x.size, moved)[0], expected, rtol=1e-14)
