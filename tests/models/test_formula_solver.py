"""The solver that a text declares, and what its stages evaluate again."""

import math

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.integration import SOLVERS
from kennfeld.graph.interpreter import Interpreter, evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.models.formula import formula, to_text
from tests.clocks import even_clock
from tests.models.formula_graphs import one_nan

T = 0.1
U = np.array([1.5, -2.0, 0.25, 4.0, 4.0, -1.0, 0.0, 7.5, 3.0, -3.5])
TIME = T * np.arange(U.size)


def run(model, **scalars):
    columns = {"u": U, **even_clock(T, U.size)}
    return evaluate(model.graph, columns, ParameterSet([Scalar(name, value) for name, value in scalars.items()]))


def integrated(solver, slope, x):
    """The states at each sample; `slope(t, x, k)` is the derivative within step k."""
    tableau, rows = SOLVERS[solver], []
    x = np.array(x, dtype=float)
    for k, t in enumerate(TIME):
        rows.append(x)
        stages = []
        for node, row in zip(tableau.nodes, tableau.rows, strict=True):
            inner = x + T * sum((a * s for a, s in zip(row, stages, strict=False)), np.zeros_like(x))
            stages.append(np.array(slope(t + node * T, inner, k), dtype=float))
        x = x + T * sum(w * s for w, s in zip(tableau.weights, stages, strict=True))
    return np.array(rows).T


@pytest.mark.parametrize("solver", SOLVERS)
def test_integrators_are_advanced_together_by_the_declared_solver(solver):
    model = formula(f"solver {solver}\nx = integrator(v, 1)\nv = integrator(u - k * x - 0.3 * v + sin(t))\nscalar k")
    outputs = run(model, k=2.0)
    expected = integrated(solver, lambda t, y, k: (y[1], U[k] - 2 * y[0] - 0.3 * y[1] + math.sin(t)), (1.0, 0.0))
    np.testing.assert_allclose([outputs["x"], outputs["v"]], expected, rtol=1e-13, atol=1e-13)
    assert (model.solver, len(model.equations.states)) == (solver, 2)


def test_without_a_declaration_an_integrator_is_a_sum():
    text = "x = integrator(u - x, 1, -2, 3)"
    model = formula(text)
    assert (model.solver, model.equations) == ("", None)
    np.testing.assert_array_equal(run(model)["x"], run(formula(f"solver ode1\n{text}"))["x"])


@pytest.mark.parametrize("solver", ["", "solver ode1\n", "solver ode4\n"])
def test_an_integrator_starts_each_step_from_the_value_that_is_named(solver):
    model = formula(f"{solver}x = if(u > 3.5, 0, integrator(1, 5, -inf, inf, x))")
    expected = np.array([5.0, 5.1, 5.2, 0.0, 0.0, 0.1, 0.2, 0.0, 0.1, 0.2])
    np.testing.assert_allclose(run(model)["x"], expected, atol=1e-14)


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_stage_of_a_solver_sees_a_state_beyond_its_limits(solver):
    outputs = run(formula(f"solver {solver}\nx = integrator(20 * u, 0, -1, 0.5)\ny = integrator(x * x * x)"))

    def slope(t, state, k):
        x, way = np.clip(state[0], -1, 0.5), 20 * U[k]
        return (0.0 if (x == -1 and way < 0) or (x == 0.5 and way > 0) else way, x**3)

    tableau, x, y, rows = SOLVERS[solver], 0.0, 0.0, []
    for k, t in enumerate(TIME):
        rows.append((x, y))
        stages = []
        for node, row in zip(tableau.nodes, tableau.rows, strict=True):
            inner = [s + T * sum(a * r[i] for a, r in zip(row, stages, strict=False)) for i, s in enumerate((x, y))]
            stages.append(slope(t + node * T, inner, k))
        total = [T * sum(w * r[i] for w, r in zip(tableau.weights, stages, strict=True)) for i in range(2)]
        x, y = float(np.clip(x + total[0], -1, 0.5)), y + total[1]
    np.testing.assert_allclose([outputs["x"], outputs["y"]], np.array(rows).T, rtol=1e-12, atol=1e-13)


def test_memory_and_inputs_are_constant_within_a_step_and_so_is_what_is_sampled():
    model = formula(
        "solver ode4\nx = integrator(prev(u) - sampled(x) - PT1(x, 0.5) + prev(x, 2), 1)\n"
        "lag = PT1(x, 0.5)\nback = prev(x, 2)"
    )
    outputs = run(model)
    rates = np.concatenate([[0.0], U[:-1]]) - outputs["x"] - outputs["lag"] + outputs["back"]
    np.testing.assert_allclose(np.diff(outputs["x"]), T * rates[:-1], rtol=1e-13)


def test_sampled_changes_nothing_without_a_solver():
    assert formula("y = sampled(u) + 1").graph == formula("y = u + 1").graph
    assert formula("solver ode2\ny = sampled(u) + sampled(2)").graph == formula("y = u + 2").graph


@pytest.mark.parametrize("solver", SOLVERS)
def test_derivatives_pass_through_a_solver(solver):
    model = formula(f"solver {solver}\nx = integrator(u - k * x * x, 1, -1, 2)\nscalar k")
    values = ParameterSet([Scalar("k", 0.7)])
    columns = {"u": U, **even_clock(T, U.size)}
    lowered = lower_lookups(model.graph, values)
    line = differentiate(lowered.graph, [lowered.graph.names["x"]], ("k",))
    exact = Interpreter(lowered, values).rows(line, {"k": 0}, columns).jacobian[:, 0, 0]
    differences = (run(model, k=0.7 + 1e-6)["x"] - run(model, k=0.7 - 1e-6)["x"]) / 2e-6
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)
    assert np.abs(exact).max() > 0.1


@pytest.mark.parametrize(
    "body",
    [
        "x = integrator(u)",
        "x = integrator(u - x, k)",
        "x = integrator(u, 0, -1)",
        "x = integrator(u, 0, -inf, k)",
        "x = integrator(v, 1)\nv = integrator(u - x)",
        "x = if(u > 1, 2, integrator(u, 0, -1, 1, x))",
        "y = integrator(sampled(sin(t)) * y + hidden(y) * integrator(2 * y + t))",
        "y = prev(x) + x\nx = integrator(x * x + y)",
    ],
)
def test_text_with_a_solver_is_printed_as_it_is_read(body):
    model = formula(f"step 0.1\nsolver ode3\n{body}")
    text = to_text(model.equations, model.step, solver=model.solver)
    assert "step 0.1\nsolver ode3\n" in text
    again = formula(text)
    assert one_nan(again.graph) == one_nan(model.graph)
    assert to_text(again.equations, again.step, solver=again.solver) == text


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("solver ode45\ny = u", "line 1, column 8: solver must be one of ode1, ode2, ode3, ode4, ode5, ode8"),
        ("solver %ode4%\ny = u", "line 1, column 8: solver must be one of"),
        ("solver ode4 0.1\ny = u", "solver must be one of"),
        ("solver ode4\nsolver ode3\ny = u", "line 2, column 1: duplicate solver, first in formula line 1. Remove one."),
    ],
)
def test_a_wrong_solver_is_answered_with_place_and_remedy(text, remedy):
    with pytest.raises(InputError) as caught:
        formula(text)
    assert remedy in str(caught.value)


def test_solver_may_still_be_the_name_of_a_node():
    assert formula("solver = u + 1\ny = solver * 2").graph.outputs == ("y",)


def test_continuous_states_cannot_be_printed_without_their_solver():
    model = formula("solver ode4\nx = integrator(u)")
    with pytest.raises(ValueError, match="needs a solver"):
        to_text(model.equations)


@pytest.mark.parametrize("limits", ["-b, b", "b", "-inf, b"])
def test_a_limited_start_is_printed_and_read_again_as_it_is(limits):
    equations = formula(f"solver ode2\ny = integrator(u, a, {limits})\nscalar a\nscalar b").equations
    assert formula(to_text(equations, solver="ode2")).equations == equations
