"""Library functions of reductions along a dimension, and of linear algebra.

Systems of equations are solved by elimination with partial pivoting; row exchanges are decisions.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import TYPE_CHECKING, Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, is_vector
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, matrix_product
from kennfeld.models.imperative.symbolic_values import EMPTY, SymbolicValue, as_logical, constants

if TYPE_CHECKING:
    from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator


_SUMS = {"sum": ("add", 0.0), "prod": ("mul", 1.0), "any": ("or", 0.0), "all": ("and", 1.0)}
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing"})

_MAX_EQUATIONS: Final = 12  # rows of a system of equations: the choice of pivots grows with their cube


def reduce_along(array: Nodes, axis: int, fold: Callable[[list[Nodes]], Nodes]) -> Nodes:
    """Apply a function to the slices along a dimension, which then has length 1."""
    if axis >= array.ndim:
        return fold([np.asarray(array)])
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    result = fold(parts)
    if parts or result.size != 1:
        return result
    rest = (*array.shape[:axis], 1, *array.shape[axis + 1 :])
    return np.full(rest, result.item(), dtype=np.int64)


def along_default(args: SymbolicArguments, at: int, array: Nodes) -> tuple[Nodes, int]:
    """Return an array and the dimension to work along; by default, `[]` is a row of no elements."""
    array = array.reshape(1, 0) if len(args) <= at and array.shape == (0, 0) else array
    return array, args.dimension(at, array)


def combine(builder: GraphBuilder, op: str, empty: float, parts: list[Nodes]) -> Nodes:
    """Combine all slices by an operation; `empty` if there are none."""
    return reduce(lambda a, b: elementwise(builder, op, a, b), parts) if parts else constants(builder, empty)


@function(*_SUMS, least=1, most=3)
def reduce_array(args: SymbolicArguments) -> SymbolicValue:
    """Compute a sum, a product, any or all, along a dimension or of all elements."""
    (op, empty), builder, array = _SUMS[args.name], args.calls.builder, args.array(0)
    if args.name in ("any", "all"):
        array = elementwise(builder, "ne", array, constants(builder, 0.0))
    words = {value for value in args.held[1:] if isinstance(value, str)}
    if not words <= _WORDS:
        raise args.refuse(f"{min(words - _WORDS)!r} is not supported", "Leave elements out by a loop with if.")
    if "all" in words:
        array = array.ravel(order="F").reshape(-1, 1)
    args = replace(args, held=[value for value in args.held if not isinstance(value, str)])
    if "all" in words and len(args) > 1:
        raise args.refuse("'all' and a dimension exclude each other")
    array, axis = along_default(args, 1, array)
    result = reduce_along(array, axis, lambda parts: combine(builder, op, empty, parts))
    return as_logical(result) if args.name in ("any", "all") else result


@function("cumsum", "cumprod", least=1, most=2)
def accumulate(args: SymbolicArguments) -> SymbolicValue:
    """Compute cumulative sums or products."""
    builder, array = args.calls.builder, args.array(0)
    op, axis = "add" if args.name == "cumsum" else "mul", args.dimension(1, array)

    def fold(parts: list[Nodes]) -> Nodes:
        result = parts[:1]
        for part in parts[1:]:
            result.append(elementwise(builder, op, result[-1], part))
        return np.concatenate(result, axis=axis) if result else array

    return reduce_along(array, axis, fold)


@function("mean", "rms", least=1, most=2)
def mean(args: SymbolicArguments) -> SymbolicValue:
    """Compute the mean, or the root mean square."""
    builder, array = args.calls.builder, args.array(0)
    if args.name == "rms":
        array = elementwise(builder, "mul", array, array)
    array, axis = along_default(args, 1, array)
    count = constants(builder, float(array.shape[axis] if axis < array.ndim else 1))
    result = elementwise(
        builder, "div", reduce_along(array, axis, lambda parts: combine(builder, "add", 0.0, parts)), count
    )
    return elementwise(builder, "sqrt", result) if args.name == "rms" else result


@function("var", "std", least=1, most=3)
def variance(args: SymbolicArguments) -> SymbolicValue:
    """Compute the variance or standard deviation, with divisor n - 1 or, for a weight of 1, n."""
    builder = args.calls.builder
    array, axis = along_default(args, 2, args.array(0))
    weight = args.whole(1) if len(args) > 1 and args.array(1).size > 0 else 0
    if weight not in (0, 1):
        raise args.refuse(f"the weight must be 0 or 1, got {weight}")
    count = array.shape[axis] if axis < array.ndim else 1
    if not count:
        return reduce_along(array, axis, lambda parts: constants(builder, math.nan))
    whole = reduce_along(array, axis, lambda parts: combine(builder, "add", 0.0, parts))
    away = elementwise(builder, "sub", array, elementwise(builder, "div", whole, constants(builder, float(count))))
    squares = reduce_along(
        elementwise(builder, "mul", away, away), axis, lambda parts: combine(builder, "add", 0.0, parts)
    )
    result = elementwise(builder, "div", squares, constants(builder, float(count if weight else max(count - 1, 1))))
    return elementwise(builder, "sqrt", result) if args.name == "std" else result


@function("diff", least=1, most=3)
def differences(args: SymbolicArguments) -> SymbolicValue:
    """Compute the differences of neighbours, once or several times."""
    builder, array = args.calls.builder, args.array(0)
    times = args.whole(1) if len(args) > 1 and args.array(1).size else 1
    if times < 1:
        raise args.refuse(f"the order must be an integer >= 1, got {times}")
    for _ in range(times):
        if array.size == 1 and len(args) < 3:
            return EMPTY
        array = elementwise(builder, "sub", *_neighbours(array, args.dimension(2, array)))
    return array


def _neighbours(array: Nodes, axis: int) -> tuple[Nodes, Nodes]:
    """Return all elements along a dimension except the first, and all except the last."""
    whole = np.asarray(array).reshape(array.shape + (1,) * (axis + 1 - array.ndim))
    places = np.arange(whole.shape[axis])
    return np.take(whole, places[1:], axis=axis), np.take(whole, places[:-1], axis=axis)


@function("min", "max", least=1, most=3)
def extreme(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """Return the smaller or larger of two arrays, or the extreme along a dimension with its index."""
    builder = args.calls.builder
    if len(args) == 2 or (len(args) == 3 and args.array(1).size):
        pair = args.arrays[:2]
        args.fits(*pair)
        return elementwise(builder, args.name, *pair)
    array = args.array(0)
    if array.size == 0:
        return _empty_extreme(args, array)
    if args.wanted < 2:
        return reduce_along(array, args.dimension(2, array), lambda parts: combine(builder, args.name, 0.0, parts))
    return _extreme_with_index(args, array)


def _empty_extreme(args: SymbolicArguments, array: Nodes) -> Nodes:
    """Return the extreme of an empty array: of length 1 if only other dimensions are empty, else unchanged."""
    axis = args.dimension(2, array)
    if axis >= array.ndim or array.shape[axis] == 0:
        return array
    return np.take(array, [0], axis=axis)


def _extreme_with_index(args: SymbolicArguments, array: Nodes) -> tuple[SymbolicValue, ...]:
    """Return the extreme and its first index; NaN propagates."""
    builder, places = args.calls.builder, list[Nodes]()
    worse = "ge" if args.name == "min" else "le"

    def fold(parts: list[Nodes]) -> Nodes:
        best, place = parts[0], np.full(parts[0].shape, builder.const(1.0), dtype=np.int64)
        for at, part in enumerate(parts[1:], 2):
            wins = elementwise(
                builder,
                "and",
                elementwise(builder, "not", elementwise(builder, worse, part, best)),
                elementwise(builder, "eq", best, best),
            )
            place = elementwise(builder, "select", wins, constants(builder, float(at)), place)
            best = elementwise(builder, "select", wins, part, best)
        places.append(place)
        return best

    return reduce_along(array, args.dimension(2, array), fold), places[0]


@function("bounds")
def bounds(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Return the smallest and the largest element along the first dimension."""
    builder, array = args.calls.builder, args.array(0)
    axis = args.dimension(1, array)
    smallest = reduce_along(array, axis, lambda parts: combine(builder, "min", 0.0, parts))
    return smallest, reduce_along(array, axis, lambda parts: combine(builder, "max", 0.0, parts))


@function("nnz")
def count(args: SymbolicArguments) -> SymbolicValue:
    """Return the number of non-zero elements."""
    builder = args.calls.builder
    flat = elementwise(builder, "ne", args.array(0), constants(builder, 0.0)).reshape(-1, 1)
    return reduce_along(flat, 0, lambda parts: combine(builder, "add", 0.0, parts))


@function("trapz", least=1, most=2)
def integrate(args: SymbolicArguments) -> SymbolicValue:
    """Integrate by the trapezoidal rule along the first dimension, or over the points of two vectors."""
    builder = args.calls.builder
    if len(args) == 2:
        x, y = args.vector(0), args.vector(1)
        if x.shape != y.shape:
            raise args.refuse("its arguments have different sizes")
        wide = elementwise(builder, "sub", x[1:], x[:-1])
        return reduce_along(
            elementwise(builder, "mul", wide, _middles(args, y, 0)),
            0,
            lambda parts: combine(builder, "add", 0.0, parts),
        )
    y, axis = along_default(args, 1, args.array(0))
    return reduce_along(_middles(args, y, axis), axis, lambda parts: combine(builder, "add", 0.0, parts))


def _middles(args: SymbolicArguments, array: Nodes, axis: int) -> Nodes:
    """Return the means of neighbours along a dimension."""
    builder = args.calls.builder
    return elementwise(builder, "mul", constants(builder, 0.5), elementwise(builder, "add", *_neighbours(array, axis)))


def transpose(array: Nodes) -> Nodes:
    """Return the transposed matrix."""
    if array.ndim > 2:
        raise ProgramError(f"an array of {array.ndim} dimensions cannot be transposed", "Use permute.")
    return array.T


def checked_matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    if left.ndim != 2 or right.ndim != 2 or left.shape[1] != right.shape[0]:
        sizes = " and ".join("x".join(map(str, item.shape)) for item in (left, right))
        raise ProgramError(f"matrices of {sizes} cannot be multiplied")
    return matrix_product(builder, left, right)


def matrix_divide(builder: GraphBuilder, operator: str, left: Nodes, right: Nodes) -> Nodes:
    r"""Compute `left \ right` or `left / right` for a square matrix."""
    return (
        solve_linear_system(builder, left, right)
        if operator == "\\"
        else solve_linear_system(builder, right.T, left.T).T
    )


def solve_linear_system(builder: GraphBuilder, matrix: Nodes, right: Nodes) -> Nodes:
    """Solve a system of equations by elimination with partial pivoting; row exchanges are decisions."""
    count = matrix.shape[0]
    if matrix.ndim != 2 or matrix.shape != (count, count) or right.shape[0] != count:
        sizes = " and ".join("x".join(map(str, item.shape)) for item in (matrix, right))
        raise ProgramError(f"a system of equations of {sizes} is not supported, only square ones")
    a, _ = _eliminate(builder, np.concatenate([np.asarray(matrix), np.asarray(right)], axis=1), count)
    x: list[Nodes] = [a[0, count:]] * count
    for row in range(count - 1, -1, -1):
        rest = a[row, count:]
        for column in range(row + 1, count):
            rest = elementwise(builder, "sub", rest, elementwise(builder, "mul", a[row, column].reshape(1), x[column]))
        x[row] = elementwise(builder, "div", rest, a[row, row].reshape(1))
    return np.stack(x)


def _eliminate(builder: GraphBuilder, matrix: Nodes, count: int) -> tuple[Nodes, int]:
    """Return a matrix in triangular form, and the node of the determinant's sign due to row exchanges."""
    if count > _MAX_EQUATIONS:
        raise ProgramError(f"a system of {count} equations exceeds the maximum of {_MAX_EQUATIONS}")
    a, sign = matrix.copy(), builder.const(1.0)
    for at in range(count):
        for row in range(at + 1, count):
            sign = _exchange_rows(builder, a, at, row, sign)
        for row in range(at + 1, count):
            share = elementwise(builder, "div", a[row, at].reshape(1), a[at, at].reshape(1))
            a[row, at + 1 :] = elementwise(
                builder, "sub", a[row, at + 1 :], elementwise(builder, "mul", share, a[at, at + 1 :])
            )
    return a, sign


def _exchange_rows(builder: GraphBuilder, a: Nodes, at: int, row: int, sign: int) -> int:
    """Exchange two rows if that gives the larger pivot; return the sign."""
    larger = builder.call("gt", builder.call("abs", int(a[row, at])), builder.call("abs", int(a[at, at])))
    if builder.value(larger) == 0.0:
        return sign
    choice, high, low = np.array([larger], dtype=np.int64), a[at, at:].copy(), a[row, at:].copy()
    a[at, at:], a[row, at:] = (
        elementwise(builder, "select", choice, low, high),
        elementwise(builder, "select", choice, high, low),
    )
    return builder.call("select", larger, builder.call("neg", sign), sign)


def matrix_power(calls: "ExpressionEvaluator", left: Nodes, right: Nodes) -> Nodes:
    """Raise a square matrix to a constant integer power."""
    exponent = calls.context.numbers(right, "the power of a matrix")
    if exponent is None or exponent.size != 1 or left.ndim != 2 or left.shape[0] != left.shape[1]:
        raise ProgramError(
            "a matrix power requires a square matrix and a constant exponent", "Use .^ element by element."
        )
    if not float(exponent.item()).is_integer() or not -64 <= exponent.item() <= 64:
        raise ProgramError(f"the exponent {exponent.item():g} of a matrix is not supported")
    times = int(exponent.item())
    unit = constants(calls.builder, np.eye(left.shape[0]))
    base = left if times >= 0 else solve_linear_system(calls.builder, left, unit)
    return reduce(lambda a, b: checked_matrix_product(calls.builder, a, b), [base] * abs(times)) if times else unit


@function("mtimes", "mldivide", "mrdivide", "mpower", least=2, most=2)
def apply_operator(args: SymbolicArguments) -> SymbolicValue:
    signs = {"mtimes": "*", "mldivide": "\\", "mrdivide": "/", "mpower": "^"}
    return args.calls.operation(signs[args.name], *args.arrays)


@function("pinv")
def pseudo_inverse(args: SymbolicArguments) -> SymbolicValue:
    """Return the pseudoinverse of a constant matrix, or the inverse of one that depends on signals."""
    builder, matrix = args.calls.builder, args.matrix(0)
    if all(builder.value(int(node)) is not None for node in matrix.ravel()):
        if not np.isfinite(args.numbers(0)).all():
            raise args.refuse("its numbers are not finite")
        return constants(builder, np.linalg.pinv(args.numbers(0)))
    return _inverse(builder, matrix)


@function("inv")
def inverse(args: SymbolicArguments) -> SymbolicValue:
    return _inverse(args.calls.builder, args.matrix(0))


def _inverse(builder: GraphBuilder, matrix: Nodes) -> Nodes:
    return solve_linear_system(builder, matrix, constants(builder, np.eye(matrix.shape[0])))


@function("det")
def determinant(args: SymbolicArguments) -> SymbolicValue:
    builder, matrix = args.calls.builder, args.matrix(0)
    if matrix.shape[0] != matrix.shape[1]:
        raise args.refuse("its matrix is not square")
    a, sign = _eliminate(builder, np.asarray(matrix), matrix.shape[0])
    for at in range(matrix.shape[0]):
        sign = builder.call("mul", sign, int(a[at, at]))
    return np.array([[sign]], dtype=np.int64)


@function("trace")
def trace(args: SymbolicArguments) -> SymbolicValue:
    diagonal = np.diagonal(args.matrix(0)).reshape(-1, 1)
    return reduce_along(diagonal, 0, lambda parts: combine(args.calls.builder, "add", 0.0, parts))


@function("dot", least=2, most=2)
def dot(args: SymbolicArguments) -> SymbolicValue:
    """Return the scalar product; of matrices, along their columns."""
    builder, (a, b) = args.calls.builder, args.arrays
    if is_vector(a) and is_vector(b):
        a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    if a.shape != b.shape:
        raise args.refuse("its arguments have different sizes")
    products, axis = along_default(args, 2, elementwise(builder, "mul", a, b))
    return reduce_along(products, axis, lambda parts: combine(builder, "add", 0.0, parts))


@function("cross", least=2, most=2)
def cross(args: SymbolicArguments) -> SymbolicValue:
    """Return the cross product of two vectors of three elements."""
    builder, (a, b) = args.calls.builder, args.arrays
    if a.size != 3 or b.size != 3:
        raise args.refuse("only vectors of three elements are supported")
    x, y = a.ravel(), b.ravel()
    first = elementwise(builder, "mul", x[[1, 2, 0]], y[[2, 0, 1]])
    return elementwise(builder, "sub", first, elementwise(builder, "mul", x[[2, 0, 1]], y[[1, 2, 0]])).reshape(a.shape)


@function("norm", least=1, most=2)
def norm(args: SymbolicArguments) -> SymbolicValue:
    """Return the norm of a vector of order 1, 2 or inf, or of a matrix of order 1, inf or 'fro'."""
    builder, array = args.calls.builder, args.array(0)
    order: object = 2.0
    if len(args) > 1:
        order = args.held[1] if isinstance(args.held[1], str) else float(args.numbers(1).item())
    vector = is_vector(args.matrix(0))
    if order == "fro" or (vector and order == 2.0):
        flat = elementwise(builder, "mul", array, array).reshape(-1, 1)
        return elementwise(builder, "sqrt", reduce_along(flat, 0, lambda parts: combine(builder, "add", 0.0, parts)))
    size = elementwise(builder, "abs", array)
    if order not in (1.0, np.inf, "inf", "Inf"):
        raise args.refuse(f"of order {order} is not supported")
    largest = order != 1.0
    if vector:
        op = "max" if largest else "add"
        return reduce_along(size.reshape(-1, 1), 0, lambda parts: combine(builder, op, 0.0, parts))
    sums = reduce_along(size, int(largest), lambda parts: combine(builder, "add", 0.0, parts))
    return reduce_along(sums.reshape(-1, 1), 0, lambda parts: combine(builder, "max", 0.0, parts))
