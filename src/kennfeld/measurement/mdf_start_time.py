"""The start time in the header of MDF files: what their time stamps count from."""

from datetime import UTC, datetime, timedelta, timezone
from typing import NamedTuple

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LOCAL, _WITH_OFFSETS = 1, 2  # flags
_SECOND = 10**9  # ns


class HeaderTime(NamedTuple):
    """The start time as the header of MDF 4 has it: in ns since 1970, offsets in minutes, and flags.

    Writers compute the nanoseconds by floating point, so that they are rounded to microseconds here.

    >>> HeaderTime.of(datetime(2026, 3, 1, 12, tzinfo=UTC)).start_time
    datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.timezone.utc)
    """

    nanoseconds: int
    zone: int = 0
    daylight: int = 0
    flags: int = 0

    @classmethod
    def of(cls, start: datetime) -> "HeaderTime":
        """Return the fields of a start time: local time without a time zone; none before 1970, which has no number."""
        offset = start.utcoffset()
        nanoseconds = (start.replace(tzinfo=start.tzinfo or UTC) - _EPOCH) // timedelta(microseconds=1) * 1000
        if nanoseconds < 0:
            return cls(0)
        if offset is None:
            return cls(nanoseconds, flags=_LOCAL)
        return cls(nanoseconds, offset // timedelta(minutes=1), flags=_WITH_OFFSETS)

    @property
    def start_time(self) -> datetime | None:
        """The start time; None if the header states none."""
        if self.nanoseconds == 0:
            return None
        try:
            utc = _EPOCH + timedelta(microseconds=(self.nanoseconds + 500) // 1000)
            if self.flags & _LOCAL:
                return utc.replace(tzinfo=None)
            offset = timedelta(minutes=self.zone + self.daylight if self.flags & _WITH_OFFSETS else 0)
            return utc.astimezone(timezone(offset) if offset else UTC)
        except (ValueError, OverflowError):  # a damaged header
            return None


def start_time_of_texts(date: bytes, time: bytes, nanoseconds: int) -> datetime | None:
    """Return the start time of MDF 2 and 3, a local time: `31:12:2026`, `23:59:59`, and ns since 1970 if not 0.

    >>> start_time_of_texts(b"01:03:2026", b"12:00:00", 250_000_000)
    datetime.datetime(2026, 3, 1, 12, 0, 0, 250000)
    """
    try:
        whole = datetime.strptime(f"{date.decode('ascii')} {time.decode('ascii')}", "%d:%m:%Y %H:%M:%S")
    except (ValueError, UnicodeDecodeError):
        return None
    # the texts have whole seconds, the nanoseconds their fraction, which may round up to the next second
    return whole.replace(microsecond=min((nanoseconds % _SECOND + 500) // 1000, 999_999))
