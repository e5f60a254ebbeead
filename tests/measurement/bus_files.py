"""Writes bus logs and CAN databases for the tests."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

DBC = """VERSION ""

BU_: ECU1 ECU2

BO_ 500 Engine: 8 ECU1
 SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" ECU2
 SG_ Temp : 16|8@1+ (1,-40) [-40|215] "degC" ECU2
 SG_ State : 24|2@1+ (1,0) [0|3] "" ECU2

BO_ 501 Gearbox: 4 ECU1
 SG_ Speed : 7|16@0- (0.5,0) [0|8000] "rpm" ECU2
 SG_ Gear : 16|4@1+ (1,0) [0|8] "" ECU2

BO_ 502 Muxed: 8 ECU1
 SG_ Mode M : 0|8@1+ (1,0) [0|3] "" ECU2
 SG_ A m0 : 8|16@1+ (0.1,0) [0|0] "bar" ECU2
 SG_ B m1 : 8|16@1- (1,0) [0|0] "K" ECU2

BO_ 2364540158 EEC1: 8 Vector__XXX
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX
 SG_ Torque : 16|8@1+ (1,-125) [-125|125] "%" Vector__XXX

CM_ SG_ 500 Speed "Speed of the
crankshaft";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2364540158 3;
VAL_ 500 State 0 "Off" 1 "On" ;
"""


class Frame(NamedTuple):
    """A frame: time in s, identifier, payload, whether it has 29 bits, and the channel from 1 on."""

    time: float
    identifier: int
    data: bytes
    extended: bool = False
    bus: int = 1


def engine(speed: float, temp: float, state: int = 1) -> bytes:
    """Return the payload of the message Engine."""
    return int(speed / 0.25).to_bytes(2, "little") + bytes([int(temp + 40), state, 0, 0, 0, 0])


def gearbox(speed: float, gear: int) -> bytes:
    """Return the payload of the message Gearbox."""
    return int(speed / 0.5).to_bytes(2, "big", signed=True) + bytes([gear, 0])


def eec1(speed: float, torque: float) -> bytes:
    """Return the payload of EEC1 of J1939."""
    return bytes([0xFF, 0xFF, int(torque + 125)]) + int(speed / 0.125).to_bytes(2, "little") + b"\xff\xff\xff"


def drive(count: int = 20) -> list[Frame]:
    """Return the frames of a drive: the engine every 10 ms, the gearbox every 20 ms."""
    return sorted(_drive(count))


def _drive(count: int) -> Iterator[Frame]:
    for k in range(count):
        yield Frame(0.01 * k, 500, engine(1000 + 10 * k, 80))
        if k % 2 == 0:
            yield Frame(0.01 * k + 0.001, 501, gearbox(-500 + 5 * k, 3))


def write_mf4(path: Path, frames: Sequence[Frame], event: str = "CAN_DataFrame", compression: int = 0) -> Path:
    """Write frames as a bus log of MDF 4."""
    from asammdf import MDF, Signal
    from asammdf.blocks.source_utils import Source

    width = max(len(frame.data) for frame in frames)
    columns = {
        "BusChannel": np.array([frame.bus for frame in frames], np.uint8),
        "ID": np.array([frame.identifier for frame in frames], np.uint32),
        "IDE": np.array([frame.extended for frame in frames], np.uint8),
        "DLC": np.array([len(frame.data) for frame in frames], np.uint8),
        "DataLength": np.array([len(frame.data) for frame in frames], np.uint8),
        "DataBytes": np.array([list(frame.data.ljust(width, b"\0")) for frame in frames], np.uint8),
    }
    types = [(f"{event}.{name}", column.dtype, column.shape[1:]) for name, column in columns.items()]
    samples = np.zeros(len(frames), dtype=types)
    for name, column in columns.items():
        samples[f"{event}.{name}"] = column
    kind = Source.BUS_TYPE_LIN if event.startswith("LIN") else Source.BUS_TYPE_CAN
    source = Source("CAN", "CAN", "", Source.SOURCE_BUS, kind)
    times = np.array([frame.time for frame in frames])
    with MDF(version="4.10") as mdf:
        mdf.append(Signal(samples, times, name=event, source=source))
        mdf.groups[0].channel_group.flags |= 6  # bus event, plain
        mdf.save(path, overwrite=True, compression=compression)
    return path


def write_log(path: Path, frames: Sequence[Frame]) -> Path:
    """Write frames by python-can, in the format of the ending."""
    import can

    writer = {".log": can.CanutilsLogWriter, ".trc": can.TRCWriter, ".asc": can.ASCWriter, ".blf": can.BLFWriter}
    with writer[path.suffix](str(path)) as log:
        for frame in frames:
            log.on_message_received(
                can.Message(
                    timestamp=1_700_000_000.0 + frame.time,
                    arbitration_id=frame.identifier,
                    data=frame.data,
                    is_extended_id=frame.extended,
                    is_fd=len(frame.data) > 8,
                    channel=frame.bus - 1,
                )
            )
    return path
