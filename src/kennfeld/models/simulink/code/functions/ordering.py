"""Functions that order elements: by exchanges of neighbours, each a decision."""

import math

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function
from kennfeld.models.simulink.code.values import Held, Truths, constants, truths
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

_MOST = 64  # elements: the exchanges grow with their square


def _ordered(given: Given, parts: list[Nodes], falling: bool) -> tuple[list[Nodes], list[Nodes]]:
    """The parts in order, equal ones as they were, and the places they come from."""
    if len(parts) > _MOST:
        raise given.refuse(f"{len(parts)} elements, of which {_MOST} is the most")
    loom, made = given.calls.loom, list(parts)
    places = [np.full(part.shape, loom.const(at + 1.0), dtype=np.int64) for at, part in enumerate(parts)]
    for end in range(len(made) - 1, 0, -1):
        for at in range(end):
            wrong = _wrong(loom, made[at], made[at + 1], falling)
            for row in (made, places):
                low, high = row[at], row[at + 1]
                row[at], row[at + 1] = each(loom, "select", wrong, high, low), each(loom, "select", wrong, low, high)
    return made, places


def _wrong(loom: Loom, one: Nodes, other: Nodes, falling: bool) -> Nodes:
    """Whether two neighbours have to change places; what is not a number counts as the largest."""
    right = each(loom, "ge" if falling else "le", one, other)
    number = one if falling else other
    return each(loom, "and", each(loom, "not", right), each(loom, "eq", number, number))


@function("sort", least=1, most=3)
def ordered(given: Given) -> tuple[Held, ...]:
    """The elements along a dimension in rising or falling order, and where they were."""
    falling = any(isinstance(one, str) and one.startswith("desc") for one in given.held)
    array = given.array(0)
    given_axis = len(given) > 1 and not isinstance(given.held[1], str)
    axis = given.whole(1) - 1 if given_axis else next((at for at, size in enumerate(array.shape) if size != 1), 0)
    if axis >= array.ndim:
        return array, np.full(array.shape, given.calls.loom.const(1.0), dtype=np.int64)
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    if not parts:
        return array, array
    made, places = _ordered(given, parts, falling)
    whole = np.concatenate(made, axis=axis)
    return truths(whole) if isinstance(array, Truths) else whole, np.concatenate(places, axis=axis)


@function("median")
def median(given: Given) -> Held:
    """The middle of the elements of a vector, or the mean of the two in the middle; of what is not a number none."""
    loom, vector = given.calls.loom, np.asarray(given.vector(0))
    if not vector.size:
        if vector.size != given.array(0).size or 0 not in given.array(0).shape[1:]:
            raise given.refuse("of an empty matrix is not supported")
        return constants(loom, math.nan)
    made, _ = _ordered(given, [node.reshape(1, 1) for node in vector], False)
    low, high, last = made[(len(made) - 1) // 2], made[len(made) // 2], made[-1]
    middle = low if len(made) % 2 else each(loom, "mul", constants(loom, 0.5), each(loom, "add", low, high))
    return each(loom, "select", each(loom, "eq", last, last), middle, constants(loom, math.nan))
