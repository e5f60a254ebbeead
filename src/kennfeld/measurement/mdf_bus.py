"""Bus events of MDF files (ASAM MDF 4 bus logging): groups whose records are frames, not values of signals."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.measurement.bus_databases import Network
from kennfeld.measurement.bus_frames import Frames, bytes_of_codes, joined

_EVENT = re.compile(r"((?:CAN|LIN|FLX|MOST|ETH|USB|K_LINE)_[A-Za-z]+)(?:\.|\Z)")  # begins the names of its channels
_IS_BUS = 2  # flag of a group
_DATA: dict[str, Network] = {"CAN_DataFrame": "CAN", "LIN_Frame": "LIN"}  # events with the bytes of signals
_LENGTHS = ("DataLength", "ReceivedDataByteCount")
_STANDARD = 0x7FF  # largest identifier of 11 bits
_EXTENDED = 1 << 31  # of an identifier, if there is no channel for it


def event_of(file: Any, group: int) -> str:
    """Return the bus event that a group records, `CAN_DataFrame`; nothing for a group of measured channels."""
    own = file.groups[group]
    names = {str(channel.name) for channel in own.channels}
    events = dict.fromkeys(match[1] for name in names if (match := _EVENT.match(name)))
    flagged = int(getattr(own.channel_group, "flags", 0) or 0) & _IS_BUS
    return next((event for event in events if flagged or {f"{event}.ID", f"{event}.DataBytes"} <= names), "")


def is_of_event(event: str, name: str) -> bool:
    """Return whether a channel is a part of the event, and not a signal that the logger decoded."""
    return bool(event) and (name == event or name.startswith(f"{event}."))


def read_frames(file: Any, groups: Sequence[int]) -> list[Frames]:
    """Return the data frames of all buses, by network; there may be none."""
    frames: dict[Network, list[Frames]] = {}
    for group in groups:
        event = event_of(file, group)
        if event in _DATA and (read := _read(file, group, event)) is not None:
            frames.setdefault(_DATA[event], []).append(read)
    return [joined(parts) for parts in frames.values()]


def _read(file: Any, group: int, event: str) -> Frames | None:
    """Return the frames of a group; None if it lacks identifiers or bytes."""
    own = file.groups[group].channels
    places = {str(channel.name).removeprefix(f"{event}."): index for index, channel in enumerate(own)}
    names = [name for name in ("ID", "DataBytes", *_LENGTHS, "DLC", "BusChannel", "IDE") if name in places]
    if not {"ID", "DataBytes"} <= set(names):
        return None
    select = [(None, group, places[name]) for name in names]
    # with conversions: a channel and a format that are constant are often the offset of a virtual channel
    signals = file.select(select, raw=False, copy_master=False, ignore_value2text_conversions=True)
    columns = {name: np.asarray(signal.samples) for name, signal in zip(names, signals, strict=True)}
    payload = _payload(columns["DataBytes"])
    identifier = columns["ID"].astype(np.int64)
    extended = (identifier & _EXTENDED) != 0
    if "IDE" in columns:
        extended = columns["IDE"].astype(np.int64) != 0
    # more than 11 bits are an extended identifier, whatever the file states
    extended |= (identifier & ~_EXTENDED) > _STANDARD
    bus = columns["BusChannel"].astype(np.int64) if "BusChannel" in columns else np.zeros(len(identifier), np.int64)
    time = np.asarray(signals[0].timestamps, dtype=np.float64)
    lengths = _lengths(columns, payload)
    return Frames.of(_DATA[event], time, bus, identifier, extended, lengths, payload)


def _payload(samples: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of frames, UInt8[frames, bytes]."""
    if samples.dtype.names:
        samples = samples[samples.dtype.names[0]]
    if samples.dtype.kind in "SV":
        samples = np.frombuffer(samples.tobytes(), np.uint8).reshape(len(samples), samples.dtype.itemsize)
    if samples.ndim == 1:
        samples = samples[:, np.newaxis]
    return np.ascontiguousarray(samples).view(np.uint8).reshape(len(samples), -1)


def _lengths(columns: dict[str, NDArray[Any]], payload: NDArray[np.uint8]) -> NDArray[np.integer]:
    for name in _LENGTHS:
        if name in columns:
            return np.clip(columns[name].astype(np.int64), 0, 64)
    if "DLC" in columns:
        return bytes_of_codes(columns["DLC"])
    return np.full(len(payload), min(payload.shape[1], 64))
