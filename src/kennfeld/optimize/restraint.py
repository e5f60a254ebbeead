"""A slight penalty in addition to the roughness, for values determined neither by data nor by smoothness.

If only the product of two tables is measured, one can grow while the other shrinks: a pull towards the start resolves
that. Grid points without data follow a straight line or a twisted plane through the others, however steep: a penalty on
differences between neighbours flattens them. Both are too weak to matter at grid points with data.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.roughness import MovingRoughness, Roughness, roughness_of
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

PULL = 1e-4  # of the curvature of the data
EMPTY = 1e-2  # of the mean curvature of a table: a value below it has no data


@dataclass(frozen=True, eq=False)
class Restraint:
    """The cost sum weights (z - toward)^2 + sum stiffness (z_i - z_j)^2 over the values z of a table.

    `edges` are the pairs (i, j) of neighbouring grid points, as numbers in the flat table, at least one without data.
    """

    weights: Float  # Float[values]
    toward: Float  # Float[values]
    edges: Int  # Int[edges, 2]
    stiffness: Float  # Float[edges]

    @classmethod
    def of(cls, start: Parameter, values: Float, curvature: Float, variance: float) -> "Restraint":
        """Return the restraint of a table.

        A difference next to a grid point without data counts as one sample of the value 0, whose standard deviation is
        the range of the values with data over the cells of the axis.

        Args:
            start: The table with the values towards which it is pulled.
            values: Its values at a fit, flat.
            curvature: The diagonal of the Gauss-Newton matrix there.
            variance: The noise, as the cost of one independent sample.
        """
        empty = curvature <= EMPTY * curvature.mean()
        with_data = values[~empty]
        edges, stiffness = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)]
        if with_data.size:
            span = np.ptp(with_data) ** 2 + variance / curvature[~empty].mean()
            for axis, count in enumerate(start.values.shape):
                pairs = _neighbours(start.values.shape, axis)
                pairs = pairs[empty[pairs].any(axis=1)]
                edges.append(pairs)
                stiffness.append(np.full(len(pairs), variance * (count - 1) ** 2 / max(span, 1e-300)))
        return cls(PULL * curvature, start.values.ravel(), np.concatenate(edges), np.concatenate(stiffness))


def _neighbours(shape: Sequence[int], axis: int) -> Int:
    """Return the pairs of neighbours along an axis."""
    lines = np.moveaxis(np.arange(np.prod(shape, dtype=int)).reshape(shape), axis, 0)
    return np.stack([lines[:-1].ravel(), lines[1:].ravel()], axis=-1)


@dataclass(frozen=True, eq=False)
class Restrained:
    """Roughness, and the restraints of all tables together."""

    roughness: Roughness | MovingRoughness
    steps: Roughness  # rows of the first differences
    weights: Float  # Float[values], 0 where there is no pull
    toward: Float  # Float[values]

    def cost(self, values: Float) -> float:
        pull = float(self.weights @ (values - self.toward) ** 2)
        return self.roughness.cost(values) + self.steps.cost(values) + pull

    def add(self, values: Float, gradient: Float, matrix: Float) -> None:
        """Add half the gradient and the matrix of the penalty, in place."""
        self.roughness.add(values, gradient, matrix)
        self.steps.add(values, gradient, matrix)
        gradient += self.weights * (values - self.toward)
        matrix[np.diag_indices_from(matrix)] += self.weights

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Return residuals and Jacobian rows whose squares are the penalty."""
        pulled = np.flatnonzero(self.weights)
        roots = self.weights[pulled] ** 0.5
        jacobian = np.zeros((pulled.size, values.size))
        jacobian[np.arange(pulled.size), pulled] = roots
        parts = [
            self.roughness.rows(values),
            self.steps.rows(values),
            (roots * (values - self.toward)[pulled], jacobian),
        ]
        residuals, jacobians = zip(*parts, strict=True)
        return np.concatenate(residuals), np.vstack(jacobians)


Penalty = Roughness | MovingRoughness | Restrained


def penalty_of(
    parameters: ParameterSet,
    values: ValueLayout,
    smoothness: Mapping[str, tuple[float, ...]],
    restraints: Mapping[str, Restraint],
) -> Penalty:
    """Return the roughness of the free parameters with these factors, and the restraints by table."""
    roughness = roughness_of(parameters, values, smoothness)
    if not restraints:
        return roughness
    weights, toward = np.zeros(values.free), np.zeros(values.free)
    columns, coefficients = [], []
    for name, restraint in restraints.items():
        at = values.offsets[name]
        part = slice(at, at + restraint.weights.size)
        weights[part], toward[part] = restraint.weights, restraint.toward
        columns.append(at + restraint.edges[:, [0, 1, 1]])
        coefficients.append(restraint.stiffness[:, None] ** 0.5 * [1.0, -1.0, 0.0])
    steps = Roughness(values.free, np.concatenate(columns), np.concatenate(coefficients))
    return Restrained(roughness, steps, weights, toward)
