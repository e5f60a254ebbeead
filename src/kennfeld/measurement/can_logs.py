"""Logs of CAN frames: Vector ASC and BLF, PEAK TRC, candump and CSV, decoded by databases.

The frames of text logs are read by python-can, of the extra `bus`.
"""

import io
import re
from array import array
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun, reason_of
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.quiet_loggers import quiet_loggers
from kennfeld.files.encoding import decode
from kennfeld.files.recordings import ASC, ASC_HEADER, BLF, CAN_CSV, CANDUMP, TRC
from kennfeld.measurement import blf, can_csv
from kennfeld.measurement.bus_decoding import BusLog
from kennfeld.measurement.bus_frames import Frames, from_rows
from kennfeld.measurement.channel_names import choose
from kennfeld.measurement.log_start_time import asc_start_time, blf_start_time
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription

_READERS = {ASC: "ASCReader", TRC: "TRCReader", CANDUMP: "CanutilsLogReader"}
_FROM_ZERO = (ASC,)  # kinds whose channels the library counts from 0
_START_TIMES = {ASC: asc_start_time, BLF: blf_start_time}
_RESUMABLE = (ASC, CANDUMP)  # kinds of which the library can read on after a damaged line
_MOST_DAMAGED = 1000  # lines
_RELATIVE_TIME = "each time stamp counts from the event before, and events that are not frames are skipped with theirs"
_ABSOLUTE = "Export the log with absolute time stamps."
_COPY = "Copy the file again from its source."
_LARGEST = (1 << 29) - 1  # identifier
_MOST_BYTES = 64
_NO_END = "the last line has no line break: the log seems to be cut off; the frames before its end are read"
_EPOCH = 1e8  # s; larger times count from 1970
_DIGITS = 6  # of such times in s: they are not known to more
_RELATIVE = "relative"


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each message that holds a requested signal."""
    log = _read_log(source)
    begin = _START_TIMES[source.format](source.start()) if source.format in _START_TIMES else None
    tables = log.tables(choose(source, log.named_channels(), selection, log.explain))
    return [replace(table, start_time=begin) for table in tables]


def describe_tables(source: MeasurementFile) -> Iterator[TableDescription]:
    """Return a description of each message."""
    log = _read_log(source)
    return log.descriptions(log.named_channels())


def _read_log(source: MeasurementFile) -> BusLog:
    own = {BLF: blf.read_frames, CAN_CSV: can_csv.read_frames}
    frames, findings = own.get(source.format, _read_text)(source)
    if not any(map(len, frames)):
        raise InputError.of(source.location, "holds no data frames of a CAN bus", "Is it the right file?")
    return BusLog(source, frames, findings)


class _Columns:
    """Collects frames as the library yields them."""

    def __init__(self, from_zero: bool) -> None:
        self._shift = 1 if from_zero else 0
        # packed arrays: a log has millions of frames, and lists of numbers would take several times the memory
        self.time, self.lengths, self.content = array("d"), bytearray(), bytearray()
        self._buses, self._identifiers, self._extended = bytearray(), array("L"), bytearray()

    def add(self, message: Any) -> None:
        """Take a message; those without data are no frames of signals."""
        if message.is_error_frame or message.is_remote_frame:
            return
        content = bytes(message.data[:_MOST_BYTES])
        if not 0 <= message.arbitration_id <= _LARGEST:
            raise ValueError(f"the identifier {message.arbitration_id} is not one of a frame")
        self.time.append(message.timestamp)
        self._buses.append(self._bus(message.channel))
        self._identifiers.append(message.arbitration_id)
        self._extended.append(message.is_extended_id)
        self.lengths.append(len(content))
        self.content += content

    def _bus(self, channel: object) -> int:
        """Return the number of a channel from 1 on; `can0` is the first one."""
        if isinstance(channel, int):
            number = channel + self._shift
        else:
            digits = re.search(r"\d{1,3}\Z", str(channel or ""))
            number = int(digits[0]) + 1 if digits else 0
        # one byte a frame holds the channel, and a damaged line may state any number
        return min(max(number, 0), 255)

    def frames(self, *, is_relative: bool) -> Frames:
        """Return all frames; `is_relative` if each time stamp counts from the one before.

        Times that count from 1970 are made to count from the first frame.
        """
        time = np.array(self.time, dtype=np.float64)
        columns = (np.frombuffer(part, np.uint8) for part in (self._buses, self._extended, self.lengths))
        buses, extended, lengths = columns
        identifiers = np.array(self._identifiers, dtype=np.int64)
        with np.errstate(over="ignore", invalid="ignore"):  # of a damaged file
            if is_relative:
                time = np.cumsum(time)
            elif time.size and time[0] > _EPOCH:
                time = np.round(time - time[0], _DIGITS)
        return from_rows("CAN", time, buses, identifiers, extended, lengths, self.content)


def _read_text(source: MeasurementFile) -> tuple[list[Frames], list[Finding]]:
    """Return the frames of a text log; a warning if lines of it are damaged or the last one is cut off."""
    reader_class = _load(source)
    header: dict[str, str] = {}
    is_relative = False
    if source.format is ASC:
        base, is_relative = _asc_header(source)
        header = {"base": base}
    columns, problems = _Columns(source.format in _FROM_ZERO), list[str]()
    with (
        quiet_loggers("can"),
        source.open() as raw,
        io.TextIOWrapper(raw, encoding="utf-8", errors="replace") as text,
    ):
        reader = reader_class(text, **header)
        # an exception ends the library's generator; the next one reads on from the following line of the text
        while not (done := _collect(reader, columns, problems)):
            if source.format not in _RESUMABLE or len(problems) >= _MOST_DAMAGED:
                break
    frames = [columns.frames(is_relative=is_relative)] if columns.time else []
    findings = [Finding(source.location, _RELATIVE_TIME, _ABSOLUTE, severity="warning")] if is_relative else []
    if frames and not problems and not _ends_with_line_break(source):
        findings.append(Finding(source.location, _NO_END, _COPY, severity="warning"))
    if not problems:
        return frames, findings
    message = f"{count_noun(len(problems), 'line')} cannot be read, the first one because of {problems[0]}"
    if not frames:
        raise InputError.of(source.location, message, _COPY)
    rest = "the other frames are read" if done else f"only the {len(columns.time)} frames before are read"
    return frames, [*findings, Finding(source.location, f"{message}; {rest}", _COPY, severity="warning")]


def _ends_with_line_break(source: MeasurementFile) -> bool:
    with source.open() as raw:
        raw.seek(-1, io.SEEK_END)
        return raw.read(1) in b"\r\n"


def _collect(reader: Any, columns: _Columns, problems: list[str]) -> bool:
    """Take frames up to the end, or up to a damaged line; return whether it is the end."""
    try:
        for message in reader:
            columns.add(message)
    # these concern the file or its archive, not one line
    except (EOFError, OSError):
        raise
    except Exception as error:  # of many kinds: the library trusts what it reads
        problems.append(reason_of(error))
        return False
    return True


def _load(source: MeasurementFile) -> Any:
    """Return the class of the library that reads the frames."""
    with optional_package(source.location, "bus"):
        import can
    reader = getattr(can, _READERS[source.format])
    # its own search for the header takes the first frame for a line of it, also after a damaged line
    return type("Reader", (reader,), {"_extract_header": lambda self: None}) if source.format is ASC else reader


def _asc_header(source: MeasurementFile) -> tuple[str, bool]:
    """Return the base of the numbers in an ASC log, `hex` or `dec`, and whether its time stamps are relative."""
    match = ASC_HEADER.search(decode(source.start(), whole=False))
    if match is None:
        return "hex", False
    return match["base"].lower(), (match["stamps"] or "").lower() == _RELATIVE
