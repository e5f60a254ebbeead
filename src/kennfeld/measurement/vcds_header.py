"""Head of the logs of VCDS (VAG-COM), which has several rows of names, and a time stamp for each group of channels.

Measuring blocks: a row of groups, one or two rows of names (`Absolute Pres.` above `(specified)`), and the units in the
row of `STAMP`. Single channels: a row of identifiers (`Loc. IDE00021`), names in the row of `STAMP`, units below it.
"""

import re
from collections.abc import Sequence

from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.unit_text import looks_like_unit, plain_unit

_SIGNATURE = re.compile(r"VCID:|VCDS|VAG-?COM", re.IGNORECASE)
_STAMPS = frozenset(
    ("time", "stamp", "zeit", "stempel", "zeitstempel", "czas", "zapisu", "temps", "tempo", "tiempo", "tijd", "čas")
)
_IDENTIFIER = re.compile(r"Loc\.|(?:IDE|MAS|ENG)\d{4,}")
_MOST_ROWS = 14  # that the head of a log has


def find_vcds_header(rows: Sequence[Sequence[str]], decimal: Decimal) -> Header | None:
    """Return the head of a VCDS log; None if the rows are not one.

    The time columns are named `time`, `time_2` and so on; each belongs to the channels after it.
    """
    head = rows[:_MOST_ROWS]
    stamped = [k for k, row in enumerate(head) if sum(_is_stamp(cell) for cell in row)]
    if not stamped:
        return None
    words = {cell.strip().casefold() for row in stamped for cell in rows[row] if _is_stamp(cell)}
    signed = any(_SIGNATURE.search(cell) for row in head[: stamped[0]] for cell in row)
    # `TIME` above `STAMP` are as certain as the name of the program
    if not (signed or words >= {"time", "stamp"}):
        return None
    first, last = stamped[0], stamped[-1]
    clocks = sorted({k for row in stamped for k, cell in enumerate(rows[row]) if _is_stamp(cell)})
    data = next((k for k in range(last + 1, len(rows)) if _is_number(rows[k], clocks[0], decimal)), None)
    if data is None:
        return None
    labels = [row for row in rows[_first_label(rows, first) : data] if any(map(str.strip, row))]
    width = max(map(len, labels))
    units = labels.pop() if len(labels) > 1 and _are_units(labels[-1]) else []
    names = [_name_of(labels, column) for column in range(width)]
    for number, column in enumerate(clocks, start=1):
        names[column] = "time" if number == 1 else f"time_{number}"
    unit_of = [plain_unit(_cell(units, column)) for column in range(width)]
    for column in clocks:
        unit_of[column] = "s"
    names[: clocks[0]] = [""] * clocks[0]  # the column of markers
    _drop_empty_groups(names, clocks)
    return Header(last, data, tuple(unique_names(names)), tuple(unit_of), staggered=True)


def _first_label(rows: Sequence[Sequence[str]], stamped: int) -> int:
    """Return the first row of names: the one right above the time stamps, if it is not that of the groups."""
    above = rows[stamped - 1] if stamped else ()
    # `Group A:`, `'003`, `G003` or `F0`
    is_groups = any(re.search(r"[A-Z]:\s*$|^'\d+|^[GF]\d+$", cell.strip()) for cell in above)
    return stamped if is_groups or not any(map(str.strip, above)) else stamped - 1


def _name_of(labels: Sequence[Sequence[str]], column: int) -> str:
    """Return the name of a channel, which may run over two rows; its identifier if it has no other."""
    parts = [" ".join(_cell(row, column).split()) for row in labels]
    words = [part for part in parts if part and not _is_stamp(part)]
    return " ".join(word for word in words if not _IDENTIFIER.match(word)) or " ".join(words)


def _drop_empty_groups(names: list[str], clocks: Sequence[int]) -> None:
    """Remove the name of a time column without channels: that of a group that is not running."""
    for column, end in zip(clocks, [*clocks[1:], len(names)], strict=True):
        if not any(names[column + 1 : end]):
            names[column] = ""


def _are_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: most of its words are known ones."""
    words = [cell.strip() for cell in row[1:] if cell.strip() and not _is_stamp(cell)]  # the first column is `Marker`
    return bool(words) and 2 * sum(map(_looks_like_unit, words)) >= len(words)


def _looks_like_unit(word: str) -> bool:
    return looks_like_unit(word.lstrip("/*")) or (len(word) <= 6 and word[0] in "/*°")


def _is_stamp(cell: str) -> bool:
    return cell.strip().casefold() in _STAMPS


def _is_number(row: Sequence[str], column: int, decimal: Decimal) -> bool:
    cell = _cell(row, column)
    return bool(cell) and any(map(str.isdigit, cell)) and parse_number(cell, decimal) is not None


def _cell(row: Sequence[str], column: int) -> str:
    return row[column].strip() if column < len(row) else ""
