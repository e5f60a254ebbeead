"""Functions of the bits of whole numbers; those of negative ones are in two's complement.

A number of an integer class is rounded and kept within its limits first, as its class does in MATLAB, and so is the
result. Other numbers are taken as whole numbers of any length.
"""

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function, matlab_word
from kennfeld.models.simulink.code.values import Held, constants, integers, word_of
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.integer_types import EXACT, Word, fitted, wrapped
from kennfeld.models.simulink.expressions.signals import Nodes

__all__ = ["OF_BITS"]

OF_BITS = frozenset(
    {"bitand", "bitor", "bitxor", "bitshift", "bitsll", "bitsrl", "bitsra", "bitcmp", "bitget", "bitset"}
)
_BITS = 32


def _word(given: Given, operands: int = 1) -> Word | None:
    """The integer class of a call: that of an operand that has one, or a name behind the other arguments."""
    named = given.held[-1] if isinstance(given.held[-1], str) else None
    stated = matlab_word(named) if named is not None else None
    if named is not None and stated is None:
        raise given.refuse(f"{named!r} is not a class of integers")
    words = [word for at in range(operands) if (word := word_of(given.array(at))) is not None]
    if len({(word.bits, word.signed) for word in words}) > 1:
        raise given.refuse("its arguments are of different integer classes")
    return words[0] if words else stated


def _stored(given: Given, at: int, word: Word | None) -> Nodes:
    """An argument as whole numbers, of the class where there is one."""
    loom, array = given.calls.loom, given.array(at)
    return each(loom, "floor", array) if word is None else fitted(loom, array, word)


def _bit(loom: Loom, x: Nodes, at: int) -> Nodes:
    shifted = each(loom, "floor", each(loom, "mul", x, constants(loom, 2.0**-at)))
    return each(loom, "mod", shifted, constants(loom, 2.0))


@function("bitand", "bitor", "bitxor", least=2, most=3)
def bitwise(given: Given) -> Held:
    """An operation on the bits of two numbers, of up to 32 bits; not a number beyond these."""
    word = _word(given, 2)
    loom, (a, b) = given.calls.loom, (_stored(given, at, word) for at in (0, 1))
    given.fits(a, b)
    wanted = _wanted(given, word, a, b)
    sums = each(loom, "add", a, b)  # a + b counts common bits twice
    both = each(loom, "mul", constants(loom, 0.0), sums) if not sums.size else constants(loom, 0.0)
    for at in range(_BITS) if wanted is None else wanted:
        one = each(loom, "mul", _bit(loom, a, at), _bit(loom, b, at))
        both = each(loom, "add", both, each(loom, "mul", constants(loom, 2.0**at), one))
    if wanted is None:
        both = _signed(loom, a, b, both)
    if given.name == "bitand":
        return integers(np.broadcast_to(both, sums.shape), word)
    times = constants(loom, 1.0 if given.name == "bitor" else 2.0)
    return integers(each(loom, "sub", sums, each(loom, "mul", times, both)), word)


def _signed(loom: Loom, a: Nodes, b: Nodes, both: Nodes) -> Nodes:
    """The bits that two numbers share, with the sign where they share that; not a number where they have more bits."""
    edge, zero = constants(loom, 2.0**_BITS), constants(loom, 0.0)
    negative = each(loom, "and", each(loom, "lt", a, zero), each(loom, "lt", b, zero))
    made = each(loom, "sub", both, each(loom, "mul", edge, negative))
    for one in (a, b):
        below = each(loom, "lt", one, edge)
        fits = each(loom, "and", each(loom, "ge", one, each(loom, "neg", edge)), below)
        made = each(loom, "select", fits, made, constants(loom, np.nan))
    return made


def _wanted(given: Given, word: Word | None, a: Nodes, b: Nodes) -> list[int] | None:
    """The bits of what is fixed, which are all that both numbers can have; None where both may have any."""
    made: set[int] | None = None
    for one in (a, b):
        numbers = given.calls.desk.numbers(one, f"a mask of {given.name}")
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
def shifted(given: Given) -> Held:
    """Times a power of two, downwards to whole numbers; bits that a class has no place for are dropped."""
    word, loom = _word(given), given.calls.loom
    x, steps = _stored(given, 0, word), np.asarray(given.array(1))
    if given.name == "bitsrl" and (word is None or word.signed):
        negative = each(loom, "lt", x, constants(loom, 0.0))
        if word is None or word.bits > EXACT:
            x = each(loom, "select", negative, constants(loom, np.nan), x)
        else:
            x = each(loom, "select", negative, each(loom, "add", x, constants(loom, 2.0**word.bits)), x)
    if given.name in ("bitsrl", "bitsra"):
        steps = each(loom, "neg", steps)
    if word is not None and word.bits <= EXACT:  # further shifts leave nothing, and numbers that are no longer exact
        steps = each(loom, "min", steps, constants(loom, float(word.bits)))
    moved = each(loom, "floor", each(loom, "mul", x, each(loom, "pow", constants(loom, 2.0), steps)))
    if word is not None and word.bits <= EXACT:
        return integers(wrapped(loom, moved, word), word)
    fixed = given.calls.desk.numbers(steps, f"the places of {given.name}")
    if fixed is None or np.any(fixed > _BITS):  # numbers without a type count as those of 64 bits
        beyond = each(loom, "ge", moved, constants(loom, 2.0**64))
        moved = each(loom, "select", beyond, each(loom, "mod", moved, constants(loom, 2.0**64)), moved)
    if fixed is None or np.any(fixed > 0):
        _tell_unknown(given, "keeps the bits that an integer type would drop")
    return integers(moved, word)


def _tell_unknown(given: Given, what: str) -> None:
    if given.calls.desk.numbers(given.array(0), f"an argument of {given.name}") is None:
        given.calls.desk.remark(f"{given.name} {what}, since nothing says the type of its argument. {_TYPED}")


@function("bitcmp", least=1, most=2)
def complement(given: Given) -> Held:
    """A number with all of its bits inverted."""
    word, loom = _word(given), given.calls.loom
    if word is None or word.bits > EXACT:
        raise given.refuse("the class of its argument decides, and is no integer of up to 32 bits", _TYPED)
    top = constants(loom, -1.0 if word.signed else 2.0**word.bits - 1)
    return integers(each(loom, "sub", top, _stored(given, 0, word)), word)


@function("bitget", least=2, most=3)
def bit(given: Given) -> Held:
    """A bit by its place, counted from 1."""
    word, loom = _word(given), given.calls.loom
    scale = each(loom, "pow", constants(loom, 2.0), each(loom, "sub", constants(loom, 1.0), given.array(1)))
    moved = each(loom, "floor", each(loom, "mul", _stored(given, 0, word), scale))
    return integers(each(loom, "mod", moved, constants(loom, 2.0)), word)


@function("bitset", least=2, most=4)
def with_bit(given: Given) -> Held:
    """A number with a bit set to 1, or to a value."""
    is_named = isinstance(given.held[-1], str)
    word, loom = _word(given), given.calls.loom
    x, place = _stored(given, 0, word), np.asarray(given.array(1))
    new = given.array(2) if len(given) - is_named > 2 else constants(loom, 1.0)
    new = each(loom, "ne", new, constants(loom, 0.0))
    weight = each(loom, "pow", constants(loom, 2.0), each(loom, "sub", place, constants(loom, 1.0)))
    old = each(loom, "mod", each(loom, "floor", each(loom, "div", x, weight)), constants(loom, 2.0))
    made = each(loom, "add", x, each(loom, "mul", weight, each(loom, "sub", new, old)))
    if word is None or word.bits > EXACT:
        return integers(made, word)
    return integers(wrapped(loom, made, word), word)


_TYPED = "Convert its argument, for instance by int16(x)"
