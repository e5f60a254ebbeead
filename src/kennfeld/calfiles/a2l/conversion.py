"""Conversions (COMPU_METHOD) between raw and physical values, by ASAM MCD-2 MC.

    LINEAR a b              physical = a raw + b
    RAT_FUNC a b c d e f    raw = (a p^2 + b p + c) / (d p^2 + e p + f),   p physical

A conversion without a unique inverse has none here; nothing is guessed.

Formulas are arithmetic in one raw value X1, parsed here and never evaluated by Python:

    sum     := product (("+" | "-") product)*
    product := factor (("*" | "/") factor)*
    factor  := ("+" | "-") factor | number | "X1" | "X" | name "(" sum ("," sum)* ")" | "(" sum ")"

The operator ^ is a power in older versions of the standard and an exclusive or in newer ones, and `log` has the base
e or 10; formulas with them are not supported.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.a2l.objects import A2l, CompuMethod, CompuTab, CompuVtab
from kennfeld.calfiles.a2l.syntax import A2lError

Formula = Callable[[Float], Float]

_TOKEN = re.compile(r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|[-+*/(),])\s*")
_FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
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
_MAX_NESTING = 50  # brackets within each other
_MAX_CHARACTERS, _MAX_TOKENS = 2000, 300  # characters, tokens

Numbers = Callable[[Float], Float]


class _UnsupportedFormulaError(Exception):
    pass


def parse_formula(text: str) -> Formula | None:
    """Return the function of a formula, None if it is empty or not supported.

    What has no finite value gives NaN.

    >>> parse_formula("(X1 + 4) * 2")(np.array([1.0])).tolist()
    [10.0]
    >>> parse_formula("X1 ^ 2") is None
    True
    """
    try:
        parser = _ArithmeticParser(_tokens(text))
        found = parser.sum(0)
        if parser.at != len(parser.tokens) or len(parser.tokens) > _MAX_TOKENS:
            return None
    except _UnsupportedFormulaError:
        return None

    def value(raw: Float) -> Float:
        with np.errstate(all="ignore"):
            given = np.broadcast_to(np.asarray(found(np.asarray(raw, np.float64)), np.float64), np.shape(raw))
            return np.where(np.isfinite(given), given, np.nan)

    return value


def _tokens(text: str) -> list[str]:
    tokens, at = [], 0
    while at < len(text) and len(text) <= _MAX_CHARACTERS:
        match = _TOKEN.match(text, at)
        if match is None:
            raise _UnsupportedFormulaError
        tokens.append(match[1])
        at = match.end()
    return tokens


class _ArithmeticParser:
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
            left = _combine(np.add if sign == "+" else np.subtract, left, self._product(depth))
        return left

    def _product(self, depth: int) -> Formula:
        left = self._factor(depth)
        while sign := self._take("*", "/"):
            left = _combine(np.multiply if sign == "*" else np.divide, left, self._factor(depth))
        return left

    def _factor(self, depth: int) -> Formula:
        if depth > _MAX_NESTING:
            raise _UnsupportedFormulaError
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
        if word.casefold() in _FUNCTIONS:
            return self._call(word.casefold(), depth)
        return _parse_constant(word)

    def _call(self, name: str, depth: int) -> Formula:
        if not self._take("("):
            raise _UnsupportedFormulaError
        count, function = _FUNCTIONS[name]
        arguments = [self.sum(depth + 1)]
        while self._take(","):
            arguments.append(self.sum(depth + 1))
        self._closed()
        if len(arguments) != count:
            raise _UnsupportedFormulaError
        return lambda raw: function(*(argument(raw) for argument in arguments))

    def _closed(self) -> None:
        if not self._take(")"):
            raise _UnsupportedFormulaError


def _combine(function: Callable[..., Any], left: Formula, right: Formula) -> Formula:
    return lambda raw: function(left(raw), right(raw))


def _parse_constant(word: str) -> Formula:
    try:
        value = float(word)
    except ValueError:
        raise _UnsupportedFormulaError from None
    return lambda raw: np.full(np.shape(raw), value)


@dataclass(frozen=True)
class VerbalConversion:
    """Texts assigned to raw values."""

    table: CompuVtab

    def text(self, raw: float) -> str | None:
        """Return the word of a raw number, None if there is none."""
        for least, most, word in self.table.ranges:
            if least <= raw <= most:
                return word
        return self.table.default

    def raw(self, text: str) -> float | None:
        """Return the least raw number that a word stands for."""
        return next((least for least, _, word in self.table.ranges if word == text), None)


@dataclass(frozen=True)
class CompuConversion:
    """One conversion, ready to use; `raw` is None if it has no inverse. NaN stands for what has no value."""

    name: str
    unit: str
    physical: Numbers
    raw: Numbers | None
    words: VerbalConversion | None = None


def conversion_of(a2l: A2l, name: str, lower: float, upper: float) -> CompuConversion:
    """Return the conversion of an object within physical limits. Raises `A2lError`."""
    if name in ("NO_COMPU_METHOD", ""):
        return CompuConversion(name, "", _identity, _identity)
    method = a2l.compu_methods.get(name)
    if method is None:
        raise A2lError(f"has the conversion {name[:60]}, which is not defined")
    physical, raw, words = _functions(a2l, method, lower, upper)
    return CompuConversion(name, method.unit, physical, raw, words)


def _identity(values: Float) -> Float:
    return values


def _functions(
    a2l: A2l, method: CompuMethod, lower: float, upper: float
) -> tuple[Numbers, Numbers | None, VerbalConversion | None]:
    if method.kind == "IDENTICAL":
        return _identity, _identity, None
    if method.kind == "LINEAR":
        return *_linear(*method.coeffs), None
    if method.kind == "RAT_FUNC":
        return *_rational(method, lower, upper), None
    if method.kind in ("TAB_INTP", "TAB_NOINTP", "TAB_VERB"):
        return _table_conversion(a2l, method)
    if method.kind == "FORM":
        return *_formula(method), None
    raise A2lError(f"has the conversion {method.name} of the unknown kind {method.kind[:40]!r}")


def _linear(slope: float, offset: float) -> tuple[Numbers, Numbers | None]:
    def raw(values: Float) -> Float:
        return (values - offset) / slope

    return lambda values: slope * values + offset, raw if slope else None


def _rational(method: CompuMethod, lower: float, upper: float) -> tuple[Numbers, Numbers]:
    a, b, c, d, e, f = method.coeffs

    def raw(values: Float) -> Float:
        with np.errstate(all="ignore"):
            return _nan_if_infinite(((a * values + b) * values + c) / ((d * values + e) * values + f))

    def physical(values: Float) -> Float:
        with np.errstate(all="ignore"):
            return _nan_if_infinite((f * values - c) / (b - e * values))

    if not (a or b or d or e):
        raise A2lError(f"has the conversion {method.name}, which has no physical value")
    if b * f == c * e and not (a or d):
        raise A2lError(f"has the conversion {method.name}, which maps every value to the same raw value")
    return (partial(_root, method.coeffs, lower, upper), raw) if a or d else (physical, raw)


def _root(coeffs: tuple[float, ...], lower: float, upper: float, values: Float) -> Float:
    """Return the root of the quadratic within the limits, NaN if none or both are."""
    a, b, c, d, e, f = coeffs
    two, one, none = a - d * values, b - e * values, c - f * values
    with np.errstate(all="ignore"):
        whole = -0.5 * (one + np.where(one < 0, -1.0, 1.0) * np.sqrt(one * one - 4 * two * none))
        roots = _nan_if_infinite(np.stack([whole / two, none / whole]))
    slack = 1e-9 * (np.abs(roots) + 1e-300)
    inside = (roots >= lower - slack) & (roots <= upper + slack)
    same = np.isclose(roots[0], roots[1], rtol=1e-12, atol=0)
    inside[1] &= ~(inside[0] & same)
    return np.where(inside.sum(axis=0) == 1, np.where(inside[0], roots[0], roots[1]), np.nan)


def _nan_if_infinite(values: Float) -> Float:
    return np.where(np.isfinite(values), values, np.nan)


def _table_conversion(a2l: A2l, method: CompuMethod) -> tuple[Numbers, Numbers | None, VerbalConversion | None]:
    words = a2l.compu_vtabs.get(method.table)
    if words is not None:
        return _identity, _identity, VerbalConversion(words)
    table = a2l.compu_tabs.get(method.table)
    if table is None or not table.raw:
        raise A2lError(f"has the conversion {method.name}, whose table {method.table[:60]!r} is not defined")
    if method.kind == "TAB_VERB":
        raise A2lError(f"has the conversion {method.name}, whose table {table.name} contains no texts")
    if any(np.diff(table.raw) <= 0):
        raise A2lError(f"has the conversion {method.name}, whose table {table.name} contains a raw value twice")
    return *(_interpolating_table(table) if method.kind == "TAB_INTP" else _exact_table(table)), None


def _interpolating_table(table: CompuTab) -> tuple[Numbers, Numbers | None]:
    raw, physical = np.array(table.raw), np.array(table.physical)
    outside = np.nan if table.default is None else table.default
    steps = np.diff(physical)
    forwards = _interpolation(raw, physical, outside)
    if np.all(steps > 0):
        return forwards, _interpolation(physical, raw, np.nan)
    if np.all(steps < 0):
        return forwards, _interpolation(physical[::-1], raw[::-1], np.nan)
    return forwards, None


def _interpolation(given: Float, wanted: Float, outside: float) -> Numbers:
    def value(numbers: Float) -> Float:
        return np.asarray(np.interp(numbers, given, wanted, left=outside, right=outside), dtype=np.float64)

    return value


def _exact_table(table: CompuTab) -> tuple[Numbers, Numbers]:
    raw, physical = np.array(table.raw), np.array(table.physical)
    order = np.argsort(physical, kind="stable")
    missing = np.nan if table.default is None else table.default

    def forwards(values: Float) -> Float:
        at = np.clip(np.searchsorted(raw, values), 0, raw.size - 1)
        return np.where(raw[at] == values, physical[at], missing)

    def back(values: Float) -> Float:
        """Return the raw value of the closest physical one."""
        known = physical[order]
        right = np.clip(np.searchsorted(known, values), 0, known.size - 1)
        left = np.clip(right - 1, 0, known.size - 1)
        closer = np.where(np.abs(known[left] - values) <= np.abs(known[right] - values), left, right)
        return raw[order][closer]

    return forwards, back


def _formula(method: CompuMethod) -> tuple[Numbers, Numbers | None]:
    if not method.formula:
        raise A2lError(f"has the conversion {method.name}, which has no FORMULA")
    forwards, back = parse_formula(method.formula), parse_formula(method.formula_inverse)
    if forwards is None:
        message = f"has the conversion {method.name}, whose formula {method.formula[:60]!r} is not supported"
        raise A2lError(message)
    return forwards, back
