"""Library functions of linear algebra.

Systems of equations are solved by elimination with partial pivoting; row exchanges are decisions.
"""

from functools import partial, reduce
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import is_vector
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, format_sizes, matrix_product, reduce_slices
from kennfeld.models.imperative.symbolic_values import SymbolicValue, constants

_MAX_EQUATIONS: Final = 12  # rows of a system of equations: the choice of pivots grows with their cube


def sum_along(apply: Elementwise, array: Nodes, axis: int = 0) -> Nodes:
    """Return the sums along a dimension."""
    return reduce_slices(apply, "add", array, axis, 0.0)


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
    if matrix.shape != (count, count) or not count or right.ndim != 2 or right.shape[0] != count:
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
    return reduce_slices(apply, "max", sums.reshape(-1, 1), 0, 0.0)
