"""Functions that make arrays of fixed size, tell sizes, and arrange elements.

Functions that order elements: by exchanges of neighbours, each a decision.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, is_vector, matlab_word
from kennfeld.models.imperative.library.reduction_functions import transposed
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

_MOST = 64  # elements: the exchanges grow with their square


def sizes(given: SymbolicArguments, begin: int = 0) -> list[int]:
    """The size that arguments ask for; dimensions of one element at its end do not count."""
    found: list[float] = []
    for at in range(begin, len(given)):
        found += [float(n) for n in given.numbers(at, "a size").ravel(order="F")]
    if any(not math.isfinite(n) or n != math.floor(n) for n in found):
        raise given.refuse("a size is not a whole number")
    if len(found) == 0 < len(given) - begin:
        raise given.refuse("a size is empty")
    given.calls.context.room(math.prod(max(n, 0.0) for n in found))
    made = [max(int(n), 0) for n in found]
    made = made * 2 if len(made) == 1 else made or [1, 1]
    while len(made) > 2 and made[-1] == 1:
        made.pop()
    return made


def _without_class(given: SymbolicArguments, *allowed: str) -> SymbolicArguments:
    """The arguments before the name of a class, which says nothing here."""
    at = next((at for at, one in enumerate(given.held) if isinstance(one, str)), None)
    if at is None:
        return given
    if given.text(at) not in (*_CLASSES, "like"):
        raise given.refuse(f"{given.text(at)!r} is not a class of numbers")
    return replace(given, held=given.held[:at])


@function(*_FILLED, least=0, most=8)
def filled(given: SymbolicArguments) -> SymbolicValue:
    """An array of one number."""
    size = sizes(_without_class(given))
    made = np.full(size, given.calls.builder.const(_FILLED[given.name]), dtype=np.int64)
    if given.name in ("true", "false"):
        return as_logical(made)
    kind = next((one for one in given.held if isinstance(one, str)), "")
    return of_class(given.array(-1), made) if kind == "like" else integers(made, matlab_word(kind))


@function("pi", least=0, most=0)
def pi(given: SymbolicArguments) -> SymbolicValue:
    """The number pi."""
    return constants(given.calls.builder, math.pi)


@function(*_ALONE, least=0, most=1)
def alone(given: SymbolicArguments) -> SymbolicValue:
    """A number with a name."""
    return constants(given.calls.builder, _ALONE[given.name])


@function("eps", least=0, most=1)
def spacing(given: SymbolicArguments) -> SymbolicValue:
    """The distance from 1, or from a fixed number, to the next larger number."""
    if not len(given) or isinstance(given.held[0], str):
        return constants(given.calls.builder, 2.0**-52)
    return constants(given.calls.builder, np.spacing(np.abs(given.numbers(0))))


@function("intmax", "intmin", "flintmax", least=0, most=1)
def extreme(given: SymbolicArguments) -> SymbolicValue:
    """The largest or smallest number of a class."""
    if given.name == "flintmax":
        return constants(given.calls.builder, 2.0**53)
    kind = given.text(0) if len(given) else "int32"
    if kind not in _BITS:
        raise given.refuse(f"{kind} is no class of integers")
    high, signed = 2.0 ** _BITS[kind], not kind.startswith("u")
    return constants(given.calls.builder, high - 1 if given.name == "intmax" else -high if signed else 0.0)


@function("eye", least=0, most=3)
def identity(given: SymbolicArguments) -> SymbolicValue:
    """A matrix with ones on its diagonal."""
    shape = sizes(_without_class(given))
    if len(shape) > 2:
        raise given.refuse("a matrix has two sizes")
    return constants(given.calls.builder, np.eye(shape[0], shape[1]))


@function("linspace", least=2, most=3)
def evenly(given: SymbolicArguments) -> SymbolicValue:
    """Evenly spaced numbers, whose ends may depend on signals."""
    count = given.whole(2) if len(given) > 2 else 100
    given.calls.context.room(count)
    builder, (first, last) = given.calls.builder, (given.array(0), given.array(1))
    shares = constants(builder, np.linspace(0.0, 1.0, count).reshape(1, -1))
    made = elementwise(
        builder, "add", first, elementwise(builder, "mul", elementwise(builder, "sub", last, first), shares)
    )
    made[0, -1] = last.item()
    return made


def _shape(held: SymbolicValue) -> tuple[int, ...]:
    if isinstance(held, np.ndarray):
        return held.shape
    if isinstance(held, str):
        return (1, 1) if isinstance(held, String) else (1 if held else 0, len(held))
    return held.shape if isinstance(held, SymbolicCell) else (1, 1)


@function("size", least=1, most=2)
def size(given: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """The size of an array, along all dimensions or one."""
    builder, shape = given.calls.builder, _shape(given.held[0])
    if len(given) == 2:
        chosen = given.wholes(1)
        if min(chosen, default=0) < 1:
            raise given.refuse("a dimension is not a whole number from 1")
        return constants(builder, [[float(shape[at - 1]) if at <= len(shape) else 1.0 for at in chosen]])
    if given.wanted <= 1:
        return constants(builder, [[float(n) for n in shape]])
    parts = [*shape, *(1,) * given.wanted][: given.wanted]
    parts[-1] = int(np.prod(shape[given.wanted - 1 :])) if len(shape) >= given.wanted else 1
    return tuple(constants(builder, float(n)) for n in parts)


@function("numel", "length", "ndims", "isempty", "isscalar", "isvector", "isrow", "iscolumn", "ismatrix", "issquare")
def told(given: SymbolicArguments) -> SymbolicValue:
    """What is known of an array by its size."""
    shape = _shape(given.held[0])
    count = int(np.prod(shape))
    found = {
        "numel": count, "length": max(shape) if count else 0, "ndims": len(shape), "isempty": count == 0,
        "isscalar": count == 1, "isvector": len(shape) == 2 and 1 in shape, "isrow": len(shape) == 2 and shape[0] == 1,
        "iscolumn": len(shape) == 2 and shape[1] == 1, "ismatrix": len(shape) == 2,
        "issquare": len(shape) == 2 and shape[0] == shape[1],
    }[given.name]  # fmt: skip
    made = constants(given.calls.builder, float(found))
    return as_logical(made) if isinstance(found, bool) else made


@function("reshape", least=2, most=8)
def reshaped(given: SymbolicArguments) -> SymbolicValue:
    """The elements in another shape; an empty size is what is left."""
    array = given.array(0)
    shape = [-1 if given.array(at).size == 0 else 0 for at in range(1, len(given))]
    shape = [size or given.whole(at) for at, size in enumerate(shape, 1)] if -1 in shape else sizes(given, 1)
    if len(given) == 2 and given.array(1).size == 1:
        raise given.refuse("a size needs two numbers")
    return array.reshape(shape, order="F")


@function("repmat", least=2, most=4)
def repeated(given: SymbolicArguments) -> SymbolicValue:
    """An array several times beside itself."""
    counts, array = sizes(given, 1), given.array(0)
    given.calls.context.room(float(array.size) * float(np.prod(counts)))
    return np.tile(_deeper(array, len(counts)), [*counts, *(1,) * (array.ndim - len(counts))])


def _deeper(array: Nodes, count: int) -> Nodes:
    """An array with as many dimensions, those behind its own one long."""
    return array.reshape((*array.shape, *(1,) * (count - array.ndim)))


@function("horzcat", "vertcat", "cat", least=1, most=50)
def beside(given: SymbolicArguments) -> SymbolicValue:
    """Arrays joined along a dimension."""
    first = 1 if given.name == "cat" else 0
    axis = given.whole(0) - 1 if first else int(given.name == "horzcat")
    arrays = [given.array(at) for at in range(first, len(given))]
    if len(arrays) == 1:
        return arrays[0]
    kept = [np.asarray(one) for one in arrays if one.size] or [np.asarray(max(arrays, key=np.shape, default=EMPTY))]
    most = max(axis + 1, *(one.ndim for one in kept))
    made = np.concatenate([_deeper(one, most) for one in kept], axis=axis)
    return as_logical(made) if arrays and all(isinstance(one, LogicalNodes) for one in arrays) else made


@function("transpose", "ctranspose")
def with_rows_as_columns(given: SymbolicArguments) -> SymbolicValue:
    """Rows as columns."""
    return transposed(given.array(0))


@function("permute", least=2, most=2)
def permuted(given: SymbolicArguments) -> SymbolicValue:
    """Dimensions in another order."""
    order = [n - 1 for n in given.wholes(1)]
    array = given.array(0)
    made = np.transpose(_deeper(array, len(order)), order)
    while made.ndim > 2 and made.shape[-1] == 1:
        made = made[..., 0]
    return made


@function("squeeze")
def squeezed(given: SymbolicArguments) -> SymbolicValue:
    """An array of more than two dimensions without those that are one long; a column where one is left."""
    array = given.array(0)
    longer = [size for size in array.shape if size != 1]
    return array if array.ndim < 3 else array.reshape((*longer, 1, 1)[: max(len(longer), 2)], order="F")


@function("fliplr", "flipud", "flip", least=1, most=2)
def flipped(given: SymbolicArguments) -> SymbolicValue:
    """Elements in the opposite order."""
    array = given.array(0)
    axis = {"fliplr": 1, "flipud": 0}.get(given.name, given.dimension(1, array))
    return np.flip(array, axis)


@function("circshift", least=2, most=3)
def shifted(given: SymbolicArguments) -> SymbolicValue:
    """Elements moved by fixed numbers of places, those at the end to the beginning."""
    array, by = given.array(0), given.wholes(1)
    if len(by) > 1:
        return np.roll(array, by, axis=tuple(range(len(by))))
    return np.roll(array, by[0], axis=given.dimension(2, array))


@function("diag", least=1, most=2)
def diagonal(given: SymbolicArguments) -> SymbolicValue:
    """The diagonal of a matrix, or a matrix with this diagonal."""
    array, offset = given.matrix(0), given.whole(1) if len(given) > 1 else 0
    if not is_vector(array):
        return EMPTY if array.shape == (0, 0) else np.diagonal(array, offset).reshape(-1, 1).copy()
    count = array.size + abs(offset)
    made = np.full((count, count), given.calls.builder.const(0.0), dtype=np.int64)
    places = np.arange(array.size)
    made[places + max(-offset, 0), places + max(offset, 0)] = array.ravel(order="F")
    return as_logical(made) if isinstance(array, LogicalNodes) else made


@function("tril", "triu", least=1, most=2)
def triangle(given: SymbolicArguments) -> SymbolicValue:
    """A matrix with zeros above or below its diagonal."""
    array, offset = given.matrix(0), given.whole(1) if len(given) > 1 else 0
    keep = np.tril if given.name == "tril" else np.triu
    made = np.where(keep(np.ones(array.shape, dtype=bool), offset), np.asarray(array), given.calls.builder.const(0.0))
    return as_logical(made) if isinstance(array, LogicalNodes) else made


@function("find", least=1, most=3)
def found(given: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """The places of the elements that are not 0, where that is fixed."""
    array = given.array(0)
    if len(given) > 1 and given.whole(1) < 1:
        raise given.refuse(f"{given.whole(1)} is not a number of elements")
    numbers = given.calls.context.numbers(array, "the places that find tells")
    if numbers is None:
        return _first(given, array)
    places = np.flatnonzero(numbers.ravel(order="F"))
    if len(given) > 1:
        last = len(given) > 2 and given.text(2) == "last"
        places = places[-given.whole(1) :] if last else places[: given.whole(1)]
    shape = (1, -1) if array.shape[0] == 1 and array.shape[1] != 1 and array.ndim == 2 else (-1, 1)
    if array.shape == (0, 0) or (array.size == 1 and not places.size):
        shape = (0, 0)
    if given.wanted > 1:
        flat = (array.shape[0], array.size // max(array.shape[0], 1))
        rows, columns = np.unravel_index(places, flat, order="F")
        return tuple(constants(given.calls.builder, (one + 1.0).reshape(shape)) for one in (rows, columns))
    return constants(given.calls.builder, (places + 1.0).reshape(shape))


def _first(given: SymbolicArguments, array: Nodes) -> SymbolicValue:
    """The first or last place, where there is one; how many there are would depend on signals otherwise."""
    last = len(given) > 2 and given.text(2) == "last"
    if len(given) < 2 or given.whole(1) != 1 or given.wanted > 1:
        raise given.refuse(
            "how many elements it finds depends on signals", "Write a loop over all elements, or find(x, 1)."
        )
    builder = given.calls.builder
    made, flat = builder.const(float("nan")), [int(node) for node in array.ravel(order="F")]
    order = range(len(flat)) if last else range(len(flat) - 1, -1, -1)
    for at in order:
        made = builder.call("select", flat[at], builder.const(at + 1.0), made)
    return np.array([[made]], dtype=np.int64)


@function("colon", least=2, most=3)
def colon(given: SymbolicArguments) -> SymbolicValue:
    """A range of fixed ends."""
    ends = [float(given.numbers(at).item()) for at in range(len(given))]
    first, step, last = (ends[0], 1.0, ends[1]) if len(ends) == 2 else tuple(ends)
    given.calls.context.room(abs((last - first) / step) if step else 0.0)
    count = max(math.floor((last - first) / step + 1e-10) + 1, 0) if step else 0
    return constants(given.calls.builder, (first + step * np.arange(count)).reshape(1, -1))


@function("meshgrid", least=1, most=2)
def grids(given: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Two vectors as the columns and rows of matrices."""
    x, y = given.array(0), given.array(len(given) - 1)
    given.calls.context.room(float(x.size) * y.size)
    made = np.meshgrid(x.ravel(order="F"), y.ravel(order="F"))
    return tuple(made)


@function("kron", least=2, most=2)
def kronecker(given: SymbolicArguments) -> SymbolicValue:
    """Every element of a matrix times another matrix."""
    builder, (a, b) = given.calls.builder, (given.matrix(0), given.matrix(1))
    given.calls.context.room(float(a.size) * b.size)
    if not a.size or not b.size:
        return np.zeros((a.shape[0] * b.shape[0], a.shape[1] * b.shape[1]), dtype=np.int64)
    rows = [np.concatenate([elementwise(builder, "mul", one.reshape(1, 1), b) for one in row], axis=1) for row in a]
    return np.concatenate(rows, axis=0)


@function("blkdiag", least=1, most=50)
def blocks(given: SymbolicArguments) -> SymbolicValue:
    """Matrices along the diagonal of a larger one."""
    arrays = [np.asarray(one) for one in given.arrays]
    shape = [sum(one.shape[axis] for one in arrays) for axis in (0, 1)]
    given.calls.context.room(float(np.prod(shape)))
    made, row, column = np.full(shape, given.calls.builder.const(0.0), dtype=np.int64), 0, 0
    for one in arrays:
        made[row : row + one.shape[0], column : column + one.shape[1]] = one
        row, column = row + one.shape[0], column + one.shape[1]
    return made


@function("cell", least=0, most=8)
def cells(given: SymbolicArguments) -> SymbolicValue:
    """Empty cells."""
    shape = tuple(sizes(given)) if len(given) else (0, 0)
    return SymbolicCell((EMPTY,) * math.prod(shape), shape)


@function("iscell", "isstruct", "ischar", "isstring", "isnumeric", "islogical", "isreal", "isfloat", "isinteger")
def is_kind(given: SymbolicArguments) -> SymbolicValue:
    """What kind of value it is; all numbers are real, in double precision."""
    held = given.held[0]
    number = isinstance(held, np.ndarray) and not isinstance(held, LogicalNodes)
    found = {
        "iscell": isinstance(held, SymbolicCell), "isstruct": isinstance(held, SymbolicStruct),
        "ischar": isinstance(held, str) and not isinstance(held, String), "isstring": isinstance(held, String),
        "isreal": isinstance(held, np.ndarray | str) and not isinstance(held, String),
        "islogical": isinstance(held, LogicalNodes), "isinteger": False,
    }.get(given.name, number)  # fmt: skip
    return as_logical(constants(given.calls.builder, float(found)))


def _ordered(given: SymbolicArguments, parts: list[Nodes], falling: bool) -> tuple[list[Nodes], list[Nodes]]:
    """The parts in order, equal ones as they were, and the places they come from."""
    if len(parts) > _MOST:
        raise given.refuse(f"{len(parts)} elements, of which {_MOST} is the most")
    builder, made = given.calls.builder, list(parts)
    places = [np.full(part.shape, builder.const(at + 1.0), dtype=np.int64) for at, part in enumerate(parts)]
    for end in range(len(made) - 1, 0, -1):
        for at in range(end):
            wrong = _wrong(builder, made[at], made[at + 1], falling)
            for row in (made, places):
                low, high = row[at], row[at + 1]
                row[at], row[at + 1] = (
                    elementwise(builder, "select", wrong, high, low),
                    elementwise(builder, "select", wrong, low, high),
                )
    return made, places


def _wrong(builder: GraphBuilder, one: Nodes, other: Nodes, falling: bool) -> Nodes:
    """Whether two neighbours have to change places; what is not a number counts as the largest."""
    right = elementwise(builder, "ge" if falling else "le", one, other)
    number = one if falling else other
    return elementwise(builder, "and", elementwise(builder, "not", right), elementwise(builder, "eq", number, number))


@function("sort", least=1, most=3)
def ordered(given: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """The elements along a dimension in rising or falling order, and where they were."""
    falling = any(isinstance(one, str) and one.startswith("desc") for one in given.held)
    array = given.array(0)
    given_axis = len(given) > 1 and not isinstance(given.held[1], str)
    axis = given.whole(1) - 1 if given_axis else next((at for at, size in enumerate(array.shape) if size != 1), 0)
    if axis >= array.ndim:
        return array, np.full(array.shape, given.calls.builder.const(1.0), dtype=np.int64)
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    if not parts:
        return array, array
    made, places = _ordered(given, parts, falling)
    whole = np.concatenate(made, axis=axis)
    return as_logical(whole) if isinstance(array, LogicalNodes) else whole, np.concatenate(places, axis=axis)


@function("median")
def median(given: SymbolicArguments) -> SymbolicValue:
    """The middle of the elements of a vector, or the mean of the two in the middle; of what is not a number none."""
    builder, vector = given.calls.builder, np.asarray(given.vector(0))
    if not vector.size:
        if vector.size != given.array(0).size or 0 not in given.array(0).shape[1:]:
            raise given.refuse("of an empty matrix is not supported")
        return constants(builder, math.nan)
    made, _ = _ordered(given, [node.reshape(1, 1) for node in vector], False)
    low, high, last = made[(len(made) - 1) // 2], made[len(made) // 2], made[-1]
    middle = (
        low
        if len(made) % 2
        else elementwise(builder, "mul", constants(builder, 0.5), elementwise(builder, "add", low, high))
    )
    return elementwise(builder, "select", elementwise(builder, "eq", last, last), middle, constants(builder, math.nan))
