"""Arrays of nodes on which functions of MATLAB numbers work: numpy's operations on them build those of the graph."""

import math
from typing import Any, Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import Array, Elements
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, TWO, Rule, expm1
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, matrix_product, reduce_slices, truncate
from kennfeld.models.imperative.symbolic_values import LogicalNodes, as_logical, constants

# operations of the graph by those of numpy
_SAME: Final = (
    np.sin,
    np.cos,
    np.tan,
    np.sinh,
    np.cosh,
    np.tanh,
    np.exp,
    np.log,
    np.log10,
    np.sqrt,
    np.sign,
    np.floor,
    np.ceil,
)
_OPERATIONS: Final[dict[np.ufunc, str]] = {
    **{ufunc: ufunc.__name__ for ufunc in _SAME},
    np.add: "add", np.subtract: "sub", np.multiply: "mul", np.divide: "div", np.negative: "neg", np.absolute: "abs",
    np.arcsin: "asin", np.arccos: "acos", np.arctan: "atan", np.arctan2: "atan2", np.fmin: "min", np.fmax: "max",
    np.equal: "eq", np.not_equal: "ne", np.less: "lt", np.less_equal: "le", np.greater: "gt", np.greater_equal: "ge",
    np.logical_and: "and", np.logical_or: "or",
}  # fmt: skip
_COMPOSED: Final[dict[np.ufunc, Rule]] = {
    np.trunc: truncate,
    np.hypot: TWO["hypot"],
    np.arcsinh: INVERSE_HYPERBOLIC["asinh"],
    np.arccosh: INVERSE_HYPERBOLIC["acosh"],
    np.arctanh: INVERSE_HYPERBOLIC["atanh"],
    np.log2: lambda builder, x: Elementwise(builder)("div", Elementwise(builder)("log", x), math.log(2.0)),
    np.log1p: lambda builder, x: Elementwise(builder)("log", Elementwise(builder)("add", x, 1.0)),
    np.expm1: expm1,
    np.deg2rad: lambda builder, x: Elementwise(builder)("mul", x, math.pi / 180),
    np.rad2deg: lambda builder, x: Elementwise(builder)("div", x, math.pi / 180),
    np.isnan: lambda builder, x: Elementwise(builder)("ne", x, x),
    np.isinf: lambda builder, x: Elementwise(builder)("eq", Elementwise(builder)("abs", x), math.inf),
    np.isfinite: lambda builder, x: Elementwise(builder)("lt", Elementwise(builder)("abs", x), math.inf),
}
_CONDITIONS: Final = frozenset(
    {np.equal, np.not_equal, np.less, np.less_equal, np.greater, np.greater_equal}
    | {np.logical_and, np.logical_or, np.isnan, np.isinf, np.isfinite}
)
_OF_NOTHING: Final[dict[np.ufunc, float]] = {np.add: 0.0, np.multiply: 1.0, np.logical_or: 0.0, np.logical_and: 1.0}
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
        op, apply = _OPERATIONS.get(ufunc, ""), Elementwise(self.builder)
        if ufunc in _COMPOSED:
            result = _COMPOSED[ufunc](self.builder, *operands)
        elif not op or method not in ("__call__", "reduce", "accumulate"):
            return NotImplemented
        elif method == "__call__":
            result = apply(op, *operands)
        else:
            empty = _OF_NOTHING.get(ufunc)
            result = reduce_slices(apply, op, operands[0], options["axis"], empty, method == "accumulate")
        return self.of(self.builder, as_logical(result) if ufunc in _CONDITIONS else result)

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
