"""Writes logs of MoTeC and files of FAMOS, byte by byte."""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

_CHANNELS = 1762  # byte of the first channel, behind the header


class LogChannel(NamedTuple):
    """A channel of a MoTeC log: its samples as they are stored, and how they become physical values."""

    name: str
    unit: str
    raw: Any
    rate: int = 10
    shift: int = 0
    multiplier: int = 1
    scale: int = 1
    decimals: int = 0
    sort: int | None = None


def motec_file(channels: Sequence[LogChannel]) -> bytes:
    """Return a log of MoTeC."""
    first = _CHANNELS if channels else 0
    head = struct.pack("<I4xII20xI", 0x40, first, _CHANNELS + 124 * len(channels), 0).ljust(94, b"\0")
    head += b"28/11/2026".ljust(32, b"\0") + b"10:15:30".ljust(32, b"\0")
    places, data = b"", b""
    for number, channel in enumerate(channels):
        raw = np.asarray(channel.raw)
        at = _CHANNELS + 124 * number
        following = at + 124 if number + 1 < len(channels) else 0
        before = at - 124 if number else 0
        sort = channel.sort if channel.sort is not None else 7 if raw.dtype.kind == "f" else 3
        places += struct.pack("<IIII", before, following, _CHANNELS + 124 * len(channels) + len(data), raw.size)
        places += struct.pack("<HHHH", 0x2EE1 + number, sort, raw.dtype.itemsize, channel.rate)
        places += struct.pack("<hhhh", channel.shift, channel.multiplier, channel.scale, channel.decimals)
        texts = struct.pack("32s8s12s", channel.name.encode(), channel.name.encode()[:8], channel.unit.encode("cp1252"))
        places += texts.ljust(92, b"\0")
        data += raw.tobytes()
    return head.ljust(_CHANNELS, b"\0") + places + data


def key(name: str, *fields: Any, version: int = 1) -> bytes:
    """Return a key of a FAMOS file; a text as a field is written with its length."""
    cells = []
    for cell in fields:
        if isinstance(cell, str):
            raw = cell.encode("cp1252")
            cells += [str(len(raw)).encode(), raw]
        else:
            cells.append(cell if isinstance(cell, bytes) else repr(cell).encode())
    content = b",".join(cells)
    return f"|{name},{version},{len(content)},".encode() + content + b";\r\n"


class Component(NamedTuple):
    """A component of a FAMOS channel: its samples as they are stored, its scale and its unit."""

    raw: Any
    unit: str = ""
    factor: float | None = None
    offset: float = 0.0
    kind: int = 0


_KINDS = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8, "u8": 12, "i8": 14}


def famos_curve(
    name: str,
    *components: Component,
    step: float = 0.1,
    unit: str = "s",
    origin: float = 0.0,
    trigger: tuple[float, ...] | None = None,
    delay: float = 0.0,
    comment: str = "",
    number: int = 1,
    names: Sequence[tuple[str, int]] = (),
    order: str = "<",
) -> bytes:
    """Return the keys of a channel, with its raw data."""
    keys = key("CG", len(components), len(components), len(components))
    keys += key("CD", step, 1, unit, 0, 0, 0)
    keys += b"" if trigger is None else key("NT", *trigger)
    data = b""
    for place, component in enumerate(components, 1):
        raw = np.asarray(component.raw)
        stored = raw.astype(raw.dtype.newbyteorder(order)).tobytes()
        width, kind = raw.dtype.itemsize, component.kind or _KINDS[raw.dtype.str[1:]]
        if kind == 13:
            width, stored = 6, raw.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :6].tobytes()
        keys += key("CC", place, 1) + key("CP", place, width, kind, 8 * width, 0, 0, 1, 0)
        size = len(stored)
        keys += key("Cb", 1, 0, place, number, len(data), size, 0, size, 1, origin, delay, b"")
        scaled = component.factor is not None
        keys += key("CR", int(scaled), component.factor or 1.0, component.offset, 1, component.unit)
        if place == 1:
            for each, bit in names or [(name, 0)]:
                keys += key("CN", 0, 0, bit, each, comment)
        data += stored
    return keys + key("CS", number, data)


def famos_file(*curves: bytes, processor: int = 1) -> bytes:
    """Return a FAMOS file."""
    return key("CF", processor, version=2) + key("CK", 1, 1) + b"".join(curves)
