"""Tables of markdown, and numbers short enough to stand in them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

__all__ = ["Table", "megabytes", "seconds"]


@dataclass
class Table:
    """A topic's table, with the sentences that say how it was measured."""

    title: str
    columns: Sequence[str]
    rows: list[Sequence[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *cells: str) -> None:
        """A further row; cells that are left out stay empty."""
        self.rows.append([*cells, *[""] * (len(self.columns) - len(cells))])

    def __str__(self) -> str:
        rows = [[str(cell) for cell in row] for row in (self.columns, *self.rows)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(self.columns))]
        lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in rows]
        lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
        notes = [f"- {note}" for note in self.notes]
        return "\n".join([f"## {self.title}", "", *lines, "", *notes, *([""] if notes else [])])


def seconds(value: float | None) -> str:
    """A duration in s or ms.

    >>> seconds(0.01234), seconds(12.34), seconds(None)
    ('12.3 ms', '12.3 s', '-')
    """
    if value is None:
        return "-"
    return f"{value:.3g} s" if value >= 1 else f"{value * 1e3:.3g} ms"


def megabytes(value: float) -> str:
    """Bytes in MB."""
    return f"{value / 1e6:.0f} MB"
