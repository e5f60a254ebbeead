"""Roughness of tables: the mean square of second differences along each axis, as a quadratic form of the values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.native import Values
from kennfeld.parameters import Parameter, ParameterSet

__all__ = ["Roughness", "second_differences"]


def second_differences(breakpoints: Float) -> Float:
    """Coefficients of d = 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), x in units of the mean spacing.

    Shape (points - 2, 3): of z1, z2 and z3. On an even axis d is z1 - 2 z2 + z3.

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
    """Second differences of all lines of a table along one axis, divided by sqrt(points): grid points, coefficients."""
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
    def of(cls, parameters: ParameterSet, values: Values, smoothness: Mapping[str, Sequence[float]]) -> "Roughness":
        """The penalty of the free parameters with these factors, one an axis."""
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
        """The penalty."""
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
        """Rows, columns and values of the matrix of the penalty where it is not zero."""
        places = self.columns[:, :, None] * self.size + self.columns[:, None, :]
        products = self.coefficients[:, :, None] * self.coefficients[:, None, :]
        where, at = np.unique(places, return_inverse=True)
        entries = np.bincount(at.ravel(), products.ravel(), minlength=where.size).astype(np.float64)
        rows, columns = np.divmod(where.astype(np.int64), max(self.size, 1))
        return rows, columns, entries

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Residuals and Jacobian rows whose squares are the penalty."""
        jacobian: Float = np.zeros((len(self.columns), self.size))
        np.add.at(jacobian, (np.arange(len(self.columns))[:, None], self.columns), self.coefficients)
        return self._differences(values), jacobian
