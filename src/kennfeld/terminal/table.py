"""Tables of text that fit the terminal."""

from collections.abc import Sequence
from shutil import get_terminal_size

from kennfeld.errors import visible

__all__ = ["aligned"]

GAP = "  "
ENDLESS = 10_000  # columns where there is no terminal


def aligned(rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Rows under their heading, numbers to the right; where they are wider than the terminal, a block a row.

    >>> for line in aligned([("dataset", "RMSE"), ("bench", "1.75"), ("fresh", "12.1")]):
    ...     print(line)
    dataset  RMSE
    bench    1.75
    fresh    12.1
    >>> aligned([("dataset", "RMSE"), ("bench", "1.75")], width=10)
    ['dataset  bench', 'RMSE     1.75']
    """
    rows = [[visible(cell).replace("\n", "\\u000a") for cell in row] for row in rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    if sum(widths) + len(GAP) * (len(widths) - 1) > (width or get_terminal_size((ENDLESS, 24)).columns):
        return _blocks(rows)
    numeric = [all(_is_number(row[i]) for row in rows[1:]) for i in range(len(rows[0]))]
    return [
        GAP.join(
            cell.rjust(wide) if right else cell.ljust(wide)
            for cell, wide, right in zip(row, widths, numeric, strict=True)
        ).rstrip()
        for row in rows
    ]


def _blocks(rows: Sequence[Sequence[str]]) -> list[str]:
    heading, *others = rows
    wide = max(len(cell) for cell in heading)
    blocks = [[f"{name.ljust(wide)}{GAP}{cell}" for name, cell in zip(heading, row, strict=True)] for row in others]
    return [line for i, block in enumerate(blocks) for line in (*([""] if i else []), *block)]


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip("%") or 0)
    except ValueError:
        return False
    return True
