"""Order of nodes, and loops."""

import pytest

from kennfeld.base.errors import InputError
from kennfeld.models.formula import formula
from kennfeld.models.formula.lowering import topological_order


def findings(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        formula(text, "loop.kf")
    return [str(finding) for finding in caught.value.findings]


def test_names_come_after_what_they_use():
    assert topological_order({"a": ["b", "c"], "b": ["c"], "c": []}) == (["c", "b", "a"], [])


def test_loops_within_the_names_of_another_are_not_repeated():
    uses = {"a": ["b", "b"], "b": ["c"], "c": ["a", "b", "c"], "d": ["d"]}
    assert topological_order(uses)[1] == [["a", "b", "c", "a"], ["d", "d"]]


def test_a_long_chain_of_nodes_is_ordered():
    lines = [f"a{i} = a{i + 1} + 1" for i in range(1500)]
    graph = formula("\n".join([*lines, "a1500 = u"])).graph
    assert len(graph.names) == 1501


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a = a + 1", "line 1, column 1: algebraic loop: a -> a"),
        ("a = b + 1\nb = 2 * a", "line 1, column 1: algebraic loop: a -> b -> a"),
        ("x = b\nb = c\na = b\nc = M(a)", "line 2, column 1: algebraic loop: b -> c -> a -> b"),
        ("y = PT1(u - y, 1)", "line 1, column 1: algebraic loop: y -> y"),
        ("y = integrator(u, 0) + y", "line 1, column 1: algebraic loop: y -> y"),
        ("def f(a) = a + y\ny = f(u)", "line 2, column 1: algebraic loop: y -> y"),
        ("def f(a) = a + prev(u, 0)\ny = f(y)", "line 2, column 1: algebraic loop: y -> y"),
    ],
)
def test_an_algebraic_loop_is_named(text, shown):
    remedy = "Break it with prev(x, init) to use the value of the previous step."
    assert findings(text) == [f"loop.kf {shown}. {remedy}"]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("y = prev(u, y)", "line 1, column 1: an initial value depends on itself: y -> y"),
        ("y = prev(u, 2 * z)\nz = y + 1", "line 1, column 1: an initial value depends on itself: y -> z -> y"),
        ("y = PT1(u, 1, z)\nz = y + 1", "line 1, column 1: an initial value depends on itself: y -> z -> y"),
        ("def f(a) = prev(u, a)\ny = f(y)", "line 2, column 1: an initial value depends on itself: y -> y"),
    ],
)
def test_a_loop_of_initial_values_is_named(text, shown):
    assert findings(text) == [f"loop.kf {shown}. Use an initial value that does not depend on it."]


def test_functions_that_call_themselves_are_named():
    assert findings("def f(a) = g(a)\ndef g(a) = prev(f(a), 0)\ny = f(u)") == [
        "loop.kf line 1, column 5: a function calls itself: f -> g -> f. Write feedback with prev(x, init)."
    ]


def test_every_loop_of_a_text_is_reported():
    assert len(findings("a = b\nb = a\nc = d\nd = c\ne = prev(u, e)")) == 3


@pytest.mark.parametrize(
    "text",
    [
        "y = prev(y + u, 0)",
        "y = prev(z, 0)\nz = y + u",
        "z = y + u\ny = prev(z, 0)",
        "y = delay(y + u, 3)",
        "y = integrator(u - y)",
        "y = integrator(u, 0, -z, z)\nz = abs(y) + 1",
        "y = prev(w, prev(y, 2))\nw = u + y",
        "y = PT1(u - prev(y), 1)",
        "def hold(x) = prev(x, 0)\ny = hold(y + u)",
        "def twice(x) = hold(hold(x))\ndef hold(x) = prev(x, 0)\ny = twice(y + u)",
    ],
)
def test_feedback_through_memory_is_not_an_algebraic_loop(text):
    assert formula(text).graph.states
