"""Functions of mathematics on node arrays that keep all digits where the obvious formulas lose them."""

import math
from typing import Final

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate

_SPLIT: Final = 2.0**27 + 1.0  # splits a double into two halves of 26 bits
WHOLE_ONLY: Final = 2.0**52  # doubles from here on are integers
_MOST_WHOLE: Final = 2.0**53  # integers up to here are doubles
_LARGE: Final = 1e8  # from which x^2 + 1 is x^2


def rounded_product(builder: GraphBuilder, a: Nodes, b: Nodes) -> tuple[Nodes, Nodes]:
    """Compute the product of two numbers >= 0 as rounded, and the exact one less that, which is a double as well.

    T. J. Dekker, Numerische Mathematik 18 (1971) 224. Both must be below 1e300.
    """
    apply = Elementwise(builder)
    # `abs` changes nothing but keeps machine code from fusing the product with a sum, which would not round it
    product = apply("abs", apply("mul", a, b))
    (high_a, low_a), (high_b, low_b) = _halves(apply, a), _halves(apply, b)
    # products of halves are exact, and so is each difference in this order
    error = apply("sub", apply("mul", high_a, high_b), product)
    for left, right in ((high_a, low_b), (low_a, high_b), (low_a, low_b)):
        error = apply("add", error, apply("mul", left, right))
    return product, error


def _halves(apply: Elementwise, x: Nodes) -> tuple[Nodes, Nodes]:
    spread = apply("abs", apply("mul", x, _SPLIT))
    high = apply("sub", spread, apply("sub", spread, x))
    return high, apply("sub", x, high)


def remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute the remainder of a / b with the sign of a, exactly, as `fmod` of C.

    It is NaN where the quotient is too large for a double to tell its last digit, 2^53; a if b is infinite.
    """
    apply = Elementwise(builder)
    size = apply("abs", b)
    quotient = truncate(builder, apply("div", apply("abs", a), size))
    if all(_is_power_of_two(builder.value(int(node))) for node in b.ravel()):
        # quotient and product are exact
        rest = apply("sub", apply("abs", a), apply("mul", quotient, size))
    else:
        # a quotient that is nearly whole may be rounded up, 1.0 / 0.1 to 10: the rest is then negative
        product, error = rounded_product(builder, quotient, size)
        rest = apply("sub", apply("sub", apply("abs", a), product), error)
        rest = apply("add", rest, apply("select", apply("lt", rest, 0.0), size, 0.0))
        rest = apply("select", apply("le", quotient, _MOST_WHOLE), rest, math.nan)
    return with_infinite(builder, apply("select", apply("lt", a, 0.0), apply("neg", rest), rest), a, b)


def with_infinite(builder: GraphBuilder, rest: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """Return a remainder of a / b with the sign of a, replaced by a if b is infinite and a is not."""
    if is_finite(builder, b):
        return rest
    apply = Elementwise(builder)
    return apply("select", within_infinity(apply, a, b), a, rest)


def is_finite(builder: GraphBuilder, array: Nodes) -> bool:
    """Return True if all elements are known to be finite."""
    values = [builder.value(int(node)) for node in array.ravel()]
    return all(value is not None and math.isfinite(value) for value in values)


def within_infinity(apply: Elementwise, a: Nodes, b: Nodes) -> Nodes:
    """Return the condition that a is finite and b is not."""
    return apply("and", apply("eq", apply("abs", b), math.inf), apply("lt", apply("abs", a), math.inf))


def _is_power_of_two(value: float | None) -> bool:
    return value is not None and abs(math.frexp(value)[0]) == 0.5 and abs(value) >= math.ulp(1.0)


def round_to_even(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Round to the nearest integer, halves to the even one, as `rint` of C."""
    apply = Elementwise(builder)
    low = apply("floor", x)
    distance = apply("sub", x, low)
    is_odd = apply("ne", apply("mod", low, 2.0), 0.0)
    up = apply("or", apply("gt", distance, 0.5), apply("and", apply("eq", distance, 0.5), is_odd))
    # beyond 2^52 the floor is x itself, and inf - inf would be NaN
    return apply("select", apply("lt", apply("abs", x), WHOLE_ONLY), apply("add", low, up), x)


def log1p(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute log(1 + x), so that a small x keeps its digits."""
    apply = Elementwise(builder)
    grown = apply("add", x, 1.0)
    # log(u) - ((u - 1) - x) / u, u = 1 + x as rounded: the second term takes the rounding back, and has the slope 0
    rounding = apply("sub", apply("sub", grown, 1.0), x)
    counts = apply("and", apply("gt", x, -1.0), apply("lt", x, WHOLE_ONLY))
    return apply("sub", apply("log", grown), apply("select", counts, apply("div", rounding, grown), 0.0))


def log2(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute the logarithm to the base 2, exactly for powers of two, so that its floor is their exponent."""
    apply = Elementwise(builder)
    quotient = apply("div", apply("log", x), math.log(2.0))
    nearest = apply("round", quotient)
    return apply("select", apply("eq", apply("pow", 2.0, nearest), x), nearest, quotient)


def asinh(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute asinh as an odd function, so that large negative numbers do not cancel; its slope at 0 is 1."""
    apply = Elementwise(builder)
    is_negative = apply("lt", x, 0.0)
    size = apply("select", is_negative, apply("neg", x), x)
    near = apply("min", size, _LARGE)  # the square of a larger one may be infinite
    square = apply("mul", near, near)
    # log(s + sqrt(s^2 + 1)) = log1p(s + s^2 / (1 + sqrt(s^2 + 1))); for a large s it is log(2 s)
    root = apply("add", apply("sqrt", apply("add", square, 1.0)), 1.0)
    result = log1p(builder, apply("add", near, apply("div", square, root)))
    far = apply("add", apply("log", apply("max", size, _LARGE)), math.log(2.0))
    result = apply("select", apply("le", size, _LARGE), result, far)
    return apply("select", is_negative, apply("neg", result), result)


def acosh(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute acosh; NaN below 1."""
    apply = Elementwise(builder)
    near = apply("sub", apply("min", x, _LARGE), 1.0)
    # log(x + sqrt(x^2 - 1)) = log1p(t + sqrt(t) sqrt(t + 2)), t = x - 1; the roots of negative numbers are NaN
    root = apply("mul", apply("sqrt", near), apply("sqrt", apply("add", near, 2.0)))
    far = apply("add", apply("log", apply("max", x, _LARGE)), math.log(2.0))
    return apply("select", apply("gt", x, _LARGE), far, log1p(builder, apply("add", near, root)))


def atanh(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute atanh; infinite at -1 and 1, NaN beyond."""
    apply = Elementwise(builder)
    is_negative = apply("lt", x, 0.0)
    size = apply("select", is_negative, apply("neg", x), x)
    # log((1 + s) / (1 - s)) = log1p(2 s / (1 - s)) / 2
    result = apply("mul", 0.5, log1p(builder, apply("div", apply("mul", 2.0, size), apply("sub", 1.0, size))))
    return apply("select", is_negative, apply("neg", result), result)


def hypotenuse(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute sqrt(a^2 + b^2) for numbers whose squares may be infinite or 0, as `hypot` of C."""
    apply = Elementwise(builder)
    size = apply("max", apply("abs", a), apply("abs", b))
    # a power of two changes no digit, and none is needed for common numbers
    shrunk = apply("select", apply("gt", size, 2.0**500), 2.0**-600, 1.0)
    factor = apply("select", apply("lt", size, 2.0**-500), 2.0**600, shrunk)
    a, b = apply("mul", a, factor), apply("mul", b, factor)
    length = apply("sqrt", apply("add", apply("mul", a, a), apply("mul", b, b)))
    # an infinite side counts, even if the other one is NaN
    is_infinite = apply("or", apply("eq", apply("abs", a), math.inf), apply("eq", apply("abs", b), math.inf))
    return apply("select", is_infinite, math.inf, apply("div", length, factor))


def cube_root(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute the root of the third degree of numbers of both signs."""
    apply = Elementwise(builder)
    root = apply("mul", apply("sign", x), apply("pow", apply("abs", x), 1.0 / 3.0))
    # the exponent is rounded, which one step of Newton's method corrects: y - (y - x / y^2) / 3
    is_plain = apply("and", apply("ne", x, 0.0), apply("lt", apply("abs", x), math.inf))
    rest = apply("div", apply("sub", root, apply("div", x, apply("mul", root, root))), 3.0)
    return apply("sub", root, apply("select", is_plain, rest, 0.0))


def copy_sign(builder: GraphBuilder, x: Nodes, y: Nodes) -> Nodes:
    """Compute the size of x with the sign of y, which may be that of -0.0."""
    apply = Elementwise(builder)
    size = apply("abs", x)
    # -0.0 is not below 0, but its reciprocal is
    is_negative = apply("or", apply("lt", y, 0.0), apply("lt", apply("div", 1.0, y), 0.0))
    return apply("select", is_negative, apply("neg", size), size)
