"""Operations on arrays of graph nodes: element by element, from the first to the last, products of matrices.

What a block's rule works with: the block's parameters, its inputs, memory, and the graph under construction.

What a wire carries while a model is built: an array of graph nodes, or a bus of named signals.

Parts of structs, by the names on the way to them: `a.b.c`.

The variables found so far, while one source after the other is read.

What a name means in a block's parameters: masks from the inside out, then the variables of the model.
"""

from functools import reduce
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError

__all__ = ["Nodes", "Numbers", "aligned", "check_size", "elementwise", "matrix_product", "reduce_nodes", "truncate"]

Nodes: TypeAlias = npt.NDArray[np.int64]

_LARGEST: Final = 1_000_000  # elements of an array that stands in a variable, or of one of signals
_MOST_PRODUCTS: Final = 2_000_000  # of a product of two matrices

Numbers: TypeAlias = npt.NDArray[np.float64]


def check_size(size: int) -> None:
    """Raise `NoValueError` where an array would have more elements than any model needs."""
    if size > _LARGEST:
        raise EvaluationError(f"it makes an array of {size} elements, and {_LARGEST} is the most")


def aligned(*arrays: Nodes) -> list[Nodes]:
    """Arrays with as many dimensions as the deepest of them has, which numpy then expands as MATLAB does.

    MATLAB takes missing dimensions at the end for one long, numpy those at the beginning. Vectors of blocks, which have
    one dimension, stay as they are.
    """
    most = max(array.ndim for array in arrays)
    return [one.reshape(one.shape + (1,) * (most - one.ndim)) if one.ndim > 1 else one for one in arrays]


def elementwise(builder: GraphBuilder, op: str, *args: Nodes) -> Nodes:
    """An operation element by element, arrays expanded against each other."""
    spread = np.broadcast_arrays(*aligned(*args))
    check_size(spread[0].size)
    made = [builder.call(op, *(int(a) for a in parts)) for parts in zip(*(a.ravel() for a in spread), strict=True)]
    return np.array(made, dtype=np.int64).reshape(spread[0].shape)


def reduce_nodes(builder: GraphBuilder, op: str, nodes: list[int]) -> int:
    """An operation from the first to the last; 0 of no nodes."""
    return reduce(lambda a, b: builder.call(op, a, b), nodes) if nodes else builder.const(0.0)


def matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    """The product of two matrices of nodes; raises `NoValueError` where it is too large."""
    products = left.size * right.shape[1]
    if products > _MOST_PRODUCTS:
        raise EvaluationError(
            f"a product of matrices takes {products} products of numbers; {_MOST_PRODUCTS} is the most"
        )
    made = np.zeros((left.shape[0], right.shape[1]), dtype=np.int64)
    for row in range(left.shape[0]):
        for column in range(right.shape[1]):
            terms = elementwise(builder, "mul", left[row, :], right[:, column])
            made[row, column] = reduce_nodes(builder, "add", [int(term) for term in terms])
    return made


def truncate(builder: GraphBuilder, x: Nodes) -> Nodes:
    """The whole part, towards 0."""
    return elementwise(
        builder, "mul", elementwise(builder, "sign", x), elementwise(builder, "floor", elementwise(builder, "abs", x))
    )
