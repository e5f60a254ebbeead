"""Reader of `.ld` files of MoTeC's loggers.

The layout is that of the public reader ldparser: a header with the address of the first channel, then a list of
channels, each with address, number and type of its samples and its rate. All numbers are little-endian; a physical
value is (raw * 10^-decimals / scale + shift) * multiplier.
"""

import struct
from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.mlg import plain_text
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, UnreadableChannel, tables_of
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table

_FIRST = struct.Struct("<I")  # address of the first channel, at byte 8
# previous, next, begin, samples, sort, width, rate, shift, multiplier, scale, decimals, name, short name, unit
_CHANNEL = struct.Struct("<IIII2xHHHhhhh32s8s12s")
_DATE = slice(94, 110)
_FLOATS = {2: "<f2", 4: "<f4"}
_INTEGERS = {2: "<i2", 4: "<i4"}
_FLOATING, _WHOLE = (7,), (0, 3, 5)
_MOST_CHANNELS = 100_000
_MOST_DECIMALS = 30  # more than a double has, and few enough that no value overflows
_COPY_AGAIN = "Copy it again from the logger."


@dataclass(frozen=True)
class _LogChannel:
    """A channel: its name, unit and rate in Hz, and where its samples are."""

    name: str
    unit: str
    rate: int
    begin: int
    samples: int
    kind: str  # of a sample; empty if it is unknown
    shift: int
    multiplier: int
    scale: int
    decimals: int


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each rate with a requested channel."""
    content = np.memmap(source.path, np.uint8, mode="r")
    channels = list(_channels(source, content))
    unknown = [
        UnreadableChannel(channel.name, "has samples of an unknown type", "Export it as CSV from MoTeC i2.")
        for channel in channels
        if not channel.kind
    ]
    return tables_of(source, _groups(content, [c for c in channels if c.kind and c.samples]), selection, unknown)


def _channels(source: MeasurementFile, content: NDArray[np.uint8]) -> Iterator[_LogChannel]:
    """Yield the channels of the list that begins at the address in the header."""
    if content.size < 12:
        raise InputError.of(source.location, "the MoTeC log is cut off", _COPY_AGAIN)
    (at,) = _FIRST.unpack(content[8:12].tobytes())
    seen: set[int] = set()
    while at:
        if at in seen or len(seen) > _MOST_CHANNELS or at + _CHANNEL.size > content.size:
            message = f"the MoTeC log is damaged: after {count_noun(len(seen), 'channel')} there is none at byte {at}"
            raise InputError.of(source.location, message, _COPY_AGAIN)
        seen.add(at)
        _, following, *fields = _CHANNEL.unpack(content[at : at + _CHANNEL.size].tobytes())
        yield _channel(source, content.size, *fields)
        at = following


def _channel(
    source: MeasurementFile,
    size: int,
    begin: int,
    samples: int,
    sort: int,
    width: int,
    rate: int,
    shift: int,
    multiplier: int,
    scale: int,
    decimals: int,
    *texts: bytes,
) -> _LogChannel:
    name = plain_text(texts[0]) or plain_text(texts[1]) or f"channel at byte {begin}"
    kinds = _FLOATS if sort in _FLOATING else _INTEGERS if sort in _WHOLE else {}
    kind = kinds.get(width, "")
    problem = ""
    if kind and begin + samples * width > size:
        problem = f"claims {samples} samples from byte {begin}, but the file has {size} bytes"
    elif not rate and samples:
        problem = "has no rate"
    elif not scale:
        problem = "has a scale of 0"
    elif abs(decimals) > _MOST_DECIMALS:
        problem = f"has {decimals} decimals"
    if problem:
        location = source.location.within(f"channel {name}")
        raise InputError.of(location, f"the MoTeC log is damaged or cut off: it {problem}", _COPY_AGAIN)
    return _LogChannel(name, plain_text(texts[2]), rate, begin, samples, kind, shift, multiplier, scale, decimals)


def _groups(content: NDArray[np.uint8], channels: list[_LogChannel]) -> list[RecordedGroup]:
    """Return the channels of one rate and length as a group; its path is the rate if there are several."""
    rasters: dict[tuple[int, int], list[_LogChannel]] = {}
    for channel in channels:
        rasters.setdefault((channel.rate, channel.samples), []).append(channel)
    groups = []
    for (rate, samples), members in rasters.items():
        path = f"{rate} Hz" if len(rasters) > 1 else ""
        recorded = [
            RecordedChannel(c.name, f"{path}/{c.name}".lstrip("/"), c.unit, partial(_values, content, c))
            for c in members
        ]
        groups.append(RecordedGroup(path, samples, recorded, partial(_time, samples, rate)))
    return groups


def _time(samples: int, rate: int) -> Float:
    return np.arange(samples) / rate


def _values(content: NDArray[np.uint8], channel: _LogChannel) -> Float:
    kind = np.dtype(channel.kind)
    raw = content[channel.begin : channel.begin + channel.samples * kind.itemsize].view(kind)
    with np.errstate(invalid="ignore"):
        values = raw.astype(np.float64)
    values[np.isnan(values)] = np.nan
    if (channel.decimals, channel.scale) != (0, 1):
        values = values / (channel.scale * 10.0**channel.decimals)
    physical: Float = (values + channel.shift) * channel.multiplier
    return physical
