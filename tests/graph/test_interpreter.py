"""The first values of states, as the reference interpreter finds them."""

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import GraphBuilder
from kennfeld.graph.interpreter import Interpreter, evaluate

NOTHING = ParameterSet()


def chain(count, backwards):
    """States that start each at the next plus one, the last at u, and fall by half in a step."""
    b = GraphBuilder()
    states = [b.state() for _ in range(count)]
    order = states[::-1] if backwards else states
    for one, other in zip(order, [*order[1:], None], strict=True):
        first = b.input("u") if other is None else b.call("add", other, b.const(1.0))
        b.close(one, first, b.call("mul", one, b.const(0.5)))
    return b.finish({"y": order[0]}, {}, ("y",))


@pytest.mark.parametrize("backwards", [False, True])
def test_states_start_from_others_in_any_order(backwards):
    outputs = evaluate(chain(6, backwards), {"u": [2.0, 9.0, 4.0]}, NOTHING, starts=(0, 2))
    np.testing.assert_array_equal(outputs["y"], [7.0, 3.5, 9.0])


def test_each_node_is_computed_once_for_the_first_values_of_many_states(monkeypatch):
    graph = chain(300, backwards=True)
    computed = []
    node = Interpreter._node

    def counted(self, *args):
        computed.append(args[0])
        return node(self, *args)

    monkeypatch.setattr(Interpreter, "_node", counted)
    assert evaluate(graph, {"u": [2.0]}, NOTHING)["y"] == 301.0
    assert len(computed) < 2 * len(graph.nodes)


@pytest.mark.parametrize(("u", "first"), [(1.0, 3.0), (-1.0, np.nan)])
def test_a_circular_first_value_is_missing_only_on_the_circular_branch(u, first):
    b = GraphBuilder()
    one, other = b.state(), b.state()
    b.close(one, other, b.const(5.0))
    b.close(other, b.call("select", b.call("gt", b.input("u"), b.const(0.0)), b.const(3.0), one), b.const(5.0))
    outputs = evaluate(b.finish({"y": one}, {}, ("y",)), {"u": [u, u]}, NOTHING)
    np.testing.assert_array_equal(outputs["y"], [first, 5.0])
