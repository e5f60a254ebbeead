"""Whole numbers that keep the rows of limits, as close as possible to numbers that violate some.

An integer program finds the least weighted distance in steps from the target, within bounds and rows. First, only
values around the violated rows may move. If that is not enough, it is solved for each group of values that rows
connect; if that has no solution either, the values of the group cannot be rounded.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.rounding.lattice import Lattice, matrix_of, violated_rows

MAX_NODES = 2000  # of the branches of one program; unlike a time, it gives the same result everywhere
REACH = 3  # rows from a violated one, as far as which values move at first
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
    program = _Program(lattice, matrix_of(lattice.rows, lattice.size), weights)
    near = program.near(violated)
    if (moved := program.solve(numbers, near)) is not None:
        return Repair(moved, impossible)
    groups = program.groups()
    for group in np.unique(groups[near]):
        values = np.flatnonzero(groups == group)
        if not violated_rows(lattice, numbers)[program.rows_of(values)].any():
            continue
        if (moved := program.solve(numbers, values)) is None:
            impossible[values] = True
        else:
            numbers = moved
    return Repair(numbers, impossible)


@dataclass(frozen=True, eq=False)
class _Program:
    """The integer program over some values of a lattice, with the matrix of its rows, shape (rows, size)."""

    lattice: Lattice
    matrix: Sparse
    weights: Float

    def rows_of(self, values: Int) -> Int:
        """Return the rows that touch any of some values, Int[touching]."""
        return np.flatnonzero(np.diff(self.matrix[:, values].indptr))

    def near(self, violated: Bool) -> Int:
        """Return the values within `REACH` rows of the violated ones, Int[near]."""
        rows = np.flatnonzero(violated)
        for _ in range(REACH):
            values = np.unique(self.matrix[rows].indices)
            rows = self.rows_of(values)
        return np.asarray(values)

    def groups(self) -> Int:
        """Return the number of the group of each value, Int[size]."""
        from scipy.sparse.csgraph import connected_components

        return np.asarray(connected_components(abs(self.matrix).T @ abs(self.matrix), directed=False)[1])

    def solve(self, numbers: Float, values: Int) -> Float | None:
        """Return whole numbers in which some values have moved so that their rows hold; None if there are none."""
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import hstack

        lattice, rows = self.lattice, self.rows_of(values)
        part = self.matrix[rows][:, values]
        product = lattice.rows.times(numbers)[rows]
        # upward and downward moves, both >= 0, so that their sum is the distance
        up, down = lattice.upper[values] - numbers[values], numbers[values] - lattice.lower[values]
        sides = lattice.rows.lower[rows] - product, lattice.rows.upper[rows] - product
        solution = milp(
            np.tile(self.weights[values] / self.weights[values].max(), 2),
            integrality=np.ones(2 * values.size),
            bounds=Bounds(0.0, np.concatenate([up, down])),
            constraints=LinearConstraint(hstack([part, -part]).tocsc(), *sides),
            options={"node_limit": MAX_NODES, "mip_rel_gap": GAP},
        )
        if solution.x is None:
            return None
        moved = numbers.copy()
        moved[values] += np.rint(solution.x[: values.size]) - np.rint(solution.x[values.size :])
        moved = np.clip(moved, lattice.lower, lattice.upper)
        # the tolerance of the program is coarser than that of the rows
        return None if violated_rows(lattice, moved)[rows].any() else moved
