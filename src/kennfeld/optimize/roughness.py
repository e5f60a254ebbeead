"""Roughness of tables: the mean square of second differences along each axis, as a quadratic form of the values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kennfeld.arrays import Float
from kennfeld.native import Values
from kennfeld.parameters import Parameter, ParameterSet

__all__ = ["Roughness", "second_differences"]


def second_differences(breakpoints: Float) -> Float:
    """Rows that take d = 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), x in units of the mean spacing.

    Shape (points - 2, points). On an even axis this is z1 - 2 z2 + z3.

    >>> second_differences(np.array([0.0, 10.0, 20.0]))
    array([[ 1., -2.,  1.]])
    """
    count = breakpoints.size
    rows = np.zeros((max(count - 2, 0), count))
    if count < 3:
        return rows
    x = breakpoints / ((breakpoints[-1] - breakpoints[0]) / (count - 1))
    left, right, both = x[1:-1] - x[:-2], x[2:] - x[1:-1], x[2:] - x[:-2]
    at = np.arange(count - 2)
    rows[at, at] = 2 / (left * both)
    rows[at, at + 1] = -2 / (left * right)
    rows[at, at + 2] = 2 / (right * both)
    return rows


def _along(parameter: Parameter, axis: int) -> Float:
    """Second differences of all lines of a table along one axis, over its flat values, divided by sqrt(points)."""
    shape = parameter.values.shape
    rows = second_differences(parameter.axes[axis].breakpoints) / np.sqrt(float(shape[axis]))
    before, after = int(np.prod(shape[:axis])), int(np.prod(shape[axis + 1 :]))
    return np.asarray(np.kron(np.kron(np.eye(before), rows), np.eye(after)), dtype=np.float64)


@dataclass(frozen=True)
class Roughness:
    """The penalty sum S R over all tables: rows L of each table, so that its penalty is |L z|^2."""

    size: int
    parts: tuple[tuple[int, Float], ...]  # first column, rows

    @classmethod
    def of(cls, parameters: ParameterSet, values: Values, smoothness: Mapping[str, Sequence[float]]) -> "Roughness":
        """The penalty of the free parameters with these factors, one an axis."""
        parts = []
        for name, factors in smoothness.items():
            at = values.offsets.get(name, values.free)
            rows: list[Float] = [_along(parameters[name], i) * s**0.5 for i, s in enumerate(factors) if s > 0]
            if rows and at < values.free:
                parts.append((at, np.concatenate(rows)))
        return cls(values.free, tuple(parts))

    def cost(self, values: Float) -> float:
        """The penalty."""
        return float(sum(np.sum(np.square(rows @ values[at : at + rows.shape[1]])) for at, rows in self.parts))

    def add(self, values: Float, gradient: Float, matrix: Float) -> None:
        """Add half the gradient and the matrix of the penalty, in place."""
        for (at, rows), square in zip(self.parts, self._squares, strict=True):
            part = slice(at, at + rows.shape[1])
            gradient[part] += square @ values[part]
            matrix[part, part] += square

    @cached_property
    def _squares(self) -> list[Float]:
        return [rows.T @ rows for _, rows in self.parts]

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Residuals and Jacobian rows whose squares are the penalty."""
        count = sum(rows.shape[0] for _, rows in self.parts)
        jacobian: Float = np.zeros((count, self.size))
        start = 0
        for at, rows in self.parts:
            jacobian[start : start + rows.shape[0], at : at + rows.shape[1]] = rows
            start += rows.shape[0]
        return jacobian @ values[: self.size], jacobian
