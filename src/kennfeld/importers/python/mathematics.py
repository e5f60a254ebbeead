"""The functions of Python, `math` and NumPy that translated code calls, by their names."""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.c.functions import LIBRARY as C_LIBRARY
from kennfeld.importers.c.functions import MATHEMATICS, TESTS
from kennfeld.importers.python.number_rules import (
    divide,
    exact_remainder,
    failing_at_zero,
    floor_divide,
    integer_modulo,
    integer_operation,
    logarithm,
    modulo,
    numpy_floor_divide,
    of_finite,
    power,
    to_integer,
    with_exact_remainder,
    within,
    without_overflow,
)
from kennfeld.importers.rules import RuleFunction, elementwise, known_integer
from kennfeld.models.imperative.evaluation_context import LibraryFunction, SymbolicEvaluator
from kennfeld.models.imperative.exact_arithmetic import (
    acosh,
    atanh,
    log1p,
    log2,
    round_to_even,
    rounded_product,
)
from kennfeld.models.imperative.gamma_functions import log_gamma
from kennfeld.models.imperative.graph_operators import ONE, Rule, expm1
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate

MAX_DIGITS: Final = 22  # powers of ten up to here are doubles


def _round_to_digits(builder: GraphBuilder, x: Nodes, digits: Nodes) -> Nodes:
    """Round to decimal places as Python does: by the exact decimal number, which a product x 10^n may miss."""
    apply = Elementwise(builder)
    places = int(builder.value(int(digits.item())) or 0)
    factor, size = np.asarray(builder.const(10.0 ** abs(places))), apply("abs", x)
    if places < 0:
        # the remainder tells exactly on which side of a half x is
        scaled = apply("div", size, factor)
        product, rest = rounded_product(builder, scaled, factor)
        error = apply("sub", apply("sub", size, product), rest)
    else:
        scaled, error = rounded_product(builder, size, factor)
    low = apply("floor", scaled)
    distance = apply("sub", scaled, low)
    is_half = apply("eq", distance, 0.5)
    is_odd = apply("ne", apply("mod", low, 2.0), 0.0)
    # an exact half goes to the even neighbor
    tie = apply("select", apply("eq", error, 0.0), is_odd, apply("gt", error, 0.0))
    up = apply("select", is_half, tie, apply("gt", distance, 0.5))
    whole = apply("mul", apply("sign", x), apply("add", low, up))
    result = apply("mul" if places < 0 else "div", whole, factor)
    # a number without such decimals stays, as does one that is infinite
    return apply("select", apply("lt", apply("abs", scaled), 2.0**52), result, x)


def _round_by_product(builder: GraphBuilder, x: Nodes, digits: Nodes) -> Nodes:
    """Round to decimal places as NumPy does."""
    apply = Elementwise(builder)
    places = int(builder.value(int(digits.item())) or 0)
    first, last = ("mul", "div") if places >= 0 else ("div", "mul")
    factor = 10.0 ** abs(places)
    return apply(last, round_to_even(builder, apply(first, x, factor)), factor)


def _extreme(op: str, comparison: str) -> Callable[..., Nodes]:
    """Return the rule of min or max, which keep the first argument unless the second one is below or above it."""

    def rule(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
        apply = Elementwise(builder)
        result = apply(op, a, b)
        values = [builder.value(int(node)) for node in b.ravel()]
        # NaN is neither below nor above; the operation of the graph returns it from both sides
        is_number = all(value is not None and not math.isnan(value) for value in values)
        return result if is_number else apply("select", apply("ne", b, b), a, result)

    return rule


def _element(evaluator: SymbolicEvaluator, index: Nodes, *items: Nodes) -> Nodes:
    """Return an element of a list by its index from 0, or from -1 at the end; fail with IndexError."""
    apply, builder, count = Elementwise(evaluator.builder), evaluator.builder, len(items)
    known = builder.value(int(index.item()))
    if known is not None and known in range(-count, count):
        return items[int(known)]
    is_within = apply("and", apply("ge", index, float(-count)), apply("lt", index, float(count)))
    evaluator.fail_where(apply("not", apply("and", is_within, apply("eq", index, apply("floor", index)))))
    result: Nodes = _constant(builder, math.nan)
    for at, item in enumerate(items):
        is_this = apply("or", apply("eq", index, float(at)), apply("eq", index, float(at - count)))
        result = apply("select", is_this, item, result)
    return result


def _raise(evaluator: SymbolicEvaluator) -> Nodes:
    """Note that the code raises an exception wherever it comes here."""
    evaluator.fail_where(_constant(evaluator.builder, 1.0))
    return _constant(evaluator.builder, math.nan)


def _constant(builder: GraphBuilder, number: float) -> Nodes:
    return np.array([[builder.const(number)]], dtype=np.int64)


def _interpolate(
    evaluator: SymbolicEvaluator, x: Nodes, left: Nodes, right: Nodes, count: Nodes, *points: Nodes
) -> Nodes:
    """Interpolate between points as `numpy.interp`: breakpoints, which increase, precede the values."""
    apply, size = Elementwise(evaluator.builder), known_integer(evaluator, count)
    breakpoints, values = points[:size], points[size:]
    # the interval is chosen first, so that its line is written once: base, slope and start of each
    lines = [
        (low, apply("div", apply("sub", b, a), apply("sub", high, low)), a)
        for low, high, a, b in zip(breakpoints[:-1], breakpoints[1:], values[:-1], values[1:], strict=True)
    ]
    result = values[0]
    if lines:
        base, slope, start = (_chosen(apply, x, breakpoints[1:-1], column) for column in zip(*lines, strict=True))
        result = apply("add", apply("mul", slope, apply("sub", x, base)), start)
        # NumPy returns the last value itself, which the line may miss by its rounding
        result = apply("select", apply("eq", x, breakpoints[-1]), values[-1], result)
    result = apply("select", apply("gt", x, breakpoints[-1]), right, result)
    result = apply("select", apply("lt", x, breakpoints[0]), left, result)
    return apply("select", apply("ne", x, x), x, result)


def _chosen(apply: Elementwise, x: Nodes, limits: Sequence[Nodes], items: Sequence[Nodes]) -> Nodes:
    """Return the item of the interval that x is in, by bisection; `limits` are those between the items."""
    if len(items) == 1:
        return items[0]
    middle = len(items) // 2
    below = _chosen(apply, x, limits[: middle - 1], items[:middle])
    above = _chosen(apply, x, limits[middle:], items[middle:])
    return apply("select", apply("lt", x, limits[middle - 1]), below, above)


def _plain(op: str) -> Callable[..., Nodes]:
    return lambda builder, *args: Elementwise(builder)(op, *args)


def _scaled(factor: float) -> Callable[..., Nodes]:
    return lambda builder, x: Elementwise(builder)("mul", x, factor)


_OVERFLOWING: Final[dict[str, Rule]] = {
    "exp": ONE["exp"],
    "exp2": lambda builder, x: Elementwise(builder)("pow", 2.0, x),
    "expm1": expm1,
    "lgamma": log_gamma,
    "sinh": ONE["sinh"],
    "cosh": ONE["cosh"],
}
_ROUNDING: Final[dict[str, Rule]] = {
    "floor": ONE["floor"], "ceil": ONE["ceil"], "trunc": truncate, "round": round_to_even,
}  # fmt: skip
# the numbers that functions of `math` take, with and without their ends
_CLOSED_DOMAINS: Final[dict[str, tuple[Rule, tuple[float, float]]]] = {
    "sqrt": (ONE["sqrt"], (0.0, math.inf)),
    "asin": (ONE["asin"], (-1.0, 1.0)),
    "acos": (ONE["acos"], (-1.0, 1.0)),
    "acosh": (acosh, (1.0, math.inf)),
}
_OPEN_DOMAINS: Final[dict[str, tuple[Rule, tuple[float, float]]]] = {
    "log": (ONE["log"], (0.0, math.inf)),
    "log10": (ONE["log10"], (0.0, math.inf)),
    "log2": (log2, (0.0, math.inf)),
    "log1p": (log1p, (-1.0, math.inf)),
    "atanh": (atanh, (-1.0, 1.0)),
}
_FUNCTIONS: Final = (
    RuleFunction("divide", 2, divide),
    RuleFunction("modulo", 2, failing_at_zero(modulo)),
    RuleFunction("floor_divide", 2, failing_at_zero(floor_divide)),
    RuleFunction("numpy_modulo", 2, with_exact_remainder(modulo)),
    RuleFunction("numpy_floor_divide", 2, with_exact_remainder(numpy_floor_divide)),
    RuleFunction("pow", 2, power),
    RuleFunction("fmod", 2, exact_remainder),
    *(RuleFunction(name, 1, without_overflow(rule)) for name, rule in _OVERFLOWING.items()),
    *(RuleFunction(name, 1, to_integer(rule)) for name, rule in _ROUNDING.items()),
    *(RuleFunction(name, 1, of_finite(ONE[name])) for name in ("sin", "cos", "tan")),
    *(RuleFunction(name, 1, within(rule, *limits)) for name, (rule, limits) in _CLOSED_DOMAINS.items()),
    *(RuleFunction(name, 1, within(rule, *limits, ends=False)) for name, (rule, limits) in _OPEN_DOMAINS.items()),
    RuleFunction("raise", 0, _raise),
    RuleFunction("sign", 1, elementwise(ONE["sign"])),
    RuleFunction("logarithm", 2, logarithm),
    RuleFunction("min", 2, elementwise(_extreme("min", "lt"))),
    RuleFunction("max", 2, elementwise(_extreme("max", "gt"))),
    RuleFunction("minimum", 2, elementwise(_plain("min"))),
    RuleFunction("maximum", 2, elementwise(_plain("max"))),
    RuleFunction("element", 2, _element),
    RuleFunction("integer_add", 3, integer_operation("add", operator.add)),
    RuleFunction("integer_sub", 3, integer_operation("sub", operator.sub)),
    RuleFunction("integer_mul", 3, integer_operation("mul", operator.mul)),
    RuleFunction("integer_pow", 3, integer_operation("pow", operator.pow)),
    RuleFunction("integer_modulo", 2, integer_modulo),
    RuleFunction("first", 1, lambda evaluator, first, *others: first),
    RuleFunction("interp", 5, _interpolate),
    RuleFunction("degrees", 1, elementwise(_scaled(180.0 / math.pi))),
    RuleFunction("radians", 1, elementwise(_scaled(math.pi / 180.0))),
    RuleFunction("round_to_digits", 2, elementwise(_round_to_digits)),
    RuleFunction("round_by_product", 2, elementwise(_round_by_product)),
)
LIBRARY: Final[dict[str, LibraryFunction]] = {
    **C_LIBRARY,
    **{f"py:{function.name}": function for function in _FUNCTIONS},
}
# names in the library, where they differ; `math` raises exceptions, NumPy computes as C
_MATH: Final = {
    name: f"py:{name}"
    for name in (
        *_OVERFLOWING, "floor", "ceil", "trunc", "sin", "cos", "tan", *_CLOSED_DOMAINS, *_OPEN_DOMAINS, "pow", "fmod",
        "degrees", "radians",
    )
}  # fmt: skip
_NUMPY: Final = {
    "arcsin": "c:asin", "arccos": "c:acos", "arctan": "c:atan", "arctan2": "c:atan2", "arcsinh": "c:asinh",
    "arccosh": "c:acosh", "arctanh": "c:atanh", "abs": "c:fabs", "absolute": "c:fabs", "power": "c:pow",
    "fix": "c:trunc", "sign": "py:sign", "minimum": "py:minimum", "maximum": "py:maximum", "degrees": "py:degrees",
    "rad2deg": "py:degrees", "radians": "py:radians", "deg2rad": "py:radians", "mod": "py:numpy_modulo",
    "remainder": "py:numpy_modulo", "floor_divide": "py:numpy_floor_divide", "round": "c:rint", "around": "c:rint",
}  # fmt: skip
_BUILT_IN: Final = {
    "abs": "c:fabs", "min": "py:min", "max": "py:max", "int": "py:trunc", "pow": "py:pow", "round": "py:round",
}  # fmt: skip
_ABSENT: Final = {
    "math": ("round", "rint", "nearbyint", "fmin", "fmax", "fdim", "tgamma", "nexttoward"),
    "numpy": (
        "pow",
        "nearbyint",
        "fma",
        "lgamma",
        "tgamma",
        "erf",
        "erfc",
        "nexttoward",
    ),
}
_COUNTS: Final = {
    **{f"c:{name}": count for name, count in (*MATHEMATICS.items(), *TESTS.items())},
    **{f"py:{function.name}": function.count for function in _FUNCTIONS},
}
_TABLES: Final = {"math": _MATH, "numpy": _NUMPY, "builtins": _BUILT_IN}


def library_name(module: str, name: str, arguments: int) -> str:
    """Return the name in the library of a function of a module with so many arguments; empty if it has none.

    >>> library_name("math", "log", 1), library_name("numpy", "log", 1), library_name("math", "gamma", 1)
    ('py:log', 'c:log', '')
    """
    names = _TABLES.get(module, {})
    plain = f"c:{name}" if module in _ABSENT and name not in _ABSENT[module] else ""
    result = names.get(name, plain)
    return result if _COUNTS.get(result) == arguments else ""
