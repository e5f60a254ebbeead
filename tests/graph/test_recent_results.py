import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.recent_results import RECENT, SMALL, kept_for_small_graphs
from kennfeld.models.formula import formula


def constant(value):
    b = GraphBuilder()
    return b.finish({"y": b.const(value)})


def counted():
    calls = []

    @kept_for_small_graphs
    def size(graph, names=()):
        calls.append(graph)
        return len(graph.nodes)

    return calls, size


def test_the_result_of_an_equal_graph_is_kept():
    calls, size = counted()
    assert size(constant(2.0)) == size(constant(2.0)) == 1
    assert len(calls) == 1


def test_other_arguments_have_a_result_of_their_own():
    calls, size = counted()
    size(constant(2.0), ("a",)), size(constant(2.0), ("b",)), size(constant(2.0), names=("a",))
    assert len(calls) == 3


def test_zeros_of_both_signs_are_different_constants():
    calls, size = counted()
    size(constant(0.0)), size(constant(-0.0))
    assert [np.signbit(graph.nodes[0].payload) for graph in calls] == [False, True]


def test_large_graphs_are_not_kept():
    calls, size = counted()
    text = "\n".join(f"y{i} = x + {i}" for i in range(SMALL))
    large = formula(text).graph
    size(large), size(large)
    assert len(calls) == 2


def test_only_the_last_results_are_kept():
    calls, size = counted()
    for value in range(RECENT + 1):
        size(constant(float(value)))
    size(constant(0.0))
    assert len(calls) == RECENT + 2


def test_equal_graphs_share_their_derivatives():
    first = formula("y = a * x", parameters=["a"]).graph
    line = differentiate(first, [first.names["y"]], ["a"])
    again = formula("y = a * x", parameters=["a"]).graph
    assert differentiate(again, [again.names["y"]], ["a"]) is line
