"""Library functions that create, measure, arrange and sort arrays.

The sizes of arrays are fixed. Sorting exchanges neighbours, each exchange being a decision.
"""

import math

import numpy as np

from kennfeld.matlab.values import array_value, characters
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.library.numeric_rules import call_numerically
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes
from kennfeld.models.imperative.symbolic_values import FoundIndex, LogicalNodes, SymbolicValue, as_logical, constants

_MAX_SORTED = 64  # elements: the exchanges grow with their square


@function("linspace", least=2, most=3)
def linspace(args: SymbolicArguments) -> SymbolicValue:
    count = args.whole(2) if len(args) > 2 else 100
    args.context.room(count)
    apply, (first, last) = args.apply, (args.array(0), args.array(1))
    shares = constants(args.builder, np.linspace(0.0, 1.0, count).reshape(1, -1))
    result = apply("add", first, apply("mul", apply("sub", last, first), shares))
    result[0, -1] = last.item()
    return result


@function("find", least=1, most=3)
def find(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """Return the indices of the non-zero elements, if they are constant."""
    array = args.array(0)
    if len(args) > 1 and args.whole(1) < 1:
        raise args.refuse(f"the number of elements must be >= 1, got {args.whole(1)}")
    numbers = args.context.numbers(array, "the indices that find returns")
    if numbers is None:
        return _find_single(args, array)
    arguments = [numbers, *(args.numbers(at) for at in range(1, min(len(args), 2)))]
    if len(args) > 2:
        arguments.append(characters(args.text(2)))
    return tuple(constants(args.builder, array_value(places)) for places in call_numerically(args, arguments))


def _find_single(args: SymbolicArguments, array: Nodes) -> SymbolicValue:
    """Return the first or last index, if there is one; any other number of indices would depend on signals."""
    last = len(args) > 2 and args.text(2) == "last"
    if len(args) < 2 or args.whole(1) != 1 or args.wanted > 1:
        raise args.refuse(
            "the number of elements found depends on signals", "Write a loop over all elements, or find(x, 1)."
        )
    builder = args.builder
    result, flat = builder.const(math.nan), [int(node) for node in array.ravel(order="F")]
    order = range(len(flat)) if last else range(len(flat) - 1, -1, -1)
    for at in order:
        result = builder.call("select", flat[at], builder.const(at + 1.0), result)
    return np.array([[result]], dtype=np.int64).view(FoundIndex)


@function("meshgrid", least=1, most=2)
def meshgrid(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    x, y = args.array(0), args.array(len(args) - 1)
    args.context.room(float(x.size) * y.size)
    return tuple(np.meshgrid(x.ravel(order="F"), y.ravel(order="F")))


@function("blkdiag", least=1, most=50)
def block_diagonal(args: SymbolicArguments) -> SymbolicValue:
    shape = [sum(array.shape[axis] for array in args.arrays) for axis in (0, 1)]
    args.context.room(float(np.prod(shape)))
    result, row, column = np.full(shape, args.builder.const(0.0), dtype=np.int64), 0, 0
    for array in args.arrays:
        result[row : row + array.shape[0], column : column + array.shape[1]] = array
        row, column = row + array.shape[0], column + array.shape[1]
    return result


def _sort_parts(args: SymbolicArguments, parts: list[Nodes], falling: bool) -> tuple[list[Nodes], list[Nodes]]:
    """Sort the parts stably, and return them with their original indices."""
    if len(parts) > _MAX_SORTED:
        raise args.refuse(f"{len(parts)} elements exceed the maximum of {_MAX_SORTED}")
    apply, result = args.apply, list(parts)
    places = [np.full(part.shape, args.builder.const(at + 1.0), dtype=np.int64) for at, part in enumerate(parts)]
    for end in range(len(result) - 1, 0, -1):
        for at in range(end):
            wrong = _out_of_order(apply, result[at], result[at + 1], falling)
            for row in (result, places):
                low, high = row[at], row[at + 1]
                row[at], row[at + 1] = apply("select", wrong, high, low), apply("select", wrong, low, high)
    return result, places


def _out_of_order(apply: Elementwise, left: Nodes, right: Nodes, falling: bool) -> Nodes:
    """Return the condition that two neighbours must be exchanged; NaN counts as the largest number."""
    ordered = apply("ge" if falling else "le", left, right)
    number = left if falling else right
    return apply("and", apply("not", ordered), apply("eq", number, number))


@function("sort", least=1, most=3)
def sort(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Sort elements along a dimension, ascending or descending, and return their original indices."""
    falling = any(isinstance(value, str) and value.startswith("desc") for value in args.values)
    array = args.array(0)
    has_axis = len(args) > 1 and not isinstance(args.values[1], str)
    axis = args.whole(1) - 1 if has_axis else next((at for at, size in enumerate(array.shape) if size != 1), 0)
    if axis >= array.ndim:
        return array, np.full(array.shape, args.builder.const(1.0), dtype=np.int64)
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    if not parts:
        return array, array
    result, places = _sort_parts(args, parts, falling)
    whole = np.concatenate(result, axis=axis)
    return as_logical(whole) if isinstance(array, LogicalNodes) else whole, np.concatenate(places, axis=axis)


@function("median")
def median(args: SymbolicArguments) -> SymbolicValue:
    """Return the median of a vector; NaN if an element is NaN."""
    apply, vector = args.apply, np.asarray(args.vector(0))
    if not vector.size:
        if 0 not in args.array(0).shape[1:]:
            raise args.refuse("of an empty matrix is not supported")
        return constants(args.builder, math.nan)
    result, _ = _sort_parts(args, [node.reshape(1, 1) for node in vector], False)
    low, high, last = result[(len(result) - 1) // 2], result[len(result) // 2], result[-1]
    middle = low if len(result) % 2 else apply("mul", 0.5, apply("add", low, high))
    return apply("select", apply("eq", last, last), middle, math.nan)
