import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.graph import CLOCK, Graph, GraphBuilder, Node, State
from kennfeld.graph.traversal import rewrite
from tests.draws import few_or_many
from tests.graph.random_graphs import cases


def built(order=("u", "v")):
    b = GraphBuilder()
    inputs = {name: b.input(name) for name in order}
    total = b.call("add", inputs["u"], b.call("mul", inputs["v"], b.lookup("K")))
    return b.finish({"y": total})


def test_equal_nodes_are_one():
    b = GraphBuilder()
    x = b.input("x")
    assert b.call("sin", x) == b.call("sin", x)
    assert b.lookup("M", x, x) == b.lookup("M", x, x)
    assert b.const(0.1) == b.const(0.1)
    assert b.lookup("K") != b.lookup("L")


def test_plus_and_minus_zero_are_two_constants():
    b = GraphBuilder()
    assert b.const(0.0) != b.const(-0.0)


def test_not_a_number_is_one_constant():
    b = GraphBuilder()
    assert b.const(float("nan")) == b.const(float("nan"))


def test_an_operation_on_constants_is_a_constant():
    b = GraphBuilder()
    folded = b.call("add", b.const(2.0), b.call("mul", b.const(3.0), b.const(4.0)))
    assert b.nodes[folded] == Node("const", (), 14.0)


def test_a_folded_operation_may_give_what_is_not_finite():
    b = GraphBuilder()
    assert b.nodes[b.call("div", b.const(1.0), b.const(0.0))].payload == np.inf
    assert np.isnan(b.nodes[b.call("log", b.const(-1.0))].payload)


@pytest.mark.parametrize(
    ("op", "constant", "operand", "right"),
    [
        ("add", 0.0, True, True),
        ("sub", 0.0, False, True),
        ("mul", 1.0, True, True),
        ("guard", 1.0, True, True),
        ("div", 1.0, False, True),
        ("pow", 1.0, False, True),
    ],
)
def test_a_neutral_constant_leaves_the_other_operand(op, constant, operand, right):
    b = GraphBuilder()
    x = b.input("x")
    assert (b.call(op, x, b.const(constant)) == x) == right
    assert (b.call(op, b.const(constant), x) == x) == operand


def test_zero_times_a_node_is_not_folded_as_the_node_may_be_infinite():
    b = GraphBuilder()
    x = b.input("x")
    assert b.nodes[b.call("mul", b.const(0.0), x)].op == "mul"


def test_equal_memories_by_prev_are_one():
    b = GraphBuilder()
    x = b.input("x")
    assert b.prev(x, b.const(0.0)) == b.prev(x, b.const(0.0))
    assert b.prev(x, b.const(0.0), 2) != b.prev(x, b.const(0.0))
    assert len(b.states) == 2


def test_a_builder_of_a_graph_keeps_node_numbers():
    graph = built()
    b = GraphBuilder.of(graph)
    assert tuple(b.nodes) == graph.nodes
    assert b.lookup("K") == graph.nodes.index(Node("lookup", (), "K"))


def test_graphs_built_alike_are_equal():
    assert built() == built()


def test_graphs_built_in_another_order_are_equal():
    assert built(("u", "v")) == built(("v", "u"))


def test_graphs_with_a_nan_constant_are_equal():
    def graph():
        b = GraphBuilder()
        return b.finish({"y": b.call("add", b.input("x"), b.call("log", b.const(-1.0)))})

    assert graph() == graph()


def test_finish_drops_unused_nodes():
    b = GraphBuilder()
    x = b.input("x")
    b.call("sin", x)
    b.prev(b.input("z"), x)
    graph = b.finish({"y": b.call("cos", x)})
    assert [node.op for node in graph.nodes] == ["input", "cos"]
    assert graph.states == ()


def test_finish_keeps_nodes_of_states_and_renumbers_states():
    b = GraphBuilder()
    b.prev(b.input("unused"), b.const(1.0))
    y = b.prev(b.prev(b.input("x"), b.const(2.0)), b.input("start"), 3)
    graph = b.finish({"y": y})
    assert graph.inputs == ("start", "x")
    assert [state.latency for state in graph.states] == [3, 1]
    assert [node.payload for node in graph.nodes if node.op == "state"] == [0, 1]


def test_arguments_come_before_their_node():
    b = GraphBuilder()
    y = b.input("x")
    for _ in range(3000):
        y = b.call("sin", y)
    graph = b.finish({"y": y})
    assert all(a < at for at, node in enumerate(graph.nodes) for a in node.args)


def test_outputs_are_the_names_that_nothing_uses():
    b = GraphBuilder()
    x = b.call("sin", b.input("x"))
    cosine = b.call("cos", x)
    graph = b.finish({"x": x, "held": cosine, "y": b.call("add", x, b.prev(cosine, b.const(0.0)))})
    assert graph.outputs == ("y",)


@st.composite
def feedback(draw):
    """A graph of names that use earlier names, and any name of the step before; and what each uses."""
    b = GraphBuilder()
    count = draw(st.integers(1, 7))
    some = st.sets(st.integers(0, count - 1), max_size=3)
    read = [b.state() for _ in range(count)]
    states, uses = [], []
    for name in range(count):
        now, before = draw(some), draw(some)
        node = b.lookup(f"K{name}")
        for used in [states[i] for i in now if i < name] + [read[i] for i in before]:
            node = b.call("add", node, used)
        states.append(node)
        uses.append({i for i in now if i < name} | before)
    for state, node in zip(read, states, strict=True):
        b.close(state, b.const(0.0), node)
    return b.finish({f"y{i}": node for i, node in enumerate(states)}), uses


@few_or_many(feedback(), few=10, many=100)
def test_a_name_is_an_output_if_all_that_use_it_are_what_it_uses_itself(case):
    graph, uses = case
    needs = [set(used) for used in uses]
    for _ in uses:
        needs = [used.union(*(needs[i] for i in used)) for used in needs]
    expected = [
        f"y{i}"
        for i in range(len(uses))
        if all(user in needs[i] for user in range(len(uses)) if i in uses[user] - {user})
    ]
    assert graph.outputs == tuple(expected)


def test_declared_outputs_are_kept():
    b = GraphBuilder()
    x = b.input("x")
    assert b.finish({"a": x, "y": b.call("sin", x)}, outputs=("a",)).outputs == ("a",)


def test_inputs_leave_out_the_clock():
    b = GraphBuilder()
    total = b.input("x")
    for name in CLOCK:
        total = b.call("add", total, b.input(name))
    assert b.finish({"y": total}).inputs == ("x",)


def test_parameters_tell_their_number_of_coordinates():
    b = GraphBuilder()
    x = b.input("x")
    y = b.call("add", b.lookup("K"), b.lookup("M", x, x))
    assert b.finish({"y": y}).parameters == {"K": 0, "M": 2}


def test_a_graph_cannot_be_changed():
    graph = built()
    with pytest.raises(AttributeError):
        graph.nodes = ()
    with pytest.raises(TypeError):
        graph.names["z"] = 0


def test_units_belong_to_the_graph():
    b = GraphBuilder()
    assert b.finish({"y": b.input("x")}, units={"x": "rpm"}).units == {"x": "rpm"}


@few_or_many(cases(), few=10, many=40)
def test_numbers_are_canonical(case):
    def again(b, at, args):
        op, _, payload = case.graph.nodes[at]
        return b.node(op, args, payload)

    assert rewrite(case.graph, again) == case.graph
    assert len(set(case.graph.nodes)) == len(case.graph.nodes)


def test_a_state_reads_like_its_fields():
    assert State(1, 2) == State(init=1, next=2, latency=1)


def test_a_graph_of_no_names_is_empty():
    assert GraphBuilder().finish({}) == Graph((), {}, (), {}, ())


def test_a_condition_compared_with_0_or_joined_with_a_neutral_constant_is_itself():
    b = GraphBuilder()
    x, zero, one = b.input("x"), b.const(0.0), b.const(1.0)
    for condition in (b.call("lt", x, one), b.call("not", x), b.node("hold", (b.call("eq", x, one),))):
        same = [b.call("ne", condition, zero), b.call("gt", condition, zero)]
        same += [b.call("and", condition, one), b.call("and", one, condition), b.call("or", zero, condition)]
        assert set(same) == {condition}
    for op, args in (("ne", (x, zero)), ("and", (x, one)), ("or", (zero, x)), ("gt", (b.call("lt", x, one), one))):
        assert b.nodes[b.call(op, *args)].op == op
