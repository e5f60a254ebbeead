"""Detection of the rows of names, units and first numbers at the top of a table."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import takewhile

from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.cells import Decimal, is_dated, is_missing, parse_number
from kennfeld.measurement.stamps import is_stamp
from kennfeld.measurement.unit_text import in_seconds, is_clock, looks_like_unit, plain_unit, split_name, time_unit

Row = Sequence[object]

_LABELS = ("unit", "units", "einheit", "einheiten")  # before the units of a row
_MAX_HEADER_ROWS = 5  # above the numbers
_MIN_TABLE_ROWS = 3  # of numbers; fewer may be settings above the table
_MIN_NUMBERED = 3  # columns of a row of column numbers
_MAX_LISTED = 6  # names in a message
_MAX_BLOCK_ROWS = 10  # of numbers in a block above the table


def unique_names(names: Sequence[str]) -> list[str]:
    """Return unique names: the second `Speed` becomes `Speed (2)`; empty ones stay empty.

    >>> unique_names(["Speed", "Torque", "Speed", "", ""])
    ['Speed', 'Torque', 'Speed (2)', '', '']
    """
    taken = set(names)
    seen: set[str] = set()
    # the next number to try: n equal names would take n**2 / 2 trials otherwise
    last: dict[str, int] = {}
    unique = []
    for name in names:
        free, k = name, last.get(name, 1)
        # the second `Speed` must not become a `Speed (2)` that the file already has
        while name and (free in seen or (free != name and free in taken)):
            k += 1
            free = f"{name} ({k})"
        last[name] = k
        seen.add(free)
        unique.append(free)
    return unique


@dataclass(frozen=True)
class Header:
    """The head of a table: `row` holds the names, `data` is the first row of numbers, both counted from 0."""

    row: int
    data: int
    names: tuple[str, ...]  # empty if a column has none
    units: tuple[str, ...]
    staggered: bool = False  # groups of channels are sampled one after the other, each with its own time
    numbered: bool = False  # the row above the first one of numbers holds channel numbers
    renamed: tuple[str, ...] = ()  # columns whose names stand before them already

    @property
    def width(self) -> int:
        """Number of cells up to the last named column."""
        return max((i + 1 for i, name in enumerate(self.names) if name), default=0)


@dataclass(frozen=True)
class _Shape:
    """The columns of a row that hold numbers and text."""

    numbers: frozenset[int]
    texts: frozenset[int]
    ones: bool  # no number but 1, which may be a unit
    worded: bool  # no number but words such as `on`, which may be a name


def find_header(rows: Sequence[Row], decimal: Decimal = ".") -> Header | None:
    """Return the header of the table in these rows; None if there is no row of names above numbers.

    >>> header = find_header([["a test"], ["Speed", "Torque"], ["rpm", "Nm"], ["1000", "80"]])
    >>> header.names, header.units, header.data
    (('Speed', 'Torque'), ('rpm', 'Nm'), 3)
    """
    shapes = [_shape(row, decimal) for row in rows]
    filled = [i for i, shape in enumerate(shapes) if shape.numbers or shape.texts]
    first: tuple[Header, list[int]] | None = None
    for at, row in enumerate(filled[:-1]):
        below = _find_data(filled[at:], rows, shapes)
        if below is None:
            continue
        unit_row, data = below
        numbered = False
        if unit_row is not None and _has_time(rows[row][:1]):
            first_row = _skip_column_numbers(filled, rows, shapes, data, decimal, is_first=at == 0)
            data, numbered = first_row, first_row > data
        run = list(takewhile(lambda row: shapes[row].numbers, (row for row in filled if row >= data)))
        header = _build_header(rows, *_raise_names(rows, shapes, row, unit_row, data), data, numbered)
        # a long block, or one up to the end, is the table; a short one may be settings above it
        complete = len(run) >= _MAX_BLOCK_ROWS or run[-1] == filled[-1]
        if first is None:
            if complete:
                return header
            first = header, run
        # after settings, the next head counts, unless it is one of settings again
        elif len(first[1]) < _MIN_TABLE_ROWS and _are_settings(first[1], shapes):
            if complete or len(run) >= _MIN_TABLE_ROWS or not _are_settings(run, shapes):
                return header
        elif len(run) > len(first[1]) and _names_more_channels(header, first[0], rows, shapes):
            return header
    return first[0] if first else None


def _skip_column_numbers(
    filled: Sequence[int],
    rows: Sequence[Row],
    shapes: Sequence[_Shape],
    data: int,
    decimal: Decimal,
    *,
    is_first: bool,
) -> int:
    """Return the first row of data below a row of channel numbers.

    Loggers write such a row below the units: 1 to n above a blank row or with a time that does not continue in the
    rows below; and in files that begin with facts about the session, whole numbers without one for the time.
    """
    following = next((row for row in filled if row > data and shapes[row].numbers), data)
    cells = ["" if _is_blank(cell) else str(cell).strip() for cell in rows[data]]
    counted = [str(k + 1) for k in range(len(cells))]
    if len(cells) >= _MIN_NUMBERED and cells == counted:
        below = [row for row in filled if row > data and shapes[row].numbers][:2]
        times = [parse_number(rows[row][0], decimal) for row in below if rows[row]]
        is_apart = following > data + 1 and not is_first
        return following if is_apart or _begins_anew(times) else data
    if is_first:
        return data
    numbers = [cell for cell in cells if cell]
    is_untimed = not cells[0] and bool(rows[following]) and not _is_blank(rows[following][0])
    return following if is_untimed and len(numbers) > 1 and all(map(str.isdecimal, numbers)) else data


def _begins_anew(times: Sequence[float | None]) -> bool:
    """Return whether time stamps do not continue a first one of 1: the step to them is another one."""
    first, second = (*times, None, None)[:2]
    if first is None or second is None:
        return first is not None and first < 1
    return not math.isclose(first - 1, second - first, rel_tol=0.1)


def _names_more_channels(later: Header, first: Header, rows: Sequence[Row], shapes: Sequence[_Shape]) -> bool:
    """Return whether a header further down is the one of the table, and what is above a block of numbers of its own.

    It names more columns of numbers, or the time where the first one does not.
    """
    named = [sum(bool(h.names[i]) for i in shapes[h.data].numbers if i < len(h.names)) for h in (later, first)]
    return named[0] > named[1] or (named[0] == named[1] and _has_time(rows[later.row]) > _has_time(rows[first.row]))


def _raise_names(
    rows: Sequence[Row], shapes: Sequence[_Shape], row: int, unit_row: int | None, data: int
) -> tuple[int, int | None]:
    """Return the rows of names and units if the names are above rows of descriptions, types and units.

    The word for time tells them from what else stands above a table.
    """
    if unit_row is None and _has_time(rows[row]):
        unit_row = _units_above(rows, shapes, row)
    for above in range(row - 1, max(row - _MAX_HEADER_ROWS, -1), -1):
        shape = shapes[above]
        if shape.numbers or len(shape.texts) < len(shapes[row].texts):
            break
        covered = 2 * len(shape.texts & shapes[data].numbers) >= len(shapes[data].numbers)
        if covered and _has_time(rows[above]) and _are_names(rows[above], rows[row]):
            below = [k for k in range(above + 1, data) if rows[k] != rows[above]]
            units = [k for k in below if 2 * _count_units(rows[k]) >= len(_texts(rows[k])) > 0]
            return above, max(units, key=lambda k: _count_units(rows[k]), default=None)
    return row, unit_row


def _units_above(rows: Sequence[Row], shapes: Sequence[_Shape], row: int) -> int | None:
    """Return the row above the names, if it holds nothing but units of them."""
    if not row or shapes[row - 1].numbers or not shapes[row - 1].texts <= shapes[row].texts:
        return None
    return row - 1 if _count_units(rows[row - 1]) == len(shapes[row - 1].texts) >= 2 else None


def _are_distinct(names: Sequence[str]) -> bool:
    """Return whether each is another one; the time may come again, for another group of channels."""
    others = [name for name in names if time_unit(*split_name(name)) is None]
    return len(set(others)) == len(others)


def _has_time(row: Row) -> bool:
    return any(time_unit(*split_name(cell)) is not None for cell in _texts(row))


def _are_names(row: Row, below: Row) -> bool:
    """Return whether all cells may be names of channels: each is another one, or the row below lacks the time."""
    names = [cell.strip() for cell in _texts(row)]
    return (_are_distinct(names) or not _has_time(below)) and all(
        name[0].isalpha() or name[0] in "_$%" for name in names
    )


def _count_units(row: Row) -> int:
    return sum(looks_like_unit(cell) or in_seconds(cell) is not None for cell in _texts(row))


def _texts(row: Row) -> list[str]:
    return [str(cell) for cell in row if not _is_blank(cell)]


def _shape(row: Row, decimal: Decimal) -> _Shape:
    values = {i: parse_number(cell, decimal) for i, cell in enumerate(row) if not _is_blank(cell)}
    texts = frozenset(i for i, value in values.items() if value is None)
    numbers = frozenset(values) - texts
    # a dash is a gap among numbers, and an empty cell in a row of texts
    dashes = {i for i in numbers if str(row[i]).strip("-?* ") == ""}
    ones = all(values[i] == 1 for i in numbers - dashes)
    worded = all(isinstance(row[i], str) and str(row[i]).strip().isalpha() for i in numbers - dashes)
    return _Shape(numbers - dashes if texts or numbers == dashes else numbers, texts, ones, worded)


def _is_blank(cell: object) -> bool:
    return cell is None or (isinstance(cell, str) and not cell.strip())


def _find_data(filled: Sequence[int], rows: Sequence[Row], shapes: Sequence[_Shape]) -> tuple[int | None, int] | None:
    """Return the row of units (or None) and the first row of data if filled[0] holds names; else None."""
    names = shapes[filled[0]]
    if not names.texts or not names.worded:
        return None
    named = names.texts | names.numbers
    # the numbers begin below the names, or below one row of units
    for skipped, unit_row in ((1, None), (2, filled[1])):
        if len(filled) <= skipped:
            return None
        data = shapes[filled[skipped]]
        # a unit of 1, as ratios have it, is not yet a number
        if unit_row is None and _is_unit_row_of_ones(rows[filled[1]], data):
            continue
        if data.numbers and 2 * len(named & data.numbers) >= len(data.numbers):
            if unit_row is None or _is_unit_row(rows[filled[0]], rows[unit_row], shapes[unit_row]):
                return unit_row, filled[skipped]
            return None
    return None


def _is_unit_row_of_ones(row: Row, shape: _Shape) -> bool:
    """Return whether the row holds units of which some are 1."""
    return bool(shape.texts) and shape.ones and all(looks_like_unit(str(row[i])) for i in shape.texts)


def _is_unit_row(names: Row, row: Row, shape: _Shape) -> bool:
    if shape.numbers and not _is_unit_row_of_ones(row, shape):
        return False
    cells = [str(row[i]).strip() for i in sorted(shape.texts)]
    above = [str(names[i]).strip() if i < len(names) else "" for i in sorted(shape.texts)]
    if cells == above:  # names twice, of which the lower ones would hide the unit of time
        return False
    if all(above) and any(map(_is_unit_below_time, above, cells)):
        return True
    known = sum(looks_like_unit(cell) for cell in cells)
    if not all(above) or (known < len(cells) and not _are_distinct(above)):
        return False
    # unknown words that repeat are units; descriptions would differ
    return 2 * known >= len(cells) or len(set(cells)) < len(cells)


def _is_unit_below_time(name: str, cell: str) -> bool:
    return time_unit(*split_name(name)) is not None and in_seconds(cell) is not None


def _are_settings(run: Sequence[int], shapes: Sequence[_Shape]) -> bool:
    """Return whether the rows are settings above the table, such as `Rate; 0.1`, rather than its data."""
    return all(shapes[row].texts and len(shapes[row].texts | shapes[row].numbers) <= 2 for row in run)


def _build_header(rows: Sequence[Row], row: int, unit_row: int | None, data: int, numbered: bool) -> Header:
    split = [("", "") if is_missing(cell) else split_name(str(cell)) for cell in rows[row]]
    if _is_unnamed_time(rows, row, data):
        split[0] = ("time", "")
    raw = ["" if is_missing(cell) else " ".join(str(cell).split()) for cell in rows[row]]
    short = [name for name, _ in split]
    shorts, raws = Counter(short), Counter(raw)
    # `p [bar]` beside `p [kPa]`: only the full heads tell them apart
    names = [full if full and shorts[name] > raws[full] else name for name, full in zip(short, raw, strict=True)]
    below = [] if unit_row is None else [plain_unit(_unit_text(cell)) for cell in rows[unit_row]]
    below = ["" if unit.casefold() in _LABELS else unit for unit in below]
    below += [""] * (len(names) - len(below))
    units = [unit or stated for unit, (_, stated) in zip(below, split, strict=False)]
    unique = _rename_repeated(names, units)
    renamed = tuple(new for new, name in zip(unique, names, strict=True) if new != name)
    return Header(row, data, tuple(unique), tuple(units), numbered=numbered, renamed=renamed)


def _rename_repeated(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return names of which each is another one; those of a time may repeat, for groups of channels side by side."""
    is_time = [is_clock(name, unit) for name, unit in zip(names, units, strict=True)]
    own = iter(unique_names([name for name, is_own in zip(names, is_time, strict=True) if not is_own]))
    return [name if is_own else next(own) for name, is_own in zip(names, is_time, strict=True)]


def header_remarks(location: Location, header: Header) -> Iterator[Finding]:
    """Yield what was done to read the head of a table: columns that were renamed, a row that was skipped."""
    if header.renamed:
        message = f"columns with a name that stands before were renamed: {join_names(header.renamed, _MAX_LISTED)}"
        yield Finding(location, message, severity="remark")
    if header.numbered:
        message = "a row of channel numbers above the first sample was skipped"
        yield Finding(location, message, "Put another value into it if it is a sample.", severity="remark")


def _is_unnamed_time(rows: Sequence[Row], row: int, data: int) -> bool:
    """Return whether the first column holds dates or times but has no name, as pandas writes an index."""
    first = rows[data][0] if rows[data] else None
    is_unnamed = bool(rows[row]) and is_missing(rows[row][0]) and not _has_time(rows[row])
    return is_unnamed and (is_dated(first) or is_stamp(first))


def _unit_text(cell: object) -> str:
    if cell is None:
        return ""
    return f"{cell:g}" if isinstance(cell, float) else str(cell)
