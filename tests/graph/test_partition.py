import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.graph.partition import partition_graph
from tests.draws import few_or_many
from tests.graph.noise import assert_close, spread, steady
from tests.graph.random_graphs import cases


def lowered(names, b, *parameters):
    return lower_lookups(b.finish(names), ParameterSet(parameters)).graph


def fed(graph):
    return {node.payload for node in graph.nodes if node.op == "input" and node.payload.startswith("#")}


@few_or_many(cases(), few=8, many=40)
def test_the_parts_equal_the_whole(case):
    low = lower_lookups(case.graph, case.parameters)
    outputs = tuple(case.graph.names)
    parts = partition_graph(low.graph, outputs, case.fitted)

    def whole(interpreter):
        run = interpreter.run(low.graph.nodes, low.graph.states, case.columns, case.starts)
        return np.array([run[low.graph.names[name]] for name in outputs])

    def joined(interpreter):
        run = interpreter.run(low.graph.nodes, low.graph.states, case.columns, case.starts)
        columns = {**case.columns, **{name: np.asarray(run[at]) for name, at in parts.columns.items()}}
        again = interpreter.run(parts.graph.nodes, parts.graph.states, columns, case.starts)
        return np.array([again[parts.graph.names[name]] for name in outputs])

    plain = Interpreter(low, case.parameters)
    exact = whole(plain)
    change = spread(plain, whole, exact)
    assert_close(joined(plain), exact, change, steady(exact, change))


@pytest.mark.slow
@few_or_many(cases(), few=10, many=40)
def test_columns_are_exactly_what_the_reduced_graph_reads(case):
    low = lower_lookups(case.graph, case.parameters)
    parts = partition_graph(low.graph, ["y0"], case.fitted)
    assert fed(parts.graph) == set(parts.columns)


def test_columns_that_the_chosen_outputs_do_not_need_are_left_out():
    b = GraphBuilder()
    slow = b.call("exp", b.input("x"))
    graph = lowered({"y": b.lookup("K"), "z": b.call("mul", slow, b.lookup("K"))}, b, Scalar("K", 1.0))
    assert partition_graph(graph, ["y"], ["K"]).columns == {}


@few_or_many(cases(), few=10, many=40)
def test_no_column_depends_on_a_free_parameter(case):
    low = lower_lookups(case.graph, case.parameters)
    parts = partition_graph(low.graph, tuple(case.graph.names), case.fitted)

    def constant_columns(c):
        run = Interpreter(low, c.parameters).run(low.graph.nodes, low.graph.states, c.columns, c.starts)
        return [run[at] for at in parts.columns.values()]

    for before, after in zip(constant_columns(case), constant_columns(case.with_other_values()), strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_search_is_done_again():
    b = GraphBuilder()
    graph = lowered({"y": b.lookup("C", b.input("x"))}, b, Curve("C", [0.0, 1.0], [2.0, 3.0]))
    parts = partition_graph(graph, ["y"], ["C"])
    assert parts.columns == {}
    assert [node.op for node in parts.graph.nodes] == ["input", "position", "interpolate"]


def test_costly_coordinates_become_a_column():
    b = GraphBuilder()
    coordinate = b.call("exp", b.input("x"))
    tables = [Curve(name, [0.0, 1.0 + i], [2.0, 3.0]) for i, name in enumerate("CD")]
    graph = lowered({"y": b.call("add", b.lookup("C", coordinate), b.lookup("D", coordinate))}, b, *tables)
    parts = partition_graph(graph, ["y"], ["C", "D"])
    assert [graph.nodes[at].op for at in parts.columns.values()] == ["exp"]
    assert [node.op for node in parts.graph.nodes].count("position") == 2


def test_cheap_nodes_are_computed_again():
    b = GraphBuilder()
    cheap = b.call("sub", b.input("x"), b.input("z"))
    graph = lowered({"y": b.call("mul", cheap, b.lookup("K"))}, b, Scalar("K", 1.0))
    assert partition_graph(graph, ["y"], ["K"]).columns == {}


def test_a_state_of_data_alone_becomes_a_column():
    b = GraphBuilder()
    late = b.prev(b.input("x"), b.const(0.0))
    graph = lowered({"y": b.call("mul", late, b.lookup("K"))}, b, Scalar("K", 1.0))
    parts = partition_graph(graph, ["y"], ["K"])
    assert parts.graph.states == ()
    assert [graph.nodes[at].op for at in parts.columns.values()] == ["state"]


def test_a_fixed_parameter_counts_as_data():
    b = GraphBuilder()
    graph = lowered(
        {"y": b.call("add", b.lookup("C", b.input("x")), b.lookup("K"))},
        b,
        Scalar("K", 1.0),
        Curve("C", [0, 1], [2, 3]),
    )
    parts = partition_graph(graph, ["y"], ["K"])
    assert [graph.nodes[at].op for at in parts.columns.values()] == ["interpolate"]


def test_the_first_value_and_the_feedback_of_a_live_state_are_cut_too():
    b = GraphBuilder()
    first, drive = b.call("exp", b.input("x")), b.call("sin", b.input("x"))
    state = b.state()
    b.close(state, first, b.call("add", b.call("mul", state, b.lookup("K")), drive))
    graph = lowered({"y": state}, b, Scalar("K", 0.5))
    parts = partition_graph(graph, ["y"], ["K"])
    assert sorted(graph.nodes[at].op for at in parts.columns.values()) == ["exp", "sin"]
    assert len(parts.graph.states) == 1


def test_an_output_of_data_alone_is_one_column():
    b = GraphBuilder()
    graph = lowered({"y": b.call("exp", b.call("sin", b.input("x"))), "z": b.lookup("K")}, b, Scalar("K", 1.0))
    parts = partition_graph(graph, ["y", "z"], ["K"])
    assert [graph.nodes[at].op for at in parts.columns.values()] == ["exp"]
    assert parts.graph.outputs == ("y", "z")
