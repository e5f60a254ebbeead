"""Library functions of single elements: bit operations, conversions, elementary functions, logic.

Bit operations on negative integers use two's complement. Numbers of an integer class are first rounded and saturated as
by MATLAB, and so is the result. Other numbers are integers of any length.
"""

import math
from collections.abc import Callable
from functools import partial, reduce
from typing import Final

import numpy as np

from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.graph_operators import ONE_IN_C, TWO, TWO_IN_C, Rule
from kennfeld.models.imperative.integer_types import EXACT, IntegerType, fit_to_type, wrap_to_type
from kennfeld.models.imperative.library.function_registry import C_FUNCTIONS, SymbolicArguments, function, matlab_word
from kennfeld.models.imperative.library.numeric_rules import OF_ONE, OF_TWO
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, truncate

_BITS = 32
_OF_TRUTHS: Final = {"bitand": "and", "bitor": "or", "bitxor": "ne"}

_TYPED = "Convert its argument, for instance by int16(x)."

_CASTS: Final = (
    "double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "fi", "half",
)  # fmt: skip
_DEGREES: Final = math.pi / 180


def _integer_class(args: SymbolicArguments, operands: int = 1) -> IntegerType | None:
    """Return the integer class of a call: that of an operand, or one named after the other arguments."""
    named = args.values[-1] if isinstance(args.values[-1], str) else None
    stated = matlab_word(named) if named is not None else None
    if named is not None and stated is None:
        raise args.refuse(f"{named!r} is not an integer class")
    words = [word for at in range(operands) if (word := s.word_of(args.array(at))) is not None]
    if len({(word.bits, word.signed) for word in words}) > 1:
        raise args.refuse("its arguments have different integer classes")
    return words[0] if words else stated


def _as_integers(args: SymbolicArguments, at: int, word: IntegerType | None) -> Nodes:
    """Return an argument as integers, of its class if it has one."""
    array = args.array(at)
    return args.apply("floor", array) if word is None else fit_to_type(args.builder, array, word)


def _bit(apply: Elementwise, x: Nodes, at: int) -> Nodes:
    return apply("mod", apply("floor", apply("mul", x, 2.0**-at)), 2.0)


@function("bitand", "bitor", "bitxor", least=2, most=3)
def bitwise(args: SymbolicArguments) -> s.SymbolicValue:
    """Combine the bits of two numbers of up to 32 bits; NaN beyond. Two truth values have a single bit."""
    word, apply = _integer_class(args, 2), args.apply
    if all(_are_truths(args, at) for at in (0, 1)):
        return s.integers(apply(_OF_TRUTHS[args.name], args.array(0), args.array(1)), word)
    a, b = (_as_integers(args, at, word) for at in (0, 1))
    args.fits(a, b)
    constant_bits = [0] if any(_are_truths(args, at) for at in (0, 1)) else _constant_bits(args, word, a, b)
    sums = apply("add", a, b)  # a + b counts common bits twice
    both = apply("mul", 0.0, sums) if not sums.size else s.constants(args.builder, 0.0)
    for at in range(_BITS) if constant_bits is None else constant_bits:
        common = apply("mul", _bit(apply, a, at), _bit(apply, b, at))
        both = apply("add", both, apply("mul", 2.0**at, common))
    if constant_bits is None:
        both = _common_bits(apply, a, b, both)
    if args.name == "bitand":
        return s.integers(np.broadcast_to(both, sums.shape), word)
    return s.integers(apply("sub", sums, apply("mul", 1.0 if args.name == "bitor" else 2.0, both)), word)


def _are_truths(args: SymbolicArguments, at: int) -> bool:
    array = args.array(at)
    if isinstance(array, s.LogicalNodes) or not array.size:
        return isinstance(array, s.LogicalNodes)
    return all(args.builder.is_truth(int(node)) for node in np.ravel(array))


def _common_bits(apply: Elementwise, a: Nodes, b: Nodes, both: Nodes) -> Nodes:
    """Return the common bits of two numbers, with their sign if it is the same; NaN if they have more bits."""
    edge = 2.0**_BITS
    negative = apply("and", apply("lt", a, 0.0), apply("lt", b, 0.0))
    result = apply("sub", both, apply("mul", edge, negative))
    for operand in (a, b):
        fits = apply("and", apply("ge", operand, -edge), apply("lt", operand, edge))
        result = apply("select", fits, result, math.nan)
    return result


def _constant_bits(args: SymbolicArguments, word: IntegerType | None, a: Nodes, b: Nodes) -> list[int] | None:
    """Return the bits of a constant operand, the only ones both can share; None if there is none."""
    result: set[int] | None = None
    for operand in (a, b):
        numbers = args.context.numbers(operand, f"a mask of {args.name}")
        if numbers is None or (word is not None and np.any(numbers < 0)):
            continue
        if np.any(numbers < 0) or np.any(numbers != np.floor(numbers)) or np.any(numbers >= 2.0**53):
            raise args.refuse("its numbers are negative or not integers", _TYPED)
        used = int(np.bitwise_or.reduce(numbers.ravel().astype(np.int64))) if numbers.size else 0
        bits = {at for at in range(_BITS) if used >> at & 1}
        result = bits if result is None else result & bits
        if used >> _BITS:
            raise args.refuse(f"its numbers have more than {_BITS} bits")
    return None if result is None else sorted(result)


@function("bitshift", "bitsll", "bitsrl", "bitsra", least=2, most=3)
def shift_bits(args: SymbolicArguments) -> s.SymbolicValue:
    """Multiply by a power of two, rounded down; bits that exceed the class are dropped."""
    word, apply = _integer_class(args), args.apply
    x, steps = _as_integers(args, 0, word), np.asarray(args.array(1))
    if args.name == "bitsrl" and (word is None or word.signed):
        unsigned = math.nan if word is None or word.bits > EXACT else apply("add", x, 2.0**word.bits)
        x = apply("select", apply("lt", x, 0.0), unsigned, x)
    if args.name in ("bitsrl", "bitsra"):
        steps = apply("neg", steps)
    if word is not None and word.bits <= EXACT:  # further shifts leave nothing, and numbers that are no longer exact
        steps = apply("min", steps, float(word.bits))
    shifted = apply("floor", apply("mul", x, apply("pow", 2.0, steps)))
    if word is not None and word.bits <= EXACT:
        return s.integers(wrap_to_type(args.builder, shifted, word), word)
    fixed = args.context.numbers(steps, f"the shift of {args.name}")
    if fixed is None or np.any(fixed > _BITS):  # numbers without a type count as those of 64 bits
        shifted = apply("select", apply("ge", shifted, 2.0**64), apply("mod", shifted, 2.0**64), shifted)
    may_grow = fixed is None or np.any(fixed > 0)
    if may_grow and args.context.numbers(args.array(0), f"an argument of {args.name}") is None:
        message = "keeps the bits that an integer type would drop, because the type of its argument is unknown"
        args.context.remark(f"{args.name} {message}. {_TYPED}", 0)
    return s.integers(shifted, word)


@function("bitcmp", least=1, most=2)
def complement_bits(args: SymbolicArguments) -> s.SymbolicValue:
    word = _integer_class(args)
    if word is None or word.bits > EXACT:
        raise args.refuse("its argument must be of an integer class of up to 32 bits", _TYPED)
    top = -1.0 if word.signed else 2.0**word.bits - 1
    return s.integers(args.apply("sub", top, _as_integers(args, 0, word)), word)


@function("bitget", least=2, most=3)
def get_bit(args: SymbolicArguments) -> s.SymbolicValue:
    """Return a bit by its position, counted from 1."""
    word, apply = _integer_class(args), args.apply
    scale = apply("pow", 2.0, apply("sub", 1.0, args.array(1)))
    shifted = apply("floor", apply("mul", _as_integers(args, 0, word), scale))
    return s.integers(apply("mod", shifted, 2.0), word)


@function("bitset", least=2, most=4)
def set_bit(args: SymbolicArguments) -> s.SymbolicValue:
    """Set a bit to 1, or to a value."""
    is_named = isinstance(args.values[-1], str)
    word, apply = _integer_class(args), args.apply
    x, place = _as_integers(args, 0, word), np.asarray(args.array(1))
    new = apply("ne", args.array(2), 0.0) if len(args) - is_named > 2 else s.constants(args.builder, 1.0)
    weight = apply("pow", 2.0, apply("sub", place, 1.0))
    old = apply("mod", apply("floor", apply("div", x, weight)), 2.0)
    result = apply("add", x, apply("mul", weight, apply("sub", new, old)))
    if word is not None and word.bits <= EXACT:
        result = wrap_to_type(args.builder, result, word)
    return s.integers(result, word)


@function(*_CASTS, most=5)
def cast(args: SymbolicArguments) -> s.SymbolicValue:
    """Return the value unchanged: values are physical, in double precision. Bit functions see the integer type."""
    return s.integers(args.array(0), matlab_word(args.name))


@function("cast", least=2, most=3)
def cast_to(args: SymbolicArguments) -> s.SymbolicValue:
    """Return the value unchanged, as the casts by name do."""
    x = args.array(0)
    if args.values[1] == "like":
        return s.of_class(args.array(2), x)
    if args.text(1) not in (*_CASTS, "logical"):
        raise args.refuse(f"{args.text(1)!r} is not a numeric class")
    if args.text(1) != "logical":
        return s.integers(x, matlab_word(args.text(1)))
    return s.as_logical(args.apply("ne", x, 0.0))


@function("real", "conj")
def to_number(args: SymbolicArguments) -> s.SymbolicValue:
    return np.asarray(args.array(0))


@function("full")
def full(args: SymbolicArguments) -> s.SymbolicValue:
    """Return the value unchanged: all arrays are full."""
    return args.array(0)


@function("logical", "boolean")
def to_logical(args: SymbolicArguments) -> s.SymbolicValue:
    """Return whether elements are not 0."""
    x = args.array(0)
    return x if isinstance(x, s.LogicalNodes) else s.as_logical(args.apply("ne", x, 0.0))


def _wrap_to_turn(apply: Elementwise, x: Nodes, turn: float) -> Nodes:
    """Wrap an angle to a full turn from 0; positive multiples of a turn are kept."""
    result = apply("mod", x, turn)
    whole = apply("and", apply("eq", result, 0.0), apply("gt", x, 0.0))
    return apply("select", whole, turn, result)


def _wrap_to_half_turn(apply: Elementwise, x: Nodes, half: float) -> Nodes:
    """Wrap an angle to half a turn on both sides; angles within are unchanged."""
    result = apply("sub", _wrap_to_turn(apply, apply("add", x, half), 2 * half), half)
    return apply("select", apply("gt", apply("abs", x), half), result, x)


# functions of one argument composed from operations of the graph
_COMPOSED: Final[dict[str, Callable[[Elementwise, Nodes], Nodes]]] = {
    "sec": lambda apply, x: apply("div", 1.0, apply("cos", x)),
    "csc": lambda apply, x: apply("div", 1.0, apply("sin", x)),
    "cot": lambda apply, x: apply("div", 1.0, apply("tan", x)),
    "sind": lambda apply, x: apply("sin", apply("mul", x, _DEGREES)),
    "cosd": lambda apply, x: apply("cos", apply("mul", x, _DEGREES)),
    "tand": lambda apply, x: apply("tan", apply("mul", x, _DEGREES)),
    "wrapToPi": partial(_wrap_to_half_turn, half=math.pi),
    "wrapTo180": partial(_wrap_to_half_turn, half=180.0),
    "wrapTo2Pi": partial(_wrap_to_turn, turn=2 * math.pi),
    "wrapTo360": partial(_wrap_to_turn, turn=360.0),
    "uplus": lambda apply, x: x,
}


@function(*_COMPOSED)
def composed_function(args: SymbolicArguments) -> s.SymbolicValue:
    return _COMPOSED[args.name](args.apply, args.array(0))


@function(*ONE_IN_C, library=C_FUNCTIONS)
def unary_function_in_c(args: SymbolicArguments) -> s.SymbolicValue:
    return ONE_IN_C[args.name](args.builder, args.array(0))


_OWN: Final[dict[str, Rule]] = {
    **{name: TWO[name] for name in ("mod", "rem", "power")},
    "realpow": TWO["power"],
}


@function("round")
def round_half_away(args: SymbolicArguments) -> s.SymbolicValue:
    return args.apply("round", args.array(0))


@function(*_OWN, least=2, most=2)
def binary_function(args: SymbolicArguments) -> s.SymbolicValue:
    """Apply a function of two arguments, element by element."""
    args.fits(*args.arrays)
    return _OWN[args.name](args.builder, *args.arrays)


@function(*TWO_IN_C, least=2, most=2, library=C_FUNCTIONS)
def binary_function_in_c(args: SymbolicArguments) -> s.SymbolicValue:
    return TWO_IN_C[args.name](args.builder, *args.arrays)


@function("and", "or", least=2, most=20)
def combine_logical(args: SymbolicArguments) -> s.SymbolicValue:
    """Combine several arguments by a logical operation, element by element."""
    return s.as_logical(reduce(lambda a, b: args.apply(args.name, a, b), args.arrays))


@function("not")
def negate(args: SymbolicArguments) -> s.SymbolicValue:
    return s.as_logical(args.apply("not", args.array(0)))


ELEMENTWISE_NAMES: Final = frozenset({*_CASTS, *_COMPOSED, *_OWN, *OF_ONE, *OF_TWO, "round", "not", "logical"})


@function("idivide", least=2, most=3)
def divide_and_round(args: SymbolicArguments) -> s.SymbolicValue:
    """Divide and round, towards zero by default."""
    rounding = args.text(2) if len(args) > 2 else "fix"
    quotient = args.apply("div", args.array(0), args.array(1))
    if rounding not in ("fix", "floor", "ceil", "round"):
        raise args.refuse(f"unknown rounding method {rounding!r}")
    return truncate(args.builder, quotient) if rounding == "fix" else args.apply(rounding, quotient)


@function("nthroot", least=2, most=2)
def nth_root(args: SymbolicArguments) -> s.SymbolicValue:
    """Return a real root of an integer degree, of negative numbers if the degree is odd."""
    apply, x, degree = args.apply, args.array(0), args.whole(1)
    if not degree:
        raise args.refuse("a root of degree 0")
    if degree % 2 == 0:
        return apply("pow", x, 1.0 / degree)
    return apply("mul", apply("sign", x), apply("pow", apply("abs", x), 1.0 / degree))
