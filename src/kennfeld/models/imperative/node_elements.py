"""Arrays of nodes on which functions of MATLAB numbers work: numpy's operations on them build those of the graph."""

from typing import Any, Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import Array, Elements
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, matrix_product, reduce_slices
from kennfeld.models.imperative.symbolic_values import LogicalNodes, as_logical, constants

# operations by those of numpy, and the results of reducing no elements
_OPERATIONS: Final = {
    "add": "add", "subtract": "sub", "multiply": "mul", "divide": "div", "negative": "neg", "sqrt": "sqrt",
    "absolute": "abs", "fmin": "min", "fmax": "max", "not_equal": "ne", "equal": "eq", "less": "lt",
    "less_equal": "le", "greater": "gt", "greater_equal": "ge", "logical_and": "and", "logical_or": "or",
}  # fmt: skip
_CONDITIONS: Final = frozenset({"eq", "ne", "lt", "le", "gt", "ge", "and", "or"})
_OF_NOTHING: Final = {"add": 0.0, "mul": 1.0, "or": 0.0, "and": 1.0}
# functions that only select elements, or that numpy composes of the operations above
_SELECTING: Final = (np.diff, np.expand_dims, np.take)


class NodeElements(Elements):
    """An array of nodes; conditions are of class logical, everything else is of class double."""

    builder: GraphBuilder

    def __array_finalize__(self, origin: Any) -> None:
        if isinstance(origin, NodeElements):
            self.builder, self.matlab_class = origin.builder, origin.matlab_class

    @classmethod
    def of(cls, builder: GraphBuilder, nodes: Nodes) -> "NodeElements":
        """Return nodes as such an array."""
        result = np.asarray(nodes).view(cls)
        result.builder, result.matlab_class = builder, "logical" if isinstance(nodes, LogicalNodes) else "double"
        return result

    def nodes(self) -> Nodes:
        """Return the plain array of nodes."""
        return as_logical(np.asarray(self)) if self.matlab_class == "logical" else np.asarray(self)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        operands = [self._operand(operand) for operand in inputs]
        if ufunc is np.matmul:
            left, right = (operand.reshape(1, -1) if operand.ndim < 2 else operand for operand in operands)
            return self.of(self.builder, matrix_product(self.builder, left, right if inputs[1].ndim > 1 else right.T))
        op = _OPERATIONS.get(ufunc.__name__)
        if ufunc is np.isnan:
            op, operands = "ne", operands * 2
        if op is None or method not in ("__call__", "reduce", "accumulate"):
            return NotImplemented
        apply = Elementwise(self.builder)
        if method == "__call__":
            result = apply(op, *operands)
        else:
            result = reduce_slices(apply, op, operands[0], options["axis"], _OF_NOTHING.get(op), method == "accumulate")
        return self.of(self.builder, as_logical(result) if op in _CONDITIONS else result)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function not in _SELECTING:
            return NotImplemented
        return super().__array_function__(function, types, arguments, options)

    def astype(self, *_: Any, **__: Any) -> "NodeElements":
        """Return the array itself: nodes have no other type."""
        return self

    def _operand(self, operand: Any) -> Any:
        if isinstance(operand, NodeElements) or np.ndim(operand) == 0:
            return np.asarray(operand) if isinstance(operand, NodeElements) else float(operand)
        return np.asarray(constants(self.builder, operand)).reshape(np.shape(operand))

    def first_extremes(self, name: str, axis: int) -> tuple[Array, Array]:
        """Return the smallest or largest elements along a dimension and their first positions; NaN propagates."""
        apply = Elementwise(self.builder)
        parts = [np.take(np.asarray(self), [at], axis=axis) for at in range(self.shape[axis])]
        best, place = parts[0], np.full(parts[0].shape, self.builder.const(1.0), dtype=np.int64)
        worse = "ge" if name == "min" else "le"
        for at, part in enumerate(parts[1:], 2):
            wins = apply("and", apply("not", apply(worse, part, best)), apply("eq", best, best))
            place = apply("select", wins, float(at), place)
            best = apply("select", wins, part, best)
        return self.of(self.builder, best), self.of(self.builder, place)
