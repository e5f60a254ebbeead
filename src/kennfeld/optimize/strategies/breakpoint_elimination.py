"""Backward elimination of the breakpoints of a dense axis in a quadratic model of the cost.

A breakpoint is removed by making every line of its tables straight there, a linear equality between values. In the
quadratic model the least increase of the cost under A z = 0 is (A z)' (A C A')^-1 (A z), where C is the inverse of its
matrix, and both z and C under the equality follow in closed form. The cheapest breakpoint is removed repeatedly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int

ROUNDING = 1e-12  # of the largest variance: avoids a division by zero for dependent lines


@dataclass(frozen=True)
class DenseAxis:
    """An axis with more breakpoints than `wanted`.

    `columns` are the indices of the values at each breakpoint, one column per line of a table. `stays` marks the
    breakpoints that must not be removed.
    """

    points: Float  # Float[points]
    columns: Int  # Int[points, lines]
    stays: Bool  # Bool[points]
    wanted: int


def eliminate_breakpoints(axes: Sequence[DenseAxis], values: Float, inverse: Float) -> tuple[list[Int], Float]:
    """Remove breakpoints until each axis has as many as wanted.

    Args:
        axes: dense axes.
        values: minimum of the quadratic model, Float[values].
        inverse: inverse of its matrix, Float[values, values]; 0 for values that cannot move.

    Returns:
        Indices of the remaining breakpoints of each axis, and the best values with them.

    >>> hat = DenseAxis(np.arange(4.0), np.arange(4)[:, None], np.array([True, False, False, True]), 3)
    >>> left, values = eliminate_breakpoints([hat], np.array([0.0, 1.0, 2.0, 0.0]), np.eye(4))
    >>> left[0].tolist(), values.round(6).tolist()
    ([0, 2, 3], [0.0, 1.0, 2.0, 0.0])
    """
    work = _Elimination(axes, values, inverse)
    while work.remove():
        pass
    return [np.array(kept) for kept in work.kept], work.values


class _Elimination:
    """Values and their covariance under the equalities so far."""

    def __init__(self, axes: Sequence[DenseAxis], values: Float, inverse: Float) -> None:
        self.axes = axes
        self.values = values.copy()
        self.inverse = inverse.copy()
        self.kept = [list(range(axis.points.size)) for axis in axes]

    def remove(self) -> bool:
        """Remove the cheapest breakpoint; False if none can be removed."""
        candidates = [
            (*self._cost(which, at), which, at)
            for which, axis in enumerate(self.axes)
            if len(self.kept[which]) > axis.wanted
            for at in range(1, len(self.kept[which]) - 1)
            if not axis.stays[self.kept[which][at]]
        ]
        if not candidates:
            return False
        _, _, which, at = min(candidates, key=lambda candidate: candidate[:2])
        self._straighten(*self._rows(which, at))
        del self.kept[which][at]
        return True

    def _rows(self, which: int, at: int) -> tuple[Int, Float]:
        """Return columns Int[lines, 3] and coefficients of the equalities that remove a breakpoint."""
        axis, three = self.axes[which], self.kept[which][at - 1 : at + 2]
        left, middle, right = axis.points[three]
        share = (middle - left) / (right - left)
        return axis.columns[three].T, np.array([share - 1, 1.0, -share])

    def _cost(self, which: int, at: int) -> tuple[float, float]:
        """Return the least increase of the cost, and the distance of the neighbours to break ties."""
        columns, coefficients = self._rows(which, at)
        three = self.kept[which][at - 1 : at + 2]
        apart = float(np.ptp(self.axes[which].points[three]))
        bend = self.values[columns] @ coefficients
        blocks = self.inverse[columns[:, None, :, None], columns[None, :, None, :]]
        spread = np.einsum("abij,i,j->ab", blocks, coefficients, coefficients)
        return float(bend @ _solved(spread, bend)), apart

    def _straighten(self, columns: Int, coefficients: Float) -> None:
        """Update values and covariance for additional equalities."""
        reach: Float = np.einsum("naj,j->na", self.inverse[:, columns], coefficients)
        spread = np.einsum("aib,i->ab", reach[columns], coefficients)
        gain = _solved(spread, reach.T)
        self.values -= gain.T @ (self.values[columns] @ coefficients)
        self.inverse -= reach @ gain


def _solved(spread: Float, right: Float) -> Float:
    floor = ROUNDING * float(np.diag(spread).max(initial=0.0)) + 1e-300
    return np.asarray(np.linalg.solve(spread + floor * np.eye(len(spread)), right), dtype=np.float64)
