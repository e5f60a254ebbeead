"""Dates and times of day as text: ISO, German and US order, names of months, 12-hour clocks.

`03/04/2026` is the third of April or the fourth of March. `StampCollector` reads a column in both orders and decides at
its end: a part above 12 is not a month, the header may state the order, and time increases. If that leaves both, a
doubt says so.
"""

import re
from collections.abc import Sequence
from dataclasses import field
from datetime import UTC, date, datetime
from functools import lru_cache

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.cells import is_missing

_DAY = 86_400.0
_HALF_DAY = 43_200.0
_HOUR = 3600.0
_MONTH_NAMES = ("jan", "feb", "mar|mär|mrz", "apr", "may|mai", "jun", "jul", "aug", "sep", "oct|okt", "nov", "dec|dez")
_MONTHS = {name: number for number, names in enumerate(_MONTH_NAMES, start=1) for name in names.split("|")}
# 2026-3-31, 20260331T, 31.3.2026, 3/4/2026 in either order, 31-Mar-2026
_DATE = (
    r"(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)"
    r"|(?P<y1>\d{4})(?P<m1>\d\d)(?P<d1>\d\d)(?=[T ]\d\d)"
    r"|(?P<d2>\d\d?)\.(?P<m2>\d\d?)\.(?P<y2>\d{4})"
    r"|(?P<a>\d\d?)(?P<mark>[-/])(?P<b>\d\d?)(?P=mark)(?P<y3>\d{4})"
    r"|(?P<d4>\d\d?)[- ](?P<month>[^\W\d_]{3,9})\.?[- ](?P<y4>\d{4})"
)
_EITHER = re.compile(r"\b\d\d?([-/])\d\d?\1\d{4}")  # a date whose order shows in the data alone
# an order that a header states: MM/DD/YYYY, dd-mm-yyyy, TT/MM/JJJJ
_ORDERS = (
    (re.compile(r"\bmm?[-/]dd?\b", re.IGNORECASE), True),
    (re.compile(r"\b[dtj]{1,2}[-/]mm?\b", re.IGNORECASE), False),
)
_ISO = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d(?:[.,]\d{1,9})?)Z?")
_STAMP = re.compile(
    rf"\s*(?:(?P<date>{_DATE})(?:[T ,]+|$))?"
    r"(?:(?P<h>\d{1,2}):(?P<min>\d\d)(?::(?P<s>\d\d)(?P<part>[.,:]\d{1,9})?)?(?:\s*(?P<half>[AP])\.?M\.?)?"
    r"|(?P<h1>\d\d)(?P<min1>\d\d)(?P<s1>\d\d)(?P<part1>[.,]\d{1,9})?)?"
    r"\s*(?P<zone>Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?\s*",
    re.IGNORECASE,
)
_ZONE = re.compile(r"(?:Z|UTC|GMT|:\d\d(?:[.,]\d+)?\s*[+-]\d\d(?::?\d\d)?)\s*$", re.IGNORECASE)
# what spreadsheets leave of a time of day, as their format of it has no hours
_MINUTES = re.compile(r"\s*(?P<min>\d{1,4}):(?P<s>[0-5]\d[.,]\d{1,9})\s*")
# as pandas writes them: 1 days 02:03:04.5, -1 days +23:59:59; and by ISO 8601: P1DT2H3M4.5S
_DURATION = re.compile(
    r"\s*(?P<days>[+-]?\d+) days?,?(?:\s+\+?(?P<h>\d{1,2}):(?P<min>\d\d):(?P<s>\d\d(?:[.,]\d{1,9})?))?\s*",
    re.IGNORECASE,
)
_ISO_DURATION = re.compile(
    r"\s*(?P<sign>[+-]?)P(?:(?P<days>\d+)D)?(?:T(?:(?P<h>\d+)H)?(?:(?P<min>\d+)M)?(?:(?P<s>\d+(?:[.,]\d+)?)S)?)?\s*"
)


def is_stamp(cell: object) -> bool:
    """Return whether a cell is a date, or a time of day with seconds, or both.

    >>> is_stamp("12:00:00,5"), is_stamp("2024-02-01T12:00:00Z"), is_stamp("01.02.2024"), is_stamp("12:00")
    (True, True, True, False)
    >>> is_stamp("11-Nov-2026 10:15:30.123"), is_stamp("11/25/2026 3:04:05 PM"), is_stamp("25/25/2026")
    (True, True, False)
    """
    return isinstance(cell, str) and any(_stamp_seconds(cell, month_first) is not None for month_first in (False, True))


def parse_stamps(
    cells: Sequence[object], origin: int | None = None, *, month_first: bool = False
) -> tuple[Float, int | None] | None:
    """Parse cells as seconds since the day `origin`, Float[cells], and that day; None for other text.

    The day, by default that of the first date, is a proleptic Gregorian ordinal.

    A missing cell is NaN. Times without a date count from midnight.

    >>> parse_stamps(["01.02.2024 12:00:00", "02.02.2024 00:00:00,5"])
    (array([43200. , 86400.5]), 738917)
    """
    values = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        if not isinstance(cell, str):
            return None
        seconds = _stamp_seconds(cell, month_first)
        if seconds is None:
            if is_missing(cell):
                continue
            return None
        day, within = seconds
        if day is not None:
            origin = day if origin is None else origin
            within += (day - origin) * _DAY
        values[k] = within
    return values, origin


def stated_order(header: str) -> bool | None:
    """Return whether the header of a column states that the month comes first; None if it states no order.

    >>> stated_order("Time [MM/DD/YYYY hh:mm:ss]"), stated_order("Date (dd-mm-yyyy)"), stated_order("Date")
    (True, False, None)
    """
    return next((order for pattern, order in _ORDERS if pattern.search(header)), None)


@dataclass
class StampCollector:
    """The stamps of one column, block by block, in both orders of day and month as long as both are possible."""

    month_first: bool | None = None  # as the header states it
    _blocks: dict[bool, list[Float]] = field(default_factory=lambda: {False: [], True: []})  # by month_first
    _origins: dict[bool, int | None] = field(default_factory=lambda: {False: None, True: None})
    _only_minutes: bool = True  # all times are minutes and seconds
    _example: str = ""  # a date that reads either way
    doubt: str = ""  # what the data leave open, once `build` was called
    origin_doubt: str = ""  # the same of `origin` alone
    origin: datetime | None = None  # the midnight that `build` counts from; None if there are no dates

    def extend(self, values: Float) -> None:
        """Take a block of values, Float[cells], that holds no stamps."""
        for blocks in self._blocks.values():
            blocks.append(values)

    def add(self, cells: Sequence[object]) -> bool:
        """Take a block of stamps; return False, and take nothing, if a cell is another text."""
        parsed = {order: parse_stamps(cells, self._origins[order], month_first=order) for order in self._orders(cells)}
        if not any(parsed.values()):
            return False
        # an order that was not parsed reads the same as the other
        parsed |= {order: parsed[next(iter(parsed))] for order in self._blocks if order not in parsed}
        for order, stamps in parsed.items():
            # a cell that an order cannot read rules it out for the whole column
            if stamps is None:
                del self._blocks[order]
            else:
                self._blocks[order].append(stamps[0])
                self._origins[order] = stamps[1]
        if self._only_minutes:
            self._only_minutes = all(is_missing(cell) or _MINUTES.fullmatch(str(cell)) for cell in cells)
        self._example = self._example or next((str(cell) for cell in cells if not is_missing(cell)), "")
        return True

    def _orders(self, cells: Sequence[object]) -> list[bool]:
        """Return the orders in which to parse a block; one is enough if they read the same."""
        orders = list(self._blocks)
        is_either = self._origins.get(False) != self._origins.get(True) or _EITHER.search("\n".join(map(str, cells)))
        return orders if is_either else orders[:1]

    def build(self) -> Float:
        """Return all stamps in s, Float[cells]; times of day continue across midnight, minutes across the hour."""
        orders = {order: np.concatenate(blocks) for order, blocks in self._blocks.items()}
        order = self._choose_order(orders)
        values = orders[order]
        day = self._origins[order]
        if day is not None:
            self.origin = datetime.fromordinal(day).replace(tzinfo=UTC if _ZONE.search(self._example) else None)
        else:
            values = continued(values, _HOUR if self._only_minutes else _DAY)
        return values

    def _choose_order(self, orders: dict[bool, Float]) -> bool:
        """Return whether the month comes first: the order in which time does not fall, else the shorter recording."""
        if len(orders) == 1:
            return next(iter(orders))
        if self.month_first is not None:
            return self.month_first
        elapsed = {order: _elapsed(values) for order, values in orders.items()}
        if np.array_equal(elapsed[False], elapsed[True], equal_nan=True):
            # within one day both orders count the same seconds, but from the midnight of another day
            if self._origins[False] != self._origins[True]:
                self.origin_doubt = self._doubt(month_first=False)
            return False
        rising = [order for order, values in elapsed.items() if np.all(np.diff(values[~np.isnan(values)]) >= 0)]
        if len(rising) == 1:
            return rising[0]
        order = float(np.nanmax(np.abs(elapsed[True]))) < float(np.nanmax(np.abs(elapsed[False])))
        self.doubt = self._doubt(month_first=order)
        return order

    def _doubt(self, *, month_first: bool) -> str:
        name = "month/day" if month_first else "day/month"
        return f"dates such as {self._example.strip()[:40]} read either way; {name} is assumed"


def continued(values: Float, period: float = _DAY) -> Float:
    """Return times of day in s, Float[samples], that go on across midnight: a fall by half the period begins the next.

    >>> continued(np.array([86399.0, np.nan, 0.0, 1.0]))
    array([86399.,    nan, 86400., 86401.])
    """
    known = np.flatnonzero(~np.isnan(values))
    result = values.copy()
    result[known] += period * np.cumsum(np.diff(values[known], prepend=values[known[:1]]) < -period / 2)
    return result


def _elapsed(values: Float) -> Float:
    known = values[~np.isnan(values)]
    return values - (known[0] if known.size else 0.0)


def _stamp_seconds(cell: str, month_first: bool) -> tuple[int | None, float] | None:
    """Return the day, if there is one, and the seconds of the day."""
    plain = _ISO.fullmatch(cell)
    if plain is not None:  # the usual stamp of large files
        day, hours, minutes = _ordinal(*plain.group(1, 2, 3)), int(plain[4]), int(plain[5])
        seconds = float(plain[6].replace(",", "."))
        is_time = day is not None and hours < 24 and minutes < 60 and seconds < 61.0
        return (day, 3600.0 * hours + 60.0 * minutes + seconds) if is_time else None
    match = _STAMP.fullmatch(cell)
    if match is None or (match["date"] is None and match["s"] is None):
        elapsed = _elapsed_seconds(cell)
        return None if elapsed is None else (None, elapsed)
    hours, minutes, whole = (int(match[part] or match[f"{part}1"] or 0) for part in ("h", "min", "s"))
    if match["half"]:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + (12 if match["half"] in "pP" else 0)
    # an elapsed time may pass 24 hours, a time of day beside a date may not
    if (hours > 23 and match["date"]) or minutes > 59 or whole > 60:
        return None
    seconds = (
        3600.0 * hours
        + 60.0 * minutes
        + float(f"{whole}.{(match['part'] or match['part1'] or '.0')[1:]}")
        - _offset(match["zone"])
    )
    if match["date"] is None:
        return None, seconds
    try:
        return date(*_date_of(match, month_first)).toordinal(), seconds
    except ValueError:
        return None


def _elapsed_seconds(cell: str) -> float | None:
    """Return the seconds of minutes and seconds, or of a duration."""
    match = _MINUTES.fullmatch(cell)
    if match is not None:
        return 60.0 * int(match["min"]) + _decimal(match["s"])
    match = _DURATION.fullmatch(cell) or _ISO_DURATION.fullmatch(cell)
    if match is None or not any(match[part] for part in ("days", "h", "min", "s")):
        return None
    within = 3600.0 * int(match["h"] or 0) + 60.0 * int(match["min"] or 0) + _decimal(match["s"])
    seconds = _DAY * int(match["days"] or 0) + within
    return -seconds if match.groupdict().get("sign") == "-" else seconds


def _decimal(seconds: str | None) -> float:
    return float((seconds or "0").replace(",", "."))


@lru_cache(maxsize=64)  # the stamps of a file share few days
def _ordinal(year: str, month: str, day: str) -> int | None:
    try:
        return date(int(year), int(month), int(day)).toordinal()
    except ValueError:
        return None


def _date_of(match: re.Match[str], month_first: bool) -> tuple[int, int, int]:
    """Return year, month and day; the month is 0 if its name is unknown."""
    if match["y"]:
        return int(match["y"]), int(match["m"]), int(match["d"])
    if match["y1"]:
        return int(match["y1"]), int(match["m1"]), int(match["d1"])
    if match["y2"]:
        return int(match["y2"]), int(match["m2"]), int(match["d2"])
    if match["y4"]:
        return int(match["y4"]), _MONTHS.get(match["month"][:3].casefold(), 0), int(match["d4"])
    first, second = int(match["a"]), int(match["b"])
    return (int(match["y3"]), first, second) if month_first else (int(match["y3"]), second, first)


def _offset(zone: str | None) -> float:
    if not zone or zone[0] not in "+-":
        return 0.0
    sign = -1.0 if zone[0] == "-" else 1.0
    return sign * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[3:].lstrip(":") or 0))
