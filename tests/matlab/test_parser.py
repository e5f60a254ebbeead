"""MATLAB text becomes a tree, and the tree becomes text again."""

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kennfeld.matlab.errors import MatlabError
from kennfeld.matlab.parser import parse_expression, parse_leniently, parse_script
from kennfeld.matlab.printer import format_expression
from kennfeld.program import tree as m
from tests.draws import few_or_many

a, b, x = m.Name("a"), m.Name("b"), m.Name("x")
one, two, three = m.Number(1.0), m.Number(2.0), m.Number(3.0)


def minus(operand):
    return m.Unary("-", operand)


def row(*elements):
    return m.Matrix((elements,))


EXPRESSIONS = {
    "K*2": m.Binary("*", m.Name("K"), two),
    "-a/2": m.Binary("/", minus(a), two),
    "[1 -2]": row(one, minus(two)),
    "[1 - 2]": row(m.Binary("-", one, two)),
    "[1 -2 + 3]": row(one, m.Binary("+", minus(two), three)),
    "[1, -2]": row(one, minus(two)),
    "[1-2]": row(m.Binary("-", one, two)),
    "[a' b']": row(m.Transpose(a), m.Transpose(b)),
    "[a 'b']": row(a, m.Text("b")),
    "[a', b.']": row(m.Transpose(a), m.Transpose(b, False)),
    "[a ~b]": row(a, m.Unary("~", b)),
    "[a ~= b]": row(m.Binary("~=", a, b)),
    "[a (1)]": row(a, one),
    "[a(1) 2]": row(m.Call(a, (one,)), two),
    "[(a -1) 2]": row(m.Binary("-", a, one), two),
    "[1 2\n3 1]": m.Matrix(((one, two), (three, one))),
    "[1 2;\n3 1;\n]": m.Matrix(((one, two), (three, one))),
    "[1 ... two\n 2]": row(one, two),
    "[1 % two\n 2]": m.Matrix(((one,), (two,))),
    "[]": m.Matrix(()),
    "{}": m.CellArray(()),
    "{1 'b'}": m.CellArray(((one, m.Text("b")),)),
    "{@(x) x, 2}": m.CellArray(((m.AnonymousFunction(("x",), x), two),)),
    "-2^2": minus(m.Binary("^", two, two)),
    "2^-1": m.Binary("^", two, minus(one)),
    "2^-1'": m.Transpose(m.Binary("^", two, minus(one))),
    "2^3^1": m.Binary("^", m.Binary("^", two, three), one),
    "a'^2": m.Binary("^", m.Transpose(a), two),
    "~a == b": m.Binary("==", m.Unary("~", a), b),
    "a | b & x": m.Binary("|", a, m.Binary("&", b, x)),
    "a || b && x": m.Binary("||", a, m.Binary("&&", b, x)),
    "1:2 == a": m.Binary("==", m.Range(one, None, two), a),
    "1:a+1": m.Range(one, None, m.Binary("+", a, one)),
    "3:-1:1": m.Range(three, minus(one), one),
    "a(:)": m.Call(a, (m.Colon(),)),
    "a(:, 1)": m.Call(a, (m.Colon(), one)),
    "a(end)": m.Call(a, (m.End(),)),
    "a(end-1:end)": m.Call(a, (m.Range(m.Binary("-", m.End(), one), None, m.End()),)),
    "a(b(end))": m.Call(a, (m.Call(b, (m.End(),)),)),
    "a(end')": m.Call(a, (m.Transpose(m.End()),)),
    "a([1 end])": m.Call(a, (row(one, m.End()),)),
    "a{1}.b(2)": m.Call(m.Field(m.CellIndex(a, (one,)), "b"), (two,)),
    "a.(b)": m.DynamicField(a, b),
    "a.b'": m.Transpose(m.Field(a, "b")),
    "a()": m.Call(a, ()),
    "1./a": m.Binary("./", one, a),
    "1.*a": m.Binary(".*", one, a),
    "1.'": m.Transpose(one, False),
    ".5": m.Number(0.5),
    "1.e3": m.Number(1000.0),
    "2d2": m.Number(200.0),
    "0x1F": m.Number(31.0, "u8"),
    "0b101s16": m.Number(5.0, "s16"),
    "2i": m.Number(2.0, "i"),
    "'it''s'": m.Text("it's"),
    '"say ""a"""': m.Text('say "a"', True),
    "'100 % sure'": m.Text("100 % sure"),
    "@sin": m.FunctionHandle("sin"),
    "@(a, ~) a": m.AnonymousFunction(("a", "~"), a),
    "@() a + 1": m.AnonymousFunction((), m.Binary("+", a, one)),
    "a \\ b": m.Binary("\\", a, b),
    "((a))": a,
    "a ... more\n + b": m.Binary("+", a, b),
    "a != b": m.Binary("~=", a, b),
    "- -a": minus(minus(a)),
    "a--b": m.Binary("-", a, minus(b)),
}


@pytest.mark.parametrize(("text", "tree"), EXPRESSIONS.items())
def test_an_expression_becomes_this_tree(text, tree):
    assert parse_expression(text) == tree
    assert parse_expression(format_expression(tree)) == tree


@pytest.mark.parametrize(
    ("text", "said"),
    {
        "": "line 1, column 1: a value is missing before the end",
        "a +": "line 1, column 4: a value is missing",
        "a b": "line 1, column 3: unexpected 'b'",
        "(a": "line 1, column 1: ( is never closed",
        "a)": "line 1, column 2: unmatched )",
        "[a)": "line 1, column 3: unmatched )",
        "f(1,)": "line 1, column 5: an argument is missing",
        "[1,,2]": "line 1, column 4: an element is missing",
        "a..b": "line 1, column 3: a field name is missing",
        "end": "line 1, column 1: a value is missing",
        "a(@() end)": "line 1, column 7: a value is missing",
        "'a": "line 1, column 1: unterminated text",
        '"a': "line 1, column 1: unterminated text",
        "a $ b": "line 1, column 3: unexpected character '$'",
        "1x": "line 1, column 1: invalid number '1x'",
        "1.2.3": "line 1, column 4",
        "0x1FFu8": "line 1, column 1: 0x1FFu8 has more than 8 bits",
        "a = 1": "line 1, column 3: unexpected '='",
        "[1\n2": "line 1, column 1: [ is never closed",
        "+".join(["1"] * 5000): "more than 150 operators",
        "(" * 5000 + "1" + ")" * 5000: "brackets are nested more than 30 deep",
        "-" * 5000 + "1": "more than 150 operators",
        "a" + "'" * 5000: "more than 150 operators",
        "a" + ".b" * 5000: "more than 150 operators",
        "@()" * 5000 + "1": "brackets are nested more than 30 deep",
        "(" * 29 + "1" + "+1" * 140 + (")" + "+1" * 140) * 29: "more than 150 operators",
    }.items(),
)
def test_invalid_expressions_are_reported_with_line_and_column(text, said):
    with pytest.raises(MatlabError, match=re.escape(said)):
        parse_expression(text)


def statement(text):
    (single,) = parse_script(text).statements
    return single


def test_statements_become_trees():
    assert statement("a = 1;") == m.Assign((a,), one)
    assert statement("a(2).b = 1") == m.Assign((m.Field(m.Call(a, (two,)), "b"),), one)
    assert statement("[a, ~, b] = x(1);") == m.Assign((a, None, b), m.Call(x, (one,)))
    assert statement("[a b] = x;") == m.Assign((a, b), x)
    assert statement("[a b];") == m.Evaluate(row(a, b))
    assert statement("if a, x = 1; elseif b x = 2; else, x = 3; end") == m.If(
        (m.Branch(a, (m.Assign((x,), one),)), m.Branch(b, (m.Assign((x,), two),))), (m.Assign((x,), three),)
    )
    assert statement("for a = 1:3, break, end") == m.For(a, m.Range(one, None, three), (m.Jump("break"),))
    assert statement("for (a = 1:3) continue; end") == m.For(a, m.Range(one, None, three), (m.Jump("continue"),))
    assert statement("while a\nreturn\nend") == m.While(a, (m.Jump("return"),))
    assert statement("switch a % of\n\n case {1, 2}\n x = 1;\n otherwise\n x = 2;\nend") == m.Switch(
        a, (m.Branch(m.CellArray(((one, two),)), (m.Assign((x,), one),)),), (m.Assign((x,), two),)
    )
    assert statement("try\n x = 1;\ncatch a\n x = 2;\nend") == m.Try(
        (m.Assign((x,), one),), "a", (m.Assign((x,), two),)
    )
    assert statement("global a b") == m.Declaration("global", ("a", "b"))


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        ("clear all", "clear", ("all",)),
        ("close all;", "close", ("all",)),
        ("format long g % digits", "format", ("long", "g")),
        ("load 'a b.mat'", "load", ("'a b.mat'",)),
        ("load ../data/x.mat", "load", ("../data/x.mat",)),
        ("clear -regexp ^a", "clear", ("-regexp", "^a")),
        ("figure 1", "figure", ("1",)),
        ("!dir /w", "!", ("dir /w",)),
    ],
)
def test_commands_take_words(text, name, words):
    assert statement(text) == m.Command(name, words)


def test_a_blank_makes_no_command_of_an_expression():
    assert parse_expression("a -b") == m.Binary("-", a, b)


@pytest.mark.parametrize("text", ["a == b", "a = b", "a' * b'", "a - b", "a ...\n = 1", "a ( 1 ) = 2"])
def test_statements_that_resemble_commands_are_expressions(text):
    assert not isinstance(statement(text), m.Command)


def test_functions_stand_behind_the_statements():
    script = parse_script("a = f(1);\nfunction [x, y] = f(a, ~)\n x = a; y = 2;\nend\nfunction g\nend", "init.m")
    assert len(script.statements) == 1
    assert [(f.name, f.parameters, f.results) for f in script.functions] == [
        ("f", ("a", "~"), ("x", "y")),
        ("g", (), ()),
    ]


def test_functions_of_a_file_need_no_end():
    script = parse_script("function y = f(x)\ny = x;\n\nfunction z = g\nz = 1;\n")
    assert [len(function.body) for function in script.functions] == [1, 1]


def test_block_comments_are_skipped_and_keep_line_numbers():
    script = parse_script("%{\na = (\n%{\n%}\n%}\nb = 2;")
    assert [assigned.place[:2] for assigned in script.statements] == [(6, 1)]


def test_comments_of_octave_are_comments():
    assert parse_script("a = 1; # one\n#{\nb = (\n#}\n").statements == parse_script("a = 1;").statements


def test_the_comment_behind_a_value_is_kept():
    script = parse_script("a = 1; % [Nm] torque\nb = 2; x = [1 % first\n 2]; % both\n% alone\na = 3;")
    assert [assigned.comment for assigned in script.statements] == ["[Nm] torque", "", "both", ""]


def test_every_invalid_statement_is_reported():
    with pytest.raises(MatlabError) as error:
        parse_script("x = ;\ny = (1\nif a\n z=)\nend\n1 = a;\nspmd\nw = 3;", "init.m")
    assert [str(finding.location) for finding in error.value.findings] == [
        "init.m line 1, column 5",
        "init.m line 2, column 5",
        "init.m line 4, column 4",
        "init.m line 6, column 1",
        "init.m line 7, column 1",
    ]
    assert len(parse_leniently("x = ;\na = 1;")[0].statements) == 1


def test_blocks_that_are_never_closed_are_reported():
    with pytest.raises(MatlabError, match="line 1, column 1: if is never closed"):
        parse_script("if a\n x = 1;")
    with pytest.raises(MatlabError, match="end without an open block"):
        parse_script("x = 1;\nend")
    with pytest.raises(MatlabError, match="nested more than 25 deep"):
        parse_script("if a\n" * 5000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("function f\n x = 1;\n function g\n  x = 2;\n end\n g\nend\n", [("line 3, column 2", "f")]),
        ("function y = f(u)\ny = g(u);\nfunction z = g(a)\nz = a;\nend\nfunction w = h(a)\nw = a;\nend\nend\n",
         [("line 3, column 1", "f")]),
        ("function f\nfunction g\nfunction h\nend\nend\nend\n", [("line 3, column 1", "g"), ("line 2, column 1", "f")]),
    ],
)  # fmt: skip
def test_nested_functions_are_reported_as_such(text, expected):
    with pytest.raises(MatlabError) as error:
        parse_script(text)
    findings = error.value.findings
    assert [(str(one.location), one.message.split(" is defined within ")[1]) for one in findings] == [
        (place, f"the function {outer}; nested functions are not supported") for place, outer in expected
    ]
    assert all(one.remedy.startswith("Move it behind the end of ") for one in findings)


def test_functions_without_end_are_distinguished_from_an_extra_end():
    assert len(parse_script("function f\nx = 1;\nfunction g\nx = 2;\n").functions) == 2
    with pytest.raises(MatlabError, match="end without an open block"):
        parse_script("function f\nx = 1;\nend\nend\n")


def test_line_breaks_of_all_systems_count():
    assert parse_script("a = 1;\r\nb = 2;\rx = 3;").statements[2].place[:2] == (3, 1)


PIECES = ["a", "b1", "1", "2.5", " ", "\n", "'", '"', "(", ")", "[", "]", "{", "}", ",", ";", ":", ".", "=", "==", "~"]
PIECES += ["-", "+", "*", ".*", "^", "&&", "@", "%", "...", "end", "if ", "for ", "function ", "x", "%{\n", "!", "é"]


@few_or_many(st.lists(st.sampled_from(PIECES), max_size=40).map("".join) | st.text(max_size=40), few=20, many=100)
def test_any_text_gives_a_tree_or_the_error_of_the_room(text):
    for read in (parse_expression, parse_script):
        try:
            tree = read(text)
        except MatlabError:
            continue
        statements = tree.statements if isinstance(tree, m.Script) else (m.Evaluate(tree),)
        written = [part.value for part in statements if isinstance(part, m.Assign)]
        written += [part.expression for part in statements if isinstance(part, m.Evaluate)]
        for expression in written:
            assert parse_expression(format_expression(expression)) == expression


names = st.sampled_from(["a", "b", "Kp"])
leaves = names.map(m.Name) | st.floats(0, 1e300).map(m.Number) | st.text("ab'\" %", max_size=4).map(m.Text)


def _compound(inner):
    several = st.lists(inner, min_size=1, max_size=3).map(tuple)
    indexed = st.builds(m.Call, names.map(m.Name), several) | st.builds(m.CellIndex, names.map(m.Name), several)
    operators = st.sampled_from(
        ["+", "-", "*", "/", "\\", "^", ".*", "./", ".^", "==", "~=", "<=", "&", "|", "&&", "||"]
    )
    return (
        st.builds(m.Binary, operators, inner, inner)
        | st.builds(m.Unary, st.sampled_from("+-~"), inner)
        | st.builds(m.Transpose, inner, st.booleans())
        | st.builds(m.Range, inner, st.none() | inner, inner)
        | st.builds(m.Matrix, st.lists(several, max_size=3).map(tuple))
        | st.builds(m.CellArray, st.lists(several, max_size=3).map(tuple))
        | st.builds(m.AnonymousFunction, st.lists(names, max_size=2).map(tuple), inner)
        | st.builds(m.Field, inner, names)
        | indexed
    )


@given(st.recursive(leaves, _compound, max_leaves=12))
@example(m.Call(m.Name("a"), (m.Transpose(m.Text(""), True), m.Text("a"))))
def test_a_tree_that_is_printed_and_read_is_the_same(tree):
    assert parse_expression(format_expression(tree)) == tree
