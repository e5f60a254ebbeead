"""Functions along a dimension of an array: sums, products, extremes, differences.

Matrices: products, systems of equations by elimination with pivots, determinants, powers.
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

__all__ = ["checked_matrix_product", "combine", "matrix_divide", "matrix_power", "reduce_along", "transposed"]

_SUMS = {"sum": ("add", 0.0), "prod": ("mul", 1.0), "any": ("or", 0.0), "all": ("and", 1.0)}
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing"})

_LARGEST: Final = 12  # rows of a system of equations: the choice of pivots grows with their cube


def reduce_along(array: Nodes, axis: int, fold: Callable[[list[Nodes]], Nodes]) -> Nodes:
    """What a function makes of the slices along a dimension, which is one long then."""
    if axis >= array.ndim:
        return fold([np.asarray(array)])
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    made = fold(parts)
    if parts or made.size != 1:
        return made
    rest = (*array.shape[:axis], 1, *array.shape[axis + 1 :])
    return np.full(rest, made.item(), dtype=np.int64)


def along_default(given: SymbolicArguments, at: int, array: Nodes) -> tuple[Nodes, int]:
    """An array and the dimension along which it is taken; without one `[]` counts as a row of no elements."""
    array = array.reshape(1, 0) if len(given) <= at and array.shape == (0, 0) else array
    return array, given.dimension(at, array)


def combine(builder: GraphBuilder, op: str, empty: float, parts: list[Nodes]) -> Nodes:
    """All slices taken together by an operation; `empty` of none."""
    return reduce(lambda a, b: elementwise(builder, op, a, b), parts) if parts else constants(builder, empty)


@function(*_SUMS, least=1, most=3)
def reduced(given: SymbolicArguments) -> SymbolicValue:
    """A sum, product, or whether any or all elements are not 0, along a dimension or of all elements."""
    (op, empty), builder, array = _SUMS[given.name], given.calls.builder, given.array(0)
    if given.name in ("any", "all"):
        array = elementwise(builder, "ne", array, constants(builder, 0.0))
    words = {one for one in given.held[1:] if isinstance(one, str)}
    if not words <= _WORDS:
        raise given.refuse(f"{min(words - _WORDS)!r} is not supported", "Leave elements out by a loop with if.")
    if "all" in words:
        array = array.ravel(order="F").reshape(-1, 1)
    given = replace(given, held=[one for one in given.held if not isinstance(one, str)])
    if "all" in words and len(given) > 1:
        raise given.refuse("'all' stands beside a dimension")
    array, axis = along_default(given, 1, array)
    made = reduce_along(array, axis, lambda parts: combine(builder, op, empty, parts))
    return as_logical(made) if given.name in ("any", "all") else made


@function("cumsum", "cumprod", least=1, most=2)
def running(given: SymbolicArguments) -> SymbolicValue:
    """Sums or products up to each element."""
    builder, array = given.calls.builder, given.array(0)
    op, axis = "add" if given.name == "cumsum" else "mul", given.dimension(1, array)

    def fold(parts: list[Nodes]) -> Nodes:
        made = parts[:1]
        for part in parts[1:]:
            made.append(elementwise(builder, op, made[-1], part))
        return np.concatenate(made, axis=axis) if made else array

    return reduce_along(array, axis, fold)


@function("mean", "rms", least=1, most=2)
def mean(given: SymbolicArguments) -> SymbolicValue:
    """The mean, or the root of the mean of squares."""
    builder, array = given.calls.builder, given.array(0)
    if given.name == "rms":
        array = elementwise(builder, "mul", array, array)
    array, axis = along_default(given, 1, array)
    count = constants(builder, float(array.shape[axis] if axis < array.ndim else 1))
    made = elementwise(
        builder, "div", reduce_along(array, axis, lambda parts: combine(builder, "add", 0.0, parts)), count
    )
    return elementwise(builder, "sqrt", made) if given.name == "rms" else made


@function("var", "std", least=1, most=3)
def spread(given: SymbolicArguments) -> SymbolicValue:
    """The variance or standard deviation, over n - 1 or, with a weight of 1, over n."""
    builder = given.calls.builder
    array, axis = along_default(given, 2, given.array(0))
    weight = given.whole(1) if len(given) > 1 and given.array(1).size > 0 else 0
    if weight not in (0, 1):
        raise given.refuse(f"the weight {weight} is neither 0 nor 1")
    count = array.shape[axis] if axis < array.ndim else 1
    if not count:
        return reduce_along(array, axis, lambda parts: constants(builder, math.nan))
    whole = reduce_along(array, axis, lambda parts: combine(builder, "add", 0.0, parts))
    away = elementwise(builder, "sub", array, elementwise(builder, "div", whole, constants(builder, float(count))))
    squares = reduce_along(
        elementwise(builder, "mul", away, away), axis, lambda parts: combine(builder, "add", 0.0, parts)
    )
    made = elementwise(builder, "div", squares, constants(builder, float(count if weight else max(count - 1, 1))))
    return elementwise(builder, "sqrt", made) if given.name == "std" else made


@function("diff", least=1, most=3)
def differences(given: SymbolicArguments) -> SymbolicValue:
    """The differences of neighbours, once or several times."""
    builder, array = given.calls.builder, given.array(0)
    times = given.whole(1) if len(given) > 1 and given.array(1).size else 1
    if times < 1:
        raise given.refuse(f"the order {times} is not a whole number from 1")
    for _ in range(times):
        if array.size == 1 and len(given) < 3:
            return EMPTY
        array = elementwise(builder, "sub", *_neighbours(array, given.dimension(2, array)))
    return array


def _neighbours(array: Nodes, axis: int) -> tuple[Nodes, Nodes]:
    """All elements along a dimension but the first, and all but the last."""
    whole = np.asarray(array).reshape(array.shape + (1,) * (axis + 1 - array.ndim))
    places = np.arange(whole.shape[axis])
    return np.take(whole, places[1:], axis=axis), np.take(whole, places[:-1], axis=axis)


@function("min", "max", least=1, most=3)
def extreme(given: SymbolicArguments) -> SymbolicValue | tuple[SymbolicValue, ...]:
    """The smaller or larger of two arrays, or the smallest or largest along a dimension, with its place."""
    builder = given.calls.builder
    if len(given) == 2 or (len(given) == 3 and given.array(1).size):
        pair = given.arrays[:2]
        given.fits(*pair)
        return elementwise(builder, given.name, *pair)
    array = given.array(0)
    if array.size == 0:
        return _of_nothing(given, array)
    if given.wanted < 2:
        return reduce_along(array, given.dimension(2, array), lambda parts: combine(builder, given.name, 0.0, parts))
    return _placed(given, array)


def _of_nothing(given: SymbolicArguments, array: Nodes) -> Nodes:
    """The extreme of an empty array: one long where the others are none, else as empty as it was."""
    axis = given.dimension(2, array)
    if axis >= array.ndim or array.shape[axis] == 0:
        return array
    return np.take(array, [0], axis=axis)


def _placed(given: SymbolicArguments, array: Nodes) -> tuple[SymbolicValue, ...]:
    """The extreme and the first place where it is; what is not a number counts as such."""
    builder, places = given.calls.builder, list[Nodes]()
    worse = "ge" if given.name == "min" else "le"

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

    return reduce_along(array, given.dimension(2, array), fold), places[0]


@function("bounds")
def bounds(given: SymbolicArguments) -> tuple[SymbolicValue, ...]:
    """The smallest and the largest element along the first dimension."""
    builder, array = given.calls.builder, given.array(0)
    axis = given.dimension(1, array)
    smallest = reduce_along(array, axis, lambda parts: combine(builder, "min", 0.0, parts))
    return smallest, reduce_along(array, axis, lambda parts: combine(builder, "max", 0.0, parts))


@function("nnz")
def count(given: SymbolicArguments) -> SymbolicValue:
    """How many elements are not 0."""
    builder = given.calls.builder
    flat = elementwise(builder, "ne", given.array(0), constants(builder, 0.0)).reshape(-1, 1)
    return reduce_along(flat, 0, lambda parts: combine(builder, "add", 0.0, parts))


@function("trapz", least=1, most=2)
def area(given: SymbolicArguments) -> SymbolicValue:
    """The area below lines through the points of an array along its first dimension, or through those of vectors."""
    builder = given.calls.builder
    if len(given) == 2:
        x, y = given.vector(0), given.vector(1)
        if x.shape != y.shape:
            raise given.refuse("its arguments have different sizes")
        wide = elementwise(builder, "sub", x[1:], x[:-1])
        return reduce_along(
            elementwise(builder, "mul", wide, _middles(given, y, 0)),
            0,
            lambda parts: combine(builder, "add", 0.0, parts),
        )
    y, axis = along_default(given, 1, given.array(0))
    return reduce_along(_middles(given, y, axis), axis, lambda parts: combine(builder, "add", 0.0, parts))


def _middles(given: SymbolicArguments, array: Nodes, axis: int) -> Nodes:
    """The means of neighbours along a dimension."""
    builder = given.calls.builder
    return elementwise(builder, "mul", constants(builder, 0.5), elementwise(builder, "add", *_neighbours(array, axis)))


def transposed(array: Nodes) -> Nodes:
    """Rows as columns."""
    if array.ndim > 2:
        raise ProgramError(f"an array of {array.ndim} dimensions cannot be transposed", "Use permute.")
    return array.T


def checked_matrix_product(builder: GraphBuilder, left: Nodes, right: Nodes) -> Nodes:
    """The product of two matrices."""
    if left.ndim != 2 or right.ndim != 2 or left.shape[1] != right.shape[0]:
        sizes = " and ".join("x".join(map(str, one.shape)) for one in (left, right))
        raise ProgramError(f"matrices of {sizes} cannot be multiplied")
    return matrix_product(builder, left, right)


def matrix_divide(builder: GraphBuilder, operator: str, left: Nodes, right: Nodes) -> Nodes:
    r"""`left \ right` or `left / right`, of a square matrix."""
    return (
        solve_linear_system(builder, left, right)
        if operator == "\\"
        else solve_linear_system(builder, right.T, left.T).T
    )


def solve_linear_system(builder: GraphBuilder, matrix: Nodes, right: Nodes) -> Nodes:
    """The solution of a system of equations, by elimination with partial pivots; rows change places by decisions."""
    count = matrix.shape[0]
    if matrix.ndim != 2 or matrix.shape != (count, count) or right.shape[0] != count:
        sizes = " and ".join("x".join(map(str, one.shape)) for one in (matrix, right))
        raise ProgramError(f"a system of equations of {sizes}; only square ones are solved")
    a, _ = _eliminated(builder, np.concatenate([np.asarray(matrix), np.asarray(right)], axis=1), count)
    x: list[Nodes] = [a[0, count:]] * count
    for row in range(count - 1, -1, -1):
        rest = a[row, count:]
        for column in range(row + 1, count):
            rest = elementwise(builder, "sub", rest, elementwise(builder, "mul", a[row, column].reshape(1), x[column]))
        x[row] = elementwise(builder, "div", rest, a[row, row].reshape(1))
    return np.stack(x)


def _eliminated(builder: GraphBuilder, matrix: Nodes, count: int) -> tuple[Nodes, int]:
    """A matrix in triangular form, and the node of the sign that changes of rows give its determinant."""
    if count > _LARGEST:
        raise ProgramError(f"a system of {count} equations; {_LARGEST} is the most")
    a, sign = matrix.copy(), builder.const(1.0)
    for at in range(count):
        for row in range(at + 1, count):
            sign = _exchanged(builder, a, at, row, sign)
        for row in range(at + 1, count):
            share = elementwise(builder, "div", a[row, at].reshape(1), a[at, at].reshape(1))
            a[row, at + 1 :] = elementwise(
                builder, "sub", a[row, at + 1 :], elementwise(builder, "mul", share, a[at, at + 1 :])
            )
    return a, sign


def _exchanged(builder: GraphBuilder, a: Nodes, at: int, row: int, sign: int) -> int:
    """Let the larger of two candidates be the pivot."""
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
    """A square matrix to a fixed whole power."""
    exponent = calls.context.numbers(right, "the power of a matrix")
    if exponent is None or exponent.size != 1 or left.ndim != 2 or left.shape[0] != left.shape[1]:
        raise ProgramError("a power of or with a matrix that is not square or not fixed", "Use .^ element by element.")
    if not float(exponent.item()).is_integer() or not -64 <= exponent.item() <= 64:
        raise ProgramError(f"the power {exponent.item():g} of a matrix")
    times = int(exponent.item())
    unit = constants(calls.builder, np.eye(left.shape[0]))
    base = left if times >= 0 else solve_linear_system(calls.builder, left, unit)
    return reduce(lambda a, b: checked_matrix_product(calls.builder, a, b), [base] * abs(times)) if times else unit


@function("mtimes", "mldivide", "mrdivide", "mpower", least=2, most=2)
def operator(given: SymbolicArguments) -> SymbolicValue:
    """An operator by its name."""
    signs = {"mtimes": "*", "mldivide": "\\", "mrdivide": "/", "mpower": "^"}
    return given.calls.operation(signs[given.name], *given.arrays)


@function("pinv")
def pseudo_inverse(given: SymbolicArguments) -> SymbolicValue:
    """The pseudoinverse of a matrix of constants; of one that depends on signals the inverse, which has to exist."""
    builder, matrix = given.calls.builder, given.matrix(0)
    if all(builder.value(int(node)) is not None for node in matrix.ravel()):
        if not np.isfinite(given.numbers(0)).all():
            raise given.refuse("its numbers are not finite")
        return constants(builder, np.linalg.pinv(given.numbers(0)))
    return _inverse(builder, matrix)


@function("inv")
def inverse(given: SymbolicArguments) -> SymbolicValue:
    """The inverse of a square matrix."""
    return _inverse(given.calls.builder, given.matrix(0))


def _inverse(builder: GraphBuilder, matrix: Nodes) -> Nodes:
    return solve_linear_system(builder, matrix, constants(builder, np.eye(matrix.shape[0])))


@function("det")
def determinant(given: SymbolicArguments) -> SymbolicValue:
    """The determinant of a square matrix."""
    builder, matrix = given.calls.builder, given.matrix(0)
    if matrix.shape[0] != matrix.shape[1]:
        raise given.refuse("its matrix is not square")
    a, sign = _eliminated(builder, np.asarray(matrix), matrix.shape[0])
    for at in range(matrix.shape[0]):
        sign = builder.call("mul", sign, int(a[at, at]))
    return np.array([[sign]], dtype=np.int64)


@function("trace")
def trace(given: SymbolicArguments) -> SymbolicValue:
    """The sum of the diagonal."""
    diagonal = np.diagonal(given.matrix(0)).reshape(-1, 1)
    return reduce_along(diagonal, 0, lambda parts: combine(given.calls.builder, "add", 0.0, parts))


@function("dot", least=2, most=2)
def dot(given: SymbolicArguments) -> SymbolicValue:
    """The sum of the products of elements; of matrices along their columns."""
    builder, (a, b) = given.calls.builder, given.arrays
    if is_vector(a) and is_vector(b):
        a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    if a.shape != b.shape:
        raise given.refuse("its arguments have different sizes")
    products, axis = along_default(given, 2, elementwise(builder, "mul", a, b))
    return reduce_along(products, axis, lambda parts: combine(builder, "add", 0.0, parts))


@function("cross", least=2, most=2)
def cross(given: SymbolicArguments) -> SymbolicValue:
    """The cross product of two vectors of three elements."""
    builder, (a, b) = given.calls.builder, given.arrays
    if a.size != 3 or b.size != 3:
        raise given.refuse("only vectors of three elements are supported")
    x, y = a.ravel(), b.ravel()
    first = elementwise(builder, "mul", x[[1, 2, 0]], y[[2, 0, 1]])
    return elementwise(builder, "sub", first, elementwise(builder, "mul", x[[2, 0, 1]], y[[1, 2, 0]])).reshape(a.shape)


@function("norm", least=1, most=2)
def norm(given: SymbolicArguments) -> SymbolicValue:
    """The length of a vector: of order 1, 2 or inf; of a matrix 1, inf or 'fro'."""
    builder, array = given.calls.builder, given.array(0)
    order: object = 2.0
    if len(given) > 1:
        order = given.held[1] if isinstance(given.held[1], str) else float(given.numbers(1).item())
    vector = is_vector(given.matrix(0))
    if order == "fro" or (vector and order == 2.0):
        flat = elementwise(builder, "mul", array, array).reshape(-1, 1)
        return elementwise(builder, "sqrt", reduce_along(flat, 0, lambda parts: combine(builder, "add", 0.0, parts)))
    size = elementwise(builder, "abs", array)
    if order not in (1.0, np.inf, "inf", "Inf"):
        raise given.refuse(f"of order {order} is not supported")
    largest = order != 1.0
    if vector:
        op = "max" if largest else "add"
        return reduce_along(size.reshape(-1, 1), 0, lambda parts: combine(builder, op, 0.0, parts))
    sums = reduce_along(size, int(largest), lambda parts: combine(builder, "add", 0.0, parts))
    return reduce_along(sums.reshape(-1, 1), 0, lambda parts: combine(builder, "max", 0.0, parts))
