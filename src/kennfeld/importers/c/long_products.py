"""Products of two integers that doubles do not hold, as far as their quotients or upper bits do.

Fixed-point code multiplies 32-bit integers to 64 bits and takes the upper ones: `((int64_t)a * b) >> 31`.
With a = h 2^16 + l, the parts h b and l b are below 2^53, and so are the steps of a long division.
"""

from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes
from kennfeld.models.imperative.path_facts import bound_of

_HALF: Final = 2.0**16
_MOST: Final = 2.0**34  # h b is then up to 2^52, and the rest of a division times 2^16 up to 2^50
_EXACT: Final = 2.0**53
LEAST_BITS: Final = 16.0  # that upper bits leave out


def _size(builder: GraphBuilder, x: Nodes) -> float:
    node = int(x.item())
    return max(bound_of(builder, node, True), -bound_of(builder, node, False))


def needs_parts(
    builder: GraphBuilder, word: IntegerType, a: Nodes, b: Nodes, other: Nodes, *, is_sum: bool = False
) -> bool:
    """Return True if a product, or its sum with `other`, may be beyond 2^53 but not wrap, and its parts are not."""
    sizes = [_size(builder, number) for number in (a, b, other)]
    limit = float(word.most) - sizes[2] * is_sum
    return _EXACT < sizes[0] * sizes[1] <= limit and max(sizes) <= _MOST


def quotient_of_product(builder: GraphBuilder, a: Nodes, b: Nodes, divisor: Nodes) -> Nodes:
    """Compute a b / divisor, cut off towards 0."""
    apply = Elementwise(builder)
    sizes = [apply("abs", x) for x in (a, b, divisor)]
    high, low = apply("floor", apply("div", sizes[0], _HALF)), apply("mod", sizes[0], _HALF)
    upper = apply("mul", high, sizes[1])
    first = apply("floor", apply("div", upper, sizes[2]))
    rest = apply("sub", upper, apply("mul", first, sizes[2]))
    # the rest is below the divisor, so that what follows has no digit above 2^16
    lower = apply("add", apply("mul", rest, _HALF), apply("mul", low, sizes[1]))
    result = apply("add", apply("mul", first, _HALF), apply("floor", apply("div", lower, sizes[2])))
    signs = [apply("lt", x, 0.0) for x in (a, b, divisor)]
    is_negative = apply("ne", apply("ne", signs[0], signs[1]), signs[2])
    return apply("select", is_negative, apply("neg", result), result)


def upper_bits_of_product(builder: GraphBuilder, a: Nodes, b: Nodes, addend: Nodes, count: float) -> Nodes:
    """Compute (a b + addend) >> count, for a count of 16 or more and an addend up to 2^34."""
    apply = Elementwise(builder)
    high, low = apply("floor", apply("div", a, _HALF)), apply("mod", a, _HALF)
    lower = apply("floor", apply("div", apply("add", apply("mul", low, b), addend), _HALF))
    # floor((p 2^16 + q) / 2^n) = floor((p + floor(q / 2^16)) / 2^(n - 16))
    whole = apply("add", apply("mul", high, b), lower)
    return apply("floor", apply("div", whole, np.asarray(builder.const(2.0 ** (count - 16)))))
