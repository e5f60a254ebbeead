"""Names in formula text, and the message for an ambiguous one."""

import pytest

from kennfeld.base.errors import InputError, Location
from kennfeld.models.formula import expression, extend, formula


def findings(text: str, parameters: list[str] | None = None) -> list[str]:
    with pytest.raises(InputError) as caught:
        formula(text, "torque.kf", parameters)
    return [str(finding).removeprefix("torque.kf ") for finding in caught.value.findings]


def test_without_knowledge_what_is_called_is_a_table_and_a_bare_name_an_input():
    graph = formula("y = M(u, v) * K").graph
    assert graph.inputs == ("u", "v", "K")
    assert graph.parameters == {"M": 2}


def test_a_declared_scalar_is_a_parameter():
    graph = formula("y = M(u, v) * K\nscalar K").graph
    assert graph.inputs == ("u", "v")
    assert graph.parameters == {"M": 2, "K": 0}


def test_a_known_parameter_needs_no_declaration():
    graph = formula("y = M(u, v) * K", parameters=["K", "M", "unused"]).graph
    assert graph.inputs == ("u", "v")
    assert graph.parameters == {"M": 2, "K": 0}


def test_a_quoted_name_can_be_a_table_called_like_a_function():
    graph = formula("y = %min%(u, v) + min(u, v)").graph
    assert graph.parameters == {"min": 2}


@pytest.mark.parametrize("name", ["single", "round"])
def test_a_table_declared_in_quotes_leaves_the_function_of_its_name_usable(name):
    graph = formula(f"curve %{name}%\ny = %{name}%(u) + {name}(u)").graph
    assert graph.parameters == {name: 1}
    assert name in {node.op for node in graph.nodes}


def test_a_scalar_may_have_the_name_of_a_function_that_is_called():
    assert formula("scalar max\ny = max(u, max)").graph.parameters == {"max": 0}


def test_a_quoted_reserved_word_is_an_ordinary_name():
    graph = formula("%t% = u\ny = %t% + t + %and%\nscalar %and%").graph
    assert list(graph.names) == ["t", "y"]
    assert graph.parameters == {"and": 0}


@pytest.mark.parametrize("name", ["t", "dt", "dt_next"])
def test_no_channel_has_the_name_of_a_clock(name):
    with pytest.raises(InputError, match=f"an input cannot have the name {name}, which is that of the"):
        formula(f"y = 2 * %{name}%")
    assert formula(f"y = %{name}%\n%{name}% = 2 * u").graph.inputs == ("u",)


def test_dt_and_t_are_the_clock():
    graph = formula("y = dt + t").graph
    assert graph.inputs == ()
    assert [node.payload for node in graph.nodes[:2]] == ["dt", "t"]


def test_auxiliary_names_stay_out_of_the_graph():
    graph = formula("_a = u + 1\ny = _a * _a\n%_b% = _a").graph
    assert list(graph.names) == ["y", "_b"]


def test_arguments_of_a_function_hide_other_names():
    graph = formula("def f(u, y) = u - y\ny = f(2 * u, v)").graph
    assert graph.nodes == formula("y = 2 * u - v").graph.nodes


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("y = 1\ny = 2", "line 2, column 1: duplicate node y, first in torque.kf line 1. Remove one."),
        ("input u\ninput u\ny = u", "line 2, column 7: duplicate input u, first in torque.kf line 1. Remove one."),
        ("scalar K\ncurve K\ny = K", "line 2, column 7: duplicate parameter K, first in torque.kf line 1. Remove one."),
        ("step 1\nstep 2\ny = u", "line 2, column 1: duplicate step, first in torque.kf line 1. Remove one."),
        ("y = 1\ninput y", "line 2, column 7: y is both an input and a node. Rename one of them."),
        ("y = u\nscalar y", "line 2, column 8: y is both a parameter and a node. Rename one of them."),
        ("scalar u\ninput u\ny = u", "line 2, column 7: u is both an input and a parameter. Rename one of them."),
        ("y = f(u)\ndef f(a) = a\nf = 3", "line 2, column 5: f is both a function and a node. Rename one of them."),
        (
            "def abs(a) = a\ny = u",
            "line 1, column 5: the built-in name abs cannot be defined as a function. Use another name.",
        ),
        (
            "def %f%(a) = a\ny = u",
            "line 1, column 5: a quoted name cannot be defined as a function. Use another name.",
        ),
        ("def f(a, a) = a\ny = u", "line 1, column 10: duplicate argument a. Rename one of them."),
        ("output z\ny = u", "line 1, column 8: output z is not a defined node"),
        ("output speed\nSpeed = u", "line 1, column 8: output speed is not a defined node. Did you mean Speed?"),
        (
            "output _a\n_a = u\ny = _a",
            "line 1, column 8: output _a is an auxiliary node. Give the node a name without the underscore.",
        ),
        (
            "input Speed\ny = Sped",
            "line 2, column 5: unknown name Sped: not a node, a parameter or a declared input. Did you mean Speed?",
        ),
        (
            "input Speed\ny = q",
            "line 2, column 5: unknown name q: not a node, a parameter or a declared input. Declare it: input q.",
        ),
        (
            "y = M(u)\nz = M(u, v)",
            "line 2, column 5: M is a curve with 1 coordinate in torque.kf line 1, column 5 "
            "but has 2 here. Write M(x).",
        ),
        (
            "y = M(u) + M",
            "line 1, column 12: M is used as a table in torque.kf line 1, column 5, but without coordinates here. "
            "Write M(...) with its coordinates.",
        ),
        ("map M\ny = M(u)", "line 2, column 5: M is declared as a map but has 1 coordinate here. Write M(x, y)."),
        (
            "curve M\ny = M",
            "line 2, column 5: M is declared as a curve but has no coordinates here. Write M(x).",
        ),
        ("scalar M\ny = M(u)", "line 2, column 5: M is declared as a scalar but has 1 coordinate here. Write M."),
        (
            "cube M\ny = M(u, v)",
            "line 2, column 5: M is declared as a cube but has 2 coordinates here. Write M(x, y, z).",
        ),
        (
            "y = M(1, 2, 3, 4, u)",
            "line 1, column 5: M has 5 coordinates; tables have at most 4. "
            "If it is an expansion in radial basis functions, declare it: rbf M.",
        ),
        (
            "curve single\ny = single(u)",
            "line 2, column 5: single is the built-in function here, and a curve in torque.kf line 1, column 7. "
            "Write %single%(...) for the curve; quote its declaration to use both.",
        ),
        ("y = M()", "line 1, column 5: M is called without coordinates. Write M(x), or M."),
        ("y = z(2)\nz = u", "line 1, column 5: z is a node, not a table. Write * to multiply."),
        ("input u\ny = u(2)", "line 2, column 5: u is an input, not a table. Write * to multiply."),
        ("y = pi(2)", "line 1, column 5: pi is not a function. Write * to multiply."),
        ("def f(a) = a(2)\ny = f(1)", "line 1, column 12: a is an argument, not a table. Write * to multiply."),
        ("def f(a, b) = a\ny = f(1)", "line 2, column 5: f takes 2 arguments, got 1. Write f(a, b)."),
        ("def f(a) = a\ny = f", "line 2, column 5: f is a function of this text. Write f(a)."),
        ("y = sqrt(1, 2)", "line 1, column 5: sqrt takes 1 argument, got 2. Write sqrt(x)."),
        ("y = min(u)", "line 1, column 5: min takes at least 2 arguments, got 1. Write min(a, b, ...)."),
        ("y = PT1(u)", "line 1, column 5: PT1 takes 2 to 3 arguments, got 1. Write PT1(x, T, init=x)."),
        ("y = timeDelay()", "line 1, column 5: timeDelay takes 1 to 2 arguments, got 0. Write timeDelay(x, init=0)."),
        (
            "y = integrator(u, 1, 2, 3, 4, 5)",
            "line 1, column 5: integrator takes 1 to 5 arguments, got 6. "
            "Write integrator(x, init=0, lower=-inf, upper=inf, start=itself).",
        ),
    ],
)
def test_ambiguous_names_are_reported_with_place_and_remedy(text, expected):
    assert findings(text) == [expected]


def test_the_nearest_parameter_is_offered():
    assert findings("y = MapOptTorqe(u)", ["MapOptTorque", "K"]) == [
        "line 1, column 5: the start has no parameter MapOptTorqe. Did you mean MapOptTorque? "
        'A table needs initial values: kf.Curve("MapOptTorqe", ...).'
    ]


def test_the_nearest_function_is_offered():
    assert findings("y = sqr(u)", ["MapOptTorque"]) == [
        "line 1, column 5: the start has no parameter sqr. Did you mean sqrt? "
        'A table needs initial values: kf.Curve("sqr", ...).'
    ]


def test_a_node_may_not_be_called_like_a_known_parameter():
    assert findings("K = 2\ny = K", ["K"]) == [
        "line 1, column 1: K is both a node and a parameter of the start. Rename one of them."
    ]


def test_a_known_scalar_may_not_be_called_as_well():
    assert findings("y = K * u\nz = K(u)", ["K"]) == [
        "line 2, column 5: K is a scalar with no coordinates in torque.kf line 1, column 5 but has 1 here. Write K."
    ]


def test_a_wrong_line_keeps_its_name_known():
    assert len(findings("input u\na = u $\ny = a + u")) == 1


def test_all_wrong_names_of_a_text_are_reported_in_its_order():
    text = "input u\na = q1\nb = sqrt(q2, q3)\nc = u(1) + abs()\n"
    assert [finding.split(":")[0] for finding in findings(text)] == [
        "line 2, column 5",
        "line 3, column 5",
        "line 3, column 10",
        "line 3, column 14",
        "line 4, column 5",
        "line 4, column 12",
    ]


def test_an_expression_knows_channels_only():
    with pytest.raises(InputError) as caught:
        expression("lambd < 1.5 and foo(n)", Location("kennfeld.toml [[dataset]] where"), ["lambda", "n"])
    assert [str(finding) for finding in caught.value.findings] == [
        "kennfeld.toml [[dataset]] where, column 1: unknown channel lambd. Did you mean lambda?",
        "kennfeld.toml [[dataset]] where, column 17: unknown function foo. Did you mean floor?",
    ]


def test_an_extension_knows_the_model():
    model = formula("n = Speed(u) * K\nscalar K", "idle")
    with pytest.raises(InputError) as caught:
        extend(model, {"a": "Sped(u)", "b": "Speed(u, u)", "n": "u", "u": "1"}, Location("limit"))
    assert [str(finding) for finding in caught.value.findings] == [
        "limit a, column 1: model idle has no parameter Sped. Did you mean Speed?",
        "limit b, column 1: Speed is a curve with 1 coordinate of model idle but has 2 here. Write Speed(x).",
        "limit n: n is already a node of model idle. Give it another name.",
        "limit u: u is already an input of model idle. Give it another name.",
    ]
