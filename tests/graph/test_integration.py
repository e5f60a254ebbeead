"""Solvers on graphs: their order, limits, and what is constant within a step."""

import math

import numpy as np
import pytest

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.integration import SOLVERS, apply_solver, is_continuous, without_idle_holds
from kennfeld.graph.interpreter import evaluate
from tests.clocks import even_clock

NO_LIMITS = (-math.inf, math.inf)


def integral(builder, slope, init=0.0, limits=NO_LIMITS):
    """A continuous state; `slope` is called with its node."""
    x = builder.state()
    low, high = map(builder.const, limits)
    builder.close(x, builder.const(init), builder.node("advance", (x, slope(x), low, high)))
    return x


def run(graph: Graph, step: float, samples: int, **columns):
    return evaluate(graph, {**columns, **even_clock(step, samples)}, ParameterSet())


@pytest.mark.parametrize(("solver", "order"), list(zip(SOLVERS, (1, 2, 3, 4, 5, 8), strict=True)))
def test_a_solver_has_its_order_in_states_and_in_time(solver, order):
    b = GraphBuilder()
    # x' = x cos t, whose solution is exp(sin t)
    x = integral(b, lambda x: b.call("mul", x, b.call("cos", b.input("t"))), 1.0)
    graph = apply_solver(b.finish({"x": x}), solver)
    exact, steps = math.exp(math.sin(2.0)), (6, 12) if order > 5 else (20, 40)
    errors = [abs(run(graph, 2 / count, count + 1)["x"][-1] - exact) for count in steps]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_rows_of_a_method_sum_to_its_nodes(solver):
    method = SOLVERS[solver]
    np.testing.assert_allclose([sum(row) for row in method.rows], method.nodes, rtol=1e-14, atol=1e-15)
    assert sum(method.weights) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_state_rests_at_its_limit_and_leaves_it_when_its_slope_turns(solver):
    b = GraphBuilder()
    graph = apply_solver(b.finish({"x": integral(b, lambda x: b.input("u"), limits=(-0.5, 1.0))}), solver)
    u = np.repeat([1.0, -1.0], 20)
    np.testing.assert_allclose(
        run(graph, 0.1, 40, u=u)["x"][[5, 15, 20, 25, 39]], [0.5, 1.0, 1.0, 0.5, -0.5], atol=1e-12
    )


def held_decay(depth: int) -> Graph:
    """Decay whose derivative, -hold(... hold(x)), is constant within a step."""
    b = GraphBuilder()

    def slope(x):
        for _ in range(depth):
            x = b.node("hold", (x,))
        return b.call("neg", x)

    return b.finish({"x": integral(b, slope, 1.0)})


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_a_held_value_is_constant_within_a_step(depth):
    graph = apply_solver(held_decay(depth), "ode4")
    np.testing.assert_allclose(run(graph, 0.1, 9)["x"], 0.9 ** np.arange(9), rtol=1e-14)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_one_mark_is_kept_of_several_in_a_row(depth):
    marked = held_decay(depth)
    kept = without_idle_holds(marked)
    assert sum(node.op == "hold" for node in kept.nodes) == 1
    assert apply_solver(kept, "ode4") == apply_solver(marked, "ode4")


def test_a_mark_on_what_does_not_move_within_a_step_is_dropped():
    b = GraphBuilder()
    u = b.node("hold", (b.call("sin", b.input("u")),))
    x = integral(b, lambda x: b.call("sub", u, x))
    y = b.node("hold", (b.call("mul", x, u),))
    graph = b.finish({"x": x, "y": y})
    kept = without_idle_holds(graph)
    assert not any(node.op == "hold" for node in kept.nodes)
    assert apply_solver(kept, "ode5") == apply_solver(graph, "ode5")


def test_a_graph_without_continuous_states_stays_as_it_is():
    b = GraphBuilder()
    graph = b.finish({"y": b.prev(b.input("u"), b.const(0.0))})
    assert not is_continuous(graph)
    assert apply_solver(graph, "ode4") == graph


def test_a_state_may_begin_a_step_from_another_value():
    b = GraphBuilder()
    x = b.state()
    seen = b.call("select", b.input("r"), b.const(0.0), x)
    b.close(x, b.const(1.0), b.node("advance", (seen, b.const(1.0), b.const(-math.inf), b.const(math.inf))))
    values = run(apply_solver(b.finish({"x": seen}), "ode3"), 0.5, 5, r=np.array([0.0, 0.0, 1.0, 0.0, 0.0]))["x"]
    np.testing.assert_allclose(values, [1.0, 1.5, 0.0, 0.5, 1.0], atol=1e-15)


def test_a_graph_without_marks_stays_as_it_is():
    b = GraphBuilder()
    x = b.state()
    b.close(x, b.const(1.0), b.call("mul", x, b.input("u")))
    graph = b.finish({"x": x})
    assert apply_solver(graph, "ode4") is graph
    assert without_idle_holds(graph) is graph
