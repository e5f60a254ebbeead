"""Functions that translated C code calls: arithmetic of integers, mathematics of `math.h`, bits."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import GraphBuilder
from kennfeld.importers.c.long_products import (
    LEAST_BITS,
    needs_parts,
    quotient_of_product,
    upper_bits_of_product,
)
from kennfeld.importers.rules import (
    Rule,
    RuleFunction,
    elementwise,
    filled_array,
    known_integer,
    shift,
    symbolic_rule,
    wrapped,
)
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import LibraryFunction, SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.exact_arithmetic import (
    copy_sign,
    cube_root,
    hypotenuse,
    log1p,
    log2,
    remainder,
    round_to_even,
)
from kennfeld.models.imperative.floating_point import (
    class_of,
    exponent_of,
    fraction_of,
    fused_product,
    is_negative,
    is_normal,
    last_bits_of_quotient,
    logarithm_of_exponent,
    mantissa_of,
    nearest_remainder,
    next_number,
    scaled,
)
from kennfeld.models.imperative.gamma_functions import gamma, log_gamma
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, ONE, operation
from kennfeld.models.imperative.integer_types import EXACT, IntegerType
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate
from kennfeld.models.imperative.path_facts import bound_of


def written_last(builder: GraphBuilder, nodes: Nodes, last: Nodes, number: int) -> Nodes:
    """Select the numbers of a member of a union, or NaN where another one was written last.

    `nodes` and the result are Int[rows, columns]; `last`, of one node, is the number of the member written last.
    """
    apply = Elementwise(builder)
    # 0: none was written yet
    is_kept = apply("or", apply("eq", last, 0.0), apply("eq", last, float(number)))
    return apply("select", is_kept, nodes, math.nan)


@dataclass(frozen=True)
class UnionFunction:
    """A function of the members of unions: of the numbers of one, the number of the one written last, its own number.

    For those that are read, two texts follow: the union, and the names of its members.
    """

    def results(
        self, evaluator: SymbolicEvaluator, values: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]:
        """Return the numbers of the member, or NaN where another one was written last.

        Raises:
            ProgramError: another one certainly was, and this one is read.
        """
        nodes, last, own = (np.asarray(s.as_array(s.force(value))) for value in values[:3])
        number = known_integer(evaluator, own)
        known = evaluator.builder.value(int(last.item()))
        if len(values) > 3 and known not in (None, 0.0, number):
            names = str(values[4]).split()
            message = f"{values[3]}.{names[number - 1]} is read, but {names[int(known) - 1]} was written last"
            raise ProgramError(message, "Read the member of a union that was written last.")
        return (written_last(evaluator.builder, nodes, last, number),)


def _word(evaluator: SymbolicEvaluator, bits: Nodes, signed: Nodes) -> IntegerType:
    return IntegerType(known_integer(evaluator, bits), bool(known_integer(evaluator, signed)), "Round", True)


def _wrap(evaluator: SymbolicEvaluator, x: Nodes, bits: Nodes, signed: Nodes) -> Nodes:
    """Return the numbers of the lowest bits; numbers that are known to fit stay as they are."""
    word = _word(evaluator, bits, signed)
    if word.bits <= EXACT:
        return wrapped(evaluator.builder, x, float(word.least), 2.0**word.bits)
    return _known_exactly(evaluator.builder, x, word)


def _known_exactly(builder: GraphBuilder, x: Nodes, word: IntegerType) -> Nodes:
    """Return 64-bit integers, or NaN where they are beyond 2^53, or below 0 and wrap to such numbers.

    Wrapping needs all 64 bits, which a double does not have.
    """
    apply, least = Elementwise(builder), -(2.0**53) if word.signed else 0.0
    nodes = [int(node) for node in x.ravel()]
    if all(bound_of(builder, n, True) <= 2.0**53 and bound_of(builder, n, False) >= least for n in nodes):
        return x
    return apply("select", apply("and", apply("ge", x, least), apply("le", x, 2.0**53)), x, math.nan)


def _multiply(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, bits: Nodes, signed: Nodes) -> Nodes:
    """Compute the lowest bits of a product of integers, by halves if doubles do not know it exactly."""
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    largest = [max(bound_of(builder, int(x.item()), True), -bound_of(builder, int(x.item()), False)) for x in (a, b)]
    if largest[0] * largest[1] <= 2.0**53 or known_integer(evaluator, bits) > EXACT:
        return _wrap(evaluator, apply("mul", a, b), bits, signed)
    # a b mod 2^32 = ((floor(a / 2^16) b) mod 2^16) 2^16 + (a mod 2^16) b, mod 2^32: products stay below 2^49
    half = 2.0**16
    high = apply("mod", apply("mul", apply("floor", apply("div", a, half)), b), half)
    low = apply("mul", apply("mod", a, half), b)
    return _wrap(evaluator, apply("add", apply("mul", high, half), low), bits, signed)


def _quotient(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    # exact in words of 32 bits: a quotient below an integer is so by 1 / a of its size or more, and 2^-32 > 2^-53
    return truncate(evaluator.builder, Elementwise(evaluator.builder)("div", a, b))


def _quotient_of_product(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, divisor: Nodes, signed: Nodes) -> Nodes:
    """Compute a b / divisor of 64-bit integers, also if a b is beyond 2^53."""
    builder, word = evaluator.builder, IntegerType(64, bool(known_integer(evaluator, signed)))
    if needs_parts(builder, word, a, b, divisor):
        return quotient_of_product(builder, a, b, divisor)
    return _quotient(evaluator, _known_exactly(builder, Elementwise(builder)("mul", a, b), word), divisor)


def _upper_bits(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, addend: Nodes, count: Nodes, signed: Nodes) -> Nodes:
    """Compute (a b + addend) >> count of 64-bit integers, also if a b is beyond 2^53."""
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    word, bits = IntegerType(64, bool(known_integer(evaluator, signed))), builder.value(int(count.item()))
    if bits is not None and bits >= LEAST_BITS and needs_parts(builder, word, a, b, addend, is_sum=True):
        return upper_bits_of_product(builder, a, b, addend, bits)
    product = _known_exactly(builder, apply("add", apply("mul", a, b), addend), word)
    return shift(-1.0)(evaluator, product, count)


def _remainder(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    apply = Elementwise(evaluator.builder)
    return apply("sub", a, apply("mul", _quotient(evaluator, a, b), b))


_HALF: Final = 32  # bits of a half of a 64-bit integer


def _bits(name: str) -> Rule:
    apply = symbolic_rule(name)

    def rule(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, bits: Nodes, signed: Nodes) -> Nodes:
        word = _word(evaluator, bits, signed)
        if word.bits > EXACT:
            a, b = (_known_exactly(evaluator.builder, operand, word) for operand in (a, b))
        values = [evaluator.builder.value(int(operand.item())) for operand in (a, b)]
        if any(value is not None and math.isnan(value) for value in values):  # a quotient by 0, on a path not taken
            return np.full_like(a, evaluator.builder.const(math.nan))
        if word.bits <= EXACT:
            return apply(evaluator, s.integers(a, word), s.integers(b, word))
        # by halves, of which the upper one has the sign
        step, combine = 2.0**_HALF, Elementwise(evaluator.builder)
        kinds = IntegerType(_HALF, word.signed, "Round", True), IntegerType(_HALF, False, "Round", True)
        upper = [s.integers(combine("floor", combine("div", operand, step)), kinds[0]) for operand in (a, b)]
        lower = [s.integers(combine("mod", operand, step), kinds[1]) for operand in (a, b)]
        whole = combine("mul", np.asarray(apply(evaluator, *upper)), step)
        return combine("add", whole, np.asarray(apply(evaluator, *lower)))

    return rule


def _index(evaluator: SymbolicEvaluator, place: Nodes, size: Nodes) -> Nodes:
    """Return an index, counted from 1; a path on which it is certainly out of range is one that C does not define."""
    value = evaluator.builder.value(int(place.item()))
    if value is not None and not 1 <= value <= known_integer(evaluator, size):
        raise AbortedPathError
    return place


def _size(evaluator: SymbolicEvaluator, array: Nodes, row: Nodes) -> Nodes:
    """Return the number of elements of an array, or of the numbers of a matrix of so many columns."""
    count = float(len(array) * max(known_integer(evaluator, row), 1))
    return np.array([[evaluator.builder.const(count)]], dtype=np.int64)


def _zeros(evaluator: SymbolicEvaluator, *sizes: Nodes) -> Nodes:
    return filled_array(evaluator, evaluator.builder.const(0.0), sizes)


def _array(evaluator: SymbolicEvaluator, count: Nodes, *rest: Nodes) -> Nodes:
    """Return an array of `count` dimensions, whose sizes precede its elements, in the order of memory."""
    dimensions = known_integer(evaluator, count)
    shape = [known_integer(evaluator, size) for size in rest[:dimensions]]
    nodes = np.array([int(item.item()) for item in rest[dimensions:]], dtype=np.int64)
    return nodes.reshape(shape if len(shape) > 1 else (*shape, 1))


def _tail(evaluator: SymbolicEvaluator, array: Nodes, start: Nodes, is_flat: Nodes) -> Nodes:
    """Return the elements of an array from an address on; those of a matrix one by one, if `is_flat`."""
    rows = array.reshape(-1, 1) if known_integer(evaluator, is_flat) else array
    return rows[_known_start(evaluator, rows, start) :]


def _with_tail(evaluator: SymbolicEvaluator, array: Nodes, tail: Nodes) -> Nodes:
    """Return an array whose last elements are replaced by those of `tail`."""
    count = array.size - tail.size
    return np.concatenate([array.ravel()[:count], tail.ravel()]).reshape(array.shape)


def _known_start(evaluator: SymbolicEvaluator, rows: Nodes, start: Nodes) -> int:
    value = evaluator.builder.value(int(start.item()))
    if value is None:
        raise ProgramError("the address that a function gets depends on signals", "Pass the array and the index.")
    if not 0 <= value <= len(rows):
        raise AbortedPathError
    return int(value)


def _without_nan(name: str) -> Callable[..., Nodes]:
    """Return the rule of fmin or fmax, which ignore an argument that is not a number."""

    def rule(builder: GraphBuilder, x: Nodes, y: Nodes) -> Nodes:
        apply = Elementwise(builder)
        result = operation(name)(builder, x, y)
        for value, other in ((x, y), (y, x)):
            numbers = [builder.value(int(node)) for node in value.ravel()]
            # constants that are numbers need no test
            if any(number is None or math.isnan(number) for number in numbers):
                result = apply("select", apply("ne", value, value), other, result)
        return result

    return rule


def _is_any_nan(builder: GraphBuilder, x: Nodes, y: Nodes) -> Nodes:
    apply = Elementwise(builder)
    return apply("or", apply("ne", x, x), apply("ne", y, y))


def _are_unequal(builder: GraphBuilder, x: Nodes, y: Nodes) -> Nodes:
    apply = Elementwise(builder)
    return apply("or", apply("lt", x, y), apply("gt", x, y))


_ONE_ARGUMENT: Final = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "log10", "sqrt", "floor", "ceil",
    "round",
)  # fmt: skip
_MATHEMATICS: Final = (
    *(RuleFunction(name, 1, elementwise(ONE[name])) for name in _ONE_ARGUMENT),
    *(RuleFunction(name, 1, elementwise(rule)) for name, rule in INVERSE_HYPERBOLIC.items()),
    RuleFunction("fabs", 1, elementwise(ONE["abs"])),
    RuleFunction("trunc", 1, elementwise(truncate)),
    RuleFunction("rint", 1, elementwise(round_to_even)),
    RuleFunction("nearbyint", 1, elementwise(round_to_even)),
    RuleFunction("log2", 1, elementwise(log2)),
    RuleFunction("log1p", 1, elementwise(log1p)),
    RuleFunction("expm1", 1, symbolic_rule("expm1")),
    RuleFunction("exp2", 1, elementwise(lambda builder, x: Elementwise(builder)("pow", 2.0, x))),
    RuleFunction("cbrt", 1, elementwise(cube_root)),
    RuleFunction("pow", 2, elementwise(operation("pow"))),
    RuleFunction("atan2", 2, elementwise(operation("atan2"))),
    RuleFunction("fmin", 2, elementwise(_without_nan("min"))),
    RuleFunction("fmax", 2, elementwise(_without_nan("max"))),
    RuleFunction("fmod", 2, elementwise(remainder)),
    RuleFunction("hypot", 2, elementwise(hypotenuse)),
    RuleFunction("copysign", 2, elementwise(copy_sign)),
    RuleFunction("fdim", 2, elementwise(lambda b, x, y: Elementwise(b)("max", Elementwise(b)("sub", x, y), 0.0))),
    RuleFunction("fma", 3, elementwise(fused_product)),
    RuleFunction("remainder", 2, elementwise(nearest_remainder)),
    RuleFunction("logb", 1, elementwise(logarithm_of_exponent)),
    RuleFunction("erf", 1, elementwise(operation("erf"))),
    RuleFunction("erfc", 1, elementwise(operation("erfc"))),
    RuleFunction("lgamma", 1, elementwise(log_gamma)),
    RuleFunction("tgamma", 1, elementwise(gamma)),
    RuleFunction("nextafter", 2, elementwise(next_number)),
    RuleFunction("nexttoward", 2, elementwise(next_number)),
    RuleFunction("exp10", 1, elementwise(lambda builder, x: Elementwise(builder)("pow", 10.0, x))),
)
_COMPARISONS: Final = {
    "isgreater": "gt", "isgreaterequal": "ge", "isless": "lt", "islessequal": "le",
}  # fmt: skip
_TESTS: Final = (
    RuleFunction("isnan", 1, elementwise(lambda b, x: Elementwise(b)("ne", x, x))),
    RuleFunction("isinf", 1, elementwise(lambda b, x: Elementwise(b)("eq", Elementwise(b)("abs", x), math.inf))),
    RuleFunction("isfinite", 1, elementwise(lambda b, x: Elementwise(b)("lt", Elementwise(b)("abs", x), math.inf))),
    RuleFunction("signbit", 1, elementwise(is_negative)),
    *(RuleFunction(name, 2, elementwise(operation(op))) for name, op in _COMPARISONS.items()),
    RuleFunction("islessgreater", 2, elementwise(_are_unequal)),
    RuleFunction("isunordered", 2, elementwise(_is_any_nan)),
    RuleFunction("abs", 1, elementwise(ONE["abs"])),
    RuleFunction("labs", 1, elementwise(ONE["abs"])),
)
_INTERNAL: Final = (
    RuleFunction("wrap", 3, _wrap),
    RuleFunction("truncate", 1, elementwise(truncate)),
    RuleFunction("single", 1, elementwise(operation("single"))),
    RuleFunction("multiply", 4, _multiply),
    RuleFunction("quotient", 2, _quotient),
    RuleFunction("rest", 2, _remainder),
    RuleFunction("product_quotient", 4, _quotient_of_product),
    RuleFunction("upper_bits", 5, _upper_bits),
    RuleFunction("scaled", 2, elementwise(scaled)),
    RuleFunction("exponent", 1, elementwise(exponent_of)),
    RuleFunction("mantissa", 1, elementwise(mantissa_of)),
    RuleFunction("normal", 2, lambda e, x, least: is_normal(e.builder, x, e.builder.value(int(least.item())) or 0.0)),
    RuleFunction(
        "classified", 2, lambda e, x, least: class_of(e.builder, x, e.builder.value(int(least.item())) or 0.0)
    ),
    RuleFunction("nextafterf", 2, elementwise(partial(next_number, is_single=True))),
    RuleFunction("lastbits", 2, elementwise(last_bits_of_quotient)),
    RuleFunction("fraction", 1, elementwise(fraction_of)),
    RuleFunction("and", 4, _bits("bitand")),
    RuleFunction("or", 4, _bits("bitor")),
    RuleFunction("xor", 4, _bits("bitxor")),
    RuleFunction("left", 2, shift(1.0)),
    RuleFunction("right", 2, shift(-1.0)),
    RuleFunction("index", 2, _index),
    RuleFunction("size", 2, _size),
    RuleFunction("zeros", 1, _zeros),
    RuleFunction("array", 2, _array),
    RuleFunction("tail", 3, _tail),
    RuleFunction("with_tail", 2, _with_tail),
)
MATHEMATICS: Final = {function.name: function.count for function in _MATHEMATICS}
TESTS: Final = {function.name: function.count for function in _TESTS}
LIBRARY: Final[dict[str, LibraryFunction]] = {
    **{f"c:{function.name}": function for function in (*_MATHEMATICS, *_TESTS, *_INTERNAL)},
    "c:member": UnionFunction(),
    "c:overlapped": UnionFunction(),
}
