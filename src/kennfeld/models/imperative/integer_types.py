"""Integer types of a given number of bits, with rounding, saturation and wrapping."""

import re
from typing import Final

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, elementwise, truncate

EXACT: Final = 52  # bits of words whose numbers doubles know exactly
_INTEGER = re.compile(r"(u?)int(8|16|32|64)\Z")
_FIXED = re.compile(r"fixdt\(\s*([01])\s*,\s*(\d{1,3})\s*(?:,\s*0\s*)?\)\Z")


@dataclass(frozen=True)
class IntegerType:
    """An integer type of `bits` bits, one of them for the sign if signed.

    `rounding` and `saturates` define the conversion of other numbers, in the terms of a Simulink block.
    """

    bits: int
    signed: bool
    rounding: str = "Floor"
    saturates: bool = False

    @property
    def least(self) -> int:
        """The smallest number.

        >>> IntegerType(8, True).least
        -128
        """
        return -(1 << (self.bits - 1)) if self.signed else 0

    @property
    def most(self) -> int:
        """The largest number."""
        return self.least + (1 << self.bits) - 1

    def wrapped(self, number: int) -> int:
        """Return the number represented by the lowest bits of another one.

        >>> IntegerType(8, True).wrapped(217), IntegerType(8, False).wrapped(-1)
        (-39, 255)
        """
        return (number - self.least) % (1 << self.bits) + self.least


def integer_type_named(written: str) -> IntegerType | None:
    """Return the integer type of a name, such as `int8` or `fixdt(1,8)`.

    >>> integer_type_named("uint16").bits
    16
    """
    if result := _INTEGER.match(written):
        return IntegerType(int(result[2]), result[1] == "")
    fixed = _FIXED.match(written)
    return IntegerType(int(fixed[2]), fixed[1] == "1") if fixed else None


def fit_to_type(builder: GraphBuilder, x: Nodes, word: IntegerType) -> Nodes:
    """Convert numbers to an integer type; with more than 52 bits they are only rounded."""
    whole = _round(Elementwise(builder), x, word.rounding)
    if word.bits > EXACT:
        return whole
    if word.saturates:
        return elementwise(builder, "min", elementwise(builder, "max", whole, float(word.least)), float(word.most))
    return wrap_to_type(builder, whole, word)


def wrap_to_type(builder: GraphBuilder, whole: Nodes, word: IntegerType) -> Nodes:
    """Return the numbers represented by the lowest bits of integers."""
    apply, span, half = Elementwise(builder), 2.0**word.bits, 2.0 ** (word.bits - 1)
    if not word.signed:
        return apply("mod", whole, span)
    return apply("sub", apply("mod", apply("add", whole, half), span), half)


def _round(apply: Elementwise, x: Nodes, rounding: str) -> Nodes:
    match rounding:
        case "Ceiling":
            return apply("ceil", x)
        case "Zero" | "Simplest":
            return truncate(apply.builder, x)
        case "Nearest":
            return apply("floor", apply("add", x, 0.5))
        case "Round":
            return apply("round", x)
        case "Convergent":
            near = apply("floor", apply("add", x, 0.5))
            is_odd = apply("ne", apply("mod", near, 2.0), 0.0)
            is_tie = apply("eq", apply("sub", near, x), 0.5)
            return apply("sub", near, apply("and", is_tie, is_odd))
    return apply("floor", x)
