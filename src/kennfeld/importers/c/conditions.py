"""Conditions of #if: integers, and the operators of C."""

import operator
import re
from collections.abc import Callable, Sequence
from typing import Final

from kennfeld.importers.c.macros import tokens_of

_MAX_DEPTH: Final = 50
_MAX_BITS: Final = 4096  # of results in between, which C would cut off
_LEVELS: Final[tuple[tuple[str, ...], ...]] = (
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("==", "!="), ("<", "<=", ">", ">="), ("<<", ">>"), ("+", "-"),
    ("*", "/", "%"),
)  # fmt: skip
_RULES: Final[dict[str, Callable[[int, int], int]]] = {
    "||": lambda a, b: int(bool(a or b)), "&&": lambda a, b: int(bool(a and b)), "|": operator.or_,
    "^": operator.xor, "&": operator.and_, "==": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le,
    ">": operator.gt, ">=": operator.ge, "<<": lambda a, b: a << (b % 64), ">>": lambda a, b: a >> (b % 64),
    "+": operator.add, "-": operator.sub, "*": operator.mul,
    "/": lambda a, b: abs(a) // abs(b) * (1 if a * b >= 0 else -1) if b else 0,
    "%": lambda a, b: abs(a) % abs(b) * (1 if a >= 0 else -1) if b else 0,
}  # fmt: skip
_DOUBLE: Final = frozenset({"||", "&&", "==", "!=", "<=", ">=", "<<", ">>"})


class ConditionError(Exception):
    """A condition that is not an expression of integers."""


def condition_value(text: str) -> int:
    """Return the value of a condition whose macros are replaced; names that are left count as 0.

    >>> condition_value("(2 + 1 > 2) && !0x0u"), condition_value("UNKNOWN"), condition_value("1 ? 4 : 5")
    (1, 0, 4)

    Raises:
        ConditionError: it is not an expression of integers.
    """
    parser = _Parser(_joined([token for token in tokens_of(text) if not token.isspace()]))
    value = parser.conditional(0)
    if parser.tokens:
        raise ConditionError(f"unexpected {parser.tokens[0][:20]}")
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


class _Parser:
    def __init__(self, tokens: list[str]) -> None:
        self.tokens = tokens

    def _next(self) -> str:
        if not self.tokens:
            raise ConditionError("the condition ends too early")
        return self.tokens.pop(0)

    def conditional(self, depth: int) -> int:
        if depth > _MAX_DEPTH:
            raise ConditionError("too many brackets")
        value = self._binary(0, depth)
        if self.tokens[:1] != ["?"]:
            return value
        self._next()
        yes = self.conditional(depth + 1)
        if self._next() != ":":
            raise ConditionError("? without :")
        no = self.conditional(depth + 1)
        return yes if value else no

    def _binary(self, level: int, depth: int) -> int:
        if level == len(_LEVELS):
            return self._unary(depth)
        value = self._binary(level + 1, depth)
        while self.tokens and self.tokens[0] in _LEVELS[level]:
            rule = _RULES[self._next()]
            value = int(rule(value, self._binary(level + 1, depth)))
            if value.bit_length() > _MAX_BITS:
                raise ConditionError("a number is too large")
        return value

    def _unary(self, depth: int) -> int:
        if depth > _MAX_DEPTH:
            raise ConditionError("too many operators")
        token = self._next()
        match token:
            case "!":
                return int(not self._unary(depth + 1))
            case "-":
                return -self._unary(depth + 1)
            case "+":
                return self._unary(depth + 1)
            case "~":
                return ~self._unary(depth + 1)
            case "(":
                value = self.conditional(depth + 1)
                if self._next() != ")":
                    raise ConditionError("a closing bracket is missing")
                return value
        return _number(token)


def _number(token: str) -> int:
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
