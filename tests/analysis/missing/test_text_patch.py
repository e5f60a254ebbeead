"""Patches of formula text give the function that was fitted, and leave everything else as it was."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.terms import MissingTerm, extended_model
from kennfeld.analysis.missing.text_patch import with_term

TEXT = (
    "# a sensor\r\n1 a[Nm] = M(x) - b  # the base\r\nb = prev(%long name%, 0) + x\r\n"
    "%long name%[-] = if(a > 1, (a\r\n  + 2), b)\r\ny = -a ^ 2\r\n"
    "w = PT1(x, 2)\r\nv = w + 2 * prev(w, 0) + integrator(w)\r\n"
    "2 s[K] = (0.9 * prev(%s%, 1) +\r\n  if(prev(s, 1) > 3, x, 1))  # feeds back\r\nr = s - x\r\n"
)
NAMES = ["M"]


def addition(node, kind, **settings):
    term = MissingTerm(node, kind, **settings)
    return Addition(term, term.parameter("New") if kind != "delay" else None)


TERMS = [
    addition(node, kind, **settings)
    for node in ("a", "b", "long name", "y", "w", "s")
    for kind, settings in (
        ("add", {"channel": "z", "breakpoints": (0.0, 1.0)}),
        ("multiply", {"channel": "n [rpm]", "breakpoints": (0.0, 1.0)}),
        ("lag", {"seconds": 2.0}),
        ("delay", {"steps": 3}),
    )
]


@pytest.mark.parametrize("term", TERMS, ids=lambda each: f"{each.term.kind} {each.term.node}")
def test_the_patched_text_is_the_function_with_the_term(term):
    label = "" if term.parameter is None else "New"
    patched = with_term(TEXT, term)
    expected = extended_model(kf.formula(TEXT, parameters=NAMES), term.term, label)
    model = kf.formula(patched, parameters=[*NAMES, "New"])
    rng = np.random.default_rng(0)
    data = {name: rng.uniform(-1, 1, 40) for name in ("x", "z", "n [rpm]")} | {"time": 0.1 * np.arange(40)}
    data = {name: values for name, values in data.items() if name in model.graph.inputs or name == "time"}
    values = kf.ParameterSet([kf.Curve("M", [-1, 1], [0.5, 2.0])])
    if term.parameter is not None:
        effect = [0.3, 0.7] if term.parameter.axes else [2.0]
        values = values.with_parameters(term.parameter.with_values(effect))
    patched_nodes, corrected = (kf.simulate(each, data, values) for each in (model, expected))
    for name in ("a", "b", "long name", "y", "w", "v", "s", "r"):
        np.testing.assert_array_equal(patched_nodes[name].values, corrected[name].values)


def test_all_other_lines_stay_to_the_byte():
    patched = with_term(TEXT, addition("y", "add", channel="z", breakpoints=(0.0, 1.0)))
    assert patched == TEXT.replace("y = -a ^ 2", "y = -a ^ 2 + New(z)")


def test_comments_and_line_numbers_stay_behind_and_in_front():
    patched = with_term("1 a = b - c  # sum", addition("a", "multiply", channel="x", breakpoints=(0.0, 1.0)))
    assert patched == "1 a = (b - c) * New(x)  # sum"


def test_a_lag_has_a_node_for_its_time_constant():
    assert with_term("y = C(x)\n", addition("y", "lag", seconds=1.0)) == "y = PT1(C(x), T_y)\nT_y[s] = New\n"


def test_new_names_are_declared_in_texts_that_declare_theirs():
    text = "input x\ncurve C\ny = C(x)\n"
    patched = with_term(text, addition("y", "add", channel="z", breakpoints=(0.0, 1.0)), ["x"])
    assert patched == "input x\ncurve C\ny = C(x) + New(z)\ncurve New\ninput z\n"
    assert kf.formula(patched).graph.inputs == ("x", "z")


def test_a_text_without_the_node_has_no_patch():
    assert with_term("y = C(x)\n", addition("z", "lag", seconds=1.0)) is None


def test_a_node_by_its_own_earlier_values_keeps_them_under_another_name():
    term = addition("y", "add", channel="z", breakpoints=(0.0, 1.0))
    patched = with_term("y[K] = 0.9 * prev(y) + x  # wall\nw = y\n", term, taken={"y_inner"})
    assert patched == "y_inner2[K] = 0.9 * prev(y_inner2) + x  # wall\ny[K] = y_inner2 + New(z)\nw = y\n"


def test_a_node_whose_earlier_values_others_read_as_well_is_not_changed():
    term = addition("y", "add", channel="z", breakpoints=(0.0, 1.0))
    assert with_term("y = 0.9 * prev(y, 0) + x\nw = max(delay(1 - y, 2, 0), 1)\n", term) is None
