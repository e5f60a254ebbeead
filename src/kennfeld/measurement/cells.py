"""Parsing of single table cells: numbers, gaps, dates of spreadsheets, text."""

import re
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float

Decimal = Literal[".", ",", ".,"]  # the last one: a point, beside commas that separate thousands

# as spreadsheets, C runtimes and loggers write that there is no value
MISSING = (
    "", "-", "--", "---", "*", "**", "***", "****", "?", "??", "???", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "#na",
    "null", "none", "n.a.", "#value!", "#div/0!", "#ref!", "#num!", "#name?", "#null!", "no data", "nodata", "no value",
    "not available", "nan(ind)", "-nan(ind)", "+nan(ind)", "nan(snan)", "-nan(snan)", "1.#qnan", "-1.#qnan", "1.#snan",
    "-1.#snan", "1.#ind", "-1.#ind", "1.#nan",
)  # fmt: skip
TRUTH = {"true": 1.0, "on": 1.0, "false": 0.0, "off": 0.0}

_GAPS = frozenset(MISSING)
_ENDLESS = {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in ("inf", "infinity", "1.#inf")}
# a series of marks; the digits that a C runtime adds; a NaN with its bits
_MARKS = re.compile(r"[-*?#_]+|[+-]?1[.,]#(?:q?nan|snan|ind)0*|[+-]?nan\([\w]*\)")
_SEPARATED = "'\u2019\u00a0\u202f "  # thousands, in numbers with either decimal mark
_NUMBER: dict[str, re.Pattern[str]] = {
    ".": re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?(?:[0-9]+(?:,[0-9]+)?|[0-9]{1,3}(?:\.[0-9]{3})+,[0-9]+|,[0-9]+)(?:[eE][+-]?[0-9]+)?"),
}
_NUMBER[".,"] = _NUMBER["."]
_APART = rf"[+-]?[1-9][0-9]{{0,2}}(?:(?P<mark>[{_SEPARATED}])[0-9]{{3}})(?:(?P=mark)[0-9]{{3}})*"
# numbers whose thousands are separated, as far as that is certain
_GROUPED: dict[str, re.Pattern[str]] = {
    # `1,234` may have a decimal comma; `1,234.5` cannot
    ".": re.compile(rf"(?:{_APART}|[+-]?[1-9][0-9]{{0,2}}(?:,[0-9]{{3}})+(?=\.))(?:\.[0-9]*)?"),
    ",": re.compile(rf"(?:{_APART}|[+-]?[1-9][0-9]{{0,2}}(?:\.[0-9]{{3}})+)(?:,[0-9]*)?"),
    ".,": re.compile(rf"(?:{_APART}|[+-]?[1-9][0-9]{{0,2}}(?:,[0-9]{{3}})+)(?:\.[0-9]*)?"),
}
EPOCH = datetime(1970, 1, 1)  # spreadsheets know no time zones
_FIRST_DAY = datetime(1899, 12, 31)  # that spreadsheets count from; times of 24 h and more are dates of 1900 in them


def parse_number(cell: object, decimal: Decimal = ".") -> float | None:
    """Parse a cell: NaN for a gap, seconds for a date or a duration, None for text.

    >>> parse_number("1,5", ","), parse_number("on"), parse_number("-"), parse_number("rpm")
    (1.5, 1.0, nan, None)
    """
    if isinstance(cell, str):
        return _parse_text(cell.strip(), decimal)
    if cell is None:
        return np.nan
    if isinstance(cell, int | float):
        return float(cell)
    return _seconds(cell)


def _parse_text(text: str, decimal: Decimal) -> float | None:
    if _NUMBER[decimal].fullmatch(text):
        return float(text.replace(".", "").replace(",", ".") if decimal == "," else text)
    if _GROUPED[decimal].fullmatch(text):
        whole, _, fraction = text.partition("," if decimal == "," else ".")
        return float(re.sub(r"[^\d+-]", "", whole) + "." + (fraction or "0"))
    folded = text.casefold()
    if folded in _GAPS or _MARKS.fullmatch(folded):
        return np.nan
    # C runtimes fill `1.#INF` up with zeros to the digits of the format
    return TRUTH.get(folded, _ENDLESS.get(folded.replace(",", ".").rstrip("0") if "#" in folded else folded))


def _seconds(cell: object) -> float | None:
    if isinstance(cell, date):
        instant = cell.replace(tzinfo=None) if isinstance(cell, datetime) else datetime.combine(cell, time())
        return (instant - (_FIRST_DAY if is_long_time(cell) else EPOCH)).total_seconds()
    if isinstance(cell, time):
        return cell.hour * 3600.0 + cell.minute * 60.0 + cell.second + cell.microsecond / 1e6
    return cell.total_seconds() if isinstance(cell, timedelta) else None


def is_long_time(cell: object) -> bool:
    """Return whether a date of a spreadsheet is a time of 24 h and more whose format has no days.

    >>> is_long_time(datetime(1900, 1, 1, 0, 0, 1)), is_long_time(datetime(2026, 1, 1))
    (True, False)
    """
    return isinstance(cell, date) and cell.year <= 1900


def is_dated(cell: object) -> bool:
    """Return whether the cell holds a date, a time of day or a duration."""
    return isinstance(cell, date | time | timedelta)


def is_truth(cell: object) -> bool:
    """Return whether the cell holds the state of a switch: `on`, `OFF`, `true`, or a truth value.

    >>> is_truth("OFF"), is_truth(0)
    (True, False)
    """
    return isinstance(cell, bool) or (isinstance(cell, str) and cell.strip().casefold() in TRUTH)


def is_missing(cell: object) -> bool:
    """Return whether the cell is a gap.

    >>> is_missing("#N/A"), is_missing(0)
    (True, False)
    """
    if not isinstance(cell, str):
        return cell is None
    folded = cell.strip().casefold()
    return folded in _GAPS or _MARKS.fullmatch(folded) is not None


def parse_numbers(cells: Sequence[object], decimal: Decimal = ".") -> tuple[Float, list[int]]:
    """Parse a run of cells: their numbers, Float[cells], NaN if there is none, and the positions that hold text.

    >>> parse_numbers(["1", "", "rpm"])
    (array([ 1., nan, nan]), [2])
    """
    plain = _parse_quickly(cells, decimal)
    if plain is not None:
        return plain, []
    values = [parse_number(cell, decimal) for cell in cells]
    texts = [i for i, value in enumerate(values) if value is None]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64), texts


def _parse_quickly(cells: Sequence[object], decimal: Decimal) -> Float | None:
    """Return all cells by `float` alone, or None if they need a closer look.

    Python accepts 1_000 as a number, and a point is not a decimal comma: such cells need the exact parser.
    """
    if set(map(type, cells)) <= {float, int, bool}:
        return np.array(cells, dtype=np.float64)
    try:
        # one search of the joined text instead of one in each cell
        joined = "\n".join(cells)  # type: ignore[arg-type]  # a cell that is no text raises TypeError
        if "_" in joined or (decimal == "," and "." in joined):
            return None
        plain = joined.replace(",", ".").split("\n") if decimal == "," else cells
        return np.fromiter(map(float, plain), np.float64, len(cells))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def quote_cell(cell: object, limit: int = 40) -> str:
    """Return the cell as an error message quotes it.

    >>> quote_cell("rpm")
    "'rpm'"
    """
    text = str(cell).strip()
    return repr(text if len(text) <= limit else text[: limit - 3] + "...")
