"""Whole numbers that keep the rows of limits, as close as possible to numbers that violate some.

Values that rows connect form groups. Each group with a violated row is an integer program: the least weighted distance
in steps from the target, within bounds and rows. If it has no solution, the values of the group cannot be rounded.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.optimize.rounding.lattice import Lattice, matrix_of

MAX_NODES = 2000  # of the branches of one program; unlike a time, it gives the same result everywhere
GAP = 1e-3  # relative distance from the best repair that is good enough


class Repair(NamedTuple):
    """The numbers after a repair, and the values of groups without any that keep the rows, Bool[size]."""

    numbers: Float
    impossible: Bool


def repair(lattice: Lattice, target: Float, weights: Float) -> Repair:
    """Move whole numbers to the nearest that keep all rows.

    Args:
        lattice: bounds and rows.
        target: whole numbers, Float[size].
        weights: the cost of moving each by one step, Float[size], > 0.
    """
    numbers, impossible = np.clip(target, lattice.lower, lattice.upper), np.zeros(target.size, dtype=bool)
    violated = violated_rows(lattice, numbers)
    if not violated.any():
        return Repair(numbers, impossible)
    matrix = matrix_of(lattice.rows, lattice.size)
    groups = _groups(matrix)
    # a row belongs to the group of any of its values
    group_of_row = groups[matrix.indices[matrix.indptr[:-1]]]
    for group in np.unique(group_of_row[violated]):
        values, rows = np.flatnonzero(groups == group), np.flatnonzero(group_of_row == group)
        moves = _nearest_moves(lattice, matrix[rows][:, values].tocsr(), values, rows, numbers, weights)
        if moves is None:
            impossible[values] = True
        else:
            numbers[values] += moves
    return Repair(numbers, impossible)


def violated_rows(lattice: Lattice, numbers: Float) -> Bool:
    """Mark the rows that whole numbers, Float[size], violate, Bool[rows]."""
    product = lattice.rows.times(numbers)
    return np.asarray((product < lattice.rows.lower) | (product > lattice.rows.upper))


def _groups(rows: Sparse) -> Int:
    """Return the number of the group of each value, Int[size], given the rows, shape (rows, size)."""
    from scipy.sparse.csgraph import connected_components

    linked = (abs(rows).T @ abs(rows)).tocsr()
    return np.asarray(connected_components(linked, directed=False)[1])


def _nearest_moves(
    lattice: Lattice, matrix: Sparse, values: Int, rows: Int, numbers: Float, weights: Float
) -> Float | None:
    """Return the moves of the values of a group, Float[values]; None if no numbers keep its rows."""
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import hstack

    # upward and downward moves, both >= 0, so that their sum is the distance
    up, down = lattice.upper[values] - numbers[values], numbers[values] - lattice.lower[values]
    product = lattice.rows.times(numbers)[rows]
    both = hstack([matrix, -matrix]).tocsc()
    solution = milp(
        np.tile(weights[values] / weights[values].max(), 2),
        integrality=np.ones(2 * values.size),
        bounds=Bounds(0.0, np.concatenate([up, down])),
        constraints=LinearConstraint(both, lattice.rows.lower[rows] - product, lattice.rows.upper[rows] - product),
        options={"node_limit": MAX_NODES, "mip_rel_gap": GAP},
    )
    if solution.x is None:
        return None
    moves = np.rint(solution.x[: values.size]) - np.rint(solution.x[values.size :])
    trial = numbers.copy()
    trial[values] += moves
    # the tolerance of the program is coarser than that of the rows
    kept = ~violated_rows(lattice, trial)[rows]
    inside = (trial >= lattice.lower) & (trial <= lattice.upper)
    return moves if kept.all() and inside[values].all() else None
