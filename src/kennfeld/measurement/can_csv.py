"""Logs of CAN frames in CSV, as CSS Electronics, SavvyCAN and python-can write them: identifiers are hexadecimal."""

import base64
import binascii
import io
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.files.recordings import can_csv_separator
from kennfeld.formatting import count_noun
from kennfeld.measurement.bus_frames import Frames, from_rows
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.source import MeasurementFile

_TIMES = ("timestampepoch", "time stamp", "timestamp", "timestamps", "time")
_BUSES = ("buschannel", "bus", "channel")
_IDENTIFIERS = ("id", "arbitration_id")
_EXTENDED = ("ide", "extended")
_DATA = ("databytes", "data")
_REMOTE = ("remote", "error")
_MOST_BYTES = 64
_LARGEST = (1 << 29) - 1
_STANDARD = 0x7FF
_EPOCH = 1e8  # s; larger times count from 1970
_MICROSECONDS = 1e6
_DIGITS = 6


class _Row(NamedTuple):
    time: float
    bus: int
    identifier: int
    extended: bool
    content: bytes


def read_frames(source: MeasurementFile) -> tuple[list[Frames], list[Finding]]:
    """Return the frames of a log; a warning if rows of it are damaged."""
    rows: list[_Row] = []
    damaged: list[int] = []
    with source.open() as raw, io.TextIOWrapper(raw, encoding="utf-8-sig", errors="replace") as text:
        head = next(text, "").rstrip("\r\n")
        separator = can_csv_separator(head) or ","
        names = [name.strip().casefold() for name in split_line(head, separator)]
        for number, line in enumerate(text, 2):
            if not line.strip():
                continue
            try:
                row = _row(names, split_line(line.rstrip("\r\n"), separator))
            except (ValueError, IndexError, binascii.Error):
                damaged.append(number)
                continue
            if row is not None:
                rows.append(row)
    findings = []
    if damaged:
        message = f"{count_noun(len(damaged), 'row')} cannot be read as a frame, the first in line {damaged[0]}"
        if not rows:
            raise InputError.of(source.location, message, "Is it a log of CAN frames?")
        findings.append(Finding(source.location, message, "The other rows are read.", severity="warning"))
    return ([_frames(rows, "time stamp" in names)] if rows else []), findings


def _row(names: Sequence[str], cells: Sequence[str]) -> _Row | None:
    """Return the frame in a row; None if it has no data."""
    row = {name: cell.strip() for name, cell in zip(names, cells, strict=False) if name}
    if any(row.get(name, "0").casefold() not in ("0", "false", "") for name in _REMOTE):
        return None
    identifier = int(_first(row, _IDENTIFIERS), 16)
    if not 0 <= identifier <= _LARGEST:
        raise ValueError("identifier")
    stated = _first(row, _EXTENDED).casefold()
    extended = stated in ("1", "true") or (not stated and identifier > _STANDARD)
    content = _content(row)
    bus = re.sub(r"\D", "", _first(row, _BUSES)) or "0"
    return _Row(float(_first(row, _TIMES)), min(int(bus), 255), identifier, extended, content)


def _first(row: dict[str, str], names: Sequence[str]) -> str:
    return next((row[name] for name in names if name in row), "")


def _content(row: dict[str, str]) -> bytes:
    """Return the payload: hexadecimal digits, one column a byte, or base64 beside an identifier with 0x."""
    if "d1" in row:
        size = int(row.get("len") or row.get("dlc") or 0)
        if not 0 <= size <= _MOST_BYTES:
            raise ValueError("length")
        return bytes(int(row[f"d{k}"], 16) for k in range(1, size + 1))
    text = _first(row, _DATA)
    if row.get("arbitration_id", "").casefold().startswith("0x"):
        content = base64.b64decode(text, validate=True)
    else:
        content = bytes.fromhex(text)
    if len(content) > _MOST_BYTES:
        raise ValueError("length")
    return content


def _frames(rows: Sequence[_Row], in_microseconds: bool) -> Frames:
    """Return the frames; times that count from 1970 are made to count from the first one."""
    time = np.array([row.time for row in rows])
    if in_microseconds:
        time = time / _MICROSECONDS
    if time[0] > _EPOCH:
        time = np.round(time - time[0], _DIGITS)
    columns = (
        np.array([row.bus for row in rows], dtype=np.uint8),
        np.array([row.identifier for row in rows], dtype=np.int64),
        np.array([row.extended for row in rows], dtype=np.uint8),
        np.array([len(row.content) for row in rows], dtype=np.uint8),
    )
    return from_rows("CAN", time, *columns, bytearray(b"".join(row.content for row in rows)))
