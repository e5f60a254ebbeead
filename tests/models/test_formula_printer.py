"""Graph to text and back."""

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import OPERATIONS, Graph, GraphBuilder
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula, to_text
from kennfeld.models.formula.printer import merge_equal_states
from tests.draws import few_or_many
from tests.models.formula_graphs import graphs, one_nan


def lines(graph: Graph) -> list[str]:
    """The node lines of the text of a graph."""
    return [line for line in to_text(graph).splitlines() if "=" in line]


def printed(text: str) -> list[str]:
    return lines(formula(text).graph)


@few_or_many(graphs(), few=12, many=200)
def test_every_graph_is_printed_as_text_that_reads_back_to_it(graph):
    assert one_nan(formula(to_text(graph)).graph) == one_nan(merge_equal_states(graph))


@pytest.mark.slow
@few_or_many(graphs(), few=15, many=100)
def test_text_that_was_printed_prints_alike(graph):
    text = to_text(graph, step=0.01)
    model = formula(text)
    assert to_text(model.graph, model.step) == text


@few_or_many(graphs(), few=15, many=100)
def test_making_equal_memories_one_keeps_the_others(graph):
    once = merge_equal_states(graph)
    assert len(set(once.states)) == len(once.states)
    assert one_nan(merge_equal_states(once)) == one_nan(once)
    assert (once.names.keys(), once.outputs, once.units) == (graph.names.keys(), graph.outputs, graph.units)


@pytest.mark.parametrize(
    "text",
    [
        "y = a + b * c",
        "y = (a + b) * c",
        "y = a - (b - c)",
        "y = a - b - c",
        "y = a / (b * c)",
        "y = a ^ b ^ c",
        "y = (a ^ b) ^ c",
        "y = (-a) ^ b",
        "y = -a ^ b",
        "y = a ^ (-b)",
        "y = -(-a)",
        "y = -a * b",
        "y = a * (-b)",
        "y = -(a * b)",
        "y = a - (-b)",
        "y = a + (-2)",
        "y = -2 * a",
        "y = (-2) ^ a",
        "y = a ^ (-2)",
        "y = max(-2, a)",
        "y = (a < b) < c",
        "y = a + b < c and not a or b",
        "y = not (a and b)",
        "y = not (not a)",
        "y = (not a) + b",
        "y = (not a) == b",
        "y = not a == b",
        "y = a and (b or c)",
        "y = if(a > 0, M(a, b), %min%(c))",
        "y = a * inf + nan",
        "y = a + (-inf)",
        "y = 1e+300 * a + 5e-324",
        "y = prev(a, 0) + delay(a, 3, b)",
        "y = prev(y + a, 0)",
        "y = delay(prev(y, 1) + a, 2, 0)",
        "y = %two words% * %50%% load% * %pi%",
        "y = t * dt",
        "%_a% = b + 1",
        "y = a",
        "y = 3",
        "y = prev(a, 0)",
    ],
)
def test_text_is_printed_as_one_would_write_it(text):
    assert printed(text) == [text]


def test_a_node_with_two_names_is_printed_once():
    assert printed("a = u * 2\nb = u * 2\nc = b + u") == ["a = u * 2", "b = a", "c = a + u"]


def test_inner_nodes_that_are_used_twice_get_names():
    assert printed("y = sin(u * v) + cos(u * v)") == ["_y_1 = u * v", "y = sin(_y_1) + cos(_y_1)"]


def test_auxiliary_names_avoid_those_that_are_taken():
    assert printed("y = sin(%_y_1% * v) + cos(%_y_1% * v)") == [
        "_y_2 = %_y_1% * v",
        "y = sin(_y_2) + cos(_y_2)",
    ]


def test_feedback_is_printed_through_a_name():
    assert printed("y = PT1(u, 3)") == ["_y_1 = prev(y, u)", "y = _y_1 + dt / (3 + dt) * (u - _y_1)"]


def test_a_text_is_complete_by_itself():
    text = (
        "step 0.01\ninput n[1/min]\nscalar K\ncurve C\nmap %a map%[Nm]\ncube Q\ncube R\noutput y\n\n"
        "z[W] = K * C(n) + %a map%(n, t)\ny = z - Q(n, n, n) + R(n, n, n, n)\n"
    )
    model = formula(text)
    assert to_text(model.graph, model.step) == text.replace("\n\n", "\n")


def test_every_operation_but_the_guard_can_be_printed():
    b = GraphBuilder()
    inputs = [b.input(name) for name in "abc"]
    names = {f"y_{op}": b.call(op, *inputs[: o.arity]) for op, o in OPERATIONS.items() if op != "guard"}
    graph = b.finish(names)
    assert formula(to_text(graph)).graph == graph


def test_a_long_sum_is_printed_in_one_line():
    graph = formula("y = " + " + ".join(["a"] * 1500)).graph
    assert len(lines(graph)) == 1
    assert formula(to_text(graph)).graph == graph


@pytest.mark.parametrize(
    ("op", "turned"),
    [
        ("sub", True),
        ("min", False),
        ("neg", False),
        *(pytest.param("pow", turned, marks=pytest.mark.slow) for turned in (True, False)),
    ],
)
def test_deep_nesting_is_broken_into_lines(op, turned):
    b = GraphBuilder()
    u = node = b.input("u")
    for _ in range(2000):
        args = (node,) if op == "neg" else (u, node) if turned else (node, u)
        node = b.call(op, *args)
    graph = b.finish({"y": node})
    assert len(lines(graph)) > 5
    assert formula(to_text(graph)).graph == graph


def test_a_long_chain_of_memories_is_printed():
    b = GraphBuilder()
    node, zero = b.input("u"), b.const(0.0)
    for _ in range(2000):
        node = b.prev(node, zero)
    graph = b.finish({"y": node})
    assert formula(to_text(graph)).graph == graph


def test_memories_of_equal_content_are_printed_as_one():
    b = GraphBuilder()
    u, zero = b.input("u"), b.const(0.0)
    states = [b.state() for _ in range(4)]
    for state, next_ in zip(states, [u, u, states[0], states[1]], strict=True):
        b.close(state, zero, next_)
    graph = b.finish({"y": b.call("mul", states[2], states[3])})
    text = to_text(graph)
    assert lines(graph) == ["_y_1 = prev(prev(u, 0), 0)", "y = _y_1 * _y_1"]
    values = {"u": np.array([1.0, 2.0, 3.0, 4.0])}
    again = evaluate(formula(text).graph, values, ParameterSet())["y"]
    np.testing.assert_array_equal(again, evaluate(graph, values, ParameterSet())["y"])


def refused(graph: Graph) -> str:
    with pytest.raises(ArgumentError) as caught:
        to_text(graph)
    return str(caught.value)


def test_nodes_that_text_cannot_express_are_refused():
    b = GraphBuilder()
    u, v = b.input("u"), b.input("v")
    y = b.call("mul", u, v)
    assert "guard" in refused(b.finish({"y": b.call("guard", u, v)}))
    assert "'u' is a node and an input" in refused(b.finish({"u": y}))
    assert "'u' is an input and a parameter" in refused(b.finish({"y": b.call("add", u, b.lookup("u"))}))
    assert "the name '' is empty" in refused(b.finish({"": y}))
    assert "'a\\nb'" in refused(b.finish({"a\nb": y}))
    assert "the unit 'a]' of y" in refused(b.finish({"y": y}, {"y": "a]"}))
    both = b.call("add", b.lookup("M", u), b.lookup("M", u, v))
    assert "'M' is looked up with 1 and with 2 coordinates" in refused(b.finish({"y": both}))


def test_an_expansion_is_printed_with_its_declaration():
    b = GraphBuilder()
    x = [b.input(name) for name in "abcdef"]
    graph = b.finish({"y": b.lookup("Engine", *x)})
    text = to_text(graph)
    assert "rbf Engine" in text
    assert formula(text).graph == graph
