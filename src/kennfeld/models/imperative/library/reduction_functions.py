"""Library functions of reductions along a dimension, and of linear algebra.

Systems of equations are solved by elimination with partial pivoting; row exchanges are decisions.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from itertools import accumulate
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function, is_vector
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, format_sizes, matrix_product
from kennfeld.models.imperative.symbolic_values import EMPTY, SymbolicValue, as_logical, constants

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


def combine(apply: Elementwise, op: str, empty: float, parts: list[Nodes]) -> Nodes:
    """Combine all slices by an operation; `empty` if there are none."""
    return reduce(partial(apply, op), parts) if parts else constants(apply.builder, empty)


def sum_along(apply: Elementwise, array: Nodes, axis: int = 0) -> Nodes:
    """Return the sums along a dimension."""
    return reduce_along(array, axis, partial(combine, apply, "add", 0.0))


@function(*_SUMS, least=1, most=3)
def reduce_array(args: SymbolicArguments) -> SymbolicValue:
    """Compute a sum, a product, any or all, along a dimension or of all elements."""
    (op, empty), is_logical, array = _SUMS[args.name], args.name in ("any", "all"), args.array(0)
    if is_logical:
        array = args.apply("ne", array, 0.0)
    words = {value for value in args.values[1:] if isinstance(value, str)}
    if not words <= _WORDS:
        raise args.refuse(f"{min(words - _WORDS)!r} is not supported", "Leave elements out by a loop with if.")
    args = replace(args, values=[value for value in args.values if not isinstance(value, str)])
    if "all" in words:
        array = array.ravel(order="F").reshape(-1, 1)
        if len(args) > 1:
            raise args.refuse("'all' and a dimension exclude each other")
    array, axis = along_default(args, 1, array)
    result = reduce_along(array, axis, partial(combine, args.apply, op, empty))
    return as_logical(result) if is_logical else result


@function("cumsum", "cumprod", least=1, most=2)
def accumulate_array(args: SymbolicArguments) -> SymbolicValue:
    """Compute cumulative sums or products."""
    array = args.array(0)
    op, axis = "add" if args.name == "cumsum" else "mul", args.dimension(1, array)

    def fold(parts: list[Nodes]) -> Nodes:
        return np.concatenate(list(accumulate(parts, partial(args.apply, op))), axis=axis) if parts else array

    return reduce_along(array, axis, fold)


@function("mean", "rms", least=1, most=2)
def mean(args: SymbolicArguments) -> SymbolicValue:
    """Compute the mean, or the root mean square."""
    apply, array = args.apply, args.array(0)
    if args.name == "rms":
        array = apply("mul", array, array)
    array, axis = along_default(args, 1, array)
    result = apply("div", sum_along(apply, array, axis), float(_length(array, axis)))
    return apply("sqrt", result) if args.name == "rms" else result


def _length(array: Nodes, axis: int) -> int:
    return array.shape[axis] if axis < array.ndim else 1


@function("var", "std", least=1, most=3)
def variance(args: SymbolicArguments) -> SymbolicValue:
    """Compute the variance or standard deviation, with divisor n - 1 or, for a weight of 1, n."""
    apply = args.apply
    array, axis = along_default(args, 2, args.array(0))
    weight = args.whole(1) if len(args) > 1 and args.array(1).size > 0 else 0
    if weight not in (0, 1):
        raise args.refuse(f"the weight must be 0 or 1, got {weight}")
    count = _length(array, axis)
    if not count:
        return reduce_along(array, axis, lambda parts: constants(args.builder, math.nan))
    deviations = apply("sub", array, apply("div", sum_along(apply, array, axis), float(count)))
    squares = sum_along(apply, apply("mul", deviations, deviations), axis)
    result = apply("div", squares, float(count if weight else max(count - 1, 1)))
    return apply("sqrt", result) if args.name == "std" else result


@function("diff", least=1, most=3)
def differences(args: SymbolicArguments) -> SymbolicValue:
    """Compute the differences of neighbours, once or several times."""
    array = args.array(0)
    times = args.whole(1) if len(args) > 1 and args.array(1).size else 1
    if times < 1:
        raise args.refuse(f"the order must be an integer >= 1, got {times}")
    for _ in range(times):
        if array.size == 1 and len(args) < 3:
            return EMPTY
        array = args.apply("sub", *_neighbours(array, args.dimension(2, array)))
    return array


def _neighbours(array: Nodes, axis: int) -> tuple[Nodes, Nodes]:
    """Return all elements along a dimension except the first, and all except the last."""
    whole = np.asarray(array).reshape(array.shape + (1,) * (axis + 1 - array.ndim))
    places = np.arange(whole.shape[axis])
    return np.take(whole, places[1:], axis=axis), np.take(whole, places[:-1], axis=axis)


@function("min", "max", least=1, most=3)
def extreme(args: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """Return the smaller or larger of two arrays, or the extreme along a dimension with its index."""
    if len(args) == 2 or (len(args) == 3 and args.array(1).size):
        pair = args.arrays[:2]
        args.fits(*pair)
        return args.apply(args.name, *pair)
    array = args.array(0)
    if array.size == 0:  # of length 1 if only other dimensions are empty, else unchanged
        axis = args.dimension(2, array)
        return array if _length(array, axis) == 0 or axis >= array.ndim else np.take(array, [0], axis=axis)
    if args.wanted < 2:
        return reduce_along(array, args.dimension(2, array), partial(combine, args.apply, args.name, 0.0))
    return _extreme_with_index(args, array)


def _extreme_with_index(args: SymbolicArguments, array: Nodes) -> tuple[SymbolicValue, ...]:
    """Return the extreme and its first index; NaN propagates."""
    apply, places = args.apply, list[Nodes]()
    worse = "ge" if args.name == "min" else "le"

    def fold(parts: list[Nodes]) -> Nodes:
        best, place = parts[0], np.full(parts[0].shape, args.builder.const(1.0), dtype=np.int64)
        for at, part in enumerate(parts[1:], 2):
            wins = apply("and", apply("not", apply(worse, part, best)), apply("eq", best, best))
            place = apply("select", wins, float(at), place)
            best = apply("select", wins, part, best)
        places.append(place)
        return best

    return reduce_along(array, args.dimension(2, array), fold), places[0]


@function("bounds")
def bounds(args: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """Return the smallest and the largest element along the first dimension."""
    array = args.array(0)
    axis = args.dimension(1, array)
    return tuple(reduce_along(array, axis, partial(combine, args.apply, op, 0.0)) for op in ("min", "max"))


@function("nnz")
def count_nonzero(args: SymbolicArguments) -> SymbolicValue:
    """Return the number of non-zero elements."""
    return sum_along(args.apply, args.apply("ne", args.array(0), 0.0).reshape(-1, 1))


@function("trapz", least=1, most=2)
def integrate(args: SymbolicArguments) -> SymbolicValue:
    """Integrate by the trapezoidal rule along the first dimension, or over the points of two vectors."""
    if len(args) == 2:
        x, y = args.vector(0), args.vector(1)
        if x.shape != y.shape:
            raise args.refuse("its arguments have different sizes")
        areas = args.apply("mul", args.apply("sub", x[1:], x[:-1]), _middles(args, y, 0))
        return sum_along(args.apply, areas)
    y, axis = along_default(args, 1, args.array(0))
    return sum_along(args.apply, _middles(args, y, axis), axis)


def _middles(args: SymbolicArguments, array: Nodes, axis: int) -> Nodes:
    """Return the means of neighbours along a dimension."""
    return args.apply("mul", 0.5, args.apply("add", *_neighbours(array, axis)))


def transpose(array: Nodes) -> Nodes:
    """Return the transposed matrix."""
    if array.ndim > 2:
        raise ProgramError(f"an array of {array.ndim} dimensions cannot be transposed", "Use permute.")
    return array.T


def checked_matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    if left.ndim != 2 or right.ndim != 2 or left.shape[1] != right.shape[0]:
        raise EvaluationError(f"matrices of {format_sizes(left, right)} cannot be multiplied")
    return matrix_product(builder, left, right)


def matrix_divide(builder: GraphBuilder, operator: str, left: Nodes, right: Nodes) -> Nodes:
    r"""Compute `left \ right` or `left / right` for a square matrix."""
    if operator == "\\":
        return solve_linear_system(builder, left, right)
    return solve_linear_system(builder, right.T, left.T).T


def solve_linear_system(builder: GraphBuilder, matrix: Nodes, right: Nodes) -> Nodes:
    """Solve a system of equations by elimination with partial pivoting; row exchanges are decisions."""
    count = matrix.shape[0]
    if matrix.ndim != 2 or matrix.shape != (count, count) or right.shape[0] != count:
        raise ProgramError(f"a system of equations of {format_sizes(matrix, right)} is not supported, only square ones")
    apply = Elementwise(builder)
    a, _ = _eliminate(apply, np.concatenate([np.asarray(matrix), np.asarray(right)], axis=1), count)
    x: list[Nodes] = [a[0, count:]] * count
    for row in range(count - 1, -1, -1):
        rest = a[row, count:]
        for column in range(row + 1, count):
            rest = apply("sub", rest, apply("mul", a[row, column].reshape(1), x[column]))
        x[row] = apply("div", rest, a[row, row].reshape(1))
    return np.stack(x)


def _eliminate(apply: Elementwise, matrix: Nodes, count: int) -> tuple[Nodes, int]:
    """Return a matrix in triangular form, and the node of the determinant's sign due to row exchanges."""
    if count > _MAX_EQUATIONS:
        raise ProgramError(f"a system of {count} equations exceeds the maximum of {_MAX_EQUATIONS}")
    a, sign = matrix.copy(), apply.builder.const(1.0)
    for at in range(count):
        for row in range(at + 1, count):
            sign = _exchange_rows(apply, a, at, row, sign)
        for row in range(at + 1, count):
            share = apply("div", a[row, at].reshape(1), a[at, at].reshape(1))
            a[row, at + 1 :] = apply("sub", a[row, at + 1 :], apply("mul", share, a[at, at + 1 :]))
    return a, sign


def _exchange_rows(apply: Elementwise, a: Nodes, at: int, row: int, sign: int) -> int:
    """Exchange two rows if that gives the larger pivot; return the sign."""
    builder = apply.builder
    larger = builder.call("gt", builder.call("abs", int(a[row, at])), builder.call("abs", int(a[at, at])))
    if builder.value(larger) == 0.0:
        return sign
    choice, high, low = np.array([larger], dtype=np.int64), a[at, at:].copy(), a[row, at:].copy()
    a[at, at:], a[row, at:] = apply("select", choice, low, high), apply("select", choice, high, low)
    return builder.call("select", larger, builder.call("neg", sign), sign)


def matrix_power(evaluator: SymbolicEvaluator, left: Nodes, right: Nodes) -> Nodes:
    """Raise a square matrix to a constant integer power."""
    exponent = evaluator.context.numbers(right, "the power of a matrix")
    if exponent is None or exponent.size != 1 or left.ndim != 2 or left.shape[0] != left.shape[1]:
        raise ProgramError(
            "a matrix power requires a square matrix and a constant exponent", "Use .^ element by element."
        )
    if not float(exponent.item()).is_integer() or not -64 <= exponent.item() <= 64:
        raise ProgramError(f"the exponent {exponent.item():g} of a matrix is not supported")
    times = int(exponent.item())
    unit = constants(evaluator.builder, np.eye(left.shape[0]))
    base = left if times >= 0 else solve_linear_system(evaluator.builder, left, unit)
    return reduce(partial(checked_matrix_product, evaluator.builder), [base] * abs(times)) if times else unit


@function("mtimes", "mldivide", "mrdivide", "mpower", least=2, most=2)
def apply_operator(args: SymbolicArguments) -> SymbolicValue:
    signs = {"mtimes": "*", "mldivide": "\\", "mrdivide": "/", "mpower": "^"}
    return args.evaluator.operation(signs[args.name], *args.arrays)


@function("inv", "pinv")
def inverse(args: SymbolicArguments) -> SymbolicValue:
    """Return the inverse of a matrix, or the pseudoinverse of a constant one."""
    matrix = args.matrix(0)
    if args.name == "pinv" and all(args.builder.value(int(node)) is not None for node in matrix.ravel()):
        if not np.isfinite(args.numbers(0)).all():
            raise args.refuse("its numbers are not finite")
        return constants(args.builder, np.linalg.pinv(args.numbers(0)))
    return solve_linear_system(args.builder, matrix, constants(args.builder, np.eye(matrix.shape[0])))


@function("det")
def determinant(args: SymbolicArguments) -> SymbolicValue:
    matrix = args.matrix(0)
    if matrix.shape[0] != matrix.shape[1]:
        raise args.refuse("its matrix is not square")
    a, sign = _eliminate(args.apply, np.asarray(matrix), matrix.shape[0])
    return np.array([[reduce(partial(args.builder.call, "mul"), map(int, np.diagonal(a)), sign)]], dtype=np.int64)


@function("trace")
def trace(args: SymbolicArguments) -> SymbolicValue:
    return sum_along(args.apply, np.diagonal(args.matrix(0)).reshape(-1, 1))


@function("dot", least=2, most=2)
def dot(args: SymbolicArguments) -> SymbolicValue:
    """Return the scalar product; of matrices, along their columns."""
    a, b = args.arrays
    if is_vector(a) and is_vector(b):
        a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    if a.shape != b.shape:
        raise args.refuse("its arguments have different sizes")
    return sum_along(args.apply, *along_default(args, 2, args.apply("mul", a, b)))


@function("cross", least=2, most=2)
def cross(args: SymbolicArguments) -> SymbolicValue:
    """Return the cross product of two vectors of three elements."""
    apply, (a, b) = args.apply, args.arrays
    if a.size != 3 or b.size != 3:
        raise args.refuse("only vectors of three elements are supported")
    x, y = a.ravel(), b.ravel()
    products = apply("mul", x[[1, 2, 0]], y[[2, 0, 1]]), apply("mul", x[[2, 0, 1]], y[[1, 2, 0]])
    return apply("sub", *products).reshape(a.shape)


@function("norm", least=1, most=2)
def norm(args: SymbolicArguments) -> SymbolicValue:
    """Return the norm of a vector of order 1, 2 or inf, or of a matrix of order 1, inf or 'fro'."""
    apply, array = args.apply, args.array(0)
    order: object = 2.0
    if len(args) > 1:
        order = args.values[1] if isinstance(args.values[1], str) else float(args.numbers(1).item())
    vector = is_vector(args.matrix(0))
    if order == "fro" or (vector and order == 2.0):
        return apply("sqrt", sum_along(apply, apply("mul", array, array).reshape(-1, 1)))
    size = apply("abs", array)
    if order not in (1.0, np.inf, "inf", "Inf"):
        raise args.refuse(f"of order {order} is not supported")
    if vector and order == 1.0:
        return sum_along(apply, size.reshape(-1, 1))
    sums = size if vector else sum_along(apply, size, int(order != 1.0))
    return reduce_along(sums.reshape(-1, 1), 0, partial(combine, apply, "max", 0.0))
