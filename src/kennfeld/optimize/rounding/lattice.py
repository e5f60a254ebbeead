"""The storable values around a fit as whole numbers, with the cost of moving to them, bounds and rows of limits.

A whole number n stands for the value slope * n + offset; the fit lies at real numbers, the `centre`. What a move costs
is the squared change of the scored outputs, d'Hd with the Gauss-Newton matrix H of the data: the fit is the best
estimate there is, and what remains of its gradient under limits and roughness would lead after the noise. A pull
towards the fit is added, for values that these data hardly see, but others may.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.storage import StorageGrid, StorageRounding
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows

PULL = 0.03  # of the mean diagonal
SLACK = 1e-9  # of a step, or of the size of a row's terms, that is rounding


@dataclass(frozen=True)
class GridBlock:
    """Free values that share a grid: those of a parameter, or the breakpoints of an axis."""

    name: str
    places: Int  # Int[values], among the free values
    grid: StorageGrid


def grid_blocks(problem: Problem, layout: ValueLayout, rounding: StorageRounding) -> list[GridBlock]:
    """Return the blocks of free values that are rounded."""
    blocks = []
    for name in problem.free_names:
        if name in rounding.grids and problem.parameters[name].kind != "rbf":
            places = layout.offsets[name] + np.arange(problem.parameters[name].size)
            blocks.append(GridBlock(name, places, rounding.grids[name]))
    for key, axis in problem.free_axes.items():
        first = layout.moving.get(key, layout.free)
        if key in rounding.axes and first < layout.free:
            blocks.append(GridBlock(str(key), first + np.arange(len(axis.axis)), rounding.axes[key]))
    return blocks


@dataclass(frozen=True, eq=False)
class Lattice:
    """The values of a fit that are rounded.

    Attributes:
        fit: all free values, Float[free].
        blocks: those with a grid.
        places: the numbers of those that are rounded, Int[size].
        slope: the change of each value by one step, Float[size].
        centre: the fit, in steps, Float[size].
        lower, upper: whole numbers within the bounds and the largest shift, Float[size].
        rows: limits of the whole numbers; equalities have the room that storage needs.
    """

    fit: Float
    blocks: Sequence[GridBlock]
    places: Int
    slope: Float
    centre: Float
    lower: Float
    upper: Float
    rows: LinearRows

    @classmethod
    def of(cls, fit: Float, blocks: Sequence[GridBlock], limits: LinearLimits, max_shift: float) -> "Lattice":
        """Return the lattice around a fit that keeps `limits`; values without a storable one within bounds stay."""
        slope, centre = np.ones(fit.size), fit.copy()
        least, most = np.full(fit.size, np.inf), np.full(fit.size, -np.inf)
        for block in blocks:
            at = block.places
            slope[at], centre[at] = block.grid.slope, block.grid.positions(fit[at])
            least[at], most[at] = block.grid.range_within(limits.lower[at], limits.upper[at])
        places = np.flatnonzero(limits.movable & (least <= most))
        low, high, here = least[places], most[places], centre[places]
        nearest = np.clip(np.rint(here), low, high)
        # bounds may leave only values farther away than the largest shift, of which the nearest is taken
        lower = np.minimum(np.maximum(low, np.ceil(here - max_shift - SLACK)), nearest)
        upper = np.maximum(np.minimum(high, np.floor(here + max_shift + SLACK)), nearest)
        rows = _rows_in_steps(limits.rows.restricted_to(places, fit), fit[places], slope[places], here)
        rows = _within_reach(rows, lower, upper)
        return cls(fit, blocks, places, slope[places], here, lower, upper, rows)

    def without(self, left_out: Bool) -> "Lattice":
        """Return the lattice without some values, Bool[size], which stay at the fit.

        They must be all those of the rows that they are in.
        """
        kept = np.flatnonzero(~left_out)
        rows = self.rows.restricted_to(kept, self.centre)
        parts = ("places", "slope", "centre", "lower", "upper")
        return replace(self, rows=rows, **{name: getattr(self, name)[kept] for name in parts})

    @property
    def size(self) -> int:
        """Number of values that are rounded."""
        return self.places.size

    @property
    def nearest(self) -> Float:
        """The nearest whole numbers within the bounds, Float[size]."""
        return np.clip(np.rint(self.centre), self.lower, self.upper)

    def values(self, numbers: Float) -> Float:
        """Return all free values, Float[free], with those of whole numbers, Float[size], exactly as they are stored."""
        whole = np.full(self.fit.size, np.nan)
        whole[self.places] = numbers
        values = self.fit.copy()
        for block in self.blocks:
            stored = block.grid.values(whole[block.places])
            values[block.places] = np.where(np.isnan(stored), values[block.places], stored)
        return values

    def in_steps(self, matrix: Sparse) -> Sparse:
        """Restrict a matrix over all free values to these, in units of their steps; shape (size, size)."""
        from scipy.sparse import diags_array

        scale = diags_array(self.slope)
        return (scale @ matrix.tocsr()[self.places][:, self.places] @ scale).tocsr()

    def pulled(self, matrix: Sparse) -> Sparse:
        """Add the pull towards the fit to a matrix in steps."""
        from scipy.sparse import eye_array

        mean = float(matrix.diagonal().mean()) if self.size else 0.0
        # without any information, the pull alone rounds to the nearest
        return (matrix + (PULL * mean or 1.0) * eye_array(self.size)).tocsr()


def violated_rows(lattice: Lattice, numbers: Float) -> Bool:
    """Mark the rows that whole numbers, Float[size], violate, Bool[rows]."""
    product = lattice.rows.times(numbers)
    return np.asarray((product < lattice.rows.lower) | (product > lattice.rows.upper))


def _rows_in_steps(rows: LinearRows, fit: Float, slope: Float, centre: Float) -> LinearRows:
    """Return rows over values as rows over whole numbers, with room for rounding errors unless they are equalities."""
    if not rows.count:
        return rows
    constant = rows.times(fit - slope * centre)
    sides = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in (rows.lower, rows.upper)]
    room = np.where(rows.equal, 0.0, SLACK * (rows.size(fit) + np.maximum(*sides)))
    lower, upper = rows.lower - constant - room, rows.upper - constant + room
    return LinearRows(rows.columns, rows.coefficients * slope[rows.columns], lower, upper, rows.names)


def _within_reach(rows: LinearRows, lower: Float, upper: Float) -> LinearRows:
    """Widen equalities as far as storage requires: a pin between two storable values, or beyond the last one."""
    equal = np.flatnonzero(rows.equal)
    room = np.zeros(rows.count)
    for row in equal:
        used = np.flatnonzero(rows.coefficients[row])
        factors, columns, value = rows.coefficients[row, used], rows.columns[row, used], rows.lower[row]
        if used.size == 1:
            closest = np.clip(np.rint(value / factors), lower[columns], upper[columns])
            room[row] = float(np.abs(factors * closest - value)[0])
        else:
            # of several values, one step of that with the smallest factor decides
            room[row] = 0.5 * float(np.abs(factors).min())
    size = rows.size(np.maximum(np.abs(lower), np.abs(upper))) + np.abs(np.where(rows.equal, rows.lower, 0.0))
    room[equal] += SLACK * size[equal]
    return replace(rows, lower=rows.lower - room, upper=rows.upper + room)


def matrix_of(rows: LinearRows, size: int) -> Sparse:
    """Return the rows as a sparse matrix, shape (rows, size)."""
    from scipy.sparse import csr_array

    numbers = np.repeat(np.arange(rows.count), rows.columns.shape[1] if rows.count else 0)
    entries = (rows.coefficients.ravel(), (numbers, rows.columns.ravel()))
    # entries that fill up a row are zeros in a column of their own or of another entry; equal places are added
    matrix = csr_array(entries, shape=(rows.count, size))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
