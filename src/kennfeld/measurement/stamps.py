"""Dates and times of day that a table holds as text."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from kennfeld.arrays import Float

__all__ = ["is_stamp", "stamps"]

_DAY = 86_400.0
_STAMP = re.compile(
    r"\s*(?:(?P<date>(?P<y>\d{4})[-/](?P<m>\d\d?)[-/](?P<d>\d\d?)"
    r"|(?P<d2>\d\d?)\.(?P<m2>\d\d?)\.(?P<y2>\d{4}))(?:[T ,]+|$))?"
    r"(?:(?P<h>\d{1,2}):(?P<min>\d\d)(?::(?P<s>\d\d)(?P<part>[.,:]\d{1,9})?)?)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*"
)


def is_stamp(cell: object) -> bool:
    """Whether a cell is a date, or a time of day with seconds, or both.

    >>> is_stamp("12:00:00,5"), is_stamp("2024-02-01T12:00:00Z"), is_stamp("01.02.2024"), is_stamp("12:00")
    (True, True, True, False)
    """
    return isinstance(cell, str) and _seconds(cell) is not None


def stamps(cells: Sequence[object], origin: int | None = None) -> tuple[Float, int | None] | None:
    """Seconds since the day `origin` (that of the first date by default) and that day; None where a cell is no stamp.

    An empty cell is NaN. Times without a date count from midnight, and on over the next one.

    >>> stamps(["01.02.2024 12:00:00", "02.02.2024 00:00:00,5"])
    (array([43200. , 86400.5]), 738917)
    """
    found = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        if not isinstance(cell, str):
            return None
        if not cell.strip():
            continue
        seconds = _seconds(cell)
        if seconds is None:
            return None
        day, within = seconds
        if day is not None:
            origin = day if origin is None else origin
            within += (day - origin) * _DAY
        found[k] = within
    return found, origin


def _seconds(cell: str) -> tuple[int | None, float] | None:
    """The day, if there is one, and the seconds of the day."""
    match = _STAMP.fullmatch(cell)
    if match is None or (match["date"] is None and match["s"] is None):
        return None
    hours, minutes, whole = (int(match[part] or 0) for part in ("h", "min", "s"))
    if (hours > 23 and match["date"]) or minutes > 59 or whole > 60:
        return None
    seconds = 3600.0 * hours + 60.0 * minutes + float(f"{whole}.{(match['part'] or '.0')[1:]}") - _offset(match["zone"])
    if match["date"] is None:
        return None, seconds
    year, month, day = (int(match[part] or match[f"{part}2"]) for part in ("y", "m", "d"))
    try:
        return date(year, month, day).toordinal(), seconds
    except ValueError:
        return None


def _offset(zone: str | None) -> float:
    if not zone or zone == "Z":
        return 0.0
    sign = -1.0 if zone[0] == "-" else 1.0
    return sign * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:]))
