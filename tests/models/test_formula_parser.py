"""Formula text to syntax: precedence, lines, and the messages about wrong text."""

import pytest

from kennfeld.base.errors import InputError, Location
from kennfeld.models.formula import expression, formula
from kennfeld.models.formula.parser import MAX_DEPTH
from tests.draws import mostly_slow


def findings(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        formula(text, "torque.kf")
    return [str(finding) for finding in caught.value.findings]


@pytest.mark.parametrize(
    ("text", "bracketed"),
    [
        ("a + b * c", "a + (b * c)"),
        ("a * b + c", "(a * b) + c"),
        ("a - b - c", "(a - b) - c"),
        ("a - b + c", "(a - b) + c"),
        ("a / b / c", "(a / b) / c"),
        ("a / b * c", "(a / b) * c"),
        ("a ^ b ^ c", "a ^ (b ^ c)"),
        ("-a ^ b", "-(a ^ b)"),
        ("a ^ -b", "a ^ (-b)"),
        ("a ^ -b ^ c", "a ^ (-(b ^ c))"),
        ("a ^ -b * c", "(a ^ (-b)) * c"),
        ("-a * b", "(-a) * b"),
        ("a * -b", "a * (-b)"),
        ("a * -b + c", "(a * (-b)) + c"),
        ("a - -b", "a - (-b)"),
        ("+a + +b", "a + b"),
        ("a + b < c * d", "(a + b) < (c * d)"),
        ("a < b and c >= d", "(a < b) and (c >= d)"),
        ("a and b or c and d", "(a and b) or (c and d)"),
        ("a or b and c", "a or (b and c)"),
        ("not a < b", "not (a < b)"),
        ("not a and b", "(not a) and b"),
        ("a and not b or c", "(a and (not b)) or c"),
        ("not not a", "not (not a)"),
        ("not a == b", "not (a == b)"),
        ("-a < -b", "(-a) < (-b)"),
        ("a == b + 1", "a == (b + 1)"),
        ("M(a + b, -c)", "M((a + b), (-c))"),
    ],
)
def test_precedence_is_as_in_the_table(text, bracketed):
    assert formula(f"y = {text}").graph == formula(f"y = {bracketed}").graph


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-2 ^ 2", -4.0),
        ("2 ^ -1", 0.5),
        ("2 ^ 3 ^ 2", 512.0),
        ("(2 ^ 3) ^ 2", 64.0),
        (".5 + 1. + 1e-3 + 2E+1", 21.501),
        ("7 - 2 - 1", 4.0),
        ("8 / 4 / 2", 1.0),
        ("1 < 2", 1.0),
        ("not 0 == 1", 1.0),
        ("pi", 3.141592653589793),
        ("-inf", float("-inf")),
    ],
)
def test_constants_are_computed(text, value):
    graph = expression(text, Location("here"))
    assert graph.nodes[graph.names["value"]].payload == value


@pytest.mark.parametrize(
    "text",
    [
        "y=a+b",
        "  y\t=\ta + b  # a sum",
        "1 y = a + b",
        "12\ty\t=\ta + b",
        "y = (a\n     + b)",
        "y = (a  # first\n\n   + # second\n b)\n",
        "\r\ny = a + b\r\n",
        "# only a comment\ry = a + b",
        "%y% = %a% + b",
        "y[Nm] = a + b",
        "y [ Nm ] = a + b",
    ],
)
def test_the_same_line_can_be_written_in_many_ways(text):
    assert formula(text).graph.nodes == formula("y = a + b").graph.nodes


def test_a_name_may_hold_letters_digits_dots_and_underscores_of_any_script():
    names = ("n", "Drehzahl_Ü", "a.b.c", "x1", "λ", "ETK.rad_2")
    assert formula("y = " + " + ".join(names)).graph.inputs == names


def test_quotes_make_any_name():
    graph = formula("%out 1% = %rad[3].x% * %50%% load% * %pi%").graph
    assert graph.inputs == ("rad[3].x", "50% load", "pi")
    assert list(graph.names) == ["out 1"]


def test_words_of_declarations_can_name_nodes():
    graph = formula("map = u\nstep = map + 1\noutput[Nm] = step\ninput = output").graph
    assert list(graph.names) == ["map", "step", "output", "input"]


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("y = a +", "line 1, column 8: incomplete expression"),
        ("y =", "line 1, column 4: incomplete expression"),
        ("y = * a", "line 1, column 5: missing operand before *"),
        ("y = a b", "line 1, column 7: missing operator before b"),
        ("y = (a + b", "line 1, column 5: unclosed parenthesis"),
        ("y = a + b)", "line 1, column 10: unmatched closing parenthesis. Remove it, or open one before it."),
        ("y = min(a b)", "line 1, column 11: missing operator before b"),
        ("y = min(a,)", "line 1, column 11: missing operand before )"),
        ("y = 1,5", "line 1, column 6: comma outside parentheses. Use a point as decimal separator."),
        ("y = if(a = b, 1, 2)", "line 1, column 10: = inside an expression. Write == to compare."),
        ("y = a ** 2", "line 1, column 7: unexpected '**'. Write ^ for a power."),
        ("y = a && b", "line 1, column 7: unexpected '&&'. Write and."),
        ("y = a − b", "line 1, column 7: unexpected '−'. Write -."),
        (
            "y = a % 2",
            "line 1, column 7: unexpected '%'. "
            "Write mod(a, b) for a remainder, and names with other characters as %any name%.",
        ),
        ("y = a < b < c", "line 1, column 11: comparisons cannot be chained. Write a < b and b < c."),
        ("y = 0 <= x+1 < c", "line 1, column 14: comparisons cannot be chained. Write 0 <= x+1 and x+1 < c."),
        ("y = u*v == b != c+d", "line 1, column 14: comparisons cannot be chained. Write a == b and b != c."),
        (
            "y = a + not b",
            "line 1, column 9: `not` has lower precedence than the operator before it. Put it in parentheses: (not a).",
        ),
        (
            "y = 2x",
            "line 1, column 5: 2x is neither a number nor a name. "
            "Write * between a number and a name, or %2x% for a name.",
        ),
        ("y = 1e999", "line 1, column 5: 1e999 exceeds the range of numbers. Write inf for infinity."),
        (
            "y = rad[3] * 2",
            "line 1, column 8: a unit is only allowed after the name being defined. "
            "Write %rad[3]% for a name that contains brackets.",
        ),
        (
            "y = [3]",
            "line 1, column 5: a unit is only allowed after the name being defined. "
            "Write %name[3]% for a name that contains brackets.",
        ),
        (
            "rad[3].x = 2",
            "line 1, column 7: missing = after rad. "
            "Write name[unit] = expression; names with other characters as %any[3].name%.",
        ),
        ("y = 3 $ 4", "line 1, column 7: unexpected '$'"),
        ("3 + 4 = y", "line 1, column 1: a statement must start with a name"),
        ("$ = y", "line 1, column 1: unexpected '$'"),
        ("pi = 3", "line 1, column 1: pi is a reserved word. Write %pi% to use it as a name."),
        ("y ! 3", "line 1, column 3: unexpected '!'. Write not."),
        ("y = if", "line 1, column 5: if requires parentheses. Write if(condition, a, b)."),
        ("input a, b\ny=a", "line 1, column 8: only one name per declaration. Write one input line per name."),
        ("input 3 \ny=a", "line 1, column 7: input requires a name"),
        ("input a b\ny=a", "line 1, column 9: missing operator before b"),
        ("step x\ny=a", "line 1, column 6: step must be a positive number of seconds. Write step 0.01, for example."),
        ("step 0\ny=a", "line 1, column 6: step must be a positive number of seconds. Write step 0.01, for example."),
        ("def f = 3\ny=a", "line 1, column 7: missing (. Write def f(a, b) = expression."),
        ("def 3(a) = 3\ny=a", "line 1, column 5: def requires the name of the function"),
        ("def f(a b) = 3\ny=a", "line 1, column 9: missing ). Write def f(a, b) = expression."),
        ("def f(a,) = 3\ny=a", "line 1, column 9: the name of an argument is missing"),
        ("def f(a) 3\ny=a", "line 1, column 10: missing =. Write def f(a, b) = expression."),
    ],
)
def test_wrong_text_is_answered_with_place_and_mend(text, finding):
    assert findings(text) == [f"torque.kf {finding}"]


def test_a_finding_shows_the_line_and_the_place():
    with pytest.raises(InputError) as caught:
        formula("a = 1\n\ty = Ma && 3", "torque.kf")
    assert caught.value.findings[0].excerpt == "\ty = Ma && 3\n\t       ^^"


def test_the_excerpt_of_a_very_long_line_is_short():
    with pytest.raises(InputError) as caught:
        formula("y = " + "a + " * 5000 + "$ + " + "b + " * 5000 + "c")
    line, marks = caught.value.findings[0].excerpt.split("\n")
    assert len(line) <= 120
    assert line[marks.index("^")] == "$"


def test_every_wrong_line_is_reported():
    text = "a = 1 +\nb = (2\nc = 3 & 4\nd = a + b + c\ne = sqrt(1, 2)\nf = f + 1\n"
    assert [finding.split(":")[0] for finding in findings(text)] == [
        "torque.kf line 1, column 8",
        "torque.kf line 2, column 5",
        "torque.kf line 3, column 7",
        "torque.kf line 5, column 5",
        "torque.kf line 6, column 1",
    ]


@pytest.mark.parametrize(
    "following", ["b = 2 $", "b[Nm] = 2 $", "7 b = 2 $", "input %u v% $", "def f(x) = $", "step 0 $"]
)
def test_a_forgotten_bracket_does_not_hide_the_lines_below(following):
    assert len(findings(f"a = (1\n{following}\nc = 1")) == 2


def nested(depth: int) -> list[str]:
    return [
        "y = " + "(" * depth + "a" + ")" * depth,
        "y = " + "abs(" * depth + "a" + ")" * depth,
        "y = " + "f(1, a + abs(" * (depth // 2) + "a" + "))" * (depth // 2),
        "y = " + "a + (" * depth + "a" + ")" * depth,
        "y = " + "-" * depth + "a",
        "y = " + "not " * depth + "a",
        "y = " + "a ^ " * depth + "a",
    ]


@pytest.mark.parametrize("text", nested(MAX_DEPTH))
def test_deep_nesting_is_read_even_on_a_deep_stack(text):
    def below(frames: int) -> None:
        if frames:
            below(frames - 1)
        else:
            formula(text)

    below(250)


@pytest.mark.parametrize("text", nested(2 * MAX_DEPTH) + nested(3_000))
def test_deeper_nesting_is_an_error_and_no_traceback(text):
    assert (
        "the expression is nested more than 100 levels deep. Assign its inner parts to named nodes."
        in findings(text)[0]
    )


@pytest.mark.parametrize("operator", mostly_slow(["+", "-", "*", "/", "and", "or"], ["-", "or"]))
def test_long_chains_are_read(operator):
    graph = formula("y = " + f" {operator} ".join(["a"] * 3000)).graph
    assert len(graph.nodes) == 3000
