"""Formulas of conversions in one raw value, as A2L and MDF files state them.

They are arithmetic in X1 or X: numbers, + - * / and functions. Python parses them, but never evaluates them. The
operator ^ is a power in older versions of ASAM MCD-2 MC and an exclusive or in newer ones, and `log` has the base e or
10; formulas with them are not supported.
"""

import ast
import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.base.arrays import Float

Formula = Callable[[Float], Float]

_TOKEN = re.compile(r"\s*(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|[-+*/(),])\s*")
_NAMES = ("abs", "arccos", "arcsin", "arctan", "cos", "exp", "sin", "sqrt", "tan")
_FUNCTIONS: dict[str, np.ufunc] = {name: getattr(np, name) for name in _NAMES}
_FUNCTIONS |= {"acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "pow": np.power}
_OPERATORS: dict[type[ast.AST], np.ufunc] = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply}
_OPERATORS |= {ast.Div: np.divide, ast.UAdd: np.positive, ast.USub: np.negative}
_MAX_CHARACTERS, _MAX_TOKENS = 2000, 300


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
    # what no token covers, or lies beyond the limit, is missing in the tokens joined
    tokens = _TOKEN.findall(text[: _MAX_CHARACTERS + 1])
    if "".join(tokens) != text or len(tokens) > _MAX_TOKENS:
        return None
    try:
        # Blanks between the tokens part what is an operator or a number of Python only: ** // 0x1
        formula = _compile(ast.parse(" ".join(map(str.strip, tokens)), mode="eval").body)
    except (_UnsupportedFormulaError, SyntaxError, RecursionError, MemoryError):
        return None

    def value(raw: Float) -> Float:
        with np.errstate(all="ignore"):
            result = np.asarray(formula(np.asarray(raw, np.float64)), np.float64)
            return nan_if_infinite(np.broadcast_to(result, np.shape(raw)))

    return value


def nan_if_infinite(values: Float) -> Float:
    """Return the values, Float[any], with NaN in place of infinite ones."""
    return np.where(np.isfinite(values), values, np.nan)


def _compile(node: ast.expr) -> Formula:
    match node:
        # `True` is an int to Python
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            constant = _nearest_float(number)
            return lambda raw: np.full(np.shape(raw), constant)
        case ast.Name(id=name) if name.casefold() in ("x", "x1"):
            return lambda raw: raw
        case ast.UnaryOp(op=operator, operand=operand) if type(operator) in _OPERATORS:
            return _call(_OPERATORS[type(operator)], [operand])
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
            return _call(_OPERATORS[type(operator)], [left, right])
        case ast.Call(func=ast.Name(id=name), args=operands, keywords=[]) if name.casefold() in _FUNCTIONS:
            return _call(_FUNCTIONS[name.casefold()], operands)
    raise _UnsupportedFormulaError


def _nearest_float(number: float) -> float:
    """Return a number as float64: an integer beyond its range is infinite, as `1e400` is."""
    try:
        return float(number)
    except OverflowError:
        return math.inf


def _call(function: np.ufunc, operands: Sequence[ast.expr]) -> Formula:
    # NumPy would take a further operand for the array that receives the result
    if len(operands) != function.nin:
        raise _UnsupportedFormulaError
    arguments = list(map(_compile, operands))
    return lambda raw: function(*(argument(raw) for argument in arguments))
