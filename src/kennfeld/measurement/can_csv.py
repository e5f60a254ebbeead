"""Logs of CAN frames in CSV, as CSS Electronics, SavvyCAN, python-can, Kvaser and asammdf write them.

Numbers are hexadecimal, but for asammdf, whose identifiers are decimal; its bytes are too if they stand in brackets.
"""

import base64
import binascii
import csv
import io
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun
from kennfeld.files.can_csv_columns import can_csv_separator, column_names
from kennfeld.measurement.bus_frames import Frames, from_rows
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.stamps import is_stamp, parse_stamps

_TIMES = ("timestampepoch", "timestamp", "timestamps", "time")
_BUSES = ("buschannel", "bus", "channel", "chn")
_IDENTIFIERS = ("id", "arbitrationid")
_EXTENDED = ("ide", "extended")
_DATA = ("databytes", "data")
_REMOTE = ("remote", "error")
_MOST_BYTES = 64
_LARGEST = (1 << 29) - 1
_STANDARD = 0x7FF
_EPOCH = 1e8  # s; larger times count from 1970
_MICROSECONDS = 1e6
_DIGITS = 6
_STATED = re.compile(r"[\[(]\s*(hex|dec)", re.IGNORECASE)
_IDENTIFIER = re.compile(r"(?!0x$)(?P<mark>0x)?(?P<digits>[\da-f]+)(?P<extended>x?)h?", re.IGNORECASE)
_BYTES = re.compile(r"(?:(?:0x)?[\da-f]+[\s,;:-]*)*", re.IGNORECASE)
_DIGITS_OF_BYTE = re.compile(r"(?:0x)?([\da-f]+)", re.IGNORECASE)
_HEXADECIMAL = re.compile(r"[\da-f]*[a-f][\da-f]*", re.IGNORECASE)


class _Row(NamedTuple):
    time: float
    bus: int
    identifier: int
    extended: bool
    content: bytes


class _NumberBases(NamedTuple):
    """The bases of the numbers of a log."""

    identifier: int
    data: int


def read_frames(source: MeasurementFile) -> tuple[list[Frames], list[Finding]]:
    """Return the frames of a log; a warning if rows of it are damaged."""
    head, lines, table = _read_rows(source)
    names = column_names(head)
    numbers, clock = _find_bases(head, names, table), _Clock()
    rows: list[_Row] = []
    damaged: list[int] = []
    for line, cells in zip(lines, table, strict=True):
        try:
            row = _row(dict(zip(names, cells, strict=False)), numbers, clock)
            if row is not None:
                rows.append(row)
        except (ValueError, IndexError, KeyError, binascii.Error):
            damaged.append(line)
    findings = []
    if damaged:
        message = f"{count_noun(len(damaged), 'row')} cannot be read as a frame, the first in line {damaged[0]}"
        if not rows:
            raise InputError.of(source.location, message, "Is it a log of CAN frames?")
        findings.append(Finding(source.location, message, "The other rows are read.", severity="warning"))
    return ([_frames(rows, _is_in_microseconds(source), is_dated=clock.is_dated is True)] if rows else []), findings


def _read_rows(source: MeasurementFile) -> tuple[list[str], list[int], list[list[str]]]:
    """Return the cells of the first line, and line number and cells of each row."""
    lines: list[int] = []
    table: list[list[str]] = []
    with source.open() as raw, io.TextIOWrapper(raw, encoding="utf-8-sig", errors="replace", newline="") as text:
        head = text.readline()
        separator = can_csv_separator(head) or ","
        reader = csv.reader((line.replace("\0", "") for line in text), delimiter=separator, skipinitialspace=True)
        while True:
            try:
                cells = next(reader, None)
            except csv.Error:
                # a row that the parser refuses is counted as one without a frame
                cells = ["damaged"]
            if cells is None:
                break
            if any(map(str.strip, cells)):
                # the head was read before, which the reader does not count
                lines.append(reader.line_num + 1)
                table.append([cell.strip() for cell in cells])
    return head.split(separator), lines, table


def _is_in_microseconds(source: MeasurementFile) -> bool:
    """Return whether times are whole microseconds, as SavvyCAN writes them under `Time Stamp`."""
    return b"time stamp" in source.start(1024).splitlines()[0].lower()


def _find_bases(head: Sequence[str], names: Sequence[str], table: Sequence[Sequence[str]]) -> _NumberBases:
    """Return the bases of identifiers and bytes, as the head states them, else by the program and by their digits."""
    bases = _usual_bases(names, table)
    for name, cell in zip(names, head, strict=True):
        if name in _IDENTIFIERS and (stated := _STATED.search(cell)):
            bases = bases._replace(identifier=16 if stated[1].casefold() == "hex" else 10)
    return bases


def _usual_bases(names: Sequence[str], table: Sequence[Sequence[str]]) -> _NumberBases:
    if "eventtype" in names:  # the trace of asammdf
        return _NumberBases(10, 16)
    data = [k for k, name in enumerate(names) if name in _DATA]
    if any(row[k].startswith("[") for row in table[:100] for k in data if k < len(row)):
        return _NumberBases(10, 10)
    if "d0" not in names:
        return _NumberBases(16, 16)
    bytes_at = [k for k, name in enumerate(names) if re.fullmatch(r"d\d+", name)]
    cells = [row[k] for row in table for k in bytes_at if k < len(row)]
    # a byte has two hexadecimal digits, or up to three decimal ones
    if any(map(_HEXADECIMAL.fullmatch, cells)) or not any(len(cell) == 3 for cell in cells):
        return _NumberBases(16, 16)
    return _NumberBases(10, 10)


class _Clock:
    """Reads time stamps: all are numbers as the first one is, or all are dates."""

    def __init__(self) -> None:
        self.is_dated: bool | None = None
        self._origin: int | None = None  # day

    def seconds(self, text: str) -> float:
        """Return the seconds of a number, or since the first day; `ValueError` for other text."""
        if self.is_dated is None:
            self.is_dated = is_stamp(text)
        if not self.is_dated:
            value = float(text)
        else:
            stamps = parse_stamps([text], self._origin)
            value = np.nan if stamps is None else float(stamps[0][0])
            self._origin = self._origin if stamps is None else stamps[1]
        if not np.isfinite(value):
            raise ValueError("time")
        return value


def _row(row: dict[str, str], numbers: _NumberBases, clock: _Clock) -> _Row | None:
    """Return the frame in a row; None if it has no data."""
    if any(row.get(name, "0").casefold() not in ("0", "false", "") for name in _REMOTE):
        return None
    if row.get("eventtype", "CAN Frame") != "CAN Frame":
        return None
    number = _IDENTIFIER.fullmatch(_first(row, _IDENTIFIERS))
    if number is None:
        raise ValueError("identifier")
    identifier = int(number["digits"], 16 if number["mark"] else numbers.identifier)
    if not 0 <= identifier <= _LARGEST:
        raise ValueError("identifier")
    # Vector marks identifiers of 29 bits by an x behind them
    stated = _first(row, _EXTENDED).casefold() or ("1" if number["extended"] else "")
    extended = stated in ("1", "true") or (not stated and identifier > _STANDARD)
    content = _content(row, numbers.data)
    bus = re.sub(r"\D", "", _first(row, _BUSES)) or "0"
    return _Row(clock.seconds(_first(row, _TIMES)), min(int(bus), 255), identifier, extended, content)


def _first(row: dict[str, str], names: Sequence[str]) -> str:
    return next((row[name] for name in names if name in row), "")


def _content(row: dict[str, str], base: int) -> bytes:
    """Return the payload: hexadecimal digits, numbers in brackets, one column a byte, or base64 beside 0x."""
    if "d1" in row:
        stated = row.get("len") or row.get("dlc") or row.get("datalength")
        # without a length, the row ends with its last byte
        size = int(stated) if stated else sum(bool(re.fullmatch(r"d\d+", name) and cell) for name, cell in row.items())
        if not 0 <= size <= _MOST_BYTES:
            raise ValueError("length")
        # SavvyCAN counts the bytes from D1
        first = 0 if "d0" in row else 1
        return bytes(int(row[f"d{first + k}"], base) for k in range(size))
    text = _first(row, _DATA)
    if row.get("arbitrationid", "").casefold().startswith("0x") and not _is_hexadecimal(text, row):
        content = base64.b64decode(text, validate=True)
    # bytes in brackets are separated by blanks
    elif base == 10:
        content = bytes(map(int, text.strip("[]").split()))
    else:
        content = _bytes_of(text)
    if len(content) > _MOST_BYTES:
        raise ValueError("length")
    return content[: int(row["datalength"])] if row.get("datalength") and base == 10 else content


def _bytes_of(text: str) -> bytes:
    """Return bytes of hexadecimal digits: `0A00FF`, `0A 00 FF`, `0A-00-FF`, `0x0A 0x00 0xFF`; else `ValueError`."""
    if not _BYTES.fullmatch(text):
        raise ValueError("data")
    parts = _DIGITS_OF_BYTE.findall(text)
    return bytes.fromhex(parts[0]) if len(parts) == 1 else bytes(int(part, 16) for part in parts)


def _is_hexadecimal(text: str, row: dict[str, str]) -> bool:
    """Return whether a payload is as long as stated if its digits are hexadecimal, not base64 as of python-can."""
    try:
        return len(_bytes_of(text)) == int(row.get("dlc") or row.get("len") or row.get("datalength") or -1)
    except ValueError:
        return False


def _frames(rows: Sequence[_Row], in_microseconds: bool, is_dated: bool) -> Frames:
    """Return the frames; dates and times since 1970 are made to count from the first one."""
    time = np.array([row.time for row in rows])
    if in_microseconds:
        time = time / _MICROSECONDS
    if is_dated or time[0] > _EPOCH:
        time = np.round(time - time[0], _DIGITS)
    columns = (
        np.array([row.bus for row in rows], dtype=np.uint8),
        np.array([row.identifier for row in rows], dtype=np.int64),
        np.array([row.extended for row in rows], dtype=np.uint8),
        np.array([len(row.content) for row in rows], dtype=np.uint8),
    )
    return from_rows("CAN", time, *columns, bytearray(b"".join(row.content for row in rows)))
