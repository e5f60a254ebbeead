"""Systems of linear equations over nodes: solutions, inverses and determinants, for code and for block diagrams.

Elimination with partial pivoting, in which row exchanges are decisions: the pivot is known at run time only. Both sides
of such a decision compute the same solution, so that its derivatives have no kinks.
"""

from collections.abc import Iterable
from functools import partial, reduce
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, format_sizes, reduce_nodes
from kennfeld.models.imperative.symbolic_values import constants

MAX_EQUATIONS: Final = 12  # rows of a system of equations: the choice of pivots grows with their cube
_MAX_EXPANDED_ROWS: Final = 3  # of a determinant that is expanded into products


def matrix_divide(builder: GraphBuilder, operator: str, left: Nodes, right: Nodes) -> Nodes:
    r"""Compute `left \ right` or `left / right` for a square matrix."""
    if operator == "\\":
        return solve_linear_system(builder, left, right)
    # X = A / B is X B = A, or B' X' = A'
    return solve_linear_system(builder, right.T, left.T).T


def inverse_matrix(builder: GraphBuilder, matrix: Nodes) -> Nodes:
    """Invert a square matrix, Int[rows, rows]; infinite or NaN if it is singular."""
    return solve_linear_system(builder, matrix, constants(builder, np.eye(matrix.shape[0])))


def solve_linear_system(builder: GraphBuilder, matrix: Nodes, right: Nodes) -> Nodes:
    """Solve A X = B for a square matrix A, Int[rows, rows], and B, Int[rows, columns].

    Raises:
        ProgramError: if the matrix is not square or too large, or the right side has another number of rows.
    """
    count = matrix.shape[0]
    if matrix.shape != (count, count) or not count or right.ndim != 2 or right.shape[0] != count:
        raise ProgramError(f"a system of equations of {format_sizes(matrix, right)} is not supported, only square ones")
    apply = Elementwise(builder)
    a, _ = _eliminate(apply, np.concatenate([np.asarray(matrix), np.asarray(right)], axis=1), count)
    x: list[Nodes] = [a[0, count:]] * count
    # back substitution: x[i] = (b[i] - sum over j > i of a[i, j] x[j]) / a[i, i]
    for row in range(count - 1, -1, -1):
        rest = a[row, count:]
        for column in range(row + 1, count):
            rest = apply("sub", rest, apply("mul", a[row, column].reshape(1), x[column]))
        x[row] = apply("div", rest, a[row, row].reshape(1))
    return np.stack(x)


def matrix_determinant(builder: GraphBuilder, matrix: Nodes) -> int:
    """Compute the determinant of a square matrix, Int[rows, rows]."""
    count = matrix.shape[0]
    # a small one is expanded: no pivots to divide by, so that a singular matrix has the determinant 0 rather than NaN
    if count <= _MAX_EXPANDED_ROWS:
        return _expand(builder, np.asarray(matrix))
    a, sign = _eliminate(Elementwise(builder), np.asarray(matrix), count)
    diagonal: Iterable[int] = map(int, np.diagonal(a))
    return reduce(partial(builder.call, "mul"), diagonal, sign)


def _expand(builder: GraphBuilder, matrix: Nodes) -> int:
    """Expand a determinant along its first row: sum of (-1)^j a[0, j] det(minor of j)."""
    if not matrix.size:
        return builder.const(1.0)
    products = []
    for column, node in enumerate(map(int, matrix[0])):
        minor = _expand(builder, np.delete(matrix[1:], column, axis=1))
        products.append(builder.call("mul", node, minor if column % 2 == 0 else builder.call("neg", minor)))
    return reduce_nodes(builder, "add", products)


def _eliminate(apply: Elementwise, matrix: Nodes, count: int) -> tuple[Nodes, int]:
    """Return a matrix in triangular form, and the node of the determinant's sign due to row exchanges."""
    if count > MAX_EQUATIONS:
        raise ProgramError(f"a system of {count} equations exceeds the maximum of {MAX_EQUATIONS}")
    a, sign = matrix.copy(), apply.builder.const(1.0)
    for at in range(count):
        # exchanging with each row below in turn leaves the largest element of the column at the pivot
        for row in range(at + 1, count):
            sign = _exchange_rows(apply, a, at, row, sign)
        # a[row] -= a[row, at] / a[at, at] a[at]; the column below the pivot is not read again, and stays as it is
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
