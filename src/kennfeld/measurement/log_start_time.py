"""The start time in the header of logs of CAN frames: a local time."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime

_BLF_START = 40  # offset of a SYSTEMTIME: year, month, day of the week, day, hour, minute, second, millisecond
_SYSTEMTIME = struct.Struct("<8H")
_ASC_DATE = re.compile(rb"^date +\w+ +(.+?)\s*$", re.MULTILINE)
_ASC_FORMS = ("%b %d %I:%M:%S.%f %p %Y", "%b %d %I:%M:%S %p %Y", "%b %d %H:%M:%S.%f %Y", "%b %d %H:%M:%S %Y")


def blf_start_time(head: bytes) -> datetime | None:
    """Return the start time in the header of a BLF file; None if it has none."""
    if len(head) < _BLF_START + _SYSTEMTIME.size:
        return None
    year, month, _, day, hour, minute, second, millisecond = _SYSTEMTIME.unpack_from(head, _BLF_START)
    with suppress(ValueError):
        return datetime(year, month, day, hour, minute, second, 1000 * millisecond)
    return None


def asc_start_time(head: bytes) -> datetime | None:
    """Return the start time in the first line of an ASC log; None without a date with an English month.

    >>> asc_start_time(b"date Sun Mar 1 12:30:00.250 pm 2026")
    datetime.datetime(2026, 3, 1, 12, 30, 0, 250000)
    """
    match = _ASC_DATE.search(head)
    return next(_parsed(match[1].decode("ascii", errors="replace")), None) if match else None


def _parsed(text: str) -> Iterator[datetime]:
    for form in _ASC_FORMS:
        with suppress(ValueError):
            yield datetime.strptime(text, form)
