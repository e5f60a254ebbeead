"""Bounds and linear rows that the values keep at every iterate."""

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class LinearRows:
    """Linear limits `lower <= A p <= upper`; equal sides make an equality. Each row of A touches few values.

    `names` are labels of the rows for messages.
    """

    columns: Int  # Int[rows, width]
    coefficients: Float  # Float[rows, width]; rows that touch fewer are filled up with zeros
    lower: Float  # Float[rows]
    upper: Float  # Float[rows]
    names: tuple[str, ...] = ()

    @classmethod
    def none(cls) -> "LinearRows":
        return cls(np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)), np.zeros(0), np.zeros(0))

    @classmethod
    def of(cls, matrix: Float, lower: Float, upper: Float, names: Sequence[str] = ()) -> "LinearRows":
        """Convert the rows of a full matrix, Float[rows, values], and their sides, Float[rows]."""
        width = int(np.count_nonzero(matrix, axis=1).max(initial=0))
        # non-zeros first, in their order; narrower rows are filled up with columns of zeros
        columns = np.argsort(matrix == 0, axis=1, kind="stable")[:, :width]
        return cls(columns, np.take_along_axis(matrix, columns, axis=1), lower, upper, tuple(names))

    @classmethod
    def together(cls, parts: "Sequence[LinearRows]") -> "LinearRows":
        """Concatenate groups of rows."""
        parts = [part for part in parts if part.count]
        if not parts:
            return cls.none()
        width = max(part.columns.shape[1] for part in parts)
        pads = [((0, 0), (0, width - part.columns.shape[1])) for part in parts]
        return cls(
            np.concatenate([np.pad(part.columns, pad) for part, pad in zip(parts, pads, strict=True)]),
            np.concatenate([np.pad(part.coefficients, pad) for part, pad in zip(parts, pads, strict=True)]),
            np.concatenate([part.lower for part in parts]),
            np.concatenate([part.upper for part in parts]),
            tuple(name for part in parts for name in part.names),
        )

    @property
    def count(self) -> int:
        """Number of rows."""
        return self.lower.size

    @property
    def equal(self) -> Bool:
        """Mask of the equalities, Bool[rows]."""
        return np.asarray(self.lower == self.upper)

    def times(self, values: Float) -> Float:
        """Compute A p, Float[rows], for values p, Float[values]."""
        return np.asarray(np.einsum("ij,ij->i", self.coefficients, values[self.columns]))

    def size(self, values: Float) -> Float:
        """Compute |A| |p|, the size of the terms of each row, Float[rows]."""
        return np.asarray(np.einsum("ij,ij->i", np.abs(self.coefficients), np.abs(values)[self.columns]))

    def touching(self, values: Float, tolerance: float) -> Bool:
        """Mark rows at one of their sides or beyond, Bool[rows]; the tolerance is relative to the `size` of a row."""
        product, slack = self.times(values), tolerance * self.size(values)
        return np.asarray((product <= self.lower + slack) | (product >= self.upper - slack))

    def matrix(self, which: Int, values: int) -> Float:
        """Expand some rows of A to a full matrix, Float[rows, values]."""
        full = np.zeros((which.size, values))
        # added, as what fills up a row may be in the column of one of its entries
        np.add.at(full, (np.arange(which.size)[:, None], self.columns[which]), self.coefficients[which])
        return full

    def restricted_to(self, movable: Int, values: Float) -> "LinearRows":
        """Restrict the rows to movable values, Int[movable], with the others fixed; rows without any are dropped."""
        place = np.full(values.size, -1)
        place[movable] = np.arange(movable.size)
        columns = place[self.columns]
        moves = columns >= 0
        # what the fixed values contribute goes to the sides
        constant = np.einsum("ij,ij->i", np.where(moves, 0.0, self.coefficients), values[self.columns])
        coefficients = np.where(moves, self.coefficients, 0.0)
        kept = (coefficients != 0).any(axis=1)
        lower, upper = (self.lower - constant)[kept], (self.upper - constant)[kept]
        names = tuple(name for name, keep in zip(self.names, kept, strict=False) if keep)
        return LinearRows(np.where(moves, columns, 0)[kept], coefficients[kept], lower, upper, names)


@dataclass(frozen=True)
class LinearLimits:
    """Bounds on each value, `lower <= p <= upper`, and linear rows.

    `tables` is the number of the table of each value, so that a row has the scale of its table even if a value is near
    zero; without it all values belong to one table.
    """

    lower: Float  # Float[values]
    upper: Float  # Float[values]
    rows: LinearRows = field(default_factory=LinearRows.none)
    tables: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # Int[values], or empty

    @classmethod
    def none(cls, size: int) -> "LinearLimits":
        """Return no limits on `size` values."""
        return cls(np.full(size, -np.inf), np.full(size, np.inf))

    @property
    def movable(self) -> Bool:
        """Mask of the values that may change, Bool[values]."""
        return self.lower < self.upper

    def clip(self, values: Float) -> Float:
        """Clip values, Float[values], to their bounds."""
        return np.asarray(values.clip(self.lower, self.upper))

    def violations(self, values: Float, size: Float) -> Float:
        """Compute the violation of each row, Float[rows], relative to its scale for values of this typical size."""
        rows = self.rows
        sides = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in (rows.lower, rows.upper)]
        # a row of values at 0 with sides of 0 has no scale of its own
        scale = rows.size(size) + np.maximum(*sides) + 1e-300
        product = rows.times(values)
        return np.asarray(np.maximum(np.maximum(rows.lower - product, product - rows.upper), 0.0) / scale)

    def violation(self, values: Float) -> float:
        """Find the largest of the `violations`, for values, Float[values], of the size of their tables."""
        return float(np.max(self.violations(values, self.sizes(values)), initial=0.0))

    def keeps(self, values: Float) -> bool:
        """Return True if all rows hold exactly for values, Float[values]."""
        if not self.rows.count:
            return True
        product = self.rows.times(values)
        return bool(((product >= self.rows.lower) & (product <= self.rows.upper)).all())

    def sizes(self, values: Float) -> Float:
        """Find for each value the largest magnitude in its table, Float[values]."""
        if not self.tables.size:
            return np.full(values.size, np.abs(values).max(initial=0.0))
        largest = np.zeros(int(self.tables.max()) + 1)
        np.maximum.at(largest, self.tables, np.abs(values))
        return np.asarray(largest[self.tables])

    def restricted_to(self, movable: Int, values: Float) -> "LinearLimits":
        """Restrict the limits to the movable values, Int[movable], with the others fixed, Float[values]."""
        tables = self.tables[movable] if self.tables.size else self.tables
        rows = self.rows.restricted_to(movable, values)
        return LinearLimits(self.lower[movable], self.upper[movable], rows, tables)
