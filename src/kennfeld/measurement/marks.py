"""Markers that somebody set, or the logger, while it recorded."""

import re
from collections.abc import Sequence

__all__ = ["KEPT", "is_mark", "marks_detail"]

KEPT = 12  # markers that a description quotes

_MARK = re.compile(r'\s*"?MARK\s+\d+\b')


def is_mark(line: str, separator: str) -> bool:
    r"""Whether a line of a text log is a marker, as TunerStudio writes them among the rows.

    >>> is_mark("MARK 003 - Manual - Sun Aug 16", "\t"), is_mark("MARK 003\t1\t2", "\t")
    (True, False)
    """
    return _MARK.match(line) is not None and (separator == " " or separator not in line)


def marks_detail(marks: Sequence[tuple[float | None, str]], count: int) -> tuple[tuple[str, str], ...]:
    """What `kennfeld info` says of markers: the first ones, with their time in s where it is known.

    >>> marks_detail([(0.5, "MARK 000 - Manual"), (None, "MARK 001")], 3)
    (('markers', '3 (MARK 000 - Manual at 0.5 s; MARK 001; ...)'),)
    """
    if not count:
        return ()
    said = [text if time is None else f"{text} at {time:.6g} s" for time, text in marks[:KEPT]]
    more = ["..."] if count > len(said) else []
    return (("markers", f"{count} ({'; '.join(said + more)})"),)
