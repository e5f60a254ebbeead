"""Dialect of a text file: encoding, separator, decimal mark and header, detected from its first lines."""

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.header import Header, find_header
from kennfeld.measurement.table import MAX_MARKS, is_mark
from kennfeld.measurement.unit_text import looks_like_unit
from kennfeld.measurement.vcds_header import find_vcds_header

ALONE = "\x1f"  # stands for: one column, no separator
_SEPARATORS = (";", "\t", ",", "|", " ", ALONE)
# `#N/A` is a gap at the beginning of a row
_COMMENT = re.compile(r"\s*(?:#(?!n/?a\b)|//|%)", re.IGNORECASE)
_QUOTED_NUMBER = re.compile(r'"\s*[+-]?\d+(?:,\d+)+(?:\.\d*)?\s*"')  # "1,200.5", or "0,25"
_NAMES = {";": "semicolon", "\t": "tab", ",": "comma", "|": "bar", " ": "blanks", ALONE: "none"}


@dataclass(frozen=True)
class Dialect:
    """The dialect of a text file. Lines are counted from 0 here."""

    encoding: str
    separator: str
    decimal: Decimal
    decimal_seen: bool  # whether the first lines contain a number with that mark
    header: Header
    beacons: str = ""  # times at which the car passed a beacon, as AiM and MoTeC list them above the table
    repeated: frozenset[str] = frozenset()  # lines that are never rows: repeated names and units
    grouped: bool = False  # commas separate thousands beside a decimal point

    @property
    def numbers(self) -> Decimal:
        """The form of its numbers."""
        return ".," if self.grouped else self.decimal

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """Details for `kennfeld info`."""
        beacons = (("beacon markers", self.beacons),) if self.beacons else ()
        return (
            *beacons,
            ("encoding", self.encoding),
            ("separator", _NAMES[self.separator]),
            ("decimal mark", {".": "point", ",": "comma"}[self.decimal]),
            ("names in line", str(self.header.row + 1)),
        )


def is_comment(line: str) -> bool:
    """Return whether the line is a comment (#, %, //).

    >>> is_comment("# made by hand"), is_comment("#N/A;1")
    (True, False)
    """
    return _COMMENT.match(line) is not None


def split_line(line: str, separator: str) -> list[str]:
    """Return the cells of a line; quotes hold a cell together.

    >>> split_line('"Speed; [rpm]";1;', ";")
    ['Speed; [rpm]', '1', '']
    """
    if separator == " ":
        line = line.replace("\t", " ").strip()
    if '"' not in line:
        return line.split() if separator == " " else line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return line.split(separator)


@lru_cache(maxsize=8)  # a file is listed before it is read
def find_dialect(location: Location, first_lines: tuple[str, ...], encoding: str) -> Dialect:
    """Return the dialect of a file that begins with these lines; raise `InputError` if there is no table."""
    best: tuple[tuple[int, int], Dialect] | None = None
    lines = _join_cells(first_lines)
    for separator in _SEPARATORS:
        if separator == ALONE:
            if best is not None and best[0][0] >= len(lines):  # a single column has no more numbers than lines
                continue
        elif not any(separator in line for line in lines):
            continue
        rows = [[] if is_comment(line) or is_mark(line, separator) else split_line(line, separator) for line in lines]
        for decimal in _possible_decimals(separator, lines):
            rating = _rate(rows, separator, decimal, encoding, lines)
            # of equal ratings the first wins, as separators and decimal marks are tried from the likeliest on
            if rating is not None and (best is None or rating[0] > best[0]):
                best = rating
    if best is None or best[0][0] <= 0:
        raise _no_table(location, lines)
    return best[1]


def _possible_decimals(separator: str, lines: Sequence[str]) -> tuple[Decimal, ...]:
    """Return the forms that numbers between these separators may have, the likeliest first."""
    if separator == ",":
        # commas within quotes are decimal marks or separate thousands
        return (".", ".,", ",") if any(map(_QUOTED_NUMBER.search, lines)) else (".",)
    if not any("," in line for line in lines):
        return (".",)
    return (".", ",", ".,") if any("." in line for line in lines) else (".", ",")


def _join_cells(lines: Sequence[str]) -> list[str]:
    """Return the lines with each multi-line cell moved to its last line; line numbers are unchanged."""
    joined, begun = [], ""
    for i, line in enumerate(lines):
        whole = begun + line
        # a quote without a partner in the next lines is a character, or it would swallow the rest of the table
        closes = any(later.count('"') % 2 for later in lines[i + 1 : i + 5])
        begun = f"{whole} " if whole.count('"') % 2 and closes else ""
        joined.append("" if begun else whole)
    return joined


def _rate(
    rows: list[list[str]], separator: str, decimal: Decimal, encoding: str, lines: Sequence[str]
) -> tuple[tuple[int, int], Dialect] | None:
    """Rate how well the lines read with this dialect; of equal ratings the first header wins.

    Numbers count for it, text among numbers and rows of another length against it.
    """
    header = (
        find_vcds_header(rows, decimal)
        or find_header(rows, decimal)
        or _commented_header(rows, separator, decimal, lines)
    )
    if header is None:
        return None
    above = rows[: header.data]  # which a log that was restarted repeats
    data = [row for row in rows[header.data :] if any(cell.strip() for cell in row) and row not in above]
    numbers = [[None if not cell.strip() else parse_number(cell, decimal) for cell in row] for row in data]
    # NaN is a gap, which does not make its column numeric
    numeric = {i for values in numbers for i, value in enumerate(values) if value is not None and value == value}
    score, seen = 0, False
    for row, values in zip(data, numbers, strict=True):
        odd = len(row) < header.width or any(cell.strip() for cell in row[len(header.names) :])
        texts = sum(value is None and i in numeric and bool(row[i].strip()) for i, value in enumerate(values))
        score += len(values) - values.count(None) - 2 * texts - 3 * odd
        seen = seen or any(value is not None and decimal[:1] in cell for cell, value in zip(row, values, strict=True))
    repeated = frozenset(lines[header.row : header.row + 1]) - {""}
    mark: Decimal = "," if decimal == "," else "."
    grouped = decimal == ".,"
    return (score, -header.row), Dialect(encoding, separator, mark, seen, header, _beacons(above), repeated, grouped)


def _beacons(above: Sequence[Sequence[str]]) -> str:
    """Return the times of the beacons that a row above the table lists."""
    row = next((row for row in above if row and row[0].strip().casefold() == "beacon markers"), [])
    times = " ".join(row[1:]).split()
    return f"{', '.join(times[:MAX_MARKS])}{', ...' if len(times) > MAX_MARKS else ''} s" if times else ""


def _commented_header(rows: list[list[str]], separator: str, decimal: Decimal, lines: Sequence[str]) -> Header | None:
    """Return the header that a comment right above the numbers holds, as numpy writes it."""
    first = next((i for i, row in enumerate(rows) if any(cell.strip() for cell in row)), 0)
    begin = first
    while begin > max(first - 3, 0) and is_comment(lines[begin - 1]):
        begin -= 1
    above = [split_line(line.strip().lstrip("#%/").strip(), separator) for line in lines[begin:first]]
    for k in range(len(above) - 1, -1, -1):  # units may stand below the names, in a comment as well
        header = find_header([*([] for _ in range(begin + k)), *above[k:], *rows[first:]], decimal)
        if header is not None and (k == 0 or not all(map(looks_like_unit, above[k]))):
            return header
    return None


def _no_table(location: Location, lines: Sequence[str]) -> InputError:
    filled = [i for i, line in enumerate(lines, 1) if line.strip() and not is_comment(line)]
    if not filled:
        return InputError.of(location, "the file is empty", "Export the measurement again.")
    first_number = next((i for i in filled if _starts_as_number(lines[i - 1])), None)
    if first_number is not None:
        message = "the numbers have no header with channel names"
        remedy = "Put a line with the names of the channels above the numbers."
        return InputError.of(replace(location, line=first_number), message, remedy)
    few = "there are names but no row of numbers below them"
    message = few if len(filled) <= 3 else "there is no table of numbers"
    remedy = "Export the measurement again, or name another file."
    return InputError.of(replace(location, line=filled[0]), message, remedy)


def _starts_as_number(line: str) -> bool:
    first = re.split(r"[;,\t| ]", line.strip().strip('"'), maxsplit=1)[0]
    return parse_number(first.strip('"')) is not None and bool(re.search(r"\d", first))
