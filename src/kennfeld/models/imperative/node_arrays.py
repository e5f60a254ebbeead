"""Operations on arrays of graph nodes: elementwise with broadcasting, reductions, matrix products."""

from collections.abc import Iterable
from functools import partial, reduce
from itertools import accumulate
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError

Nodes: TypeAlias = npt.NDArray[np.int64]

_MAX_ELEMENTS: Final = 1_000_000  # of an array of parameters or signals
_MAX_PRODUCTS: Final = 2_000_000  # of a product of two matrices

Numbers: TypeAlias = npt.NDArray[np.float64]


def check_size(size: int) -> None:
    """Raise `EvaluationError` if an array would be too large."""
    if size > _MAX_ELEMENTS:
        raise EvaluationError(f"it creates an array of {size} elements; the maximum is {_MAX_ELEMENTS}")


def format_sizes(*arrays: Nodes) -> str:
    """Return the sizes of arrays for a message."""
    return " and ".join("x".join(map(str, array.shape)) for array in arrays)


def align_dimensions(*arrays: Nodes) -> list[Nodes]:
    """Return arrays with the same number of dimensions, so that numpy broadcasts them as MATLAB does.

    MATLAB appends missing dimensions at the end, numpy at the beginning. Vectors of blocks, which have one dimension,
    are unchanged.
    """
    most = max(array.ndim for array in arrays)
    return [item.reshape(item.shape + (1,) * (most - item.ndim)) if item.ndim > 1 else item for item in arrays]


def elementwise(builder: GraphBuilder, op: str, *args: Nodes | float) -> Nodes:
    """Apply an operation element by element, with broadcasting; numbers are constants."""
    arrays = [np.asarray(builder.const(arg) if isinstance(arg, float | int) else arg, dtype=np.int64) for arg in args]
    # most arrays of a block diagram are scalars: broadcasting would take most of the time
    shape = arrays[0].shape
    is_even = all(array.shape == shape for array in arrays)
    if is_even and arrays[0].size == 1:
        return np.array([builder.call(op, *(array.item() for array in arrays))], dtype=np.int64).reshape(shape)
    spread = arrays if is_even else np.broadcast_arrays(*align_dimensions(*arrays))
    check_size(spread[0].size)
    result = [builder.call(op, *(int(a) for a in parts)) for parts in zip(*(a.ravel() for a in spread), strict=True)]
    return np.array(result, dtype=np.int64).reshape(spread[0].shape)


@dataclass(frozen=True)
class Elementwise:
    """The operations of a graph, element by element: `apply("mul", x, 2.0)`."""

    builder: GraphBuilder

    def __call__(self, op: str, *args: Nodes | float) -> Nodes:
        return elementwise(self.builder, op, *args)


def rounded(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Return nodes in the precision of the builder."""
    return np.array([builder.rounded(int(node)) for node in x.ravel()], dtype=np.int64).reshape(x.shape)


def reduce_nodes(builder: GraphBuilder, op: str, nodes: Iterable[int]) -> int:
    """Combine nodes by an operation from first to last; 0 if there are none."""
    terms = [int(node) for node in nodes]
    return reduce(partial(builder.call, op), terms) if terms else builder.const(0.0)


def reduce_slices(
    apply: Elementwise, op: str, array: Nodes, axis: int = 0, empty: float | None = None, cumulative: bool = False
) -> Nodes:
    """Combine the slices along a dimension, which then has length 1, or unchanged length if the results accumulate.

    `empty` is the result of no slices.
    """
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    if cumulative:
        return np.concatenate(list(accumulate(parts, partial(apply, op))), axis=axis) if parts else array
    if parts or empty is None:
        return reduce(partial(apply, op), parts)
    return np.full((*array.shape[:axis], 1, *array.shape[axis + 1 :]), apply.builder.const(empty), dtype=np.int64)


def matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    """Multiply two matrices of nodes; raises `EvaluationError` if the product is too large."""
    products = left.size * right.shape[1]
    if products > _MAX_PRODUCTS:
        raise EvaluationError(f"a matrix product takes {products} multiplications; the maximum is {_MAX_PRODUCTS}")
    result = np.zeros((left.shape[0], right.shape[1]), dtype=np.int64)
    for row in range(left.shape[0]):
        for column in range(right.shape[1]):
            terms = elementwise(builder, "mul", left[row, :], right[:, column])
            result[row, column] = reduce_nodes(builder, "add", terms)
    return result


def truncate(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Round towards 0."""
    apply = Elementwise(builder)
    return apply("mul", apply("sign", x), apply("floor", apply("abs", x)))
