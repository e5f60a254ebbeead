"""Reader of FAMOS files of imc, version 2: `|` with key, version, length and content, then the next key.

The meaning of the keys is that which the public reader IMCtermite documents. A channel is a group of components (CG):
one with the values, and a second one with their abscissa if that is not even. A component has a buffer (Cb) within
the raw data (CS), the type of its samples (CP), a scale and a unit (CR) and a name (CN). Texts follow their length.
"""

from collections.abc import Callable, Iterator
from dataclasses import field
from datetime import UTC, datetime
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, UnreadableChannel, tables_of
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.unit_text import in_seconds

_TYPES = {
    1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8", 11: "u2", 12: "u8", 13: "u6", 14: "i8",
}  # fmt: skip
_SIX = "u6"  # an unsigned integer of six bytes, as the abscissa of events
_MOTOROLA = 2
_DIGITS = 6  # of the seconds between two triggers, both of which count from a distant date
_CODE_PAGE = "cp1252"
_EXPORT = "Export it as MDF or CSV."
_COPY_AGAIN = "Copy or export it again."


class FamosError(ValueError):
    """A file is damaged; the text describes the damage."""


@dataclass
class _Component:
    """A component: where its samples are, in which type, and what they mean."""

    begin: int = 0  # of its buffer in the raw data
    size: int = 0  # bytes of its buffer
    first: int = 0  # byte of the first sample in the buffer, which is a ring
    filled: int = 0  # bytes
    sample: int = 1  # number of its raw data
    origin: float = 0.0  # abscissa of the first sample
    delay: float = 0.0  # s from the trigger to the buffer
    buffers: int = 1
    width: int = 0
    kind: int = 0
    mask: int = 0
    skip: int = 0  # bytes before the first sample
    run: int = 1  # samples without a gap
    gap: int = 0  # bytes
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    step: float | None = None
    step_unit: str = ""
    trigger: float | None = None  # s since 1970


@dataclass
class _Curve:
    """The components of a channel, and its names with the numbers of their bits, from 1 on, 0 for all."""

    components: list[_Component] = field(default_factory=list)
    names: list[tuple[str, str, int]] = field(default_factory=list)
    step: float | None = None
    step_unit: str = ""
    trigger: float | None = None


class _Key(NamedTuple):
    name: str
    version: int
    begin: int
    end: int


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each time with a requested channel."""
    content = np.memmap(source.path, np.uint8, mode="r")
    try:
        file = _FamosFile(content)
        return tables_of(source, file.groups(), selection, file.unreadable)
    except (FamosError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        message = f"the FAMOS file is damaged or cut off: {' '.join(str(error).split())[:160]}"
        raise InputError.of(source.location, message, _COPY_AGAIN) from None


class _FamosFile:
    """The curves of a file."""

    def __init__(self, content: NDArray[np.uint8]) -> None:
        self.content = content
        self.curves: list[_Curve] = []
        self.unreadable: list[UnreadableChannel] = []
        self._raw: dict[int, tuple[int, int]] = {}
        self._order = "<"
        self._page = _CODE_PAGE
        self._group = _Curve()
        self._step: tuple[float | None, str] = None, ""
        self._trigger: float | None = None
        readers: dict[str, Callable[[_Key, _Fields], None]] = {
            "CF": self._read_format, "CG": self._read_group, "CD": self._read_abscissa, "NT": self._read_trigger,
            "CC": self._read_component, "CP": self._read_packing, "Cb": self._read_buffer, "CR": self._read_scale,
            "CN": self._read_name, "CS": self._read_samples, "NL": self._read_language,
        }  # fmt: skip
        for key in _keys(content):
            if key.name in readers:
                readers[key.name](key, _Fields(content, key, self._page))

    def _read_format(self, key: _Key, fields: "_Fields") -> None:
        if key.version != 2:
            return
        if fields.integer() == _MOTOROLA:
            self._order = ">"

    def _read_language(self, key: _Key, fields: "_Fields") -> None:
        page = fields.integer()
        try:
            "".encode(f"cp{page}")
        except LookupError:
            return
        self._page = f"cp{page}"

    def _read_group(self, key: _Key, fields: "_Fields") -> None:
        self._group = _Curve(trigger=self._trigger)
        self.curves.append(self._group)

    def _read_abscissa(self, key: _Key, fields: "_Fields") -> None:
        step, _, unit = fields.number(), fields.integer(), fields.text()
        # a key behind a component belongs to it, one before the first component to the whole group
        if self._group.components:
            self._group.components[-1].step, self._group.components[-1].step_unit = step, unit
        else:
            self._group.step, self._group.step_unit = step, unit

    def _read_trigger(self, key: _Key, fields: "_Fields") -> None:
        day, month, year, hour, minute = (fields.integer() for _ in range(5))
        start = datetime(year, month, day, hour, minute, tzinfo=UTC).timestamp() + fields.number()
        if self._group.components:
            self._group.components[-1].trigger = start
        else:
            # a trigger outside of a component is that of the following groups, too
            self._group.trigger = self._trigger = start

    def _read_component(self, key: _Key, fields: "_Fields") -> None:
        self._group.components.append(_Component())

    def _current(self, key: _Key) -> _Component:
        if not self._group.components:
            raise FamosError(f"the key {key.name} at byte {key.begin} belongs to no component")
        return self._group.components[-1]

    def _read_packing(self, key: _Key, fields: "_Fields") -> None:
        own = self._current(key)
        _, own.width, own.kind, _, own.mask, own.skip, own.run, own.gap = (fields.integer() for _ in range(8))

    def _read_buffer(self, key: _Key, fields: "_Fields") -> None:
        own = self._current(key)
        own.buffers, _, _, own.sample, own.begin, own.size, own.first, own.filled, _ = (
            fields.integer() for _ in range(9)
        )
        own.origin, own.delay = fields.number(), fields.number()

    def _read_scale(self, key: _Key, fields: "_Fields") -> None:
        own = self._current(key)
        is_scaled, factor, offset, _, own.unit = (
            fields.integer(), fields.number(), fields.number(), fields.integer(), fields.text(),
        )  # fmt: skip
        if is_scaled:
            own.factor, own.offset = factor, offset

    def _read_name(self, key: _Key, fields: "_Fields") -> None:
        _, _, bit = (fields.integer() for _ in range(3))
        self._group.names.append((fields.text(), fields.text(), bit))

    def _read_samples(self, key: _Key, fields: "_Fields") -> None:
        number = fields.integer()
        self._raw[number] = fields.at, key.end

    def groups(self) -> list[RecordedGroup]:
        """Return the channels of equal times as groups."""
        triggers = [trigger for curve in self.curves if (trigger := _trigger(curve)) is not None]
        earliest = min(triggers, default=0.0)
        rasters: dict[tuple[object, ...], list[tuple[_Curve, Callable[[], Float] | None, int]]] = {}
        for number, curve in enumerate(self.curves):
            problem = self._problem(curve)
            if problem:
                names = curve.names or [("without a name", "", 0)]
                self.unreadable += [UnreadableChannel(name, problem, _EXPORT) for name, _, _ in names]
                continue
            samples = self._count(curve.components[0])
            if samples:
                key, time = self._time(curve, number, samples, earliest)
                rasters.setdefault((samples, *key), []).append((curve, time, samples))
        return [self._recorded(members, number, len(rasters)) for number, members in enumerate(rasters.values(), 1)]

    def _recorded(
        self, members: list[tuple[_Curve, Callable[[], Float] | None, int]], number: int, groups: int
    ) -> RecordedGroup:
        path = f"group {number}" if groups > 1 else ""
        channels = [channel for curve, _, _ in members for channel in self._channels(curve, path)]
        _, time, samples = members[0]
        return RecordedGroup(path, samples, channels, time)

    def _channels(self, curve: _Curve, path: str) -> Iterator[RecordedChannel]:
        values, *others = curve.components
        for name, comment, bit in curve.names or [("channel", "", 0)]:
            place = f"{path}/{name}".lstrip("/")
            if bit:
                yield RecordedChannel(name, place, "", partial(self._bit, values, bit), comment)
            else:
                yield RecordedChannel(name, place, values.unit, partial(self._values, values), comment)
        name = curve.names[0][0] if curve.names else "channel"
        if others and in_seconds(others[0].unit) is None:
            yield RecordedChannel(f"{name} x", f"{path}/{name} x", others[0].unit, partial(self._values, others[0]))

    def _time(
        self, curve: _Curve, number: int, samples: int, earliest: float
    ) -> tuple[tuple[object, ...], Callable[[], Float] | None]:
        """Return what tells the time of a curve from that of others, and the time in s, None if it has none."""
        first, *others = curve.components
        trigger = _trigger(curve)
        shift = 0.0 if trigger is None else round(trigger - earliest, _DIGITS)
        if others:
            scale = in_seconds(others[0].unit)
            if scale is None:
                return (number,), None
            return (number,), lambda: shift + self._values(others[0]) * scale[0] / scale[1]
        step = curve.step if first.step is None else first.step
        unit = curve.step_unit if first.step is None else first.step_unit
        scale = in_seconds(unit)
        if step is None or step <= 0 or scale is None:
            return ("no time",), None
        times = partial(_even_times, shift, first.origin, step, samples, scale)
        return (step, unit, first.origin, shift), times

    def _problem(self, curve: _Curve) -> str:
        """Return why a curve cannot be read; empty if it can."""
        if not 1 <= len(curve.components) <= 2:
            return f"has {len(curve.components)} components"
        counts = {self._count(component) for component in curve.components}
        for component in curve.components:
            if component.kind not in _TYPES or component.width != int(_TYPES[component.kind][1:]):
                return f"has samples of type {component.kind} in {component.width} bytes, which is not supported"
            if component.buffers != 1:
                return "consists of several events"
        return "has an abscissa of another length" if len(counts) > 1 else ""

    def _count(self, component: _Component) -> int:
        """Return the number of samples; raise `FamosError` if the raw data are shorter."""
        begin, end = self._raw.get(component.sample, (0, 0))
        if min(component.begin, component.size, component.first, component.filled, component.skip, component.gap) < 0:
            raise FamosError("a buffer has a negative size")
        if component.begin + component.size > end - begin or component.filled > component.size:
            raise FamosError(f"a buffer claims {component.size} bytes from byte {component.begin} of its raw data")
        if component.width <= 0 or component.run <= 0 or component.first > component.size:
            raise FamosError("the samples of a component have no size")
        usable = component.filled - component.skip
        # `run` samples, then `gap` bytes; the last run may be shorter
        whole, rest = divmod(max(usable, 0), component.run * component.width + component.gap)
        return whole * component.run + min(rest // component.width, component.run)

    def _raws(self, component: _Component) -> NDArray[np.generic]:
        """Return the samples as they are stored."""
        begin, _ = self._raw[component.sample]
        data = self.content[begin + component.begin : begin + component.begin + component.size]
        # the oldest sample may lie anywhere in the ring
        if component.first:
            data = np.concatenate([data[component.first :], data[: component.first]])
        data = data[component.skip : component.filled]
        count, width = self._count(component), component.width
        if component.gap:
            places = np.arange(count)
            # byte of sample k: k * width, and a gap for each whole run before it
            starts = places * width + places // component.run * component.gap
            data = data[starts[:, None] + np.arange(width)]
        cells = np.ascontiguousarray(data.ravel()[: count * width])
        kind = _TYPES[component.kind]
        if kind == _SIX:
            # six bytes, least significant first, and two zeros
            wide = np.zeros((count, 8), np.uint8)
            wide[:, :6] = cells.reshape(count, 6)[:, :: 1 if self._order == "<" else -1]
            return wide.view("<u8").ravel()
        return cells.view(np.dtype(self._order + kind))

    def _values(self, component: _Component) -> Float:
        raw = self._raws(component)
        if component.mask and raw.dtype.kind in "iu":
            raw = raw & np.array(component.mask).astype(raw.dtype)
        with np.errstate(invalid="ignore"):
            values: Float = np.asarray(raw, dtype=np.float64).copy()
        # a NaN that signals would set off warnings later
        values[np.isnan(values)] = np.nan
        with np.errstate(over="ignore", invalid="ignore"):  # infinite values are reported as of all formats
            values *= component.factor
            values += component.offset
        return values

    def _bit(self, component: _Component, bit: int) -> Float:
        raw = self._raws(component)
        if raw.dtype.kind not in "iu" or bit > 8 * raw.dtype.itemsize:
            raise FamosError(f"a channel is bit {bit} of samples of {raw.dtype.itemsize} bytes")
        return ((raw.astype(np.uint64) >> np.uint64(bit - 1)) & np.uint64(1)).astype(np.float64)


def _even_times(shift: float, origin: float, step: float, samples: int, scale: tuple[float, float]) -> Float:
    times: Float = np.arange(samples, dtype=np.float64)
    times = (origin + step * times) * scale[0] / scale[1]
    return times + shift


def _trigger(curve: _Curve) -> float | None:
    """Return the time at which a curve was triggered, in s since 1970; None if the file has none."""
    if not curve.components:
        return None
    first = curve.components[0]
    trigger = curve.trigger if first.trigger is None else first.trigger
    return None if trigger is None else trigger + first.delay


class _Fields:
    """The fields of a key, separated by commas; texts follow their length and may hold commas."""

    def __init__(self, content: NDArray[np.uint8], key: _Key, page: str) -> None:
        self._content, self._key, self._page = content, key, page
        self.at = key.begin

    def _next(self) -> str:
        # far more than the characters of a number
        head = self._content[self.at : min(self.at + 64, self._key.end)].tobytes()
        cell, _, _ = head.partition(b",")
        if self.at > self._key.end:
            raise FamosError(f"the key {self._key.name} at byte {self._key.begin} has too few fields")
        self.at += len(cell) + 1
        return cell.decode("latin-1").strip()

    def integer(self) -> int:
        """Return the next field, an integer; 0 for an empty one."""
        return int(self._next() or 0)

    def number(self) -> float:
        """Return the next field, a finite number; 0 for an empty one."""
        value = float(self._next() or 0.0)
        if not np.isfinite(value):
            raise FamosError(f"the key {self._key.name} at byte {self._key.begin} holds {value}")
        return value

    def text(self) -> str:
        """Return the text after its length."""
        size = self.integer()
        if not 0 <= size <= self._key.end - self.at:
            raise FamosError(f"a text of the key {self._key.name} at byte {self._key.begin} has {size} bytes")
        raw = self._content[self.at : self.at + size].tobytes()
        self.at += size + 1
        return " ".join(raw.decode(self._page, "replace").split())


def _keys(content: NDArray[np.uint8]) -> Iterator[_Key]:
    """Yield the keys of a file with the bytes of their content."""
    at = 0
    while at < content.size:
        head = content[at : at + 64].tobytes()
        blank = len(head) - len(head.lstrip(b"\r\n\t \0"))
        if blank:
            at += blank
            continue
        parts = head.split(b",", 3)
        if not head.startswith(b"|") or len(parts) < 4 or len(parts[0]) != 3:
            raise FamosError(f"there is no key at byte {at}")
        version, size = int(parts[1]), int(parts[2])
        begin = at + sum(map(len, parts[:3])) + 3
        end = begin + size
        if size < 0 or end + 1 > content.size or content[end] != ord(";"):
            raise FamosError(f"the key {parts[0][1:].decode('latin-1')} at byte {at} claims {size} bytes")
        yield _Key(parts[0][1:].decode("latin-1"), version, begin, end)
        at = end + 1
