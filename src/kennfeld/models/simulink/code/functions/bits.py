"""Functions of the bits of whole numbers; those of negative ones are in two's complement."""

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function
from kennfeld.models.simulink.code.values import Held, constants
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

_BITS = 32


def _bit(loom: Loom, x: Nodes, at: int) -> Nodes:
    shifted = each(loom, "floor", each(loom, "mul", x, constants(loom, 2.0**-at)))
    return each(loom, "mod", shifted, constants(loom, 2.0))


@function("bitand", "bitor", "bitxor", least=2, most=3)
def bitwise(given: Given) -> Held:
    """An operation on the bits of two numbers, of up to 32 bits; not a number beyond these."""
    loom, a, b = given.calls.loom, given.array(0), given.array(1)
    both = np.full(np.broadcast_shapes(a.shape, b.shape), loom.const(0.0), dtype=np.int64)
    wanted = _wanted(given, a, b)
    for at in range(_BITS) if wanted is None else wanted:
        one = each(loom, "mul", _bit(loom, a, at), _bit(loom, b, at))
        both = each(loom, "add", both, each(loom, "mul", constants(loom, 2.0**at), one))
    if wanted is None:
        both = _signed(loom, a, b, both)
    if given.name == "bitand":
        return both
    sums = each(loom, "add", a, b)  # a + b counts common bits twice
    times = constants(loom, 1.0 if given.name == "bitor" else 2.0)
    return each(loom, "sub", sums, each(loom, "mul", times, both))


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


def _wanted(given: Given, a: Nodes, b: Nodes) -> list[int] | None:
    """The bits of what is fixed, which are all that both numbers can have; None where both depend on signals."""
    made: set[int] | None = None
    for one in (a, b):
        numbers = given.calls.desk.numbers(one, f"a mask of {given.name}")
        if numbers is not None:
            if np.any(numbers < 0) or np.any(numbers != np.floor(numbers)) or np.any(numbers >= 2.0**53):
                raise given.refuse("its numbers are negative or not whole")
            used = int(np.bitwise_or.reduce(numbers.ravel().astype(np.int64))) if numbers.size else 0
            bits = {at for at in range(_BITS) if used >> at & 1}
            made = bits if made is None else made & bits
            if used >> _BITS:
                raise given.refuse(f"its numbers have more than {_BITS} bits")
    return None if made is None else sorted(made)


@function("bitshift", "bitsll", "bitsrl", "bitsra", least=2, most=3)
def shifted(given: Given) -> Held:
    """Times a power of two, downwards to whole numbers."""
    loom, steps = given.calls.loom, given.array(1)
    if given.name in ("bitsrl", "bitsra"):
        steps = each(loom, "neg", steps)
    return each(loom, "floor", each(loom, "mul", given.array(0), each(loom, "pow", constants(loom, 2.0), steps)))


@function("bitget", least=2, most=3)
def bit(given: Given) -> Held:
    """A bit by its place, counted from 1."""
    loom = given.calls.loom
    scale = each(loom, "pow", constants(loom, 2.0), each(loom, "sub", constants(loom, 1.0), given.array(1)))
    return each(loom, "mod", each(loom, "floor", each(loom, "mul", given.array(0), scale)), constants(loom, 2.0))


@function("bitset", least=2, most=4)
def with_bit(given: Given) -> Held:
    """A number with a bit set to 1, or to a value."""
    loom, x, place = given.calls.loom, given.array(0), given.array(1)
    new = given.array(2) if len(given) > 2 else constants(loom, 1.0)
    new = each(loom, "ne", new, constants(loom, 0.0))
    weight = each(loom, "pow", constants(loom, 2.0), each(loom, "sub", place, constants(loom, 1.0)))
    old = each(loom, "mod", each(loom, "floor", each(loom, "div", x, weight)), constants(loom, 2.0))
    return each(loom, "add", x, each(loom, "mul", weight, each(loom, "sub", new, old)))
