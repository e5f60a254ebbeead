"""The parts of floating-point numbers on node arrays: exponents of two, mantissas, and whole parts, as in C."""

import math
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.exact_arithmetic import copy_sign, remainder, rounded_product, with_infinite
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate

_LARGEST_SHIFT: Final = 2100.0  # takes the least double to infinity, and the largest one to 0
_PLAIN_SHIFT: Final = 1000.0  # 2^n is a double
_LARGEST_FACTOR: Final = 1e150  # whose square and halves are doubles


def scaled(builder: GraphBuilder, x: Nodes, exponent: Nodes) -> Nodes:
    """Compute x 2^n for an integer n, as `ldexp` of C; exact unless the result is below the normal numbers."""
    apply = Elementwise(builder)
    values = [builder.value(int(node)) for node in exponent.ravel()]
    if all(value is not None and abs(value) <= _PLAIN_SHIFT for value in values):
        return apply("mul", x, apply("pow", 2.0, exponent))
    # 2^n itself may be infinite or 0 where x 2^n is neither: three factors whose exponents are n together
    limited = apply("max", apply("min", exponent, _LARGEST_SHIFT), -_LARGEST_SHIFT)
    third = truncate(builder, apply("div", limited, 3.0))
    rest = apply("sub", limited, apply("mul", 2.0, third))
    for power in (third, third, rest):
        x = apply("mul", x, apply("pow", 2.0, power))
    return x


def exponent_of(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute the n for which |x| is in [2^(n - 1), 2^n), as `frexp` of C; 0 for 0 and for numbers that are not finite.

    Its slope is 0.
    """
    apply = Elementwise(builder)
    size = apply("abs", x)
    is_plain = apply("and", apply("gt", size, 0.0), apply("lt", size, math.inf))
    size = apply("select", is_plain, size, 1.0)
    # the logarithm may be rounded across an integer, which the quotient shows
    near = apply("floor", apply("div", apply("log", size), math.log(2.0)))
    quotient = scaled(builder, size, apply("neg", near))
    above = apply("sub", apply("ge", quotient, 2.0), apply("lt", quotient, 1.0))
    return apply("select", is_plain, apply("add", apply("add", near, above), 1.0), 0.0)


def mantissa_of(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute x 2^-n, n of `exponent_of`: of a size in [0.5, 1), or x itself if it is 0 or not finite."""
    apply = Elementwise(builder)
    return scaled(builder, x, apply("neg", exponent_of(builder, x)))


def logarithm_of_exponent(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute the exponent of the first digit of x to the base 2, as `logb` of C: -inf for 0, inf for infinity."""
    apply = Elementwise(builder)
    size = apply("abs", x)
    exponent = apply("sub", exponent_of(builder, x), 1.0)
    exponent = apply("select", apply("eq", size, 0.0), -math.inf, exponent)
    return apply("select", apply("lt", size, math.inf), exponent, size)


def fraction_of(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute x less its whole part, with the sign of x, as `modf` of C; 0 for infinity."""
    apply = Elementwise(builder)
    rest = apply("select", apply("eq", apply("abs", x), math.inf), 0.0, apply("sub", x, truncate(builder, x)))
    return copy_sign(builder, rest, x)


def next_number(builder: GraphBuilder, x: Nodes, y: Nodes, *, is_single: bool = False) -> Nodes:
    """Compute the number next to x in the direction of y, as `nextafter` of C, in double or single precision.

    Its slope along x is 1.
    """
    apply = Elementwise(builder)
    digits, least, largest = (24.0, 2.0**-149, 2.0**128 - 2.0**104) if is_single else (53.0, 2.0**-1074, math.nan)
    size = apply("abs", x)
    is_outward = apply("eq", apply("gt", y, x), apply("gt", x, 0.0))
    # below a power of two, numbers are half as far apart as above
    is_power = apply("eq", mantissa_of(builder, size), 0.5)
    exponent = apply("sub", exponent_of(builder, x), apply("and", is_power, apply("not", is_outward)))
    step = apply("max", scaled(builder, np.array([[builder.const(1.0)]]), apply("sub", exponent, digits)), least)
    moved = apply("add", size, apply("select", is_outward, step, apply("neg", step)))
    if is_single:
        moved = apply("select", apply("gt", moved, largest), math.inf, moved)
    from_infinity = largest if is_single else np.finfo(np.float64).max
    moved = apply("select", apply("eq", size, math.inf), float(from_infinity), moved)
    moved = copy_sign(builder, moved, x)
    moved = apply("select", apply("eq", x, 0.0), copy_sign(builder, np.array([[builder.const(least)]]), y), moved)
    # x or y is NaN: the sum is, and so is the result
    moved = apply("select", apply("eq", x, y), y, moved)
    return apply("select", apply("or", apply("ne", x, x), apply("ne", y, y)), math.nan, moved)


def class_of(builder: GraphBuilder, x: Nodes, least: float) -> Nodes:
    """Compute the kind of a number as the GNU library counts `fpclassify`: NaN 0, infinite 1, 0 2, subnormal 3, 4."""
    apply = Elementwise(builder)
    size = apply("abs", x)
    kind = apply("select", apply("ge", size, least), 4.0, 3.0)
    kind = apply("select", apply("eq", size, 0.0), 2.0, kind)
    kind = apply("select", apply("eq", size, math.inf), 1.0, kind)
    return apply("select", apply("ne", x, x), 0.0, kind)


def last_bits_of_quotient(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute the integer of `nearest_remainder` mod 8 with the sign of a / b, as `remquo` of the GNU library."""
    apply = Elementwise(builder)
    eighth = remainder(builder, apply("abs", a), apply("mul", 8.0, apply("abs", b)))
    rest = nearest_remainder(builder, eighth, apply("abs", b))
    count = apply("mod", apply("round", apply("div", apply("sub", eighth, rest), apply("abs", b))), 8.0)
    is_negative = apply("ne", apply("lt", a, 0.0), apply("lt", b, 0.0))
    count = apply("select", is_negative, apply("neg", count), count)
    return apply("select", apply("eq", apply("abs", b), math.inf), 0.0, count)


def nearest_remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - n b for the integer n nearest to a / b, the even one of two, as `remainder` of C.

    It is NaN where a / b is beyond 2^53. K. C. Ng, fdlibm: `e_remainder.c` (Sun Microsystems, 1993).
    """
    apply = Elementwise(builder)
    size = apply("abs", b)
    rest = remainder(builder, apply("abs", a), apply("mul", 2.0, size))
    half = apply("mul", 0.5, size)
    less = apply("sub", rest, size)
    less = apply("select", apply("ge", less, half), apply("sub", less, size), less)
    rest = apply("select", apply("gt", rest, half), less, rest)
    return with_infinite(builder, apply("select", apply("lt", a, 0.0), apply("neg", rest), rest), a, b)


def is_negative(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute 1 for numbers below 0 and for -0.0, else 0."""
    apply = Elementwise(builder)
    return apply("lt", copy_sign(builder, np.array([[builder.const(1.0)]]), x), 0.0)


def is_normal(builder: GraphBuilder, x: Nodes, least: float) -> Nodes:
    """Compute 1 for finite numbers of at least the size of the least normal one, else 0."""
    apply = Elementwise(builder)
    size = apply("abs", x)
    return apply("and", apply("ge", size, least), apply("lt", size, math.inf))


def fused_product(builder: GraphBuilder, x: Nodes, y: Nodes, z: Nodes) -> Nodes:
    """Compute x y + z with the digits that the product as a double lacks, as `fma` of C to the last digit or two."""
    apply = Elementwise(builder)
    plain = apply("add", apply("mul", x, y), z)
    # the sum of two numbers as rounded, and what it lacks: D. E. Knuth, The Art of Computer Programming, 4.2.2
    size, lacking = rounded_product(builder, apply("abs", x), apply("abs", y))
    sign = apply("mul", apply("sign", x), apply("sign", y))
    product, error = apply("mul", sign, size), apply("mul", sign, lacking)
    total = apply("add", product, z)
    part = apply("sub", total, product)
    rest = apply("add", apply("sub", product, apply("sub", total, part)), apply("sub", z, part))
    exact = apply("add", total, apply("add", rest, error))
    largest = apply("max", apply("max", apply("abs", x), apply("abs", y)), apply("abs", z))
    return apply("select", apply("lt", largest, _LARGEST_FACTOR), exact, plain)
