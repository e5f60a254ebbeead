"""Roughness of tables: the mean square of second differences along each axis.

It is quadratic in the values if the breakpoints are fixed. If they are free, the same differences depend on values and
breakpoints, with exact derivatives for both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.free_axes import key_of
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

Factors = Mapping[str, Sequence[float]]


def second_differences(breakpoints: Float) -> Float:
    """Return the coefficients of d = 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), x in mean spacings.

    Args:
        breakpoints: Float[points].

    Returns:
        Float[points - 2, 3]: of z1, z2 and z3. On an even axis d is z1 - 2 z2 + z3.

    >>> second_differences(np.array([0.0, 10.0, 20.0]))
    array([[ 1., -2.,  1.]])
    """
    count = breakpoints.size
    if count < 3:
        return np.zeros((0, 3))
    x = breakpoints / ((breakpoints[-1] - breakpoints[0]) / (count - 1))
    left, right, both = x[1:-1] - x[:-2], x[2:] - x[1:-1], x[2:] - x[:-2]
    return np.stack([2 / (left * both), -2 / (left * right), 2 / (right * both)], axis=1)


def _along(parameter: Parameter, axis: int) -> tuple[Int, Float]:
    """Return grid points and coefficients of the second differences along an axis, divided by sqrt(points)."""
    count = parameter.values.shape[axis]
    lines = np.moveaxis(np.arange(parameter.size).reshape(parameter.values.shape), axis, 0).reshape(count, -1)
    points = np.stack([lines[i : max(count - 2, 0) + i] for i in range(3)], axis=-1)
    coefficients = second_differences(parameter.axes[axis].breakpoints)[:, None, :] / np.sqrt(float(count))
    return points.reshape(-1, 3), np.broadcast_to(coefficients, points.shape).reshape(-1, 3)


@dataclass(frozen=True)
class Roughness:
    """The penalty sum S R over all tables: the sum of squares of rows of three values each.

    A row of two values names one of them twice.
    """

    size: int
    columns: Int  # Int[rows, 3]
    coefficients: Float  # Float[rows, 3]

    @classmethod
    def of(
        cls, parameters: ParameterSet, values: ValueLayout, smoothness: Mapping[str, Sequence[float]]
    ) -> "Roughness":
        """Return the penalty of the free parameters with these factors, one per axis."""
        columns, coefficients = [np.zeros((0, 3), dtype=np.int64)], [np.zeros((0, 3))]
        for name, factors in smoothness.items():
            at = values.offsets.get(name, values.free)
            for axis, factor in enumerate(factors):
                if factor > 0 and at < values.free:
                    points, rows = _along(parameters[name], axis)
                    columns.append(at + points)
                    coefficients.append(rows * factor**0.5)
        return cls(values.free, np.concatenate(columns), np.concatenate(coefficients))

    def _differences(self, values: Float) -> Float:
        found: Float = np.einsum("ij,ij->i", self.coefficients, values[self.columns])
        return found

    def cost(self, values: Float) -> float:
        differences = self._differences(values)
        return float(differences @ differences)

    def add(self, values: Float, gradient: Float, matrix: Float) -> None:
        """Add half the gradient and the matrix of the penalty, in place."""
        slopes = self.coefficients * self._differences(values)[:, None]
        gradient += np.bincount(self.columns.ravel(), slopes.ravel(), minlength=self.size)
        rows, columns, entries = self._matrix
        matrix[rows, columns] += entries

    @cached_property
    def _matrix(self) -> tuple[Int, Int, Float]:
        """Rows, columns and values of the non-zero entries of the matrix of the penalty."""
        places = self.columns[:, :, None] * self.size + self.columns[:, None, :]
        products = self.coefficients[:, :, None] * self.coefficients[:, None, :]
        where, at = np.unique(places, return_inverse=True)
        entries = np.bincount(at.ravel(), products.ravel(), minlength=where.size).astype(np.float64)
        rows, columns = np.divmod(where.astype(np.int64), max(self.size, 1))
        return rows, columns, entries

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Return residuals and Jacobian rows whose squares are the penalty."""
        jacobian: Float = np.zeros((len(self.columns), self.size))
        np.add.at(jacobian, (np.arange(len(self.columns))[:, None], self.columns), self.coefficients)
        return self._differences(values), jacobian


def roughness_of(parameters: ParameterSet, values: ValueLayout, smoothness: Factors) -> "Roughness | MovingRoughness":
    """Return the penalty of the free parameters with these factors, one per axis."""
    on_fixed_axes = {
        name: tuple(0.0 if _moves(parameters, values, name, i) else factor for i, factor in enumerate(factors))
        for name, factors in smoothness.items()
    }
    fixed = Roughness.of(parameters, values, on_fixed_axes)
    if all(tuple(factors) == on_fixed_axes[name] for name, factors in smoothness.items()):
        return fixed
    return MovingRoughness.of(parameters, values, smoothness, fixed)


def _moves(parameters: ParameterSet, values: ValueLayout, name: str, axis: int) -> bool:
    at = values.moving.get(key_of(parameters[name], axis), values.free)
    return at < values.free and values.offsets.get(name, values.free) < values.free


@dataclass(frozen=True)
class MovingRoughness:
    """The penalty sum S R: along fixed axes, and squares of further rows along moving axes.

    A row is weight * c^2 * 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), where c is the mean spacing of the axis.
    Its columns are those of z1, z2, z3, x1, x2, x3 and of the first and the last breakpoint.
    """

    fixed: Roughness
    columns: Int  # Int[rows, 8]
    weights: Float  # Float[rows], sqrt(factor / points)
    counts: Float  # Float[rows], cells of the axis

    @classmethod
    def of(
        cls, parameters: ParameterSet, values: ValueLayout, smoothness: Factors, fixed: Roughness
    ) -> "MovingRoughness":
        """Return the rows of all tables along all axes that move."""
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
        """Return the rows and their derivatives Float[rows, 8]."""
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
        """Return residuals and Jacobian rows whose squares are the penalty."""
        residual, above = self.fixed.rows(values)
        row, slopes = self._linear(values)
        jacobian = np.zeros((row.size, values.size))
        np.add.at(jacobian, (np.arange(row.size)[:, None], self.columns), slopes)
        return np.concatenate([residual, row]), np.vstack([above, jacobian])


def _columns(parameters: ParameterSet, values: ValueLayout, name: str, axis: int) -> Int:
    """Return the columns of the rows of all lines of a table along one axis."""
    table = parameters[name]
    count = table.values.shape[axis]
    lines = np.moveaxis(np.arange(table.size).reshape(table.values.shape), axis, 0).reshape(count, -1)
    inner = max(count - 2, 0)
    grid = np.stack([lines[i : inner + i] for i in range(3)], axis=-1) + values.offsets[name]
    points = np.arange(inner)[:, None] + [0, 1, 2]
    ends = np.broadcast_to([0, count - 1], (inner, 2))
    place = np.hstack([points, ends])[:, None, :] + values.moving[key_of(table, axis)]
    return np.concatenate([grid, np.broadcast_to(place, (*grid.shape[:2], 5))], axis=2).reshape(-1, 8)
