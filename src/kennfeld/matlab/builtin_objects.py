"""Objects of MATLAB's own data types: string, datetime, duration, categorical, table and timetable.

Their properties are those that MATLAB saves, as the documents of the mat-io project list them and files of MATLAB
show them. A date is a count of milliseconds since 1970 in two doubles, whose sum is the exact time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab import mat_nodes as n

_MAX_STRINGS = 1_000_000
_MAX_DEPTH = 60
_PER_DAY = 86_400_000.0  # ms


@dataclass(frozen=True, eq=False)
class MatTimes(n.MatStruct):
    """Times, `datetime` or `duration`: milliseconds, since 1970 or as such, are the sum of `high` and `low`."""

    high: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    low: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def seconds(self, origin: "tuple[float, float]" = (0.0, 0.0)) -> NDArray[np.float64]:
        """Return the times in s since `origin`, its high and low part in ms; Float[times]."""
        elapsed: NDArray[np.float64] = ((self.high - origin[0]) + (self.low - origin[1])) / 1e3
        return elapsed


@dataclass(frozen=True, eq=False)
class MatTable(n.MatStruct):
    """A `table` or `timetable`: its fields are the columns, of which some have units and descriptions."""

    units: Mapping[str, str] = field(default_factory=dict)
    descriptions: Mapping[str, str] = field(default_factory=dict)
    steps: frozenset[str] = frozenset()  # columns whose values are valid until the next row
    times: MatTimes | None = None  # of the rows


def convert_builtins(node: n.Node, depth: int = 0) -> n.Node:
    """Return a node in which texts, times and tables take the place of the objects of MATLAB's types."""
    if depth > _MAX_DEPTH:
        return node
    if isinstance(node, n.MatCells):
        return replace(node, cells=[convert_builtins(cell, depth + 1) for cell in node.cells])
    if isinstance(node, n.MatStructArray):
        # strings become texts, so that an array of them is a cell array
        converted = [convert_builtins(element, depth + 1) for element in node.elements]
        structs = [element for element in converted if isinstance(element, n.MatStruct)]
        return replace(node, elements=structs) if len(structs) == len(converted) else n.MatCells(converted, node.shape)
    if not isinstance(node, n.MatStruct) or isinstance(node, MatTimes | MatTable):
        return node
    fields = {name: convert_builtins(inner, depth + 1) for name, inner in node.fields.items()}
    plain = n.MatStruct(fields, node.kind)
    convert = _CONVERTERS.get(node.kind)
    return plain if convert is None else convert(plain) or plain


def _convert_string(node: n.MatStruct) -> n.Node | None:
    """Return the text of a string: version, number of dimensions, sizes, lengths, then UTF-16, in 64-bit numbers."""
    packed = node.fields.get("any")
    if not isinstance(packed, n.MatNumbers) or packed.values.dtype.itemsize != 8 or packed.values.size < 4:
        return None
    words = packed.values.ravel(order="F").astype("<u8")
    dimensions = int(words[1])
    if int(words[0]) != 1 or not 2 <= dimensions <= words.size - 2:
        return None
    shape = tuple(int(size) for size in words[2 : 2 + dimensions])
    count = int(np.prod(shape, dtype=float))
    begin = 2 + dimensions
    if count > min(_MAX_STRINGS, words.size - begin):
        return None
    lengths = words[begin : begin + count].tolist()
    letters = words[begin + count :].tobytes()
    # the length of a missing string has all bits set
    if any(length == 2**64 - 1 for length in lengths):  # missing strings
        lengths = [0 if length == 2**64 - 1 else length for length in lengths]
    if 2 * sum(lengths) > len(letters):
        return None
    texts, at = [], 0
    for length in lengths:
        texts.append(n.MatText(letters[at : at + 2 * length].decode("utf-16-le", "replace")))
        at += 2 * length
    return texts[0] if count == 1 else n.MatCells(texts, shape)


def _convert_times(node: n.MatStruct) -> n.Node | None:
    stored = node.fields.get("data", node.fields.get("millis"))
    # MATLAB saves the two doubles as real and imaginary part
    if isinstance(stored, n.MatUnreadable) and stored.parts is not None:
        high, low = stored.parts
    elif isinstance(stored, n.MatNumbers):
        high = np.asarray(stored.values, dtype=np.float64)
        low = np.zeros(high.shape)
    else:
        return None
    parts = (np.array(part, dtype=np.float64).ravel(order="F") for part in (high, low))
    return MatTimes(node.fields, node.kind, *parts)


def _convert_table(node: n.MatStruct) -> n.Node | None:
    props = node.fields.get("props")
    fields = props.fields if isinstance(props, n.MatStruct) else {}
    names = texts_of(node.fields.get("varnames"))
    notes = (fields.get("VariableUnits"), fields.get("VariableDescriptions"), fields.get("VariableContinuity"))
    return _table("table", names, node.fields.get("data"), notes, None)


def _convert_timetable(node: n.MatStruct) -> n.Node | None:
    saved = node.fields.get("any")
    if not isinstance(saved, n.MatStruct):
        return None
    fields = saved.fields
    rows = fields.get("numRows")
    count = int(rows.values.ravel()[0]) if isinstance(rows, n.MatNumbers) and rows.values.size else 0
    times = _row_times(fields.get("rowTimes"), count)
    if times is None:
        return n.MatUnreadable("timetable", why="its row times have an unknown form")
    notes = (fields.get("varUnits"), fields.get("varDescriptions"), fields.get("varContinuity"))
    return _table("timetable", texts_of(fields.get("varNames")), fields.get("data"), notes, times)


def _table(
    kind: str, names: Sequence[str], data: n.Node | None, notes: Sequence[n.Node | None], times: MatTimes | None
) -> n.Node | None:
    columns = data.cells if isinstance(data, n.MatCells) else []
    if len(names) != len(columns):
        return None
    units, descriptions, continuity = (dict(zip(names, texts_of(note), strict=False)) for note in notes)
    steps = frozenset(name for name, word in continuity.items() if word in ("step", "event"))
    return MatTable(dict(zip(names, columns, strict=True)), kind, units, descriptions, steps, times)


def _row_times(node: n.Node | None, rows: int) -> MatTimes | None:
    """Return the times of all rows: stored ones, or an origin with a rate or a step."""
    if isinstance(node, MatTimes):
        return node if node.high.size == rows else None
    if not isinstance(node, n.MatStruct) or rows > n.MAX_BYTES // 8:
        return None
    origin, step = node.fields.get("origin"), _step(node)
    if not isinstance(origin, MatTimes) or origin.high.size != 1 or step is None:
        return None
    # rounded once for each row; multiples of a rounded step 1000/rate would drift
    elapsed = np.arange(rows) * step[0] / step[1]
    return MatTimes({}, origin.kind, np.full(rows, origin.high[0]), elapsed + origin.low[0])


def _step(node: n.MatStruct) -> tuple[float, float] | None:
    """Return numerator and denominator of the time from one row to the next, in ms."""
    if _number(node.fields.get("specifiedAsRate")) == 1:
        rate = _number(node.fields.get("sampleRate"))
        return (1000.0, rate) if rate is not None and rate > 0 else None
    step = node.fields.get("stepSize")
    if isinstance(step, MatTimes):
        return (float(step.high[0] + step.low[0]), 1.0) if step.high.size == 1 else None
    parts = step.fields.get("components") if isinstance(step, n.MatStruct) else None
    # a calendarDuration: months have no fixed length
    if not isinstance(parts, n.MatStruct) or _number(parts.fields.get("months")) != 0:
        return None
    days, milliseconds = _number(parts.fields.get("days")), _number(parts.fields.get("millis"))
    return None if days is None or milliseconds is None else (days * _PER_DAY + milliseconds, 1.0)


def _number(node: n.Node | None) -> float | None:
    return float(node.values.ravel()[0]) if isinstance(node, n.MatNumbers) and node.values.size == 1 else None


def texts_of(node: n.Node | None) -> list[str]:
    """Return the texts of a cell array or of an array of strings, empty ones for other cells.

    >>> texts_of(n.MatCells([n.MatText("rpm"), n.MatNumbers(np.zeros(1))]))
    ['rpm', '']
    """
    cells = node.cells if isinstance(node, n.MatCells) else [node] if isinstance(node, n.MatText) else []
    return [cell.text if isinstance(cell, n.MatText) else "" for cell in cells]


_CONVERTERS = {
    "string": _convert_string,
    "datetime": _convert_times,
    "duration": _convert_times,
    "table": _convert_table,
    "timetable": _convert_timetable,
}
