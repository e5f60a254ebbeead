"""Library functions that create, measure, arrange and sort arrays.

The sizes of arrays are fixed. Sorting exchanges neighbours, each exchange being a decision.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, is_vector, matlab_word
from kennfeld.models.imperative.library.reduction_functions import transpose
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.imperative.symbolic_values import (
    EMPTY,
    LogicalNodes,
    String,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
    as_logical,
    constants,
    integers,
    of_class,
)

_FILLED: Final = {
    "zeros": 0.0, "ones": 1.0, "inf": math.inf, "Inf": math.inf, "nan": math.nan, "NaN": math.nan, "true": 1.0,
    "false": 0.0,
}  # fmt: skip
_ALONE: Final = {"realmax": 1.7976931348623157e308, "realmin": 2.2250738585072014e-308}
_CLASSES: Final = (
    "double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
)  # fmt: skip
_BITS: Final = {"int8": 7, "int16": 15, "int32": 31, "int64": 63, "uint8": 8, "uint16": 16, "uint32": 32, "uint64": 64}

_MAX_SORTED = 64  # elements: the exchanges grow with their square


def sizes(args: SymbolicArguments, begin: int = 0) -> list[int]:
    """Return the size given by arguments, without trailing dimensions of length 1."""
    numbers: list[float] = []
    for at in range(begin, len(args)):
        numbers += [float(n) for n in args.numbers(at, "a size").ravel(order="F")]
    if any(not math.isfinite(n) or n != math.floor(n) for n in numbers):
        raise args.refuse("a size is not an integer")
    if len(numbers) == 0 < len(args) - begin:
        raise args.refuse("a size is empty")
    args.calls.context.room(math.prod(max(n, 0.0) for n in numbers))
    result = [max(int(n), 0) for n in numbers]
    result = result * 2 if len(result) == 1 else result or [1, 1]
    while len(result) > 2 and result[-1] == 1:
        result.pop()
    return result


def _strip_class(args: SymbolicArguments, *allowed: str) -> SymbolicArguments:
    """Return the arguments before the name of a class, which has no effect here."""
    at = next((at for at, value in enumerate(args.held) if isinstance(value, str)), None)
    if at is None:
        return args
    if args.text(at) not in (*_CLASSES, "like"):
        raise args.refuse(f"{args.text(at)!r} is not a numeric class")
    return replace(args, held=args.held[:at])


@function(*_FILLED, least=0, most=8)
def filled_array(args: SymbolicArguments) -> SymbolicValue:
    size = sizes(_strip_class(args))
    result = np.full(size, args.calls.builder.const(_FILLED[args.name]), dtype=np.int64)
    if args.name in ("true", "false"):
        return as_logical(result)
    kind = next((value for value in args.held if isinstance(value, str)), "")
    return of_class(args.array(-1), result) if kind == "like" else integers(result, matlab_word(kind))


@function("pi", least=0, most=0)
def pi(args: SymbolicArguments) -> SymbolicValue:
    return constants(args.calls.builder, math.pi)


@function(*_ALONE, least=0, most=1)
def named_constant(args: SymbolicArguments) -> SymbolicValue:
    return constants(args.calls.builder, _ALONE[args.name])


@function("eps", least=0, most=1)
def spacing(args: SymbolicArguments) -> SymbolicValue:
    """Return the distance from 1, or from a constant, to the next larger number."""
    if not len(args) or isinstance(args.held[0], str):
        return constants(args.calls.builder, 2.0**-52)
    return constants(args.calls.builder, np.spacing(np.abs(args.numbers(0))))


@function("intmax", "intmin", "flintmax", least=0, most=1)
def integer_limit(args: SymbolicArguments) -> SymbolicValue:
    """Return the largest or smallest number of an integer class."""
    if args.name == "flintmax":
        return constants(args.calls.builder, 2.0**53)
    kind = args.text(0) if len(args) else "int32"
    if kind not in _BITS:
        raise args.refuse(f"{kind} is not an integer class")
    high, signed = 2.0 ** _BITS[kind], not kind.startswith("u")
    return constants(args.calls.builder, high - 1 if args.name == "intmax" else -high if signed else 0.0)


@function("eye", least=0, most=3)
def identity(args: SymbolicArguments) -> SymbolicValue:
    shape = sizes(_strip_class(args))
    if len(shape) > 2:
        raise args.refuse("a matrix requires two sizes")
    return constants(args.calls.builder, np.eye(shape[0], shape[1]))


@function("linspace", least=2, most=3)
def linspace(args: SymbolicArguments) -> SymbolicValue:
    count = args.whole(2) if len(args) > 2 else 100
    args.calls.context.room(count)
    builder, (first, last) = args.calls.builder, (args.array(0), args.array(1))
    shares = constants(builder, np.linspace(0.0, 1.0, count).reshape(1, -1))
    result = elementwise(
        builder, "add", first, elementwise(builder, "mul", elementwise(builder, "sub", last, first), shares)
    )
    result[0, -1] = last.item()
    return result


def _shape(held: SymbolicValue) -> tuple[int, ...]:
    if isinstance(held, np.ndarray):
        return held.shape
    if isinstance(held, str):
        return (1, 1) if isinstance(held, String) else (1 if held else 0, len(held))
    return held.shape if isinstance(held, SymbolicCell) else (1, 1)


@function("size", least=1, most=2)
def size(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    builder, shape = args.calls.builder, _shape(args.held[0])
    if len(args) == 2:
        chosen = args.wholes(1)
        if min(chosen, default=0) < 1:
            raise args.refuse("a dimension must be an integer >= 1")
        return constants(builder, [[float(shape[at - 1]) if at <= len(shape) else 1.0 for at in chosen]])
    if args.wanted <= 1:
        return constants(builder, [[float(n) for n in shape]])
    parts = [*shape, *(1,) * args.wanted][: args.wanted]
    parts[-1] = int(np.prod(shape[args.wanted - 1 :])) if len(shape) >= args.wanted else 1
    return tuple(constants(builder, float(n)) for n in parts)


@function("numel", "length", "ndims", "isempty", "isscalar", "isvector", "isrow", "iscolumn", "ismatrix", "issquare")
def size_property(args: SymbolicArguments) -> SymbolicValue:
    """Return a property of an array that follows from its size."""
    shape = _shape(args.held[0])
    count = int(np.prod(shape))
    value = {
        "numel": count, "length": max(shape) if count else 0, "ndims": len(shape), "isempty": count == 0,
        "isscalar": count == 1, "isvector": len(shape) == 2 and 1 in shape, "isrow": len(shape) == 2 and shape[0] == 1,
        "iscolumn": len(shape) == 2 and shape[1] == 1, "ismatrix": len(shape) == 2,
        "issquare": len(shape) == 2 and shape[0] == shape[1],
    }[args.name]  # fmt: skip
    result = constants(args.calls.builder, float(value))
    return as_logical(result) if isinstance(value, bool) else result


@function("reshape", least=2, most=8)
def reshape(args: SymbolicArguments) -> SymbolicValue:
    array = args.array(0)
    shape = [-1 if args.array(at).size == 0 else 0 for at in range(1, len(args))]
    shape = [size or args.whole(at) for at, size in enumerate(shape, 1)] if -1 in shape else sizes(args, 1)
    if len(args) == 2 and args.array(1).size == 1:
        raise args.refuse("a size requires two numbers")
    return array.reshape(shape, order="F")


@function("repmat", least=2, most=4)
def repmat(args: SymbolicArguments) -> SymbolicValue:
    counts, array = sizes(args, 1), args.array(0)
    args.calls.context.room(float(array.size) * float(np.prod(counts)))
    return np.tile(_append_dimensions(array, len(counts)), [*counts, *(1,) * (array.ndim - len(counts))])


def _append_dimensions(array: Nodes, count: int) -> Nodes:
    """Append dimensions of length 1."""
    return array.reshape((*array.shape, *(1,) * (count - array.ndim)))


@function("horzcat", "vertcat", "cat", least=1, most=50)
def concatenate(args: SymbolicArguments) -> SymbolicValue:
    """Concatenate arrays along a dimension."""
    first = 1 if args.name == "cat" else 0
    axis = args.whole(0) - 1 if first else int(args.name == "horzcat")
    arrays = [args.array(at) for at in range(first, len(args))]
    if len(arrays) == 1:
        return arrays[0]
    kept = [np.asarray(array) for array in arrays if array.size] or [
        np.asarray(max(arrays, key=np.shape, default=EMPTY))
    ]
    most = max(axis + 1, *(array.ndim for array in kept))
    result = np.concatenate([_append_dimensions(array, most) for array in kept], axis=axis)
    return as_logical(result) if arrays and all(isinstance(array, LogicalNodes) for array in arrays) else result


@function("transpose", "ctranspose")
def transpose_array(args: SymbolicArguments) -> SymbolicValue:
    return transpose(args.array(0))


@function("permute", least=2, most=2)
def permute(args: SymbolicArguments) -> SymbolicValue:
    order = [n - 1 for n in args.wholes(1)]
    array = args.array(0)
    result = np.transpose(_append_dimensions(array, len(order)), order)
    while result.ndim > 2 and result.shape[-1] == 1:
        result = result[..., 0]
    return result


@function("squeeze")
def squeeze(args: SymbolicArguments) -> SymbolicValue:
    """Remove dimensions of length 1 from an array of more than two dimensions; a vector becomes a column."""
    array = args.array(0)
    longer = [size for size in array.shape if size != 1]
    return array if array.ndim < 3 else array.reshape((*longer, 1, 1)[: max(len(longer), 2)], order="F")


@function("fliplr", "flipud", "flip", least=1, most=2)
def flip(args: SymbolicArguments) -> SymbolicValue:
    array = args.array(0)
    axis = {"fliplr": 1, "flipud": 0}.get(args.name, args.dimension(1, array))
    return np.flip(array, axis)


@function("circshift", least=2, most=3)
def circshift(args: SymbolicArguments) -> SymbolicValue:
    array, by = args.array(0), args.wholes(1)
    if len(by) > 1:
        return np.roll(array, by, axis=tuple(range(len(by))))
    return np.roll(array, by[0], axis=args.dimension(2, array))


@function("diag", least=1, most=2)
def diagonal(args: SymbolicArguments) -> SymbolicValue:
    array, offset = args.matrix(0), args.whole(1) if len(args) > 1 else 0
    if not is_vector(array):
        return EMPTY if array.shape == (0, 0) else np.diagonal(array, offset).reshape(-1, 1).copy()
    count = array.size + abs(offset)
    result = np.full((count, count), args.calls.builder.const(0.0), dtype=np.int64)
    places = np.arange(array.size)
    result[places + max(-offset, 0), places + max(offset, 0)] = array.ravel(order="F")
    return as_logical(result) if isinstance(array, LogicalNodes) else result


@function("tril", "triu", least=1, most=2)
def triangle(args: SymbolicArguments) -> SymbolicValue:
    array, offset = args.matrix(0), args.whole(1) if len(args) > 1 else 0
    keep = np.tril if args.name == "tril" else np.triu
    result = np.where(keep(np.ones(array.shape, dtype=bool), offset), np.asarray(array), args.calls.builder.const(0.0))
    return as_logical(result) if isinstance(array, LogicalNodes) else result


@function("find", least=1, most=3)
def find(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """Return the indices of the non-zero elements, if they are constant."""
    array = args.array(0)
    if len(args) > 1 and args.whole(1) < 1:
        raise args.refuse(f"the number of elements must be >= 1, got {args.whole(1)}")
    numbers = args.calls.context.numbers(array, "the indices that find returns")
    if numbers is None:
        return _find_one(args, array)
    places = np.flatnonzero(numbers.ravel(order="F"))
    if len(args) > 1:
        last = len(args) > 2 and args.text(2) == "last"
        places = places[-args.whole(1) :] if last else places[: args.whole(1)]
    shape = (1, -1) if array.shape[0] == 1 and array.shape[1] != 1 and array.ndim == 2 else (-1, 1)
    if array.shape == (0, 0) or (array.size == 1 and not places.size):
        shape = (0, 0)
    if args.wanted > 1:
        flat = (array.shape[0], array.size // max(array.shape[0], 1))
        rows, columns = np.unravel_index(places, flat, order="F")
        return tuple(constants(args.calls.builder, (item + 1.0).reshape(shape)) for item in (rows, columns))
    return constants(args.calls.builder, (places + 1.0).reshape(shape))


def _find_one(args: SymbolicArguments, array: Nodes) -> SymbolicValue:
    """Return the first or last index, if there is one; any other number of indices would depend on signals."""
    last = len(args) > 2 and args.text(2) == "last"
    if len(args) < 2 or args.whole(1) != 1 or args.wanted > 1:
        raise args.refuse(
            "the number of elements found depends on signals", "Write a loop over all elements, or find(x, 1)."
        )
    builder = args.calls.builder
    result, flat = builder.const(float("nan")), [int(node) for node in array.ravel(order="F")]
    order = range(len(flat)) if last else range(len(flat) - 1, -1, -1)
    for at in order:
        result = builder.call("select", flat[at], builder.const(at + 1.0), result)
    return np.array([[result]], dtype=np.int64)


@function("colon", least=2, most=3)
def colon(args: SymbolicArguments) -> SymbolicValue:
    ends = [float(args.numbers(at).item()) for at in range(len(args))]
    first, step, last = (ends[0], 1.0, ends[1]) if len(ends) == 2 else tuple(ends)
    args.calls.context.room(abs((last - first) / step) if step else 0.0)
    count = max(math.floor((last - first) / step + 1e-10) + 1, 0) if step else 0
    return constants(args.calls.builder, (first + step * np.arange(count)).reshape(1, -1))


@function("meshgrid", least=1, most=2)
def meshgrid(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    x, y = args.array(0), args.array(len(args) - 1)
    args.calls.context.room(float(x.size) * y.size)
    result = np.meshgrid(x.ravel(order="F"), y.ravel(order="F"))
    return tuple(result)


@function("kron", least=2, most=2)
def kronecker(args: SymbolicArguments) -> SymbolicValue:
    builder, (a, b) = args.calls.builder, (args.matrix(0), args.matrix(1))
    args.calls.context.room(float(a.size) * b.size)
    if not a.size or not b.size:
        return np.zeros((a.shape[0] * b.shape[0], a.shape[1] * b.shape[1]), dtype=np.int64)
    rows = [
        np.concatenate([elementwise(builder, "mul", element.reshape(1, 1), b) for element in row], axis=1) for row in a
    ]
    return np.concatenate(rows, axis=0)


@function("blkdiag", least=1, most=50)
def block_diagonal(args: SymbolicArguments) -> SymbolicValue:
    arrays = [np.asarray(one) for one in args.arrays]
    shape = [sum(one.shape[axis] for one in arrays) for axis in (0, 1)]
    args.calls.context.room(float(np.prod(shape)))
    result, row, column = np.full(shape, args.calls.builder.const(0.0), dtype=np.int64), 0, 0
    for one in arrays:
        result[row : row + one.shape[0], column : column + one.shape[1]] = one
        row, column = row + one.shape[0], column + one.shape[1]
    return result


@function("cell", least=0, most=8)
def empty_cells(args: SymbolicArguments) -> SymbolicValue:
    shape = tuple(sizes(args)) if len(args) else (0, 0)
    return SymbolicCell((EMPTY,) * math.prod(shape), shape)


@function("iscell", "isstruct", "ischar", "isstring", "isnumeric", "islogical", "isreal", "isfloat", "isinteger")
def is_kind(args: SymbolicArguments) -> SymbolicValue:
    """Return whether a value is of a kind; all numbers are real and in double precision."""
    held = args.held[0]
    number = isinstance(held, np.ndarray) and not isinstance(held, LogicalNodes)
    answers = {
        "iscell": isinstance(held, SymbolicCell), "isstruct": isinstance(held, SymbolicStruct),
        "ischar": isinstance(held, str) and not isinstance(held, String), "isstring": isinstance(held, String),
        "isreal": isinstance(held, np.ndarray | str) and not isinstance(held, String),
        "islogical": isinstance(held, LogicalNodes), "isinteger": False,
    }.get(args.name, number)  # fmt: skip
    return as_logical(constants(args.calls.builder, float(answers)))


def _sort_parts(args: SymbolicArguments, parts: list[Nodes], falling: bool) -> tuple[list[Nodes], list[Nodes]]:
    """Sort the parts stably, and return them with their original indices."""
    if len(parts) > _MAX_SORTED:
        raise args.refuse(f"{len(parts)} elements exceed the maximum of {_MAX_SORTED}")
    builder, result = args.calls.builder, list(parts)
    places = [np.full(part.shape, builder.const(at + 1.0), dtype=np.int64) for at, part in enumerate(parts)]
    for end in range(len(result) - 1, 0, -1):
        for at in range(end):
            wrong = _out_of_order(builder, result[at], result[at + 1], falling)
            for row in (result, places):
                low, high = row[at], row[at + 1]
                row[at], row[at + 1] = (
                    elementwise(builder, "select", wrong, high, low),
                    elementwise(builder, "select", wrong, low, high),
                )
    return result, places


def _out_of_order(builder: GraphBuilder, one: Nodes, other: Nodes, falling: bool) -> Nodes:
    """Return the condition that two neighbours must be exchanged; NaN counts as the largest number."""
    right = elementwise(builder, "ge" if falling else "le", one, other)
    number = one if falling else other
    return elementwise(builder, "and", elementwise(builder, "not", right), elementwise(builder, "eq", number, number))


@function("sort", least=1, most=3)
def sort(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Sort elements along a dimension, ascending or descending, and return their original indices."""
    falling = any(isinstance(value, str) and value.startswith("desc") for value in args.held)
    array = args.array(0)
    given_axis = len(args) > 1 and not isinstance(args.held[1], str)
    axis = args.whole(1) - 1 if given_axis else next((at for at, size in enumerate(array.shape) if size != 1), 0)
    if axis >= array.ndim:
        return array, np.full(array.shape, args.calls.builder.const(1.0), dtype=np.int64)
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    if not parts:
        return array, array
    result, places = _sort_parts(args, parts, falling)
    whole = np.concatenate(result, axis=axis)
    return as_logical(whole) if isinstance(array, LogicalNodes) else whole, np.concatenate(places, axis=axis)


@function("median")
def median(args: SymbolicArguments) -> SymbolicValue:
    """Return the median of a vector; NaN if an element is NaN."""
    builder, vector = args.calls.builder, np.asarray(args.vector(0))
    if not vector.size:
        if vector.size != args.array(0).size or 0 not in args.array(0).shape[1:]:
            raise args.refuse("of an empty matrix is not supported")
        return constants(builder, math.nan)
    result, _ = _sort_parts(args, [node.reshape(1, 1) for node in vector], False)
    low, high, last = result[(len(result) - 1) // 2], result[len(result) // 2], result[-1]
    middle = (
        low
        if len(result) % 2
        else elementwise(builder, "mul", constants(builder, 0.5), elementwise(builder, "add", low, high))
    )
    return elementwise(builder, "select", elementwise(builder, "eq", last, last), middle, constants(builder, math.nan))
