"""Matrices: products, systems of equations by elimination with pivots, determinants, powers."""

from functools import reduce
from typing import TYPE_CHECKING, Final

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.functions.reductions import along, along_default, total
from kennfeld.models.simulink.code.functions.registry import Given, function, is_vector
from kennfeld.models.simulink.code.values import Held, constants
from kennfeld.models.simulink.expressions.arrays import each, matrix_product
from kennfeld.models.simulink.expressions.signals import Nodes

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.calls import Calls

__all__ = ["divided", "power", "product", "solved", "transposed"]

_LARGEST: Final = 12  # rows of a system of equations: the choice of pivots grows with their cube


def transposed(array: Nodes) -> Nodes:
    """Rows as columns."""
    if array.ndim > 2:
        raise CodeError(f"an array of {array.ndim} dimensions cannot be transposed", "Use permute.")
    return array.T


def product(loom: Loom, left: Nodes, right: Nodes) -> Nodes:
    """The product of two matrices."""
    if left.ndim != 2 or right.ndim != 2 or left.shape[1] != right.shape[0]:
        sizes = " and ".join("x".join(map(str, one.shape)) for one in (left, right))
        raise CodeError(f"matrices of {sizes} cannot be multiplied")
    return matrix_product(loom, left, right)


def divided(loom: Loom, operator: str, left: Nodes, right: Nodes) -> Nodes:
    r"""`left \ right` or `left / right`, of a square matrix."""
    return solved(loom, left, right) if operator == "\\" else solved(loom, right.T, left.T).T


def solved(loom: Loom, matrix: Nodes, right: Nodes) -> Nodes:
    """The solution of a system of equations, by elimination with partial pivots; rows change places by decisions."""
    count = matrix.shape[0]
    if matrix.ndim != 2 or matrix.shape != (count, count) or right.shape[0] != count:
        sizes = " and ".join("x".join(map(str, one.shape)) for one in (matrix, right))
        raise CodeError(f"a system of equations of {sizes}; only square ones are solved")
    a, _ = _eliminated(loom, np.concatenate([np.asarray(matrix), np.asarray(right)], axis=1), count)
    x: list[Nodes] = [a[0, count:]] * count
    for row in range(count - 1, -1, -1):
        rest = a[row, count:]
        for column in range(row + 1, count):
            rest = each(loom, "sub", rest, each(loom, "mul", a[row, column].reshape(1), x[column]))
        x[row] = each(loom, "div", rest, a[row, row].reshape(1))
    return np.stack(x)


def _eliminated(loom: Loom, matrix: Nodes, count: int) -> tuple[Nodes, int]:
    """A matrix in triangular form, and the node of the sign that changes of rows give its determinant."""
    if count > _LARGEST:
        raise CodeError(f"a system of {count} equations; {_LARGEST} is the most")
    a, sign = matrix.copy(), loom.const(1.0)
    for at in range(count):
        for row in range(at + 1, count):
            sign = _exchanged(loom, a, at, row, sign)
        for row in range(at + 1, count):
            share = each(loom, "div", a[row, at].reshape(1), a[at, at].reshape(1))
            a[row, at + 1 :] = each(loom, "sub", a[row, at + 1 :], each(loom, "mul", share, a[at, at + 1 :]))
    return a, sign


def _exchanged(loom: Loom, a: Nodes, at: int, row: int, sign: int) -> int:
    """Let the larger of two candidates be the pivot."""
    larger = loom.call("gt", loom.call("abs", int(a[row, at])), loom.call("abs", int(a[at, at])))
    if loom.value(larger) == 0.0:
        return sign
    choice, high, low = np.array([larger], dtype=np.int64), a[at, at:].copy(), a[row, at:].copy()
    a[at, at:], a[row, at:] = each(loom, "select", choice, low, high), each(loom, "select", choice, high, low)
    return loom.call("select", larger, loom.call("neg", sign), sign)


def power(calls: "Calls", left: Nodes, right: Nodes) -> Nodes:
    """A square matrix to a fixed whole power."""
    exponent = calls.desk.numbers(right, "the power of a matrix")
    if exponent is None or exponent.size != 1 or left.ndim != 2 or left.shape[0] != left.shape[1]:
        raise CodeError("a power of or with a matrix that is not square or not fixed", "Use .^ element by element.")
    if not float(exponent.item()).is_integer() or not -64 <= exponent.item() <= 64:
        raise CodeError(f"the power {exponent.item():g} of a matrix")
    times = int(exponent.item())
    unit = constants(calls.loom, np.eye(left.shape[0]))
    base = left if times >= 0 else solved(calls.loom, left, unit)
    return reduce(lambda a, b: product(calls.loom, a, b), [base] * abs(times)) if times else unit


@function("mtimes", "mldivide", "mrdivide", "mpower", least=2, most=2)
def operator(given: Given) -> Held:
    """An operator by its name."""
    signs = {"mtimes": "*", "mldivide": "\\", "mrdivide": "/", "mpower": "^"}
    return given.calls.operation(signs[given.name], *given.arrays)


@function("pinv")
def pseudo_inverse(given: Given) -> Held:
    """The pseudoinverse of a matrix of constants; of one that depends on signals the inverse, which has to exist."""
    loom, matrix = given.calls.loom, given.matrix(0)
    if all(loom.value(int(node)) is not None for node in matrix.ravel()):
        if not np.isfinite(given.numbers(0)).all():
            raise given.refuse("its numbers are not finite")
        return constants(loom, np.linalg.pinv(given.numbers(0)))
    return _inverse(loom, matrix)


@function("inv")
def inverse(given: Given) -> Held:
    """The inverse of a square matrix."""
    return _inverse(given.calls.loom, given.matrix(0))


def _inverse(loom: Loom, matrix: Nodes) -> Nodes:
    return solved(loom, matrix, constants(loom, np.eye(matrix.shape[0])))


@function("det")
def determinant(given: Given) -> Held:
    """The determinant of a square matrix."""
    loom, matrix = given.calls.loom, given.matrix(0)
    if matrix.shape[0] != matrix.shape[1]:
        raise given.refuse("its matrix is not square")
    a, sign = _eliminated(loom, np.asarray(matrix), matrix.shape[0])
    for at in range(matrix.shape[0]):
        sign = loom.call("mul", sign, int(a[at, at]))
    return np.array([[sign]], dtype=np.int64)


@function("trace")
def trace(given: Given) -> Held:
    """The sum of the diagonal."""
    diagonal = np.diagonal(given.matrix(0)).reshape(-1, 1)
    return along(diagonal, 0, lambda parts: total(given.calls.loom, "add", 0.0, parts))


@function("dot", least=2, most=2)
def dot(given: Given) -> Held:
    """The sum of the products of elements; of matrices along their columns."""
    loom, (a, b) = given.calls.loom, given.arrays
    if is_vector(a) and is_vector(b):
        a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    if a.shape != b.shape:
        raise given.refuse("its arguments have different sizes")
    products, axis = along_default(given, 2, each(loom, "mul", a, b))
    return along(products, axis, lambda parts: total(loom, "add", 0.0, parts))


@function("cross", least=2, most=2)
def cross(given: Given) -> Held:
    """The cross product of two vectors of three elements."""
    loom, (a, b) = given.calls.loom, given.arrays
    if a.size != 3 or b.size != 3:
        raise given.refuse("only vectors of three elements are supported")
    x, y = a.ravel(), b.ravel()
    first = each(loom, "mul", x[[1, 2, 0]], y[[2, 0, 1]])
    return each(loom, "sub", first, each(loom, "mul", x[[2, 0, 1]], y[[1, 2, 0]])).reshape(a.shape)


@function("norm", least=1, most=2)
def norm(given: Given) -> Held:
    """The length of a vector: of order 1, 2 or inf; of a matrix 1, inf or 'fro'."""
    loom, array = given.calls.loom, given.array(0)
    order: object = 2.0
    if len(given) > 1:
        order = given.held[1] if isinstance(given.held[1], str) else float(given.numbers(1).item())
    vector = is_vector(given.matrix(0))
    if order == "fro" or (vector and order == 2.0):
        flat = each(loom, "mul", array, array).reshape(-1, 1)
        return each(loom, "sqrt", along(flat, 0, lambda parts: total(loom, "add", 0.0, parts)))
    size = each(loom, "abs", array)
    if order not in (1.0, np.inf, "inf", "Inf"):
        raise given.refuse(f"of order {order} is not supported")
    largest = order != 1.0
    if vector:
        op = "max" if largest else "add"
        return along(size.reshape(-1, 1), 0, lambda parts: total(loom, op, 0.0, parts))
    sums = along(size, int(largest), lambda parts: total(loom, "add", 0.0, parts))
    return along(sums.reshape(-1, 1), 0, lambda parts: total(loom, "max", 0.0, parts))
