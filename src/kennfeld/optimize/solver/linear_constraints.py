"""What the values must keep at every iterate: bounds, and linear rows between values."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float, Int

__all__ = ["LinearLimits", "LinearRows"]


@dataclass(frozen=True)
class LinearRows:
    """Linear limits `lower <= A p <= upper`; equal sides make an equality. Each row of A touches few values.

    `names` say in words what each row limits.
    """

    columns: Int  # Int[rows, width]
    coefficients: Float  # Float[rows, width]; rows that touch fewer are filled up with zeros
    lower: Float  # Float[rows]
    upper: Float  # Float[rows]
    names: tuple[str, ...] = ()

    @classmethod
    def none(cls) -> "LinearRows":
        """No rows."""
        return cls(np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)), np.zeros(0), np.zeros(0))

    @classmethod
    def of(cls, matrix: Float, lower: Float, upper: Float, names: Sequence[str] = ()) -> "LinearRows":
        """Rows of a full matrix."""
        width = int(np.count_nonzero(matrix, axis=1).max(initial=0))
        columns = np.argsort(matrix == 0, axis=1, kind="stable")[:, :width]
        return cls(columns, np.take_along_axis(matrix, columns, axis=1), lower, upper, tuple(names))

    @classmethod
    def together(cls, parts: "Sequence[LinearRows]") -> "LinearRows":
        """Several groups of rows, one after the other."""
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
        """How many rows there are."""
        return self.lower.size

    @property
    def equal(self) -> Bool:
        """Which rows are equalities."""
        equal: Bool = self.lower == self.upper
        return equal

    def times(self, values: Float) -> Float:
        """A p."""
        product: Float = np.einsum("ij,ij->i", self.coefficients, values[self.columns])
        return product

    def size(self, values: Float) -> Float:
        """|A| |p|: the size of what is summed in each row."""
        product: Float = np.einsum("ij,ij->i", np.abs(self.coefficients), np.abs(values)[self.columns])
        return product

    def matrix(self, which: Int, values: int) -> Float:
        """Some rows of A in full, shape (rows, values)."""
        full = np.zeros((which.size, values))
        np.add.at(full, (np.arange(which.size)[:, None], self.columns[which]), self.coefficients[which])
        return full

    def narrowed(self, movable: Int, values: Float) -> "LinearRows":
        """The rows as limits of the movable values, the others standing as they are; empty rows fall out."""
        place = np.full(values.size, -1)
        place[movable] = np.arange(movable.size)
        columns = place[self.columns]
        moves = columns >= 0
        held = np.einsum("ij,ij->i", np.where(moves, 0.0, self.coefficients), values[self.columns])
        coefficients = np.where(moves, self.coefficients, 0.0)
        kept = (coefficients != 0).any(axis=1)
        columns = np.where(moves, columns, 0)
        names = tuple(name for name, keep in zip(self.names, kept, strict=False) if keep)
        return LinearRows(
            columns[kept], coefficients[kept], (self.lower - held)[kept], (self.upper - held)[kept], names
        )


@dataclass(frozen=True)
class LinearLimits:
    """Bounds on each value, `lower <= p <= upper`, and linear rows.

    `tables` numbers the table of each value, so that the scale of a row is that of its table and not of a value which
    happens to be near zero; without it all values belong to one table.
    """

    lower: Float  # Float[values]
    upper: Float  # Float[values]
    rows: LinearRows = field(default_factory=LinearRows.none)
    tables: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # Int[values], or empty

    @classmethod
    def none(cls, size: int) -> "LinearLimits":
        """No limits on `size` values."""
        return cls(np.full(size, -np.inf), np.full(size, np.inf))

    @property
    def movable(self) -> Bool:
        """Which values may change."""
        return self.lower < self.upper

    def clip(self, values: Float) -> Float:
        """The values put within their bounds, bit for bit."""
        clipped: Float = np.clip(values, self.lower, self.upper)
        return clipped

    def violations(self, values: Float, size: Float) -> Float:
        """How far each row is missed, relative to its scale for values of this typical size."""
        rows = self.rows
        sides = [np.where(np.isfinite(side), np.abs(side), 0.0) for side in (rows.lower, rows.upper)]
        scale = rows.size(size) + np.maximum(*sides) + 1e-300
        product = rows.times(values)
        missed: Float = np.maximum(np.maximum(rows.lower - product, product - rows.upper), 0.0) / scale
        return missed

    def violation(self, values: Float) -> float:
        """The largest of the `violations`, for values of the size that their tables have."""
        return float(np.max(self.violations(values, self.sizes(values)), initial=0.0))

    def keeps(self, values: Float) -> bool:
        """Whether all rows hold to the last digit."""
        product = self.rows.times(values)
        return bool(np.all((product >= self.rows.lower) & (product <= self.rows.upper)))

    def sizes(self, values: Float) -> Float:
        """For each value, the largest magnitude in its table."""
        if not self.tables.size:
            return np.full(values.size, np.abs(values).max(initial=0.0))
        largest = np.zeros(int(self.tables.max()) + 1)
        np.maximum.at(largest, self.tables, np.abs(values))
        sizes: Float = largest[self.tables]
        return sizes

    def narrowed(self, movable: Int, values: Float) -> "LinearLimits":
        """The limits on the movable values, the others standing as they are."""
        rows, tables = self.rows.narrowed(movable, values), self.tables[movable] if self.tables.size else self.tables
        return LinearLimits(self.lower[movable], self.upper[movable], rows, tables)
