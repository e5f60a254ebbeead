"""Operators that select elements by their place, or compute places: indices, extremes, order."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.elementwise import truncated
from kennfeld.importers.onnx.network import ML, Array, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first
from kennfeld.importers.onnx.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    check_size,
    constant,
    kind_of,
    rearrange,
    shape_of,
)
from kennfeld.models.imperative.node_arrays import Nodes

MAX_CHOICES = 256  # elements that an index which depends on the inputs selects from


@operator("Gather")
def gather(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, indices, axis = first(arguments), arguments[1], op.get("axis", 0)
    if isinstance(indices, NodeTensor):
        return _choose(c, x, indices, axis)
    places = constant(indices, "indices").astype(np.int64)
    check_size([*shape_of(x), places.size])
    return rearrange(lambda array: np.take(array, places, axis), x)


@operator("ArrayFeatureExtractor", domain=ML)
def extract_features(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, indices = first(arguments), arguments[1]
    if isinstance(indices, NodeTensor):
        flat = NodeTensor(indices.nodes.ravel(), indices.kind)
        return rearrange(lambda array: array.reshape(-1, flat.nodes.size), _choose(c, x, flat, -1))
    places = constant(indices, "Y").astype(np.int64).ravel()
    check_size([*shape_of(x), places.size])

    def take(array: Array) -> Array:
        chosen = np.take(array, places, -1)
        return chosen.reshape(1, -1) if array.ndim == 1 else chosen

    return rearrange(take, x)


def _choose(c: Context, x: Tensor, indices: NodeTensor, axis: int) -> Tensor:
    """Return the elements of a tensor at places that depend on the inputs; NaN at a place that does not exist."""
    shape, axis = shape_of(x), axis % len(shape_of(x))
    rest = (*shape[:axis], *shape[axis + 1 :])
    count = shape[axis]
    places = _places(c, indices.nodes.reshape(*indices.nodes.shape, *[1] * len(rest)), count)
    result: Tensor = np.full((*indices.nodes.shape, *rest), np.nan)
    # result = x[0] if index = 0, x[1] if index = 1, ..., written as nested selections
    for place in range(count):
        part = rearrange(lambda array, place=place: np.take(array, place, axis), x)  # type: ignore[misc]
        result = c.where(c.truth("eq", places, float(place)), part, result)
    dimensions = indices.nodes.ndim
    # the dimensions of the indices take the place of the axis
    targets = range(axis, axis + dimensions)
    return as_kind(rearrange(lambda array: np.moveaxis(array, range(dimensions), targets), result), kind_of(x))


def _places(c: Context, indices: Nodes, count: int) -> Tensor:
    """Return indices into so many elements from 0; a negative one counts from the end."""
    if count > MAX_CHOICES:
        raise UnsupportedOperatorError(f"an index that depends on the inputs selects from {count} elements")
    places = NodeTensor(indices, "int")
    return c.where(c.truth("lt", places, 0.0), c.apply("add", places, float(count)), places)


def as_kind(tensor: Tensor, kind: str) -> Tensor:
    """Return a tensor with elements of another kind, whose numbers are the same."""
    return NodeTensor(tensor.nodes, kind) if isinstance(tensor, NodeTensor) else tensor


@operator("GatherElements")
def gather_elements(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, indices, axis = first(arguments), arguments[1], op.get("axis", 0)
    if isinstance(indices, NodeTensor):
        return _choose_along(c, x, indices, axis % len(shape_of(x)))
    places = constant(indices, "indices").astype(np.int64)
    return rearrange(lambda array: np.take_along_axis(array, places, axis), x)


def _choose_along(c: Context, x: Tensor, indices: NodeTensor, axis: int) -> Tensor:
    """Return for each index, which depends on the inputs, the element at its own place along the other axes."""
    count, shape = shape_of(x)[axis], indices.nodes.shape
    places = _places(c, indices.nodes, count)
    # the indices may leave out the last elements along the other axes
    part = tuple(slice(None) if at == axis else slice(size) for at, size in enumerate(shape))
    result: Tensor = np.full(shape, np.nan)
    for place in range(count):
        row = rearrange(lambda array, place=place: np.take(array[part], [place], axis), x)  # type: ignore[misc]
        result = c.where(c.truth("eq", places, float(place)), row, result)
    return as_kind(result, kind_of(x))


@operator("GatherND")
def gather_nd(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    if op.get("batch_dims", 0):
        raise UnsupportedOperatorError("batch_dims is not supported")
    places = constant(arguments[1], "indices").astype(np.int64)
    return rearrange(lambda array: array[tuple(np.moveaxis(places, -1, 0))], first(arguments))


@operator("ScatterElements", "ScatterND")
def scatter(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, updates = first(arguments), arguments[2]
    places = constant(arguments[1], "indices").astype(np.int64)
    if op.get("reduction", "none") != "none" or updates is None:
        raise UnsupportedOperatorError(f"reduction {op.get('reduction')} is not supported")
    nodes, written = c.nodes(x).copy(), c.nodes(updates)
    if op.kind == "ScatterND":
        nodes[tuple(np.moveaxis(places, -1, 0))] = written
    else:
        np.put_along_axis(nodes, places, written, op.get("axis", 0))
    return NodeTensor(nodes, kind_of(x))


@operator("Compress")
def compress(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    condition = constant(arguments[1], "condition").astype(bool).ravel()
    return rearrange(lambda array: np.compress(condition, array, op.get("axis")), first(arguments))


def elements_along(tensor: Tensor, axis: int) -> Sequence[Tensor]:
    """Cut a tensor into the elements along an axis, which becomes 1 long in each."""
    return [
        rearrange(lambda array, i=i: np.take(array, [i], axis), tensor)  # type: ignore[misc]
        for i in range(shape_of(tensor)[axis])
    ]


def index_of_extreme(c: Context, tensor: Tensor, axis: int, better: str = "gt") -> Tensor:
    """Find the place of the first largest element along an axis, which becomes 1 long.

    `better` is "lt" for the smallest, "ge" for the last largest, "le" for the last smallest element.
    """
    parts = elements_along(tensor, axis)
    if not parts:
        raise UnsupportedOperatorError("it searches an empty tensor")
    best: Tensor = parts[0]
    index: Tensor = np.zeros(shape_of(best))
    for place, part in enumerate(parts[1:], start=1):
        # "gt" keeps the first of equal elements, "ge" takes the last
        exceeds = c.truth(better, part, best)
        best, index = c.where(exceeds, part, best), c.where(exceeds, float(place), index)
    return NodeTensor(index.nodes, "int") if isinstance(index, NodeTensor) else index.astype(np.int64)


@operator("ArgMax", "ArgMin")
def arg_extreme(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    axis = op.get("axis", 0) % len(shape_of(x))
    better = {"ArgMax": "gt", "ArgMin": "lt"}[op.kind]
    if op.get("select_last_index", 0):
        better = {"gt": "ge", "lt": "le"}[better]
    index = index_of_extreme(c, x, axis, better)
    return index if op.get("keepdims", 1) else rearrange(lambda array: np.squeeze(array, axis), index)


@operator("Hardmax")
def hardmax(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Mark the first largest element along an axis by 1, before version 13 along all that follow, the others by 0."""
    x = first(arguments)
    shape = shape_of(x)
    axis = op.get("axis", -1 if op.version >= 13 else 1) % len(shape)
    # before version 13, rows and columns: the dimensions before the axis, and all from it on
    if op.version < 13:
        x, axis = rearrange(lambda array: array.reshape(int(np.prod(shape[:axis])), -1), x), 1
    sizes = [1] * len(shape_of(x))
    sizes[axis] = -1
    places = np.arange(float(shape_of(x)[axis])).reshape(sizes)
    result = c.truth("eq", index_of_extreme(c, x, axis), places)
    return as_kind(rearrange(lambda array: array.reshape(shape), result), "float")


@operator("TopK")
def top_k(c: Context, op: Operator, arguments: Arguments) -> Sequence[Tensor]:
    """Sort by the number of elements that precede each; equal ones by their place."""
    x, count = first(arguments), op.get("k")
    count = int(constant(arguments[1], "K").ravel()[0]) if count is None else count
    axis = op.get("axis", -1) % len(shape_of(x))
    parts, better = elements_along(x, axis), "gt" if op.get("largest", 1) else "lt"
    if len(parts) > MAX_CHOICES or not 0 <= count <= len(parts):
        raise UnsupportedOperatorError(f"it selects {count} of {len(parts)} elements; the maximum is {MAX_CHOICES}")
    ranks = [_rank(c, parts, number, better) for number in range(len(parts))]
    values, places = [], []
    # each rank belongs to exactly one element, because equal ones are ordered by place
    for rank in range(count):
        value: Tensor = parts[0]
        place: Tensor = np.zeros(shape_of(value))
        for i, part in enumerate(parts[1:], start=1):
            chosen = c.truth("eq", ranks[i], float(rank))
            value, place = c.where(chosen, part, value), c.where(chosen, float(i), place)
        values.append(value)
        places.append(place)
    return [as_kind(_stack(c, values, axis), kind_of(x)), as_kind(_stack(c, places, axis), "int")]


def _rank(c: Context, parts: Sequence[Tensor], number: int, better: str) -> Tensor:
    """Return how many elements precede one of them: better ones, and equal ones before it."""
    own = parts[number]
    preceding: list[Tensor] = [np.zeros(shape_of(own))]
    for place, other in enumerate(parts):
        if place != number:
            is_better = c.truth(better, other, own)
            preceding.append(c.truth("or", is_better, c.truth("eq", other, own)) if place < number else is_better)
    return c.apply.fold("add", preceding)


def _stack(c: Context, tensors: Sequence[Tensor], axis: int) -> Tensor:
    return NodeTensor(np.concatenate([c.nodes(tensor) for tensor in tensors], axis))


@operator("OneHot")
def one_hot(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, values = first(arguments), arguments[2]
    depth = int(constant(arguments[1], "depth").ravel()[0])
    dimensions = len(shape_of(x)) + 1
    axis = op.get("axis", -1) % dimensions
    check_size([*shape_of(x), depth])
    places = np.arange(float(depth)).reshape([-1 if i == axis else 1 for i in range(dimensions)])
    index = rearrange(lambda array: np.expand_dims(array, axis), x)
    index = c.where(c.truth("lt", index, 0.0), c.apply("add", index, float(depth)), index)
    if values is None:
        raise UnsupportedOperatorError("its argument values is missing")
    off, on = (rearrange(lambda array, i=i: array[i], values) for i in range(2))  # type: ignore[misc]
    return as_kind(c.where(c.truth("eq", index, places), on, off), kind_of(values))


@operator("OneHotEncoder", domain=ML)
def encode_one_hot(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Mark the category of each element by 1, along a new last dimension; none is marked for another number."""
    categories = op.get("cats_int64s")
    if not categories:
        raise UnsupportedOperatorError("categories that are texts are not supported")
    if not op.get("zeros", 1):
        c.remark("OneHotEncoder: a number without a category gives zeros; ONNX Runtime ends with an error there")
    x = first(arguments)
    check_size([*shape_of(x), len(categories)])
    index = rearrange(lambda array: np.expand_dims(array, -1), x)
    if kind_of(x) == "float":
        # the category of an element is that of its integer part
        index = truncated(c, index)
    return as_kind(c.truth("eq", index, np.asarray(categories, dtype=np.float64)), "float")


@operator("Trilu")
def triangle(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    diagonal = int(constant(arguments[1], "k").ravel()[0]) if len(arguments) > 1 else 0
    rows, columns = np.indices(shape_of(x)[-2:])
    inside = columns >= rows + diagonal if op.get("upper", 1) else columns <= rows + diagonal
    return as_kind(c.where(inside, x, 0.0), kind_of(x))


@operator("CumSum", "CumProd")
def cumulative(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    axis = int(constant(arguments[1], "axis").ravel()[0])
    axis %= len(shape_of(x))
    parts = list(elements_along(x, axis))
    parts = parts[::-1] if op.get("reverse", 0) else parts
    start, step = {"CumSum": (0.0, "add"), "CumProd": (1.0, "mul")}[op.kind]
    # totals[i + 1] = totals[i] + parts[i]; an exclusive sum is the one before its own element
    totals: list[Tensor] = [np.full(shape_of(parts[0]), start)]
    for part in parts:
        totals.append(c.apply(step, totals[-1], part))
    totals = totals[:-1] if op.get("exclusive", 0) else totals[1:]
    return as_kind(_stack(c, totals[::-1] if op.get("reverse", 0) else totals, axis), kind_of(x))
