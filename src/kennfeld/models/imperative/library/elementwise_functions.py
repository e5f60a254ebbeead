"""Functions of the bits of whole numbers; those of negative ones are in two's complement.

A number of an integer class is rounded and kept within its limits first, as its class does in MATLAB, and so is the
result. Other numbers are taken as whole numbers of any length.

Functions of each element alone.
"""

import math
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, ONE, PLAIN, TWO, Rule
from kennfeld.models.imperative.integer_types import EXACT, IntegerType, fitted, wrapped
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, truncate
from kennfeld.models.imperative.symbolic_values import (
    LogicalNodes,
    SymbolicValue,
    as_logical,
    constants,
    integers,
    of_class,
    word_of,
)

__all__ = ["ELEMENTWISE_NAMES", "OF_BITS"]

OF_BITS = frozenset(
    {"bitand", "bitor", "bitxor", "bitshift", "bitsll", "bitsrl", "bitsra", "bitcmp", "bitget", "bitset"}
)
_BITS = 32

_TYPED = "Convert its argument, for instance by int16(x)"

_CASTS: Final = (
    "double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "fi", "half",
)  # fmt: skip
_DEGREES: Final = math.pi / 180


def _word(given: SymbolicArguments, operands: int = 1) -> IntegerType | None:
    """The integer class of a call: that of an operand that has one, or a name behind the other arguments."""
    named = given.held[-1] if isinstance(given.held[-1], str) else None
    stated = matlab_word(named) if named is not None else None
    if named is not None and stated is None:
        raise given.refuse(f"{named!r} is not a class of integers")
    words = [word for at in range(operands) if (word := word_of(given.array(at))) is not None]
    if len({(word.bits, word.signed) for word in words}) > 1:
        raise given.refuse("its arguments are of different integer classes")
    return words[0] if words else stated


def _stored(given: SymbolicArguments, at: int, word: IntegerType | None) -> Nodes:
    """An argument as whole numbers, of the class where there is one."""
    builder, array = given.calls.builder, given.array(at)
    return elementwise(builder, "floor", array) if word is None else fitted(builder, array, word)


def _bit(builder: GraphBuilder, x: Nodes, at: int) -> Nodes:
    shifted = elementwise(builder, "floor", elementwise(builder, "mul", x, constants(builder, 2.0**-at)))
    return elementwise(builder, "mod", shifted, constants(builder, 2.0))


@function("bitand", "bitor", "bitxor", least=2, most=3)
def bitwise(given: SymbolicArguments) -> SymbolicValue:
    """An operation on the bits of two numbers, of up to 32 bits; not a number beyond these."""
    word = _word(given, 2)
    builder, (a, b) = given.calls.builder, (_stored(given, at, word) for at in (0, 1))
    given.fits(a, b)
    wanted = _wanted(given, word, a, b)
    sums = elementwise(builder, "add", a, b)  # a + b counts common bits twice
    both = elementwise(builder, "mul", constants(builder, 0.0), sums) if not sums.size else constants(builder, 0.0)
    for at in range(_BITS) if wanted is None else wanted:
        one = elementwise(builder, "mul", _bit(builder, a, at), _bit(builder, b, at))
        both = elementwise(builder, "add", both, elementwise(builder, "mul", constants(builder, 2.0**at), one))
    if wanted is None:
        both = _signed(builder, a, b, both)
    if given.name == "bitand":
        return integers(np.broadcast_to(both, sums.shape), word)
    times = constants(builder, 1.0 if given.name == "bitor" else 2.0)
    return integers(elementwise(builder, "sub", sums, elementwise(builder, "mul", times, both)), word)


def _signed(builder: GraphBuilder, a: Nodes, b: Nodes, both: Nodes) -> Nodes:
    """The bits that two numbers share, with the sign where they share that; not a number where they have more bits."""
    edge, zero = constants(builder, 2.0**_BITS), constants(builder, 0.0)
    negative = elementwise(builder, "and", elementwise(builder, "lt", a, zero), elementwise(builder, "lt", b, zero))
    made = elementwise(builder, "sub", both, elementwise(builder, "mul", edge, negative))
    for one in (a, b):
        below = elementwise(builder, "lt", one, edge)
        fits = elementwise(builder, "and", elementwise(builder, "ge", one, elementwise(builder, "neg", edge)), below)
        made = elementwise(builder, "select", fits, made, constants(builder, np.nan))
    return made


def _wanted(given: SymbolicArguments, word: IntegerType | None, a: Nodes, b: Nodes) -> list[int] | None:
    """The bits of what is fixed, which are all that both numbers can have; None where both may have any."""
    made: set[int] | None = None
    for one in (a, b):
        numbers = given.calls.context.numbers(one, f"a mask of {given.name}")
        if numbers is not None and not (word is not None and np.any(numbers < 0)):
            if np.any(numbers < 0) or np.any(numbers != np.floor(numbers)) or np.any(numbers >= 2.0**53):
                raise given.refuse("its numbers are negative or not whole", _TYPED)
            used = int(np.bitwise_or.reduce(numbers.ravel().astype(np.int64))) if numbers.size else 0
            bits = {at for at in range(_BITS) if used >> at & 1}
            made = bits if made is None else made & bits
            if used >> _BITS:
                raise given.refuse(f"its numbers have more than {_BITS} bits")
    return None if made is None else sorted(made)


@function("bitshift", "bitsll", "bitsrl", "bitsra", least=2, most=3)
def shifted(given: SymbolicArguments) -> SymbolicValue:
    """Times a power of two, downwards to whole numbers; bits that a class has no place for are dropped."""
    word, builder = _word(given), given.calls.builder
    x, steps = _stored(given, 0, word), np.asarray(given.array(1))
    if given.name == "bitsrl" and (word is None or word.signed):
        negative = elementwise(builder, "lt", x, constants(builder, 0.0))
        if word is None or word.bits > EXACT:
            x = elementwise(builder, "select", negative, constants(builder, np.nan), x)
        else:
            x = elementwise(
                builder, "select", negative, elementwise(builder, "add", x, constants(builder, 2.0**word.bits)), x
            )
    if given.name in ("bitsrl", "bitsra"):
        steps = elementwise(builder, "neg", steps)
    if word is not None and word.bits <= EXACT:  # further shifts leave nothing, and numbers that are no longer exact
        steps = elementwise(builder, "min", steps, constants(builder, float(word.bits)))
    moved = elementwise(
        builder, "floor", elementwise(builder, "mul", x, elementwise(builder, "pow", constants(builder, 2.0), steps))
    )
    if word is not None and word.bits <= EXACT:
        return integers(wrapped(builder, moved, word), word)
    fixed = given.calls.context.numbers(steps, f"the places of {given.name}")
    if fixed is None or np.any(fixed > _BITS):  # numbers without a type count as those of 64 bits
        beyond = elementwise(builder, "ge", moved, constants(builder, 2.0**64))
        moved = elementwise(
            builder, "select", beyond, elementwise(builder, "mod", moved, constants(builder, 2.0**64)), moved
        )
    if fixed is None or np.any(fixed > 0):
        _tell_unknown(given, "keeps the bits that an integer type would drop")
    return integers(moved, word)


def _tell_unknown(given: SymbolicArguments, message: str) -> None:
    if given.calls.context.numbers(given.array(0), f"an argument of {given.name}") is None:
        given.calls.context.remark(f"{given.name} {message}, since nothing says the type of its argument. {_TYPED}")


@function("bitcmp", least=1, most=2)
def complement(given: SymbolicArguments) -> SymbolicValue:
    """A number with all of its bits inverted."""
    word, builder = _word(given), given.calls.builder
    if word is None or word.bits > EXACT:
        raise given.refuse("the class of its argument decides, and is no integer of up to 32 bits", _TYPED)
    top = constants(builder, -1.0 if word.signed else 2.0**word.bits - 1)
    return integers(elementwise(builder, "sub", top, _stored(given, 0, word)), word)


@function("bitget", least=2, most=3)
def bit(given: SymbolicArguments) -> SymbolicValue:
    """A bit by its place, counted from 1."""
    word, builder = _word(given), given.calls.builder
    scale = elementwise(
        builder, "pow", constants(builder, 2.0), elementwise(builder, "sub", constants(builder, 1.0), given.array(1))
    )
    moved = elementwise(builder, "floor", elementwise(builder, "mul", _stored(given, 0, word), scale))
    return integers(elementwise(builder, "mod", moved, constants(builder, 2.0)), word)


@function("bitset", least=2, most=4)
def with_bit(given: SymbolicArguments) -> SymbolicValue:
    """A number with a bit set to 1, or to a value."""
    is_named = isinstance(given.held[-1], str)
    word, builder = _word(given), given.calls.builder
    x, place = _stored(given, 0, word), np.asarray(given.array(1))
    new = given.array(2) if len(given) - is_named > 2 else constants(builder, 1.0)
    new = elementwise(builder, "ne", new, constants(builder, 0.0))
    weight = elementwise(
        builder, "pow", constants(builder, 2.0), elementwise(builder, "sub", place, constants(builder, 1.0))
    )
    old = elementwise(
        builder, "mod", elementwise(builder, "floor", elementwise(builder, "div", x, weight)), constants(builder, 2.0)
    )
    made = elementwise(builder, "add", x, elementwise(builder, "mul", weight, elementwise(builder, "sub", new, old)))
    if word is None or word.bits > EXACT:
        return integers(made, word)
    return integers(wrapped(builder, made, word), word)


@function(*PLAIN)
def plain(given: SymbolicArguments) -> SymbolicValue:
    """An operation of the graph."""
    return elementwise(given.calls.builder, given.name, given.array(0))


@function(*_CASTS, most=5)
def cast(given: SymbolicArguments) -> SymbolicValue:
    """The value as it is: values are physical, in double precision. Functions of bits see the integer type."""
    return integers(given.array(0), matlab_word(given.name))


@function("cast", least=2, most=3)
def cast_to(given: SymbolicArguments) -> SymbolicValue:
    """The value as it is, as with the casts by name."""
    x = given.array(0)
    if given.held[1] == "like":
        return of_class(given.array(2), x)
    if given.text(1) not in (*_CASTS, "logical"):
        raise given.refuse(f"{given.text(1)!r} is not a class of numbers")
    if given.text(1) != "logical":
        return integers(x, matlab_word(given.text(1)))
    return as_logical(elementwise(given.calls.builder, "ne", x, constants(given.calls.builder, 0.0)))


@function("real", "conj")
def same(given: SymbolicArguments) -> SymbolicValue:
    """The value as a number: all numbers are real."""
    return np.asarray(given.array(0))


@function("full")
def full(given: SymbolicArguments) -> SymbolicValue:
    """The value as it is: all arrays are full."""
    return given.array(0)


@function("logical", "boolean")
def logical(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are not 0."""
    x = given.array(0)
    return (
        x
        if isinstance(x, LogicalNodes)
        else as_logical(elementwise(given.calls.builder, "ne", x, constants(given.calls.builder, 0.0)))
    )


def _minus(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    return elementwise(builder, "sub", a, b)


def _times(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    return elementwise(builder, "mul", a, b)


def _over(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    return elementwise(builder, "div", a, b)


def _log1p(builder: GraphBuilder, x: Nodes) -> Nodes:
    return elementwise(builder, "log", elementwise(builder, "add", x, constants(builder, 1.0)))


def _expm1(builder: GraphBuilder, x: Nodes) -> Nodes:
    """By the hyperbolic tangent, which is exact near 0: 2 t / (1 - t), t = tanh(x/2)."""
    t = elementwise(builder, "tanh", _times(builder, x, constants(builder, 0.5)))
    near = _over(builder, _times(builder, constants(builder, 2.0), t), _minus(builder, constants(builder, 1.0), t))
    far = _minus(builder, elementwise(builder, "exp", x), constants(builder, 1.0))
    return elementwise(
        builder,
        "select",
        elementwise(builder, "lt", elementwise(builder, "abs", x), constants(builder, 1.0)),
        near,
        far,
    )


def _turned(builder: GraphBuilder, x: Nodes, turn: float) -> Nodes:
    """An angle from 0 to a whole turn; positive multiples of a turn stay one."""
    made = elementwise(builder, "mod", x, constants(builder, turn))
    zero = constants(builder, 0.0)
    whole = elementwise(builder, "and", elementwise(builder, "eq", made, zero), elementwise(builder, "gt", x, zero))
    return elementwise(builder, "select", whole, constants(builder, turn), made)


def _wrapped(builder: GraphBuilder, x: Nodes, half: float) -> Nodes:
    """An angle within half a turn to both sides; those that are stay as they are."""
    made = _minus(
        builder,
        _turned(builder, elementwise(builder, "add", x, constants(builder, half)), 2 * half),
        constants(builder, half),
    )
    return elementwise(
        builder, "select", elementwise(builder, "gt", elementwise(builder, "abs", x), constants(builder, half)), made, x
    )


_ONE: Final[dict[str, Rule]] = {
    **ONE,
    **INVERSE_HYPERBOLIC,
    "log2": lambda builder, x: _over(builder, elementwise(builder, "log", x), constants(builder, math.log(2.0))),
    "log1p": _log1p,
    "expm1": _expm1,
    "sec": lambda builder, x: _over(builder, constants(builder, 1.0), elementwise(builder, "cos", x)),
    "csc": lambda builder, x: _over(builder, constants(builder, 1.0), elementwise(builder, "sin", x)),
    "cot": lambda builder, x: _over(builder, constants(builder, 1.0), elementwise(builder, "tan", x)),
    "sind": lambda builder, x: elementwise(builder, "sin", _times(builder, x, constants(builder, _DEGREES))),
    "cosd": lambda builder, x: elementwise(builder, "cos", _times(builder, x, constants(builder, _DEGREES))),
    "tand": lambda builder, x: elementwise(builder, "tan", _times(builder, x, constants(builder, _DEGREES))),
    "asind": lambda builder, x: _over(builder, elementwise(builder, "asin", x), constants(builder, _DEGREES)),
    "acosd": lambda builder, x: _over(builder, elementwise(builder, "acos", x), constants(builder, _DEGREES)),
    "atand": lambda builder, x: _over(builder, elementwise(builder, "atan", x), constants(builder, _DEGREES)),
    "deg2rad": lambda builder, x: _times(builder, x, constants(builder, _DEGREES)),
    "rad2deg": lambda builder, x: _over(builder, x, constants(builder, _DEGREES)),
    "wrapToPi": lambda builder, x: _wrapped(builder, x, math.pi),
    "wrapTo180": lambda builder, x: _wrapped(builder, x, 180.0),
    "wrapTo2Pi": lambda builder, x: _turned(builder, x, 2 * math.pi),
    "wrapTo360": lambda builder, x: _turned(builder, x, 360.0),
    "uplus": lambda builder, x: x,
}


@function(*_ONE)
def composed(given: SymbolicArguments) -> SymbolicValue:
    """A function of one argument that operations of the graph make up."""
    return _ONE[given.name](given.calls.builder, given.array(0))


def _xor(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    zero = constants(builder, 0.0)
    return elementwise(builder, "ne", elementwise(builder, "ne", a, zero), elementwise(builder, "ne", b, zero))


_TWO: Final[dict[str, Rule]] = {
    **TWO,
    "realpow": TWO["power"],
    "ldivide": lambda builder, a, b: _over(builder, b, a),
}
_LOGIC: Final[dict[str, Rule]] = {
    "xor": _xor,
    "eq": lambda builder, a, b: elementwise(builder, "eq", a, b),
    "ne": lambda builder, a, b: elementwise(builder, "ne", a, b),
    "lt": lambda builder, a, b: elementwise(builder, "lt", a, b),
    "le": lambda builder, a, b: elementwise(builder, "le", a, b),
    "gt": lambda builder, a, b: elementwise(builder, "gt", a, b),
    "ge": lambda builder, a, b: elementwise(builder, "ge", a, b),
}


@function(*_TWO, least=2, most=2)
def of_two(given: SymbolicArguments) -> SymbolicValue:
    """A function of two arguments, element by element."""
    given.fits(*given.arrays)
    return _TWO[given.name](given.calls.builder, *given.arrays)


@function(*_LOGIC, least=2, most=2)
def comparison(given: SymbolicArguments) -> SymbolicValue:
    """A comparison, element by element."""
    given.fits(*given.arrays)
    return as_logical(_LOGIC[given.name](given.calls.builder, *given.arrays))


@function("and", "or", least=2, most=20)
def several(given: SymbolicArguments) -> SymbolicValue:
    """Logic of several arguments, element by element."""
    made = given.array(0)
    for other in given.arrays[1:]:
        made = elementwise(given.calls.builder, given.name, made, other)
    return as_logical(made)


@function("not")
def negation(given: SymbolicArguments) -> SymbolicValue:
    """Whether elements are 0."""
    return as_logical(elementwise(given.calls.builder, "not", given.array(0)))


ELEMENTWISE_NAMES: Final = frozenset({*PLAIN, *_CASTS, *_ONE, *_TWO, *_LOGIC, "not", "logical"})


@function("idivide", least=2, most=3)
def whole_division(given: SymbolicArguments) -> SymbolicValue:
    """A quotient made whole: towards zero where nothing else is asked for."""
    builder, how = given.calls.builder, given.text(2) if len(given) > 2 else "fix"
    quotient = _over(builder, given.array(0), given.array(1))
    if how not in ("fix", "floor", "ceil", "round"):
        raise given.refuse(f"{how!r} is no way of rounding")
    return truncate(builder, quotient) if how == "fix" else elementwise(builder, how, quotient)


@function("nthroot", least=2, most=2)
def root(given: SymbolicArguments) -> SymbolicValue:
    """A real root of a whole degree, of negative numbers where the degree is odd."""
    builder, x, degree = given.calls.builder, given.array(0), given.whole(1)
    if not degree:
        raise given.refuse("a root of degree 0")
    share = constants(builder, 1.0 / degree)
    if degree % 2 == 0:
        return elementwise(builder, "pow", x, share)
    return _times(
        builder, elementwise(builder, "sign", x), elementwise(builder, "pow", elementwise(builder, "abs", x), share)
    )
