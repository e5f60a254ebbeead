"""Integer types: how many bits a number has, and which whole number a type makes of another one."""

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, truncate

__all__ = ["EXACT", "IntegerType", "fitted", "word_named", "wrapped"]

EXACT: Final = 52  # bits of words whose numbers doubles know exactly
_INTEGER = re.compile(r"(u?)int(8|16|32|64)\Z")
_FIXED = re.compile(r"fixdt\(\s*([01])\s*,\s*(\d{1,3})\s*(?:,\s*0\s*)?\)\Z")


@dataclass(frozen=True)
class IntegerType:
    """An integer type: how many bits, and whether one of them is a sign.

    `rounding` and `saturates` say how whole numbers are made of others, in the words of a block.
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
        """The number that the lowest bits of another one are.

        >>> IntegerType(8, True).wrapped(217), IntegerType(8, False).wrapped(-1)
        (-39, 255)
        """
        return (number - self.least) % (1 << self.bits) + self.least


def word_named(written: str) -> IntegerType | None:
    """The integer type of a name, such as `int8` or `fixdt(1,8)`.

    >>> word_named("uint16").bits
    16
    """
    if found := _INTEGER.match(written):
        return IntegerType(int(found[2]), found[1] == "")
    fixed = _FIXED.match(written)
    return IntegerType(int(fixed[2]), fixed[1] == "1") if fixed else None


def fitted(builder: GraphBuilder, x: Nodes, word: IntegerType) -> Nodes:
    """Numbers as those of an integer type; those of more than 52 bits are only made whole."""
    whole = _rounded(builder, x, word.rounding)
    if word.bits > EXACT:
        return whole
    if word.saturates:
        bounded = elementwise(builder, "max", whole, _constant(builder, float(word.least)))
        return elementwise(builder, "min", bounded, _constant(builder, float(word.most)))
    return wrapped(builder, whole, word)


def wrapped(builder: GraphBuilder, whole: Nodes, word: IntegerType) -> Nodes:
    """The numbers that the lowest bits of whole numbers are."""
    span = _constant(builder, 2.0**word.bits)
    if not word.signed:
        return elementwise(builder, "mod", whole, span)
    half = _constant(builder, 2.0 ** (word.bits - 1))
    return elementwise(
        builder, "sub", elementwise(builder, "mod", elementwise(builder, "add", whole, half), span), half
    )


def _rounded(builder: GraphBuilder, x: Nodes, way: str) -> Nodes:
    """Numbers made whole in the way that a block states."""
    match way:
        case "Ceiling":
            return elementwise(builder, "ceil", x)
        case "Zero" | "Simplest":
            return truncate(builder, x)
        case "Nearest":
            return elementwise(builder, "floor", elementwise(builder, "add", x, _constant(builder, 0.5)))
        case "Round":
            return elementwise(builder, "round", x)
        case "Convergent":
            half = _constant(builder, 0.5)
            near = elementwise(builder, "floor", elementwise(builder, "add", x, half))
            is_odd = elementwise(
                builder, "ne", elementwise(builder, "mod", near, _constant(builder, 2.0)), _constant(builder, 0.0)
            )
            is_tie = elementwise(builder, "eq", elementwise(builder, "sub", near, x), half)
            return elementwise(builder, "sub", near, elementwise(builder, "and", is_tie, is_odd))
    return elementwise(builder, "floor", x)


def _constant(builder: GraphBuilder, value: float) -> Nodes:
    return np.array(builder.const(value), dtype=np.int64)
