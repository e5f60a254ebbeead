"""Syntax to graph: memories that are one, functions of the text, long texts."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula, lowering


def findings(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        formula(text, "f")
    return [str(finding) for finding in caught.value.findings]


def states(text: str) -> int:
    return len(formula(text).graph.states)


@pytest.mark.parametrize(
    "text",
    [
        "y = prev(u, 0) + prev(u, 0)",
        "y = prev(u) + timeDelay(u, 0) + delay(u, 1)",
        "y = prev(u + v, 0)\nz = prev(u + v, 0) * 2",
        "y = prev(u + v, 0)\nz = prev(w, 0)\nw = u + v",
        "y = prev(y + u, 0) + prev(y + u, 0)",
        "y = integrator(u - y) + integrator(u - y)",
        "y = PT1(u, 2) + PT1(u, 2)",
        "y = PT1(u, 2) + PT1(w, 2)\nw = u",
        "y = derivative(u) + prev(u, u)",
        "def f(a) = PT1(a, 1)\ny = f(u) + f(u)",
        "y = prev(v, 0) - prev(b, 0)\nb = v",
    ],
)
def test_equal_memory_calls_are_one_state(text):
    assert states(text) == 1


def test_equal_calls_within_equal_calls_are_one_state_each():
    assert states("y = prev(prev(u, 1), 2) + prev(a, 2)\na = prev(b, 1)\nb = u") == 2


@pytest.mark.parametrize(
    "text",
    [
        "y = prev(u, 0) + prev(u, 1)",
        "y = prev(u, 0) + prev(v, 0)",
        "y = delay(u, 2) + delay(u, 3)",
        "a = prev(a + u)\nb = prev(b + u)",
    ],
)
def test_different_memory_calls_are_different_states(text):
    assert states(text) == 2


def test_equal_subexpressions_are_one_node():
    assert [node.op for node in formula("y = (u + v) * (u + v)").graph.nodes] == ["input", "input", "add", "mul"]


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("def f(a, b) = a - 2 * b\ny = f(u, v) * f(v, u)", "y = (u - 2 * v) * (v - 2 * u)"),
        ("y = f(u)\ndef f(a) = g(a) + 1\ndef g(a) = a * k\nk = 3 * v", "y = u * (3 * v) + 1\nk = 3 * v"),
        ("def f() = u + 1\ny = f()", "y = u + 1"),
        ("def f(a) = M(a, u)\ny = f(v)", "y = M(v, u)"),
        ("def f(x) = g(x + 1)\ndef g(x) = x * x\ny = f(u)", "y = (u + 1) * (u + 1)"),
        ("def hold(x) = prev(x, 1)\ny = hold(y + u)", "y = prev(y + u, 1)"),
        ("def lag(x, n) = delay(x, n, 0)\ny = lag(u, 1 + 2)", "y = delay(u, 3, 0)"),
    ],
)
def test_functions_of_the_text_are_put_in(text, meant):
    assert formula(text).graph.nodes == formula(meant).graph.nodes
    assert formula(text).graph.states == formula(meant).graph.states


def test_calls_nested_through_many_functions_are_built():
    lines = ["def f0(x) = x + 1", *(f"def f{i}(x) = f{i - 1}(x + 1)" for i in range(1, 1500)), "y = f1499(u)"]
    y = evaluate(formula("\n".join(lines)).graph, {"u": np.array([1.0])}, ParameterSet())["y"]
    assert y == [1501.0]


def test_functions_that_use_an_argument_twice_stay_small():
    lines = ["def f0(x) = x + x", *(f"def f{i}(x) = f{i - 1}(x) + f{i - 1}(x)" for i in range(1, 60)), "y = f59(u)"]
    assert len(formula("\n".join(lines)).graph.nodes) == 61


def test_functions_that_unfold_without_end_are_an_error(monkeypatch):
    monkeypatch.setattr(lowering, "_MAX_EXPANSIONS", 5000)
    lines = ["def f0(x) = x", *(f"def f{i}(x) = f{i - 1}(x * 2) + f{i - 1}(x * 3 + 1)" for i in range(1, 40))]
    messages = findings("\n".join([*lines, "y = f39(u)"]))
    assert "the functions of this text expand to more than 5000 calls" in messages[0]


@pytest.mark.parametrize(
    ("steps", "given"),
    [
        ("0", "0"),
        ("-1", "-1"),
        ("1.5", "1.5"),
        ("inf", "inf"),
        ("nan", "nan"),
        ("u", "an expression that is not constant"),
    ],
)
def test_the_steps_of_a_delay_are_a_constant_whole_number(steps, given):
    text = f"y = delay(u, {steps})"
    message = f"the number of steps of a delay must be a constant integer >= 1, got {given}"
    assert f": {message}" in findings(text)[0]
    assert "column 14" in findings(text)[0]


def test_a_wrong_delay_is_reported_beside_other_findings():
    assert len(findings("y = delay(u, 0)\nz = 3 +")) == 2


def test_a_wrong_line_leads_to_no_further_finding_about_a_delay():
    assert len(findings("n = 3 +\ny = delay(u, n)")) == 1
