"""Operations on arrays of graph nodes: element by element, from the first to the last, products of matrices."""

from functools import reduce
from typing import Final

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import Nodes

__all__ = ["aligned", "check_size", "each", "fold", "matrix_product", "towards_zero"]

_LARGEST: Final = 1_000_000  # elements of an array that stands in a variable, or of one of signals
_MOST_PRODUCTS: Final = 2_000_000  # of a product of two matrices


def check_size(size: int) -> None:
    """Raise `NoValueError` where an array would have more elements than any model needs."""
    if size > _LARGEST:
        raise NoValueError(f"it makes an array of {size} elements, and {_LARGEST} is the most")


def aligned(*arrays: Nodes) -> list[Nodes]:
    """Arrays with as many dimensions as the deepest of them has, which numpy then expands as MATLAB does.

    MATLAB takes missing dimensions at the end for one long, numpy those at the beginning. Vectors of blocks, which have
    one dimension, stay as they are.
    """
    most = max(array.ndim for array in arrays)
    return [one.reshape(one.shape + (1,) * (most - one.ndim)) if one.ndim > 1 else one for one in arrays]


def each(loom: Loom, op: str, *args: Nodes) -> Nodes:
    """An operation element by element, arrays expanded against each other."""
    spread = np.broadcast_arrays(*aligned(*args))
    check_size(spread[0].size)
    made = [loom.call(op, *(int(a) for a in parts)) for parts in zip(*(a.ravel() for a in spread), strict=True)]
    return np.array(made, dtype=np.int64).reshape(spread[0].shape)


def fold(loom: Loom, op: str, nodes: list[int]) -> int:
    """An operation from the first to the last; 0 of no nodes."""
    return reduce(lambda a, b: loom.call(op, a, b), nodes) if nodes else loom.const(0.0)


def matrix_product(loom: Loom, left: Nodes, right: Nodes) -> Nodes:
    """The product of two matrices of nodes; raises `NoValueError` where it is too large."""
    products = left.size * right.shape[1]
    if products > _MOST_PRODUCTS:
        raise NoValueError(f"a product of matrices takes {products} products of numbers; {_MOST_PRODUCTS} is the most")
    made = np.zeros((left.shape[0], right.shape[1]), dtype=np.int64)
    for row in range(left.shape[0]):
        for column in range(right.shape[1]):
            terms = each(loom, "mul", left[row, :], right[:, column])
            made[row, column] = fold(loom, "add", [int(term) for term in terms])
    return made


def towards_zero(loom: Loom, x: Nodes) -> Nodes:
    """The whole part, towards 0."""
    return each(loom, "mul", each(loom, "sign", x), each(loom, "floor", each(loom, "abs", x)))
