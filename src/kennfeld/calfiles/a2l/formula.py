"""Formulas of conversions: arithmetic over one raw number X1, parsed, never evaluated by Python.

    sum     := product (("+" | "-") product)*
    product := factor (("*" | "/") factor)*
    factor  := ("+" | "-") factor | number | "X1" | "X" | name "(" sum ("," sum)* ")" | "(" sum ")"

The sign ^ means a power in older versions of the standard and an exclusive or in newer ones, and `log` is of the base
e or 10; a formula with them is not followed.
"""

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float

__all__ = ["arithmetic"]

Formula = Callable[[Float], Float]

_TOKEN = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|[-+*/(),])\s*")
_NAMED: dict[str, tuple[int, Callable[..., Any]]] = {
    "abs": (1, np.abs),
    "acos": (1, np.arccos),
    "arccos": (1, np.arccos),
    "arcsin": (1, np.arcsin),
    "arctan": (1, np.arctan),
    "asin": (1, np.arcsin),
    "atan": (1, np.arctan),
    "cos": (1, np.cos),
    "exp": (1, np.exp),
    "pow": (2, np.power),
    "sin": (1, np.sin),
    "sqrt": (1, np.sqrt),
    "tan": (1, np.tan),
}
_DEEPEST = 50  # brackets within each other
_LONGEST, _MOST = 2000, 300  # characters, tokens


class _WrongError(Exception):
    pass


def arithmetic(text: str) -> Formula | None:
    """The function that a formula describes, None where it is empty or has something else in it.

    What has no finite value gives NaN.

    >>> arithmetic("(X1 + 4) * 2")(np.array([1.0])).tolist()
    [10.0]
    >>> arithmetic("X1 ^ 2") is None
    True
    """
    try:
        parser = _Parser(_tokens(text))
        found = parser.sum(0)
        if parser.at != len(parser.tokens) or len(parser.tokens) > _MOST:
            return None
    except _WrongError:
        return None

    def value(raw: Float) -> Float:
        with np.errstate(all="ignore"):
            given = np.broadcast_to(np.asarray(found(np.asarray(raw, np.float64)), np.float64), np.shape(raw))
            return np.where(np.isfinite(given), given, np.nan)

    return value


def _tokens(text: str) -> list[str]:
    tokens, at = [], 0
    while at < len(text) and len(text) <= _LONGEST:
        found = _TOKEN.match(text, at)
        if found is None:
            raise _WrongError
        tokens.append(found[1])
        at = found.end()
    return tokens


class _Parser:
    def __init__(self, tokens: Sequence[str]) -> None:
        self.tokens, self.at = tokens, 0

    def _next(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def _take(self, *wanted: str) -> str:
        word = self._next()
        if word not in wanted:
            return ""
        self.at += 1
        return word

    def sum(self, depth: int) -> Formula:
        left = self._product(depth)
        while sign := self._take("+", "-"):
            left = _joined(np.add if sign == "+" else np.subtract, left, self._product(depth))
        return left

    def _product(self, depth: int) -> Formula:
        left = self._factor(depth)
        while sign := self._take("*", "/"):
            left = _joined(np.multiply if sign == "*" else np.divide, left, self._factor(depth))
        return left

    def _factor(self, depth: int) -> Formula:
        if depth > _DEEPEST:
            raise _WrongError
        if sign := self._take("+", "-"):
            inner = self._factor(depth + 1)
            return inner if sign == "+" else lambda raw: -inner(raw)
        if self._take("("):
            inner = self.sum(depth + 1)
            self._closed()
            return inner
        word = self._next()
        self.at += 1
        if word.casefold() in ("x", "x1"):
            return lambda raw: raw
        if word.casefold() in _NAMED:
            return self._call(word.casefold(), depth)
        return _constant(word)

    def _call(self, name: str, depth: int) -> Formula:
        if not self._take("("):
            raise _WrongError
        count, function = _NAMED[name]
        arguments = [self.sum(depth + 1)]
        while self._take(","):
            arguments.append(self.sum(depth + 1))
        self._closed()
        if len(arguments) != count:
            raise _WrongError
        return lambda raw: function(*(argument(raw) for argument in arguments))

    def _closed(self) -> None:
        if not self._take(")"):
            raise _WrongError


def _joined(function: Callable[..., Any], left: Formula, right: Formula) -> Formula:
    return lambda raw: function(left(raw), right(raw))


def _constant(word: str) -> Formula:
    try:
        value = float(word)
    except ValueError:
        raise _WrongError from None
    return lambda raw: np.full(np.shape(raw), value)
