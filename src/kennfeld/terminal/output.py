"""Print lines on stdout and findings on stderr; lay out tables of text to fit the terminal."""

import math
import os
import sys
from collections.abc import Iterable, Sequence
from errno import EIO, EPIPE
from shutil import get_terminal_size
from typing import TextIO

from kennfeld.errors import Finding, visible

COLUMN_GAP = "  "
UNLIMITED_WIDTH = 10_000  # characters, without a terminal


class Painted(str):
    """A line with our own colour codes, in which control characters of names are escaped already."""

    __slots__ = ()


def print_lines(*lines: str) -> None:
    """Print lines on stdout."""
    _print(sys.stdout, lines)


def print_findings(*problems: Finding | str) -> None:
    """Print problems on stderr, each in one line, followed by its excerpt."""
    for problem in problems:
        finding = problem if isinstance(problem, Finding) else Finding("", problem)
        prefix = "" if finding.severity == "error" else f"{finding.severity}: "
        excerpt = finding.excerpt.split("\n") if finding.excerpt else []
        lines = [prefix + " ".join(str(problem).split("\n")), *(f"    {text}" for text in excerpt)]
        _print(sys.stderr, lines)


def _print(stream: TextIO, lines: Iterable[str]) -> None:
    """Print lines with any content.

    Control characters become escapes, and characters that the stream cannot encode become question marks. A reader or
    terminal that has gone is not an error.
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
    """Return the lines of a table, columns of numbers aligned right; one block per row if it exceeds the width.

    >>> for line in aligned([("dataset", "RMSE"), ("bench", "1.75"), ("fresh", "12.1")]):
    ...     print(line)
    dataset  RMSE
    bench    1.75
    fresh    12.1
    >>> aligned([("dataset", "RMSE"), ("bench", "1.75")], width=10)
    ['dataset  bench', 'RMSE     1.75']
    """
    rows = [[visible(cell).replace("\n", "\\u000a") for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    if sum(widths) + len(COLUMN_GAP) * (len(widths) - 1) > (width or get_terminal_size((UNLIMITED_WIDTH, 24)).columns):
        return _blocks(rows)
    numeric = [all(map(_is_number, column)) for column in zip(*rows[1:], strict=True)] or [False] * len(widths)
    return [
        COLUMN_GAP.join(
            cell.rjust(wide) if right else cell.ljust(wide)
            for cell, wide, right in zip(row, widths, numeric, strict=True)
        ).rstrip()
        for row in rows
    ]


def _blocks(rows: Sequence[Sequence[str]]) -> list[str]:
    heading, *others = rows
    wide = max(len(cell) for cell in heading)
    blocks = [
        [f"{name.ljust(wide)}{COLUMN_GAP}{cell}" for name, cell in zip(heading, row, strict=True)] for row in others
    ]
    return [line for i, block in enumerate(blocks) for line in (*([""] if i else []), *block)]


def _is_number(cell: str) -> bool:
    try:
        float(cell.rstrip("%") or 0)
    except ValueError:
        return False
    return True


def number_text(value: float | None) -> str:
    """Return a number with six digits, nothing if it is unknown."""
    return "" if value is None or math.isnan(value) else f"{value:.6g}"


def size_text(shape: Sequence[int]) -> str:
    """Return a shape as `18 x 14`."""
    return " x ".join(map(str, shape))
