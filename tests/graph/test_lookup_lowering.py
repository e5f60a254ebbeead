import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.graph import GraphBuilder
from kennfeld.graph.lookup_lowering import AxisRef, lower_lookups
from kennfeld.graph.traversal import dependents, rewrite

SPEED = [0.0, 1.0, 3.0]


def ops(graph):
    return [node.op for node in graph.nodes]


def test_tables_over_equal_axes_share_their_search():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("A", x), b.lookup("B", x))
    parameters = ParameterSet([Curve("A", SPEED, np.ones(3)), Curve("B", Axis(SPEED, input="other"), np.zeros(3))])
    lowered = lower_lookups(b.finish({"y": y}), parameters)
    assert ops(lowered.graph).count("position") == 1
    assert len(lowered.axes) == 1
    assert lowered.axes[0].tolist() == SPEED


def test_tables_over_other_axes_search_each_for_itself():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("A", x), b.lookup("B", x))
    parameters = ParameterSet([Curve("A", SPEED, np.ones(3)), Curve("B", [0.0, 1.0, 3.5], np.zeros(3))])
    lowered = lower_lookups(b.finish({"y": y}), parameters)
    assert ops(lowered.graph).count("position") == 2
    assert len(lowered.axes) == 2


def test_clipped_and_linear_lookups_of_one_axis_are_two_searches():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("A", x), b.lookup("B", x))
    parameters = ParameterSet([Curve("A", SPEED, np.ones(3)), Curve("B", SPEED, np.ones(3), extrapolation="linear")])
    lowered = lower_lookups(b.finish({"y": y}), parameters)
    positions = {node.payload for node in lowered.graph.nodes if node.op == "position"}
    assert positions == {AxisRef(0, "clip"), AxisRef(0, "linear")}


def test_a_value_block_is_searched_by_position():
    b = GraphBuilder()
    y = b.lookup("B", b.input("i"))
    lowered = lower_lookups(b.finish({"y": y}), ParameterSet([Block("B", [5.0, 6.0, 9.0])]))
    assert lowered.axes[0].tolist() == [0.0, 1.0, 2.0]


def test_shapes_are_those_of_the_tables_looked_up():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("K"), b.lookup("Q", x, x, x))
    cube = Cube("Q", [[0, 1], [0, 1, 2], [0]], np.zeros((2, 3, 1)))
    lowered = lower_lookups(b.finish({"y": y}), ParameterSet([Scalar("K", 1), Scalar("unused", 1), cube]))
    assert dict(lowered.shapes) == {"K": (), "Q": (2, 3, 1)}


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_wrong_number_of_coordinates_is_an_error(count):
    b = GraphBuilder()
    y = b.lookup("M", *[b.input("x")] * count)
    with pytest.raises(ArgumentError, match=f"looks up M with {count} coordinates, but it has 2 axes"):
        lower_lookups(b.finish({"y": y}), ParameterSet([Map("M", SPEED, SPEED, np.zeros((3, 3)))]))


def test_a_table_used_with_two_numbers_of_coordinates_is_an_error():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("M", x), b.lookup("M", x, x))
    with pytest.raises(ArgumentError, match="looks up M with 1 coordinates, but it has 2 axes"):
        lower_lookups(b.finish({"y": y}), ParameterSet([Map("M", SPEED, SPEED, np.zeros((3, 3)))]))


def test_a_parameter_that_is_missing_is_an_error():
    b = GraphBuilder()
    with pytest.raises(ArgumentError, match="looks up K, which is not in the parameter set"):
        lower_lookups(b.finish({"y": b.lookup("K")}), ParameterSet())


def chain():
    """An outer curve over an inner one, and one over the memory of the inner one."""
    b = GraphBuilder()
    inner = b.lookup("Inner", b.input("x"))
    outer = b.lookup("Outer", inner)
    late = b.lookup("Late", b.prev(inner, b.const(0.0)))
    names = {"y": b.call("add", outer, late)}
    tables = [Curve(name, SPEED, [0.0, 1.0, 2.0]) for name in ("Inner", "Outer", "Late")]
    return b.finish(names), ParameterSet(tables)


def test_only_lookups_behind_a_smooth_parameter_are_smoothed():
    graph, parameters = chain()
    smoothed = {
        node.payload.name: node.payload.smoothed
        for node in lower_lookups(graph, parameters, smooth=["Inner"]).graph.nodes
        if node.op == "interpolate"
    }
    assert smoothed == {"Inner": (False,), "Outer": (True,), "Late": (False,)}


def test_a_smoothed_lookup_takes_the_coordinate_itself():
    graph, parameters = chain()
    lowered = lower_lookups(graph, parameters, smooth=["Inner"]).graph
    (outer,) = (n for n in lowered.nodes if n.op == "interpolate" and n.payload.name == "Outer")
    assert lowered.nodes[outer.args[0]].op == "interpolate"


def test_an_axis_of_one_breakpoint_is_never_smoothed():
    b = GraphBuilder()
    y = b.lookup("Outer", b.lookup("K"))
    parameters = ParameterSet([Scalar("K", 1.0), Curve("Outer", [1.0], [2.0])])
    lowered = lower_lookups(b.finish({"y": y}), parameters, smooth=["K"]).graph
    assert lowered.nodes[-1].payload.smoothed == (False,)


def test_rewrite_folds_new_constants():
    b = GraphBuilder()
    y = b.call("add", b.call("sin", b.input("x")), b.prev(b.input("x"), b.const(0.0)))
    graph = b.finish({"y": y})

    def zero_input(builder, at, args):
        op, _, payload = graph.nodes[at]
        if op == "input":
            return builder.const(0.0)
        return builder.call(op, *args) if args else builder.node(op, args, payload)

    rewritten = rewrite(graph, zero_input)
    assert ops(rewritten) == ["state", "const"]
    assert len(rewritten.states) == 1


def test_rewrite_keeps_names_units_and_outputs():
    b = GraphBuilder()
    x = b.input("x")
    graph = b.finish({"a": x, "y": b.call("sin", x)}, units={"x": "rpm"}, outputs=("a",))
    again = rewrite(graph, lambda builder, at, args: builder.node(graph.nodes[at].op, args, graph.nodes[at].payload))
    assert again == graph


def test_dependence_reaches_through_memory_only_if_asked():
    graph, _ = chain()

    def source(node):
        return node.op == "lookup" and node.payload == "Inner"

    late = next(i for i, n in enumerate(graph.nodes) if n.op == "lookup" and n.payload == "Late")
    assert late in dependents(graph, source)
    assert late not in dependents(graph, source, through_states=False)


def test_dependence_passes_from_state_to_state_and_from_first_values():
    b = GraphBuilder()
    far = b.prev(b.prev(b.prev(b.input("x"), b.lookup("K")), b.const(0.0)), b.const(0.0))
    other = b.prev(b.input("x"), b.const(0.0))
    graph = b.finish({"far": far, "other": other})
    live = dependents(graph, lambda node: node.op == "lookup")
    assert graph.names["far"] in live
    assert graph.names["other"] not in live
