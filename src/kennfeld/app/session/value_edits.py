"""Edits of values as operations, which are applied in the order in which they were made.

An operation says what is done, not what comes of it: steps that follow each other faster than the model is computed add
up, and edits that are made during a run are applied to its values.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter

DIGITS = 12  # of the result of arithmetic, so that 0.1 added ten times is 1


def require_cells(table: Parameter, cells: Sequence[int]) -> None:
    """Raise `ArgumentError` unless a table has values with these numbers."""
    if not all(0 <= cell < table.size for cell in cells):
        raise ArgumentError(f"{table.name} has {table.size} values, none with the number {max(cells)}")


@dataclass(frozen=True)
class ValueEdit:
    """An edit of values of a parameter.

    Attributes:
        name: the parameter.
        cells: numbers of the values in C order.
        title: what is done, for the history.
        kind: set the values, add an amount to them, or multiply them by it.
        values: the values that are set.
        amount: what is added, or the factor.
        drag: edits of one drag are one entry of the history; of those that wait, the last one counts.
    """

    name: str
    cells: Sequence[int]
    title: str
    kind: Literal["set", "add", "scale"] = "set"
    values: Sequence[float] = ()
    amount: float = 0.0
    drag: str = ""

    def apply(self, table: Parameter) -> Float:
        """Return all values of a table after the edit.

        Raises:
            ArgumentError: the table has fewer values, or the number of values that are set is another one.
        """
        require_cells(table, self.cells)
        cells = np.array(self.cells, dtype=np.int64)
        if self.kind == "set" and len(self.values) != cells.size:
            raise ArgumentError(f"{cells.size} values of {self.name} are set, {len(self.values)} are given")
        values = table.values.ravel().copy()
        values[cells] = self._changed(values[cells])
        return values.reshape(table.values.shape)

    def _changed(self, before: Float) -> Float:
        if self.kind == "set":
            return np.array(self.values, dtype=np.float64)
        after = before + self.amount if self.kind == "add" else before * self.amount
        return np.array([float(f"{value:.{DIGITS}g}") for value in after.tolist()])

    def joined(self, following: "ValueEdit") -> "ValueEdit | None":
        """Return one edit in place of this and a following one, None if both stay."""
        same = (self.name, self.cells, self.kind) == (following.name, following.cells, following.kind)
        if self.drag and self.drag == following.drag:
            return following
        if same and self.kind == "add" and not self.drag:
            return replace(following, amount=self.amount + following.amount)
        return None
