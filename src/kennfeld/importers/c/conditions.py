"""Conditions of #if: integers, and the operators of C."""

import operator
import re
from collections.abc import Callable, Sequence
from typing import Final

from kennfeld.importers.c.macros import tokens_of
from kennfeld.program.operator_parser import OperatorParser, operator_levels
from kennfeld.program.tokens import ScannedToken

_MAX_DEPTH: Final = 50
_MAX_BITS: Final = 4096  # of results in between, which C would cut off
_LEVELS: Final = operator_levels(
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("==", "!="), ("<", "<=", ">", ">="), ("<<", ">>"), ("+", "-"),
    ("*", "/", "%"),
)  # fmt: skip
_RULES: Final[dict[str, Callable[[int, int], int]]] = {
    "||": lambda a, b: int(bool(a or b)), "&&": lambda a, b: int(bool(a and b)), "|": operator.or_,
    "^": operator.xor, "&": operator.and_, "==": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le,
    ">": operator.gt, ">=": operator.ge, "<<": lambda a, b: a << (b % 64), ">>": lambda a, b: a >> (b % 64),
    "+": operator.add, "-": operator.sub, "*": operator.mul,
    # towards 0 as in C; a division by 0 may be in a side of || that does not count
    "/": lambda a, b: abs(a) // abs(b) * (1 if a * b >= 0 else -1) if b else 0,
    "%": lambda a, b: abs(a) % abs(b) * (1 if a >= 0 else -1) if b else 0,
}  # fmt: skip
_SIGNS: Final[dict[str, Callable[[int], int]]] = {
    "!": lambda a: int(not a), "-": operator.neg, "+": operator.pos, "~": operator.invert,
}  # fmt: skip
_DOUBLE: Final = frozenset({"||", "&&", "==", "!=", "<=", ">=", "<<", ">>"})


class ConditionError(Exception):
    """A condition that is not an expression of integers."""


def condition_value(text: str) -> int:
    """Evaluate a condition whose macros are replaced; names that are left count as 0.

    >>> condition_value("(2 + 1 > 2) && !0x0u"), condition_value("UNKNOWN"), condition_value("1 ? 4 : 5")
    (1, 0, 4)

    Raises:
        ConditionError: it is not an expression of integers.
    """
    words = _joined([token for token in tokens_of(text) if not token.isspace()])
    parser = _ConditionParser([*(ScannedToken("word", word) for word in words), ScannedToken("end", "")])
    value = parser.conditional()
    if parser.token.kind != "end":
        raise ConditionError(f"unexpected {parser.token.text[:20]}")
    return value


def _joined(tokens: Sequence[str]) -> list[str]:
    """Return tokens with operators of two characters as one."""
    result: list[str] = []
    for token in tokens:
        if result and result[-1] + token in _DOUBLE:
            result[-1] += token
        else:
            result.append(token)
    return result


class _ConditionParser(OperatorParser[ScannedToken, int]):
    """Computes the value while it reads the operators."""

    levels = _LEVELS
    word_kinds = ("word",)
    max_depth = _MAX_DEPTH

    def take(self) -> ScannedToken:
        token = self.tokens[self.at]
        if token.kind == "end":
            raise ConditionError("the condition ends too early")
        self.at += 1
        return token

    def too_deep(self) -> ConditionError:
        is_in_brackets = self.tokens[self.at - 1].text in ("(", "?", ":")
        return ConditionError("too many brackets" if is_in_brackets else "too many operators")

    def conditional(self) -> int:
        value = self.operations()
        if not self.accept("?"):
            return value
        yes = self.nested(self.conditional)
        if self.take().text != ":":
            raise ConditionError("? without :")
        no = self.nested(self.conditional)
        return yes if value else no

    def joined(self, left: int, level: int) -> int:
        rule = _RULES[self.take().text]
        value = int(rule(left, self.operations(level + 1)))
        # repeated shifts and products would fill the memory
        if value.bit_length() > _MAX_BITS:
            raise ConditionError("a number is too large")
        return value

    def operand(self, lowest: int = 0) -> int:
        word = self.take().text
        if word in _SIGNS:
            return _SIGNS[word](self.nested(self.operand))
        if word != "(":
            return _number(word)
        value = self.nested(self.conditional)
        if self.take().text != ")":
            raise ConditionError("a closing bracket is missing")
        return value


def _number(token: str) -> int:
    # names that are left after the macros are replaced count as 0 (C99, 6.10.1)
    if re.fullmatch(r"[A-Za-z_]\w*", token):
        return 0
    match = re.fullmatch(r"(0[xX][0-9a-fA-F]{1,16}|\d{1,20})[uUlL]*", token)
    if match is None:
        raise ConditionError(f"{token[:20]} is not an integer")
    digits = match[1]
    try:
        return int(digits, 16 if digits[:2] in ("0x", "0X") else 8 if digits[0] == "0" and len(digits) > 1 else 10)
    except ValueError:
        raise ConditionError(f"{token[:20]} is not an integer") from None
