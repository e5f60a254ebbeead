"""Roughness along axes whose breakpoints move: the same second differences, now of values and breakpoints.

Both are differentiated, so the cost that a step is judged by is the cost that it was made for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.free_axes import key_of
from kennfeld.native import Values
from kennfeld.optimize.roughness import Roughness
from kennfeld.parameters import ParameterSet

__all__ = ["MovingRoughness", "roughness_of"]

Factors = Mapping[str, Sequence[float]]


def roughness_of(parameters: ParameterSet, values: Values, smoothness: Factors) -> "Roughness | MovingRoughness":
    """The penalty of the free parameters with these factors, one an axis."""
    still = {
        name: tuple(0.0 if _moves(parameters, values, name, i) else factor for i, factor in enumerate(factors))
        for name, factors in smoothness.items()
    }
    fixed = Roughness.of(parameters, values, still)
    if all(tuple(factors) == still[name] for name, factors in smoothness.items()):
        return fixed
    return MovingRoughness.of(parameters, values, smoothness, fixed)


def _moves(parameters: ParameterSet, values: Values, name: str, axis: int) -> bool:
    at = values.moving.get(key_of(parameters[name], axis), values.free)
    return at < values.free and values.offsets.get(name, values.free) < values.free


@dataclass(frozen=True)
class MovingRoughness:
    """The penalty sum S R: that along axes that stand still, and squares of further rows.

    A row is weight * c^2 * 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), where c is the mean spacing of the axis.
    Its columns are those of z1, z2, z3, x1, x2, x3 and of the first and the last breakpoint.
    """

    fixed: Roughness
    columns: Int  # Int[rows, 8]
    weights: Float  # Float[rows], sqrt(factor / points)
    counts: Float  # Float[rows], cells of the axis

    @classmethod
    def of(cls, parameters: ParameterSet, values: Values, smoothness: Factors, fixed: Roughness) -> "MovingRoughness":
        """The rows of all tables along all axes that move."""
        columns, weights, counts = [np.zeros((0, 8), dtype=np.int64)], [np.zeros(0)], [np.zeros(0)]
        for name, factors in smoothness.items():
            for axis, factor in enumerate(factors):
                if factor > 0 and _moves(parameters, values, name, axis):
                    rows = _columns(parameters, values, name, axis)
                    count = parameters[name].values.shape[axis]
                    columns.append(rows)
                    weights.append(np.full(len(rows), (factor / count) ** 0.5))
                    counts.append(np.full(len(rows), count - 1.0))
        return cls(fixed, np.concatenate(columns), np.concatenate(weights), np.concatenate(counts))

    def _linear(self, values: Float) -> tuple[Float, Float]:
        """Rows and their slopes, Float[rows, 8]."""
        z1, z2, z3, x1, x2, x3, first, last = values[self.columns].T
        left, right, both = x2 - x1, x3 - x2, x3 - x1
        rise_left, rise_right = (z2 - z1) / left, (z3 - z2) / right
        spacing = (last - first) / self.counts
        unit = 2 * self.weights * spacing**2 / both
        row = unit * (rise_right - rise_left)
        stretch = 2 * row / (spacing * self.counts)
        slopes = [
            unit / left,
            -unit * (1 / left + 1 / right),
            unit / right,
            row / both - unit * rise_left / left,
            unit * (rise_left / left + rise_right / right),
            -row / both - unit * rise_right / right,
            -stretch,
            stretch,
        ]
        return row, np.stack(slopes, axis=1)

    def cost(self, values: Float) -> float:
        """The penalty."""
        row, _ = self._linear(values)
        return self.fixed.cost(values) + float(row @ row)

    def add(self, values: Float, gradient: Float, matrix: Float) -> None:
        """Add half the gradient and the Gauss-Newton matrix of the penalty, in place."""
        self.fixed.add(values, gradient, matrix)
        row, slopes = self._linear(values)
        np.add.at(gradient, self.columns, slopes * row[:, None])
        places = (self.columns[:, :, None], self.columns[:, None, :])
        np.add.at(matrix, places, slopes[:, :, None] * slopes[:, None, :])

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Residuals and Jacobian rows whose squares are the penalty."""
        residual, above = self.fixed.rows(values)
        row, slopes = self._linear(values)
        jacobian = np.zeros((row.size, values.size))
        np.add.at(jacobian, (np.arange(row.size)[:, None], self.columns), slopes)
        return np.concatenate([residual, row]), np.vstack([above, jacobian])


def _columns(parameters: ParameterSet, values: Values, name: str, axis: int) -> Int:
    """Columns of the rows of all lines of a table along one axis."""
    table = parameters[name]
    count = table.values.shape[axis]
    lines = np.moveaxis(np.arange(table.size).reshape(table.values.shape), axis, 0).reshape(count, -1)
    inner = max(count - 2, 0)
    grid = np.stack([lines[i : inner + i] for i in range(3)], axis=-1) + values.offsets[name]
    points = np.arange(inner)[:, None] + [0, 1, 2]
    ends = np.broadcast_to([0, count - 1], (inner, 2))
    place = np.hstack([points, ends])[:, None, :] + values.moving[key_of(table, axis)]
    return np.concatenate([grid, np.broadcast_to(place, (*grid.shape[:2], 5))], axis=2).reshape(-1, 8)
