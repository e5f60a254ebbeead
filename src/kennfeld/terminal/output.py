"""Print lines on stdout and findings on stderr; lay out tables of text to fit the terminal."""

import json
import os
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from errno import EIO, EPIPE
from itertools import zip_longest
from shutil import get_terminal_size
from typing import TextIO

from kennfeld.base.errors import Finding, Location, is_plain, visible

COLUMN_GAP = "  "
MAX_FINDINGS = 20  # that are printed at once
SEVERITIES = ("error", "warning", "remark")
_NARROWEST = 30  # characters of a column whose cells are folded
UNLIMITED_WIDTH = 10_000  # characters, without a terminal


class Painted(str):
    """A line with our own colour codes, in which control characters of names are escaped already."""

    __slots__ = ()


_quiet: list[bool] = []  # not empty within `quiet`; threads print, too, so that it is not a context variable


@contextmanager
def quiet() -> Iterator[None]:
    """Within its block, print only warnings and errors."""
    _quiet.append(True)
    try:
        yield
    finally:
        _quiet.pop()


def is_quiet() -> bool:
    """Return whether only warnings and errors are printed."""
    return bool(_quiet)


def print_lines(*lines: str) -> None:
    """Print lines on stdout, unless quiet."""
    if not is_quiet():
        _print(sys.stdout, lines)


def print_values(*lines: str) -> None:
    """Print lines on stdout that would be lost otherwise."""
    _print(sys.stdout, lines)


def print_progress(line: str) -> None:
    """Print a line on stderr, unless quiet."""
    if not is_quiet():
        _print(sys.stderr, [line])


def print_findings(*problems: Finding | str) -> None:
    """Print problems on stderr, each in one line, followed by its excerpt; no remarks if quiet.

    Of very many, the first ones are printed, errors before warnings, and how many more there are.
    """
    findings = [each if isinstance(each, Finding) else Finding(Location(), each) for each in problems]
    findings = [each for each in findings if not (is_quiet() and each.severity == "remark")]
    if len(findings) > MAX_FINDINGS:
        # sorting is stable: findings of one severity stay in the order of the file
        findings.sort(key=lambda each: SEVERITIES.index(each.severity))
    for finding in findings[:MAX_FINDINGS]:
        print_always(finding)
    if len(findings) > MAX_FINDINGS:
        _print(sys.stderr, [f"and {len(findings) - MAX_FINDINGS} more"])


def findings_json(findings: Iterable[Finding]) -> str:
    """Return findings as JSON: a list of severity, file, line, column, path, message, remedy and excerpt."""
    rows = [
        {
            "severity": each.severity,
            **{key: getattr(each.location, key) for key in ("file", "line", "column", "path")},
            **{key: getattr(each, key) for key in ("message", "remedy", "excerpt")},
        }
        for each in findings
    ]
    return json.dumps({"findings": rows}, indent=2, ensure_ascii=False)


def print_always(finding: Finding) -> None:
    """Print a finding on stderr, also a remark if quiet."""
    prefix = "" if finding.severity == "error" else f"{finding.severity}: "
    excerpt = finding.excerpt.split("\n") if finding.excerpt else []
    _print(sys.stderr, [prefix + str(finding).replace("\n", " "), *(f"    {text}" for text in excerpt)])


def _print(stream: TextIO, lines: Iterable[str]) -> None:
    """Print lines with any content.

    Control characters become escapes, and characters that the stream cannot encode become question marks. A reader or
    terminal that has gone is not an error.
    """
    encoding = stream.encoding or "utf-8"
    text = "".join(f"{line if isinstance(line, Painted) else visible(line)}\n" for line in lines)
    try:
        stream.write(text.encode(encoding, errors="replace").decode(encoding))
        stream.flush()
    except OSError as error:
        # EPIPE: the reader of a pipe has ended; EIO: the terminal has closed
        if error.errno not in (EPIPE, EIO):
            raise
        # what is still buffered would raise once more at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def align(rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Return the lines of a table, columns of numbers aligned right; one block per row if it exceeds the width.

    >>> for line in align([("dataset", "RMSE"), ("bench", "1.75"), ("fresh", "12.1")]):
    ...     print(line)
    dataset  RMSE
    bench    1.75
    fresh    12.1
    >>> align([("dataset", "RMSE"), ("bench", "1.75")], width=10)
    ['dataset  bench', 'RMSE     1.75']
    """
    rows = [row if is_plain("".join(row)) else _escaped(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    if sum(widths) + len(COLUMN_GAP) * (len(widths) - 1) > (width or get_terminal_size((UNLIMITED_WIDTH, 24)).columns):
        return _blocks(rows)
    numeric = [all(map(_is_number, column)) for column in zip(*rows[1:], strict=True)] or [False] * len(widths)
    padded = COLUMN_GAP.join(f"{{:{'>' if right else '<'}{wide}}}" for wide, right in zip(widths, numeric, strict=True))
    return [padded.format(*row).rstrip() for row in rows]


def fold(rows: Sequence[Sequence[str]], width: int) -> list[list[str]]:
    """Return the rows of a table with long cells in several rows, so that lines of the table have `width` characters.

    Words stay whole, so that paths can be copied.

    >>> fold([("name", "inputs"), ("Gas", "speed, load, ignition, temperature")], 36)
    [['name', 'inputs'], ['Gas', 'speed, load, ignition,'], ['', 'temperature']]
    """
    columns = [*zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    words = [max((len(word) for cell in column for word in cell.split()), default=0) for column in columns]
    room = width - len(COLUMN_GAP) * (len(widths) - 1)
    while sum(widths) > room:
        wide = [at for at, each in enumerate(widths) if each > max(words[at], _NARROWEST)]
        if not wide:
            break
        widest = max(wide, key=lambda at: widths[at])
        # not below the next wide column, which then shares what is left
        least = max((widths[at] for at in wide if at != widest), default=0)
        own = max(room - sum(widths) + widths[widest], min(least, widths[widest] - 1))
        widths[widest] = max(own, words[widest], _NARROWEST)
    parts = ([wrap_words(cell, wide) for cell, wide in zip(row, widths, strict=True)] for row in rows)
    return [list(cells) for row in parts for cells in zip_longest(*row, fillvalue="")]


def wrap_words(text: str, width: int, indent: str = "") -> list[str]:
    """Return the lines of a text, broken between words; all but the first begin with `indent`."""
    if len(text) <= width:
        return [text]
    return textwrap.wrap(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _escaped(row: Sequence[str]) -> list[str]:
    # a line break in a cell would break the row of a table
    return [visible(cell).replace("\n", "\\u000a") for cell in row]


def _blocks(rows: Sequence[Sequence[str]]) -> list[str]:
    heading, *others = rows
    wide = max(map(len, heading))
    return separate(
        [f"{name.ljust(wide)}{COLUMN_GAP}{cell}" for name, cell in zip(heading, row, strict=True)] for row in others
    )


def separate(blocks: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of all blocks, with an empty line between two of them."""
    return [line for block in blocks for line in ("", *block)][1:]


def _is_number(cell: str) -> bool:
    try:
        # an empty cell does not make a column one of texts
        float(cell.rstrip("%") or 0)
    except ValueError:
        return False
    return True
