"""Penalties on tables: roughness, and restraints of values that neither data nor smoothness determine.

Roughness is the mean square of second differences along each axis. It is quadratic in the values if the breakpoints are
fixed. If they are free, the same differences depend on values and breakpoints, with exact derivatives for both.

If only the product of two tables is measured, one can grow while the other shrinks: a slight pull towards the start
resolves that. Grid points without data follow a straight line or a twisted plane through the others, however steep: a
penalty on differences between neighbours flattens them. Both are too weak to matter at grid points with data.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import key_of
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.cholesky import Cholesky
from kennfeld.native.symmetric import SymmetricMatrix, add_entries, scaled
from kennfeld.optimize.problem.roughness_rows import roughness_rows

PULL = 1e-4  # of the curvature of the data
PASSES = 4  # reduce the bias of a direction with the curvature of the data by 1e16, and move one with 1e-6 of it by 4 %
EMPTY = 1e-2  # of the mean curvature of a table: a value below it has no data

Factors = Mapping[str, Sequence[float]]


def _lines(table: Parameter, axis: int) -> Int:
    """Return the flat numbers of the values along an axis, Int[points, lines]."""
    return np.moveaxis(np.arange(table.size).reshape(table.values.shape), axis, 0).reshape(len(table.axes[axis]), -1)


def _triples(table: Parameter, axis: int) -> Int:
    """Return the flat numbers of three neighbours along an axis, Int[points - 2, lines, 3]."""
    lines = _lines(table, axis)
    return np.stack([lines[i : max(len(lines) - 2, 0) + i] for i in range(3)], axis=-1)


@dataclass(frozen=True)
class Roughness:
    """The penalty sum S R over all tables: the sum of squares of rows of a few values each.

    A row of fewer values names one of them twice.
    """

    size: int
    columns: Int  # Int[rows, entries]
    coefficients: Float  # Float[rows, entries]

    @classmethod
    def of(cls, parameters: ParameterSet, values: ValueLayout, smoothness: Factors) -> "Roughness":
        """Return the penalty of the free parameters with these factors, one per axis."""
        columns, coefficients = [np.zeros((0, 3), dtype=np.int64)], [np.zeros((0, 3))]
        if not any(map(any, smoothness.values())):
            return cls(values.free, columns[0], coefficients[0])
        for name, factors in smoothness.items():
            at = values.offsets.get(name, values.free)
            for axis, factor in enumerate(factors):
                if factor > 0 and at < values.free:
                    breakpoints = parameters[name].axes[axis].breakpoints
                    along = roughness_rows(breakpoints)
                    entries = along.points.shape[1]
                    points = np.moveaxis(_lines(parameters[name], axis)[along.points], 1, 2)  # rows, lines, entries
                    # roots of 1 / N and of the factor, as rows are squared
                    rows = along.coefficients[:, None, :] / np.sqrt(float(breakpoints.size)) * factor**0.5
                    columns.append(at + points.reshape(-1, entries))
                    coefficients.append(np.broadcast_to(rows, points.shape).reshape(-1, entries))
        entries = max(part.shape[1] for part in columns)
        return cls(
            values.free,
            np.concatenate([np.pad(part, ((0, 0), (0, entries - part.shape[1])), "edge") for part in columns]),
            np.concatenate([np.pad(part, ((0, 0), (0, entries - part.shape[1]))) for part in coefficients]),
        )

    def _differences(self, values: Float) -> Float:
        return np.asarray(np.einsum("ij,ij->i", self.coefficients, values[self.columns]))

    def cost(self, values: Float) -> float:
        if not self.columns.size:
            return 0.0
        differences = self._differences(values)
        return float(differences @ differences)

    def add(self, values: Float, gradient: Float, matrix: SymmetricMatrix) -> None:
        """Add half the gradient, Float[values], and the matrix [values, values] of the penalty, in place."""
        gradient += self.slope(values)
        rows, columns, entries = self.nonzeros
        add_entries(matrix, rows, columns, entries)

    def slope(self, values: Float) -> Float:
        """Return half the gradient of the penalty, Float[values]."""
        slopes = self.coefficients * self._differences(values)[:, None]
        return np.bincount(self.columns.ravel(), slopes.ravel(), minlength=self.size).astype(np.float64)

    @cached_property
    def nonzeros(self) -> tuple[Int, Int, Float]:
        """Rows, columns and values of the entries of the matrix of the penalty, shape (entries,) each."""
        places = self.columns[:, :, None] * self.size + self.columns[:, None, :]
        products = self.coefficients[:, :, None] * self.coefficients[:, None, :]
        # sums over rows that share a pair of values
        distinct, at = np.unique(places, return_inverse=True)
        entries = np.bincount(at.ravel(), products.ravel(), minlength=distinct.size).astype(np.float64)
        rows, columns = np.divmod(distinct.astype(np.int64), max(self.size, 1))
        return rows, columns, entries

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[rows, values], whose squares are the penalty."""
        if not self.columns.size:
            return np.zeros(0), np.zeros((0, self.size))
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
                    grid = _triples(parameters[name], axis) + values.offsets[name]
                    count, inner = parameters[name].values.shape[axis], len(grid)
                    points = np.hstack([np.arange(inner)[:, None] + [0, 1, 2], np.tile([0, count - 1], (inner, 1))])
                    points = points[:, None, :] + values.moving[key_of(parameters[name], axis)]
                    rows = np.concatenate([grid, np.broadcast_to(points, (*grid.shape[:2], 5))], axis=2).reshape(-1, 8)
                    columns.append(rows)
                    weights.append(np.full(len(rows), (factor / count) ** 0.5))
                    counts.append(np.full(len(rows), count - 1.0))
        return cls(fixed, np.concatenate(columns), np.concatenate(weights), np.concatenate(counts))

    def _linear(self, values: Float) -> tuple[Float, Float]:
        """Return the rows and their derivatives Float[rows, 8]."""
        z1, z2, z3, x1, x2, x3, first, last = values[self.columns].T
        left, right, both = x2 - x1, x3 - x2, x3 - x1
        rise_left, rise_right = (z2 - z1) / left, (z3 - z2) / right
        # c, which moves with the ends of the axis
        spacing = (last - first) / self.counts
        unit = 2 * self.weights * spacing**2 / both
        row = unit * (rise_right - rise_left)
        # derivative of c^2 by the last breakpoint, and its negative by the first
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

    def add(self, values: Float, gradient: Float, matrix: SymmetricMatrix) -> None:
        """Add half the gradient, Float[values], and the Gauss-Newton matrix of the penalty, in place."""
        self.fixed.add(values, gradient, matrix)
        row, slopes = self._linear(values)
        np.add.at(gradient, self.columns, slopes * row[:, None])
        # Gauss-Newton: second derivatives of the rows by breakpoints are left out
        products = slopes[:, :, None] * slopes[:, None, :]
        rows, columns = np.broadcast_arrays(self.columns[:, :, None], self.columns[:, None, :])
        add_entries(matrix, rows.ravel(), columns.ravel(), products.ravel())

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[rows, values], whose squares are the penalty."""
        residual, above = self.fixed.rows(values)
        row, slopes = self._linear(values)
        jacobian = np.zeros((row.size, values.size))
        np.add.at(jacobian, (np.arange(row.size)[:, None], self.columns), slopes)
        return np.concatenate([residual, row]), np.vstack([above, jacobian])


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
    def of(cls, toward: Float, values: Float, curvature: Float, variance: float) -> "Restraint":
        """Return the restraint of a table.

        A difference next to a grid point without data counts as one sample of the value 0, whose standard deviation is
        the range of the values with data over the cells of the axis.

        Args:
            toward: the values towards which the table is pulled, in its shape.
            values: its values at a fit, Float[values].
            curvature: the diagonal of the Gauss-Newton matrix there, Float[values].
            variance: the noise, as the cost of one independent sample.
        """
        empty = curvature <= EMPTY * curvature.mean()
        with_data = values[~empty]
        edges, stiffness = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)]
        if with_data.size:
            # with the variance of a value: a table that is flat where it has data would be infinitely stiff elsewhere
            span = np.ptp(with_data) ** 2 + variance / curvature[~empty].mean()
            numbers = np.arange(toward.size).reshape(toward.shape)
            for axis, count in enumerate(toward.shape):
                lines = np.moveaxis(numbers, axis, 0)
                pairs = np.stack([lines[:-1].ravel(), lines[1:].ravel()], axis=-1)
                pairs = pairs[empty[pairs].any(axis=1)]
                edges.append(pairs)
                # variance over (range / cells)^2: one sample of the difference 0 with this deviation
                stiffness.append(np.full(len(pairs), variance * (count - 1) ** 2 / max(span, 1e-300)))
        return cls(PULL * curvature, toward.ravel(), np.concatenate(edges), np.concatenate(stiffness))


def move_determined(start: Float, values: Float, gradient: Float, matrix: Float | Sparse) -> Float:
    """Move the start to where the data alone would have it, in the directions that they determine.

    A pull towards the result does not bias these directions, however many samples there are, and holds all others at
    the start. Each pass reduces the distance along a direction by the share of the pull in its curvature (iterated
    Tikhonov regularisation, M. Hanke and C. W. Groetsch, Nonstationary iterated Tikhonov regularization, 1998).

    Args:
        start: values at the start, Float[values].
        values: values at a fit, at which the data are linearised, Float[values].
        gradient: half the gradient of the data there, Float[values].
        matrix: their Gauss-Newton matrix there, Float[values, values].

    >>> data = np.array([[100.0, 100.0], [100.0, 100.0]])  # only the sum is measured, and it is 12
    >>> move_determined(np.zeros(2), np.array([9.0, 3.0]), np.zeros(2), data).round(6)
    array([6., 6.])
    """
    seen = np.flatnonzero(matrix.diagonal() > 0)
    own = matrix[np.ix_(seen, seen)] if isinstance(matrix, np.ndarray) else matrix[seen][:, seen]
    scale = 1 / np.sqrt(own.diagonal())
    factor = Cholesky(seen.size).factor(scaled(own, scale), np.full(seen.size, PULL))
    moved = start.copy()
    if factor is None:
        return moved
    for _ in range(PASSES):
        # gradient of the linearised data at the moved values
        slope = gradient[seen] + own @ (moved - values)[seen]
        moved[seen] -= scale * factor.solve(scale * slope)
    return moved


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

    def add(self, values: Float, gradient: Float, matrix: SymmetricMatrix) -> None:
        """Add half the gradient, Float[values], and the matrix [values, values] of the penalty, in place."""
        self.roughness.add(values, gradient, matrix)
        self.steps.add(values, gradient, matrix)
        gradient += self.weights * (values - self.toward)
        at = np.arange(values.size)
        add_entries(matrix, at, at, self.weights)

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Compute residuals and Jacobian, Float[rows, values], whose squares are the penalty."""
        pulled = np.flatnonzero(self.weights)
        roots = self.weights[pulled] ** 0.5
        jacobian = np.zeros((pulled.size, values.size))
        jacobian[np.arange(pulled.size), pulled] = roots
        pull = roots * (values - self.toward)[pulled], jacobian
        residuals, jacobians = zip(self.roughness.rows(values), self.steps.rows(values), pull, strict=True)
        return np.concatenate(residuals), np.vstack(jacobians)


Penalty = Roughness | MovingRoughness | Restrained


def penalty_of(
    parameters: ParameterSet,
    values: ValueLayout,
    smoothness: Factors,
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
        # three entries like rows of second differences; the last one is 0
        columns.append(at + restraint.edges[:, [0, 1, 1]])
        coefficients.append(restraint.stiffness[:, None] ** 0.5 * [1.0, -1.0, 0.0])
    steps = Roughness(values.free, np.concatenate(columns), np.concatenate(coefficients))
    return Restrained(roughness, steps, weights, toward)
