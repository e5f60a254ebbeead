"""The lookups of one table in one dataset, sorted by cell, so that those near a grid point are found at once."""

from collections.abc import Iterable, Iterator
from functools import reduce
from itertools import product

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.quality.lookup_coverage import Lookup, cell_shape


class LookupIndex:
    """The lookups of a table whose coordinates are known.

    Args:
        table: the table.
        lookups: its lookups over the samples of a dataset, block by block.
    """

    def __init__(self, table: Parameter, lookups: Iterable[Lookup]) -> None:
        self._table, axes = table, len(table.index_axes)
        # 32 bits each: number and shares of a lookup of a map take 12 bytes
        samples, cells = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        shares = [np.zeros((axes, 0), np.float32)]
        for lookup in lookups:
            known = slice(None) if lookup.known.all() else np.flatnonzero(lookup.known)
            samples.append(np.arange(lookup.first, lookup.first + lookup.known.size, dtype=np.int32)[known])
            cells.append(lookup.cell[known].astype(np.int32))
            shares.append(np.array([share[known] for share in lookup.shares], np.float32))
        cell = np.concatenate(cells)
        # numbers of at most 16 bits are sorted by their digits, which takes a tenth of the time
        order = np.argsort(cell.astype(np.min_scalar_type(int(np.prod(cell_shape(table))))), kind="stable")
        self._samples, self._shares = np.concatenate(samples)[order], np.concatenate(shares, axis=1)[:, order]
        # lookups of cell c are those from _ends[c] to before _ends[c + 1]
        self._ends = np.searchsorted(cell[order], np.arange(int(np.prod(cell_shape(table))) + 1))

    def near(self, value: int, reach: int) -> tuple[Int, Float, Float]:
        """Find the lookups in at most `reach` cells on each side of a grid point.

        Args:
            value: number of the grid point in C order.
            reach: 1 for the cells that touch it.

        Returns:
            Sample numbers, Int[lookups]; coordinates, Float[axes, lookups]; the weight of the grid point in each.
        """
        if not self._samples.size:  # of a scalar, or of a table that no criterion depends on
            return np.zeros(0, np.int64), np.zeros((len(self._table.index_axes), 0)), np.zeros(0)
        center = np.unravel_index(value, self._table.values.shape)
        ranges = [
            np.arange(max(int(at) - reach, 0), min(int(at) + reach, count))
            for at, count in zip(center, cell_shape(self._table), strict=True)
        ]
        chosen = [grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij")]
        flat = np.ravel_multi_index(chosen, cell_shape(self._table))
        begins, sizes = self._ends[flat], np.diff(self._ends)[flat]
        # all positions in the ranges begins to begins + sizes, without a loop over cells
        where = np.repeat(begins - np.append(0, np.cumsum(sizes)[:-1]), sizes) + np.arange(sizes.sum())
        places, weights = [], []
        for cell, share, at, axis in zip(chosen, self._shares, center, self._table.index_axes, strict=True):
            here, part = np.repeat(cell, sizes), share[where].astype(np.float64)
            places.append(_coordinate(axis.breakpoints, here, part))
            # multilinear: 1 - share if the grid point begins the cell along this axis, share if it ends it, else 0
            weights.append(np.where(here == at, 1.0 - part, np.where(here == at - 1, part, 0.0)))
        return self._samples[where].astype(np.int64), np.array(places), reduce(np.multiply, weights)

    def places(self, most: int) -> Float:
        """Return the coordinates of at most so many lookups, evenly spread over the cells, Float[axes, lookups]."""
        count = self._samples.size
        chosen = np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)
        flat = np.searchsorted(self._ends, chosen, side="right") - 1
        cells = np.unravel_index(flat, cell_shape(self._table))
        axes = zip(self._table.index_axes, cells, self._shares, strict=True)
        return np.array([_coordinate(axis.breakpoints, cell, share[chosen]) for axis, cell, share in axes])

    def sums(self, values: Float) -> tuple[Float, Float]:
        """Sum for each grid point the values with its weight in each lookup, and these weights.

        Args:
            values: by sample, Float[samples]; NaN does not count.

        Returns:
            Float[grid points] each, in C order.
        """
        own = values[self._samples]
        known = np.isfinite(own)
        weighted, weight = (np.zeros(self._table.size) for _ in range(2))
        for points, sums in self._corner_sums(np.where(known, own, 0.0)):
            weighted[points] += sums
        for points, sums in self._corner_sums(known.astype(np.float64)):
            weight[points] += sums
        return weighted, weight

    def _corner_sums(self, values: Float) -> Iterator[tuple[Int, Float]]:
        """Yield for each corner of the cells its grid points, and the values summed with their weights by cell."""
        # a corner of all cells is the grid without its last or its first points along each axis
        grid = np.arange(self._table.size).reshape(self._table.values.shape)
        for corner in product((0, 1), repeat=len(self._shares)):
            points = grid[tuple(slice(c, c + n) for c, n in zip(corner, cell_shape(self._table), strict=True))].ravel()
            if not points.size:  # an axis of one breakpoint has no upper corner
                continue
            part = values
            for side, share in zip(corner, np.clip(self._shares, 0.0, 1.0), strict=True):
                part = part * (share if side else 1.0 - share)
            # sums by cell, as the lookups are sorted by cell
            yield points, np.diff(np.append(0.0, np.cumsum(part))[self._ends])

    def weights(self, value: int, samples: int) -> Float:
        """Return the weight of a grid point in each of so many samples; with several lookups the largest."""
        weight = np.zeros(samples)
        at, _, shares = self.near(value, 1)
        np.maximum.at(weight, at, shares)
        return weight


def _coordinate(breakpoints: Float, cell: Int, share: Float) -> Float:
    following = np.minimum(cell + 1, breakpoints.size - 1)
    place: Float = breakpoints[cell] + share * (breakpoints[following] - breakpoints[cell])
    return place
