"""Operators by their precedence, in a small language whose oracle is Python."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.program.operator_parser import OperatorParser, operator_levels
from kennfeld.program.positions import TextLines
from kennfeld.program.tokens import ScannedToken, scan_tokens

PATTERN = re.compile(r"(?P<number>\d+)|(?P<operator>[-+*&|,()])|(?P<blank>\s+)|(?P<bad>.)")
OPERATIONS = {
    "|": int.__or__,
    "&": int.__and__,
    "+": int.__add__,
    "-": int.__sub__,
    "*": int.__mul__,
}


class Calculator(OperatorParser[ScannedToken, int]):
    levels = operator_levels(("|",), ("&",), ("+", "-"), ("*",))
    max_depth = 20
    max_terms = 50

    def __init__(self, text):
        super().__init__([*scan_tokens(PATTERN, text), ScannedToken("end", "", len(text))])

    def operand(self, lowest):
        if self.accept("-"):
            return -self.nested(lambda: self.operand(lowest))
        if self.accept("("):
            value = self.nested(self.operations)
            self.expect(")")
            return value
        return int(self.take().text)

    def joined(self, left, level):
        return OPERATIONS[self.take().text](left, self.operations(level + 1))

    def missing(self, text):
        return SyntaxError(f"{text} is missing at {self.token.offset}")

    def too_deep(self):
        return SyntaxError("too deep")

    def too_many_terms(self):
        return SyntaxError("too many terms")


EXPRESSIONS = st.recursive(
    st.integers(0, 99).map(str),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(sorted(OPERATIONS)), inner).map(" ".join),
        inner.map(lambda text: f"({text})"),
        inner.map(lambda text: f"-{text}"),
    ),
    max_leaves=12,
)


@given(EXPRESSIONS)
def test_operators_bind_as_in_python(text):
    parser = Calculator(text)
    assert parser.operations() == eval(text)
    assert (parser.token.kind, parser.depth) == ("end", 0)


def test_an_operand_takes_the_operators_of_a_level_only():
    parser = Calculator("2 * 3 + 4 | 8")
    assert parser.operations(parser.levels["+"]) == 10
    assert parser.token.text == "|"


@pytest.mark.parametrize(
    ("text", "message"),
    [("(1 + 2", ") is missing at 6"), ("(" * 21 + "1", "too deep"), ("+".join("1" * 52), "too many terms")],
)
def test_what_cannot_be_parsed_is_an_error(text, message):
    with pytest.raises(SyntaxError, match=re.escape(message)):
        Calculator(text).operations()


def test_the_depth_is_that_before_an_error():
    parser = Calculator("((1")
    with pytest.raises(SyntaxError):
        parser.operations()
    assert parser.depth == 0


def test_lists_take_commas_between_their_items():
    parser = Calculator("1, 2 + 3, 4)")
    assert parser.listed(")", parser.operations) == (1, 5, 4)
    parser = Calculator("1, 2 + 3")
    assert parser.series(parser.operations) == (1, 5)
    parser = Calculator("1 2)")
    with pytest.raises(SyntaxError, match=", is missing at 2"):
        parser.listed(")", parser.operations)


def test_the_last_token_stays_the_next_one():
    parser = Calculator("1")
    assert [parser.take().kind for _ in range(3)] == ["number", "end", "end"]
    assert parser.ahead(5).kind == "end"


@given(st.text(st.sampled_from("ab\n"), max_size=30), st.data())
def test_lines_and_columns_lead_back_to_the_offset(text, data):
    offset = data.draw(st.integers(0, len(text)))
    lines = TextLines(text)
    position = lines.position(offset)
    before = text.split("\n")[: position.line - 1]
    assert sum(len(line) + 1 for line in before) + position.column - 1 == position.offset == offset
    assert lines.line(offset) == text.split("\n")[position.line - 1]
    assert lines.number(offset) == position.line
