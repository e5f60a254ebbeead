"""C99 of numbers and elementwise operations, each in the order of `native.elementwise`, so that bits are equal."""

import math
from collections.abc import Callable

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.prepared import Precision

COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_BINARY = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_LIBRARY = {
    **{name: name for name in ("sqrt", "floor", "ceil", "exp", "log", "log10", "sin", "cos", "tan", "asin", "acos")},
    **{name: name for name in ("atan", "atan2", "sinh", "cosh", "tanh", "pow", "erf", "erfc")},
    "abs": "fabs",
}
OWN = ("min", "max", "mod", "round", "sign")  # written as functions of the exported code
MAX_SHORT_POWER = 16  # exponent up to which a whole power is written as products, as `native.emitter` does


@dataclass(frozen=True)
class CArithmetic:
    """Numbers and functions of the C library in one precision.

    >>> CArithmetic("float").literal(0.1), CArithmetic("double").literal(-2.0), CArithmetic("float").library("sqrt")
    ('0.1f', '-2.0', 'sqrtf')
    """

    precision: Precision

    @property
    def is_double(self) -> bool:
        """True for double precision."""
        return self.precision == "double"

    def literal(self, value: float) -> str:
        """Return a number as C writes it, with as many digits as determine its bits."""
        if math.isnan(value):
            return "NAN" if self.is_double else "(float)NAN"
        with np.errstate(over="ignore"):
            number = float(value) if self.is_double else np.float32(value)
        if math.isinf(number):
            return "-INFINITY" if number < 0 else "INFINITY"
        digits = repr(float(number)) if self.is_double else str(number)
        digits = digits if any(letter in digits for letter in ".e") else f"{digits}.0"
        return digits if self.is_double else f"{digits}f"

    def operand(self, value: float) -> str:
        """Return a number as an operand, in parentheses if it has a sign."""
        text = self.literal(value)
        return f"({text})" if text.startswith("-") else text

    def library(self, name: str) -> str:
        """Return the name of a function of the C library."""
        return name if self.is_double else f"{name}f"

    @property
    def zero(self) -> str:
        """The number 0."""
        return self.literal(0.0)

    @property
    def one(self) -> str:
        """The number 1."""
        return self.literal(1.0)

    def elementwise(self, op: str, args: tuple[str, ...], own: Callable[[str], str]) -> str:
        """Return the expression of an operation on doubles; `own(name)` is the name of a function of the code."""
        if op in _BINARY:
            return f"{args[0]} {_BINARY[op]} {args[1]}"
        if op == "neg":
            return f"-{args[0]}"
        if op == "guard":
            return f"({args[0]} == {self.zero}) ? {self.zero} : ({args[0]} * {args[1]})"
        if op == "single":
            return f"(double)(float){args[0]}" if self.is_double else args[0]
        name = own(op) if op in OWN else self.library(_LIBRARY[op])
        return f"{name}({', '.join(args)})"


def power_products(base: str, exponent: int, name: str) -> tuple[list[tuple[str, str]], str]:
    """Return (variable, expression) of squares, and the product that is a whole power >= 1, by repeated squaring.

    >>> power_products("v1", 5, "q")
    ([('q_2', 'v1 * v1'), ('q_4', 'q_2 * q_2')], 'v1 * q_4')
    """
    squares: list[tuple[str, str]] = []
    factors: list[str] = []
    square, size = base, 1
    while exponent:
        if exponent & 1:
            factors.append(square)
        exponent >>= 1
        if exponent:
            size *= 2
            squares.append((f"{name}_{size}", f"{square} * {square}"))
            square = squares[-1][0]
    product = factors[0]
    for factor in factors[1:]:
        product = f"({product} * {factor})" if factor is not factors[-1] else f"{product} * {factor}"
    return squares, product
