"""The gamma function and the logarithm of its size on node arrays, as `tgamma` and `lgamma` of C."""

import math
from collections.abc import Sequence
from typing import Final

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes

# Stirling's series at z >= 10 is exact to the last digit: Abramowitz and Stegun, 6.1.40
_LEAST: Final = 10
_SERIES: Final = (1 / 12, -1 / 360, 1 / 1260, -1 / 1680, 1 / 1188, -691 / 360360, 1 / 156, -3617 / 122400)
_HALF_LOG: Final = 0.5 * math.log(2 * math.pi)
_MOST_LOGARITHM: Final = 1e306  # z from which log_gamma is infinite anyway
_MOST: Final = 200.0  # the same for gamma


def log_gamma(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute log |gamma(x)|, to some 1e-15 of the larger of 1 and the result; infinite at 0, -1, -2, ...

    Its slope is the digamma function, to the same digits.
    """
    apply = Elementwise(builder)
    reflected, sine, is_low = _reflected(apply, x)
    z, product, is_far = _shifted(apply, reflected, _MOST_LOGARITHM)
    # (z - 1/2) log(z) - z + log(2 pi) / 2 + series
    grown = apply("mul", apply("sub", z, 0.5), apply("log", z))
    result = apply("add", apply("add", apply("sub", grown, z), _HALF_LOG), _series(apply, z))
    result = apply("select", is_far, result, apply("sub", result, apply("log", product)))
    below = apply("sub", apply("log", apply("div", math.pi, apply("abs", sine))), result)
    result = apply("select", is_low, below, result)
    result = apply("select", apply("eq", sine, 0.0), apply("select", is_low, math.inf, result), result)
    return apply("select", apply("eq", apply("abs", x), math.inf), math.inf, result)


def gamma(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute the gamma function to some 2e-14 of the result; NaN at -1, -2, ..., infinity of the sign of x at 0."""
    apply = Elementwise(builder)
    reflected, sine, is_low = _reflected(apply, x)
    z, product, is_far = _shifted(apply, reflected, _MOST)
    # z^(z - 1/2) is a square, since it may be infinite where its product with e^-z is not
    root = apply("pow", z, apply("mul", 0.5, apply("sub", z, 0.5)))
    result = apply("mul", apply("mul", root, apply("exp", apply("sub", _series(apply, z), z))), root)
    result = apply("mul", result, math.sqrt(2 * math.pi))
    result = apply("select", is_far, result, apply("div", result, product))
    result = apply("select", is_low, apply("div", math.pi, apply("mul", sine, result)), result)
    is_pole = apply("and", is_low, apply("eq", sine, 0.0))
    at_pole = apply("select", apply("eq", x, 0.0), apply("div", 1.0, x), math.nan)
    return apply("select", is_pole, at_pole, result)


def _reflected(apply: Elementwise, x: Nodes) -> tuple[Nodes, Nodes, Nodes]:
    """Return 1 - x for x < 1/2, else x, sin(pi x), and the condition x < 1/2: gamma(x) gamma(1 - x) sin(pi x) = pi."""
    is_low = apply("lt", x, 0.5)
    near = apply("round", x)
    sine = apply("sin", apply("mul", math.pi, apply("sub", x, near)))
    is_odd = apply("ne", apply("mod", near, 2.0), 0.0)
    sine = apply("select", is_odd, apply("neg", sine), sine)
    return apply("select", is_low, apply("sub", 1.0, x), x), sine, is_low


def _shifted(apply: Elementwise, x: Nodes, most: float) -> tuple[Nodes, Nodes, Nodes]:
    """Return z >= 10 for the series, the product by which gamma(z) is larger than gamma(x), and where both are one."""
    is_far = apply("ge", x, float(_LEAST))
    near = apply("min", x, float(_LEAST))
    product = near
    for at in range(1, _LEAST):
        product = apply("mul", product, apply("add", near, float(at)))
    far = apply("min", x, most)
    return apply("select", is_far, far, apply("add", near, float(_LEAST))), product, is_far


def _series(apply: Elementwise, z: Nodes) -> Nodes:
    return apply("div", _polynomial(apply, apply("div", 1.0, apply("mul", z, z)), _SERIES), z)


def _polynomial(apply: Elementwise, x: Nodes, factors: Sequence[float]) -> Nodes:
    result = apply("mul", x, factors[-1])
    for factor in factors[-2:0:-1]:
        result = apply("mul", apply("add", result, factor), x)
    return apply("add", result, factors[0])
