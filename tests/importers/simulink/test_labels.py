"""The labels of charts taken apart, and the C action language, against trees by hand."""

import pytest

from kennfeld.importers.simulink.stateflow.c_action_parser import (
    ActionSyntaxError,
    parse_c_expression,
    parse_c_statements,
)
from kennfeld.importers.simulink.stateflow.label_parser import (
    ActionLanguage,
    parse_state_label,
    parse_transition_label,
    strip_comments,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.program import tree as m


@pytest.mark.parametrize(
    ("text", "actions"),
    [
        ("A", []),
        ("A/", []),
        ("A/ entry: y = 1;", [("entry", "y = 1;", "")]),
        ("A\nen, du: y = 1;\nex: z = 0;", [("entry", "y = 1;", ""), ("during", "y = 1;", ""), ("exit", "z = 0;", "")]),
        ("A\nentry : x = a;\non E: y++;\non after(3, tick) : z = 1;",
         [("entry", "x = a;", ""), ("on", "y++;", "E"), ("on", "z = 1;", "after(3, tick)")]),
        ("A // entry: not here\nduring: y = c ? 1; /* exit: */ z = 2;", [("during", "y = c ? 1;   z = 2;", "")]),
        ("A\nen: y = 1; ex: y = 2;", [("entry", "y = 1;", ""), ("exit", "y = 2;", "")]),
        ("A\nbind: E, x", [("bind", "E, x", "")]),
        ("A\nduring:", []),
    ],
)  # fmt: skip
def test_labels_of_states_are_taken_apart(text, actions):
    label = parse_state_label(text)
    assert label.name == "A"
    assert [(one.kind, one.code, one.event) for one in label.actions] == actions


def test_actions_without_a_keyword_are_those_at_entry_and_during():
    label = parse_state_label("A\ny = 1;\nexit: y = 0;", "MATLAB")
    assert label.bare
    assert [one.kind for one in label.actions] == ["entry", "during", "exit"]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ("", "", "", "")),
        ("?", ("", "", "", "")),
        ("E", ("E", "", "", "")),
        ("E | F[x]", ("E | F", "x", "", "")),
        ("[x[2] > 0] {y = 1;}", ("", "x[2] > 0", "y = 1;", "")),
        ("{a = 1;}/{b = 2;}", ("", "", "a = 1;", "b = 2;")),
        ("/b = 2; send(E, S)", ("", "", "", "b = 2; send(E, S)")),
        ("after(a/b, sec)[~c]/{d;}", ("after(a/b, sec)", "~c", "", "d;")),
        ("E % why\n[x > 0] % when\n{y = '}';}", ("E", "x > 0", "y = '}';", "")),
    ],
)
def test_labels_of_transitions_are_taken_apart(text, parts):
    label = parse_transition_label(text)
    assert (label.event, label.condition, label.condition_action, label.action) == parts
    assert not label.fault


@pytest.mark.parametrize(
    ("text", "message"), [("[x", "[ is never closed"), ("[x] y = 1", "unexpected 'y = 1'"), ("[x][y]", "two parts")]
)
def test_unreadable_labels_are_reported_with_the_reason(text, message):
    assert message in parse_transition_label(text).fault


def test_comments_in_quotes_stay():
    assert strip_comments("a = 'x // y'; % z", "MATLAB") == "a = 'x // y';  "
    assert strip_comments("b = a'; % it's\nc = 1;", "MATLAB") == "b = a';  \nc = 1;"


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("a + b*c", "a + b*c"),
        ("!a || b && ~c", "~a || (b && ~c)"),
        ("a | b & c", "a || (b && c)"),
        ("a | b && c", "(a || b) && c"),
        ("a && b | c || d & e", "(a && (b || c)) || (d && e)"),
        ("x[0] - m[i][2]", "x(1) - m(i+1, 3)"),
        ("-2^2", "-2^2"),
        ("2^-1 * 3", "(2^-1)*3"),
        ("a %% 3 + 1", "rem(a, 3) + 1"),
        ("a != b", "a ~= b"),
        ("a <> b", "a ~= b"),
        ("0x1F + 2.5e-1f + .5", "31 + 0.25 + 0.5"),
        ("max(a, min(b, 3)) >= fabs(c)", "max(a, min(b, 3)) >= fabs(c)"),
        ("S.T.x > 1", "S.T.x > 1"),
        ("a\n + b", "a + b"),
    ],
)
def test_expressions_of_c_are_those_of_matlab(text, same):
    assert _bare(parse_c_expression(text)) == _bare(parse_expression(same))


def _bare(tree):
    return repr(tree)


def test_statements_of_c_are_parted_by_semicolons_commas_and_lines():
    statements = parse_c_statements("x = 1, y += 2; z++\n--w; E; f(1,\n 2)\nv = 3\n + 4;")
    x, y, z, w, v = (m.Name(name) for name in "xyzwv")
    one, two = m.Number(1.0), m.Number(2.0)
    assert statements == (
        m.Assign((x,), one), m.Assign((y,), m.Binary("+", y, two)), m.Assign((z,), m.Binary("+", z, one)),
        m.Assign((w,), m.Binary("-", w, one)), m.Evaluate(m.Name("E")), m.Evaluate(m.Call(m.Name("f"), (one, two))),
        m.Assign((v,), m.Binary("+", m.Number(3.0), m.Number(4.0))),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("y = ", "unexpected 'the end'"),
        ("y = a b", "unexpected 'b'"),
        ("y = a << ", "unexpected"),
        ("y = z = 1", "chained assignment"),
        ("3 = y", "cannot assign"),
        ("y = " + "(" * 80 + "1" + ")" * 80, "nested more than"),
        ("y = ml.sin(2)", "ml is not supported"),
        ("y = $x$", "unexpected"),
    ],
)
def test_statements_other_than_c_are_reported_with_the_reason(text, message):
    with pytest.raises(ActionSyntaxError) as caught:
        parse_c_statements(text)
    assert message in str(caught.value)


def test_operators_on_bits_bind_as_in_c():
    tree = parse_c_expression("a | b ^ c & d == 1 << 2 + e", bits=True)
    a, b, c, d, e = (m.Name(name) for name in "abcde")
    shift = m.Call(m.Name("bitshift"), (m.Number(1.0), m.Binary("+", m.Number(2.0), e)))
    both = m.Call(m.Name("bitand"), (c, m.Binary("==", d, shift)))
    assert tree == m.Call(m.Name("bitor"), (a, m.Call(m.Name("bitxor"), (b, both))))
    # without C-bit operations they are those of logic, and ^ is a power
    assert parse_c_expression("a & b^c") == m.Binary("&&", a, m.Binary("^", b, c))


def test_matlab_in_charts_knows_how_to_count():
    statements = ActionLanguage("MATLAB").statements("x++; y(2) -= 3*z\nw *= 2;", "A")
    plain = ActionLanguage("MATLAB").statements("x = x + 1; y(2) = y(2) - (3*z);\nw = w * (2);", "A")
    assert statements == plain
