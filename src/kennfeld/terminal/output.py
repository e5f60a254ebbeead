"""Lines on stdout and stderr, whatever these are connected to.

Tables of text that fit the terminal.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from errno import EIO, EPIPE
from shutil import get_terminal_size
from typing import TextIO

from kennfeld.errors import Finding, visible

__all__ = ["Painted", "aligned", "print_findings", "print_lines"]

GAP = "  "
ENDLESS = 10_000  # columns where there is no terminal


class Painted(str):
    """A line with codes for colours of our own; all else in it is visible already."""

    __slots__ = ()


def print_lines(*lines: str) -> None:
    """Print lines on stdout."""
    _print(sys.stdout, lines)


def print_findings(*problems: Finding | str) -> None:
    """Print problems on stderr, each in one line; the excerpt that shows the place follows below."""
    for problem in problems:
        excerpt = problem.excerpt.split("\n") if isinstance(problem, Finding) and problem.excerpt else []
        severity = problem.severity if isinstance(problem, Finding) else "error"
        line = " ".join(str(problem).split("\n"))
        _print(
            sys.stderr, [line if severity == "error" else f"{severity}: {line}", *(f"    {text}" for text in excerpt)]
        )


def _print(stream: TextIO, lines: Iterable[str]) -> None:
    """Print lines whatever they hold.

    Control characters of names become escapes, characters that the stream cannot show question marks; a reader or
    terminal that has gone is no error.
    """
    encoding = stream.encoding or "utf-8"
    shown = (line if isinstance(line, Painted) else visible(line) for line in lines)
    text = "".join(f"{line}\n" for line in shown).encode(encoding, errors="replace").decode(encoding)
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        if error.errno not in (EPIPE, EIO):
            raise
        # what is still buffered would complain once more at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


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
