"""Reader of TDM files of National Instruments: XML that describes channels, with their values in a .tdx file beside it.

A channel group lists channels, a channel its local column, a column its sequence of values, and that a block of the
binary file. The values of a block follow each other, or, in a `block_bm`, have a record for each sample. DIAdem itself
packs the description into a ZIP archive, as its member header.xml. A column may have flags, which mark invalid values.
Times are those of LabVIEW: seconds since 1904 and a fraction of 64 bits.
"""

import re
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from functools import cached_property, partial
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from kennfeld.base.archives import ZIP_ERRORS, find_oversized
from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.base.file_errors import nearest_file
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.damage import damaged
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
from kennfeld.measurement.unit_text import plain_unit, split_name

_TYPES = {
    "eInt8Usi": "i1", "eInt16Usi": "i2", "eInt32Usi": "i4", "eInt64Usi": "i8",
    "eUInt8Usi": "u1", "eUInt16Usi": "u2", "eUInt32Usi": "u4", "eUInt64Usi": "u8",
    "eFloat32Usi": "f4", "eFloat64Usi": "f8",
}  # fmt: skip
_TIME = "eTimeUsi"
# the byte order is that of all 16 bytes, so the halves change places
_TIME_TYPES = {"<": [("fraction", "<u8"), ("seconds", "<i8")], ">": [("seconds", ">i8"), ("fraction", ">u8")]}
# DIAdem counts 365 days for the year 0
_1904 = 60_084_288_000  # s from year 0, the origin of dates as numbers, to that of times
_VALID = 0b1001  # bits of a flag: valid and defined
_MEMBER = "header.xml"
_DATE = "DT_DATE"
_REFERENCE = re.compile(r"id\(\s*[\"']([^\"']+)[\"']\s*\)")
_MAX_SIZE = 100_000_000  # bytes of the description
_MAX_VALUES = 500_000_000
_EXPORT = "Export the measurement from DIAdem as MDF, TDMS or CSV."


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each raster that has a requested channel."""
    document = _Document(source, _parse(source))
    groups = list(document.groups())
    size = source.stored_size(document.binary_path)
    return tables_of(source, groups, selection, document.unreadable, size)


def companions(source: MeasurementFile) -> list[Path]:
    """Return the file that holds the values. Raises `InputError` if the description cannot be read."""
    return [_Document(source, _parse(source)).binary_path]


def _parse(source: MeasurementFile) -> Element:
    raw = source.start(_MAX_SIZE)
    if raw.startswith(b"PK"):
        raw = _unpack(source)
    plain = raw.replace(b"\0", b"")  # UTF-16
    # entities may expand to any size
    if b"<!DOCTYPE" in plain or b"<!ENTITY" in plain:
        raise InputError.of(source.location, "declares a document type or entities", "Remove the declarations.")
    try:
        return fromstring(raw)
    except (ParseError, ValueError, LookupError) as error:
        raise damaged(source, "TDM", error) from None


def _unpack(source: MeasurementFile) -> bytes:
    try:
        with zipfile.ZipFile(source.path) as archive:
            if oversized := find_oversized(archive):
                raise InputError.of(source.location, f"suspicious archive: {oversized}", _EXPORT)
            with archive.open(_MEMBER) as member:
                return member.read(_MAX_SIZE)
    except (*ZIP_ERRORS, OSError) as error:
        raise damaged(source, "TDM", error) from None


@dataclass(frozen=True)
class _StoredBlock:
    """Values of one type in the binary file."""

    path: Path
    kind: str  # empty for times
    order: str
    offset: int  # bytes before the first value
    distance: int  # bytes from one value to the next
    length: int

    @property
    def type(self) -> np.dtype:
        """Type of a value."""
        return np.dtype(self.order + self.kind if self.kind else _TIME_TYPES[self.order])

    def read(self, count: int | None = None) -> np.ndarray:
        """Return the first `count` values, all by default."""
        count = self.length if count is None else min(count, self.length)
        if not count:
            return np.empty(0, self.type)
        with self.path.open("rb") as file:
            file.seek(self.offset)
            raw = file.read(self.distance * (count - 1) + self.type.itemsize)
        # a view: in a record, the values of other channels lie between
        return np.ndarray((count,), self.type, raw, strides=(self.distance,))


@dataclass(frozen=True)
class _Column:
    """The values of a channel: a block of the binary file, scaled; without a block they are evenly spaced."""

    block: _StoredBlock | None
    flags: _StoredBlock | None
    length: int
    start: float
    factor: float

    def values(self) -> Float:
        """Return the numbers, NaN where they are invalid; Float[samples]."""
        if self.block is None:
            return np.asarray(self.start + self.factor * np.arange(self.length), dtype=np.float64)
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged file may hold any numbers
            numbers = self.block.read().astype(np.float64) * self.factor + self.start
        return self._valid(numbers)

    def first_date(self) -> tuple[int, float]:
        """Return the first date in s since year 0, as a whole number and a fraction."""
        if self.block is not None and not self.block.kind:
            (stamp,) = self.block.read(1)
            return int(stamp["seconds"]) + _1904, float(stamp["fraction"]) * 2.0**-64
        first = self.start if self.block is None else float(self.block.read(1)[0]) * self.factor + self.start
        whole = int(first) if np.isfinite(first) else 0
        return whole, first - whole if np.isfinite(first) else 0.0

    def dates(self, origin: tuple[int, float]) -> Float:
        """Return dates in s since an origin, NaN where they are invalid; Float[samples]."""
        if self.block is None or self.block.kind:
            return self.values() - origin[0] - origin[1]
        stamps = self.block.read()
        # whole seconds as integers, so that a float holds all digits of the difference
        seconds = (stamps["seconds"].astype(np.int64) - (origin[0] - _1904)).astype(np.float64)
        return self._valid(seconds + (stamps["fraction"].astype(np.float64) * 2.0**-64 - origin[1]))

    def _valid(self, numbers: Float) -> Float:
        if self.flags is None:
            return numbers
        return np.where(self.flags.read(self.length) & _VALID == _VALID, numbers, np.nan)


class _Document:
    """The elements of the description by their identifiers."""

    def __init__(self, source: MeasurementFile, root: Element) -> None:
        self.source = source
        self.elements = {key: each for each in root.iter() if (key := each.get("id")) is not None}
        self.groups_of_channels = [each for each in root.iter() if _tag(each) == "tdm_channelgroup"]
        file = next((each for each in root.iter() if _tag(each) == "file"), None)
        self.file = {} if file is None else dict(file.attrib)
        self.unreadable: list[UnreadableChannel] = []
        self._dates: list[_Column] = []

    @cached_property
    def _origin(self) -> tuple[int, float]:
        """The earliest date; groups of a file may start one after the other."""
        return min(column.first_date() for column in self._dates)

    def groups(self) -> Iterator[RecordedGroup]:
        """Yield the channels of each group that have one length, and collect those that cannot be read."""
        several = len(self.groups_of_channels) > 1
        for group in self.groups_of_channels:
            name = _child_text(group, "name")
            by_length: dict[int, list[RecordedChannel]] = defaultdict(list)
            for channel in self._referred(group, "channels"):
                try:
                    own = self._channel(channel, name)
                except ValueError as error:
                    shared = isinstance(error, ValuesFileError)
                    self.unreadable.append(UnreadableChannel(_child_text(channel, "name"), str(error), _EXPORT, shared))
                else:
                    if own is not None:
                        by_length[own[0]].append(own[1])
            for length, channels in by_length.items():
                label = name if len(by_length) == 1 else f"{name}, {length} samples"
                yield RecordedGroup(label if several or len(by_length) > 1 else "", length, channels)

    def _referred(self, element: Element, tag: str) -> Iterator[Element]:
        """Yield the elements to which a child refers."""
        for key in _REFERENCE.findall(_child_text(element, tag)):
            if key in self.elements:
                yield self.elements[key]

    def _channel(self, channel: Element, group: str) -> tuple[int, RecordedChannel] | None:
        """Return length and content of a channel; None if it has no values."""
        column = next(self._referred(channel, "local_columns"), None)
        if column is None:
            return None
        full = _child_text(channel, "name")
        name, unit = split_name(full)
        unit = plain_unit(_child_text(channel, "unit_string")) or unit
        description = _child_text(channel, "description")
        sequence = next(self._referred(column, "values"), None)
        if sequence is not None and _tag(sequence) == "string_sequence":
            length = self._length(column)
            text = RecordedChannel(name, f"{group}/{full}", "", _no_numbers, description, content="a text")
            return (length, text) if length else None
        stored = self._column(column, sequence)
        if not stored.length:
            return None
        dated = _child_text(channel, "datatype") == _DATE or (stored.block is not None and not stored.block.kind)
        load = partial(self._dates_of, stored) if dated else stored.values
        if dated:
            self._dates.append(stored)
        return stored.length, RecordedChannel(name, f"{group}/{full}", unit, load, description, dated)

    def _dates_of(self, column: _Column) -> Float:
        # called once all groups are known, so the earliest date is that of the file
        return column.dates(self._origin)

    def _length(self, column: Element) -> int:
        submatrix = next(self._referred(column, "submatrix"), None)
        return 0 if submatrix is None else _integer(_child_text(submatrix, "number_of_rows") or "0")

    def _column(self, column: Element, sequence: Element | None) -> _Column:
        representation = _child_text(column, "sequence_representation") or "explicit"
        parameters = [_number(text) for text in _child_text(column, "generation_parameters").split()]
        if representation in ("implicit_linear", "implicit_constant"):
            parameters = parameters or self._parameters(sequence)
            if representation == "implicit_constant":
                parameters = [*parameters[:1], 0.0]
            if len(parameters) < 2:
                raise ValueError("its values are evenly spaced, but start and step are not stated")
            return _Column(None, None, self._bounded(self._length(column)), parameters[0], parameters[1])
        if (representation, len(parameters)) not in (("explicit", 0), ("raw_linear", 2)):
            raise ValueError(f"values of the representation {representation} cannot be read")
        start, factor = parameters or (0.0, 1.0)
        block = self._block_of(sequence)
        if block is None:
            raise ValueError("the description names no block with its values")
        flags = self._block_of(next(self._referred(column, "flags"), None))
        if flags is not None and (flags.length < block.length or flags.type.kind not in "iu"):
            raise ValueError("the flags of its values are fewer than the values, or not integers")
        return _Column(block, flags, block.length, start, factor)

    def _parameters(self, sequence: Element | None) -> list[float]:
        """Return start and step of evenly spaced values, which newer versions write as values themselves."""
        block = self._block_of(sequence)
        if block is not None and block.kind:
            return [float(number) for number in block.read(2)]
        return [] if sequence is None else [_number(text) for text in _child_text(sequence, "values").split()[:2]]

    def _block_of(self, sequence: Element | None) -> _StoredBlock | None:
        """Return the block to which the values of a sequence refer, if they refer to one."""
        values = None if sequence is None else next((each for each in sequence if _tag(each) == "values"), None)
        block = self.elements.get("" if values is None else values.get("external", ""))
        return None if block is None else self._block(block)

    def _block(self, block: Element) -> _StoredBlock:
        kind = block.get("valueType", "")
        if kind not in _TYPES and kind != _TIME:
            raise ValueError(f"values of type {kind or 'unknown'} cannot be read")
        order = ">" if self.file.get("byteOrder") == "bigEndian" else "<"
        length = self._bounded(_integer(block.get("length", "0")))
        size = 16 if kind == _TIME else np.dtype(_TYPES[kind]).itemsize
        offset, distance = _integer(block.get("byteOffset", "0")), size
        if _tag(block) == "block_bm":
            offset += _integer(block.get("blockOffset", "0"))
            distance = _integer(block.get("blockSize", "0"))
        path = self._binary_file()
        if offset < 0 or distance < size:
            raise ValueError("the description states an impossible place of the values")
        if length and offset + distance * (length - 1) + size > path.stat().st_size:
            raise ValuesFileError(f"file {path.name} is cut off")
        return _StoredBlock(path, _TYPES.get(kind, ""), order, offset, distance, length)

    @staticmethod
    def _bounded(length: int) -> int:
        if not 0 <= length <= _MAX_VALUES:
            raise ValueError(f"it claims {length} values")
        return length

    @cached_property
    def binary_path(self) -> Path:
        """The path of the file of values, which lies beside the description, if it is there."""
        return file_beside(self.source.path, self.file.get("url", "") or f"{self.source.path.stem}.tdx")

    def _binary_file(self) -> Path:
        path = self.binary_path
        if path.is_file():
            return path
        raise ValuesFileError(f"file {path.name} is not beside the description. {nearest_file(path)}".strip())


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _child_text(element: Element, tag: str) -> str:
    return next(((child.text or "").strip() for child in element if _tag(child) == tag), "")


def _no_numbers() -> Float:
    return np.empty(0)


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number") from None
