"""Reader of DIAdem files: a header in text (.dat), which describes channels whose values lie in files beside it.

Each line of a channel's header is a number and a value: 200 name, 201 comment, 202 unit, 210 IMPLICIT or EXPLICIT,
211 file, 213 CHANNEL or BLOCK, 214 type, 220 number of values, 221 place of the first one (from 1), 222 distance of two
values in a block, 223 column in a block of text, 230 and 231 its separator and decimal sign, 240 offset or start,
241 factor or step, 254 what stands for missing values. The global header has 111, the same for all channels, and 112,
the order of bytes. German versions write IMPLIZIT. Without 221, the channels of a record follow each other.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import nearest_file
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.recorded_groups import (
    RecordedChannel,
    RecordedGroup,
    UnreadableChannel,
    ValuesFileError,
    file_beside,
    tables_of,
)
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.unit_text import split_name

_TYPES = {
    "REAL32": "f4", "REAL64": "f8", "INT16": "i2", "INT32": "i4", "WORD8": "u1", "WORD16": "u2", "WORD32": "u4",
}  # fmt: skip
_TEXT = "ASCII"
_SWAPPED = "LOW -> HIGH"  # bytes in the order of other processors than those of PCs
_IMPLICIT = ("IMPLICIT", "IMPLIZIT")
_MAX_DIGITS_OF_KEY = 9  # far more than any key of the format has
_MAX_HEADER = 50_000_000  # bytes
_MAX_VALUES = 500_000_000
_EXPORT = "Export the measurement from DIAdem as MDF, TDMS or CSV."


@dataclass(frozen=True)
class _Header:
    """The numbered entries of the file and of each channel."""

    common: Mapping[int, str]
    channels: tuple[Mapping[int, str], ...]


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each length of channels that has a requested one."""
    groups, unreadable = _groups(source, _header(source))
    size = source.stored_size(*companions(source))
    return tables_of(source, groups, selection, unreadable, size)


def companions(source: MeasurementFile) -> list[Path]:
    """Return the files that hold the values."""
    names = {entries[211]: None for entries in _header(source).channels if entries.get(211)}
    return [file_beside(source.path, name) for name in names]


def _header(source: MeasurementFile) -> _Header:
    start = source.start(_MAX_HEADER)
    text = start.decode(detect_encoding(start, whole=True), "replace")
    common: dict[int, str] = {}
    channels: list[dict[int, str]] = []
    entries = common
    for line in text.splitlines():
        mark = line.strip().upper()
        if mark == "#BEGINCHANNELHEADER":
            entries = {}
            channels.append(entries)
        elif mark == "#BEGINGLOBALHEADER":
            entries = common
        else:
            key, separator, value = (part.strip() for part in line.partition(","))
            if separator and key.isdecimal() and len(key) <= _MAX_DIGITS_OF_KEY:
                entries.setdefault(int(key), value)
    return _Header(common, tuple(channels))


def _groups(source: MeasurementFile, header: _Header) -> tuple[list[RecordedGroup], list[UnreadableChannel]]:
    # a record holds one value of each block channel of its file, unless entry 222 states another distance
    counts = Counter(entries.get(211, "") for entries in header.channels if _method(entries) == "BLOCK")
    places: Counter[str] = Counter()
    by_length: dict[int, list[RecordedChannel]] = defaultdict(list)
    unreadable: list[UnreadableChannel] = []
    for number, entries in enumerate(header.channels, 1):
        try:
            # counted before anything can fail, as later channels of the record lie behind it
            if _method(entries) == "BLOCK":
                places[entries.get(211, "")] += 1
            length = _integer(entries, 220, 0)
            if length > _MAX_VALUES:
                raise ValueError(f"it claims {length} values")
            if length > 0:
                place = places[entries.get(211, "")]
                channel = _channel(source, header, {**_default_place(entries, place), **entries}, length, counts)
                by_length[length].append(channel)
        except ValueError as error:
            shared = isinstance(error, ValuesFileError)
            unreadable.append(UnreadableChannel(entries.get(200) or str(number), str(error), _EXPORT, shared))
    groups = [
        RecordedGroup("" if len(by_length) == 1 else f"{length} samples", length, channels)
        for length, channels in by_length.items()
    ]
    return groups, unreadable


def _default_place(entries: Mapping[int, str], place: int) -> dict[int, str]:
    """Return the entry of a channel's place within a record: of numbers the first value, of text the column."""
    if _method(entries) != "BLOCK":
        return {}
    return {223 if entries.get(214, "").upper() == _TEXT else 221: str(place)}


def _channel(
    source: MeasurementFile, header: _Header, entries: Mapping[int, str], length: int, counts: Mapping[str, int]
) -> RecordedChannel:
    full = entries.get(200, "")
    name, unit = split_name(full)
    unit = entries.get(202, "").strip("[]") or unit
    start, step = _number(entries, 240, 0.0), _number(entries, 241, 1.0)
    if entries.get(210, "").upper() in _IMPLICIT:
        return RecordedChannel(name, full, unit, partial(_even, start, step, length), entries.get(201, ""))
    stored = _Stored.of(source, header, entries, length, counts)
    load = partial(_physical, stored, step or 1.0, start)  # some writers state a factor of 0 and mean none
    return RecordedChannel(name, full, unit, load, entries.get(201, ""))


def _even(start: float, step: float, length: int) -> Float:
    return _scaled(np.arange(length, dtype=np.float64), step, start)


def _physical(stored: "_Stored", factor: float, offset: float) -> Float:
    return _scaled(stored.values(), factor, offset)


def _scaled(values: Float, factor: float, offset: float) -> Float:
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are reported as of all formats
        return np.asarray(values * factor + offset)


@dataclass(frozen=True)
class _Stored:
    """Values in a file beside the header.

    Attributes:
        path: the file.
        kind: type of the numbers; empty for text.
        first: values before the first one, for text lines before it.
        distance: values from one to the next.
        length: number of values.
        column: of text, the column, from 0.
        separator: between columns of text.
        decimal: decimal sign of text.
        missing: the number that stands for a missing value.
    """

    path: Path
    kind: str
    first: int
    distance: int
    length: int
    column: int = 0
    separator: str = ""
    decimal: str = "."
    missing: float | None = None

    @classmethod
    def of(
        cls,
        source: MeasurementFile,
        header: _Header,
        entries: Mapping[int, str],
        length: int,
        counts: Mapping[str, int],
    ) -> "_Stored":
        """Return the place of a channel's values; raise `ValueError` if the header does not tell it."""
        path = _beside(source, entries.get(211, ""))
        kind = entries.get(214, "").upper()
        in_block = _method(entries) == "BLOCK"
        first = _integer(entries, 221, 1) - 1
        missing = _number(entries, 254, _number(header.common, 111, float("nan")))
        if kind == _TEXT:
            separator, decimal = entries.get(230, ""), entries.get(231, ".") or "."
            column = _integer(entries, 223, 1) - 1 if in_block else 0
            stored = cls(path, "", first, 1, length, column, separator, decimal, missing)
        elif kind in _TYPES:
            order = ">" if header.common.get(112, "").upper() == _SWAPPED else "<"
            distance = _integer(entries, 222, counts.get(entries.get(211, ""), 1)) if in_block else 1
            stored = cls(path, order + _TYPES[kind], first, distance, length, missing=missing)
        else:
            raise ValueError(f"values of type {kind or 'unknown'} cannot be read")
        if first < 0 or stored.distance < 1 or stored.column < 0:
            raise ValueError("the header states an impossible place of the values")
        stored.check()
        return stored

    def check(self) -> None:
        """Raise `ValueError` if the file is shorter than the header claims."""
        if self.kind:
            needed = (self.first + (self.length - 1) * self.distance + 1) * np.dtype(self.kind).itemsize
            size = self.path.stat().st_size
            if needed > size:
                raise ValuesFileError(f"file {self.path.name} is cut off: it has only {size} bytes")

    def values(self) -> Float:
        """Return the numbers, NaN where they are missing; Float[samples]."""
        if self.kind:
            whole = np.memmap(self.path, self.kind, mode="r")
            last = self.first + (self.length - 1) * self.distance + 1
            numbers = np.asarray(whole[self.first : last : self.distance], dtype=np.float64)
        else:
            numbers = np.array(list(self._texts()), dtype=np.float64)
        if self.missing is not None and np.isfinite(self.missing):  # written with fewer digits than a float has
            numbers = np.where(np.isclose(numbers, self.missing, rtol=1e-6, atol=0.0), np.nan, numbers)
        return numbers

    def _texts(self) -> Iterator[float]:
        lines = self.path.read_text("latin-1").splitlines()[self.first : self.first + self.length]
        if len(lines) < self.length:
            raise InputError.of(_location(self.path), f"holds fewer than {self.length} values", _EXPORT)
        for number, line in enumerate(lines, self.first + 1):
            cells = line.split(self.separator) if self.separator else line.split()
            cell = cells[self.column].strip().replace(self.decimal, ".") if self.column < len(cells) else ""
            try:
                yield float(cell or "nan")
            except ValueError:
                raise InputError.of(_location(self.path, number), f"{cell!r} is not a number", _EXPORT) from None


def _location(path: Path, line: int = 0) -> Location:
    return Location(path.name, line) if line else Location(path.name)


def _beside(source: MeasurementFile, name: str) -> Path:
    """Return the file of values, which lies beside the header."""
    if not name:
        raise ValueError("the header names no file of values")
    path = file_beside(source.path, name)
    if path.is_file():
        return path
    raise ValuesFileError(f"file {path.name} is not beside the header. {nearest_file(path)}".strip())


def _method(entries: Mapping[int, str]) -> str:
    return entries.get(213, "CHANNEL").upper()


def _integer(entries: Mapping[int, str], key: int, default: int) -> int:
    text = entries.get(key, "")
    try:
        return int(text) if text else default
    except ValueError:
        raise ValueError(f"entry {key} is {text!r}, not a whole number") from None


def _number(entries: Mapping[int, str], key: int, default: float) -> float:
    text = entries.get(key, "").replace(",", ".")
    try:
        return float(text) if text else default
    except ValueError:
        raise ValueError(f"entry {key} is {text!r}, not a number") from None
