"""The head of an MLG file: what its records hold and where they begin.

Layout as published by EFI Analytics ("MLG Binary LogFormat") and met in files of TunerStudio. All numbers are
big-endian: `MLVLG` and a zero byte, version, Unix time, where the information begins, where the data begin, the length
of a record, how many fields it has; then the fields, of 55 bytes in version 1 and 89 in version 2; names of bits;
information.
"""

import struct
from dataclasses import dataclass

import numpy as np

from kennfeld.errors import Finding, InputError

__all__ = ["Field", "Head", "plain_text", "read_head"]

_HEADS = {1: struct.Struct(">6shIHIHH"), 2: struct.Struct(">6shIIIHH")}
_SIZES = {1: 55, 2: 89}
_NUMBER = struct.Struct(">B34s10sBffb")
_BITS = struct.Struct(">B34s10sBBIB3x")
_TYPES = {0: "u1", 1: "i1", 2: ">u2", 3: ">i2", 4: ">u4", 5: ">i4", 6: ">i8", 7: ">f4"}
# the published numbers are 10 to 12; TunerStudio writes them as if they were hexadecimal
_BIT_TYPES = {10: "u1", 11: ">u2", 12: ">u4", 16: "u1", 17: ">u2", 18: ">u4"}
_CATEGORY = slice(55, 89)
_MOST_INFORMATION = 4_000_000  # bytes


@dataclass(frozen=True)
class Field:
    """One field of a record: its value is (raw + transform) * scale; `bits` names the bits of a field of bits."""

    name: str
    unit: str
    type: str
    scale: float = 1.0
    transform: float = 0.0
    digits: int = 0
    style: int = 0
    category: str = ""
    bits: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Bytes in the record."""
        return np.dtype(self.type).itemsize


@dataclass(frozen=True)
class Head:
    """What stands before the records; `begin` is the byte of the first one, `information` a text."""

    version: int
    created: int  # Unix time in s
    fields: tuple[Field, ...]
    begin: int
    information: str

    @property
    def record(self) -> np.dtype[np.void]:
        """A record as it lies in the file: type, counter, time stamp, fields, checksum."""
        fields = [(f"{i}", field.type) for i, field in enumerate(self.fields)]
        return np.dtype([("type", "u1"), ("counter", "u1"), ("stamp", ">u2"), *fields, ("sum", "u1")])


def read_head(place: str, content: memoryview) -> Head:
    """The head of a file with this content; `InputError` with all that is wrong in it."""
    version = int.from_bytes(bytes(content[6:8]), "big")
    if version not in _HEADS:
        mend = "Log or export it anew in version 1 or 2."
        raise InputError.of(place, f"the MLG file is of version {version}, which is not known", mend)
    if len(content) < _HEADS[version].size:
        raise _cut(place, len(content), _HEADS[version].size)
    _, _, created, info, begin, length, count = _HEADS[version].unpack_from(content)
    first, size = _HEADS[version].size, _SIZES[version]
    end = first + count * size
    if end > len(content) or begin > len(content):
        raise _cut(place, len(content), max(end, begin))
    if not count or begin < end:
        what = f"the MLG file is damaged: its head names {count} fields up to byte {end}, data from byte {begin}"
        raise InputError.of(place, what, "Copy it anew from its source.")
    findings: list[Finding] = []
    fields = tuple(
        field
        for k in range(count)
        if (field := _field(place, k + 1, content, first + k * size, size, (end, begin), findings)) is not None
    )
    total = sum(field.size for field in fields)
    if not findings and total != length:
        what = f"the MLG file is damaged: its records are of {length} bytes, their fields of {total}"
        findings.append(Finding(place, what, "Copy it anew from its source."))
    if findings:
        raise InputError(findings[:20])
    text = bytes(content[info : min(begin, info + _MOST_INFORMATION)]) if end <= info <= begin else b""
    return Head(version, created, fields, begin, plain_text(text))


def _cut(place: str, size: int, needed: int) -> InputError:
    what = f"the MLG file is damaged or cut off: it has {size} bytes, its head alone needs {needed}"
    return InputError.of(place, what, "Copy it anew from its source.")


def _field(
    place: str, number: int, content: memoryview, at: int, size: int, names: tuple[int, int], findings: list[Finding]
) -> Field | None:
    kind = content[at]
    category = plain_text(bytes(content[at : at + size][_CATEGORY]))
    if kind in _BIT_TYPES:
        _, name, unit, style, _, index, count = _BITS.unpack_from(content, at)
        width = 8 * np.dtype(_BIT_TYPES[kind]).itemsize
        bits = _bit_names(content, index, min(count, width), names)
        return Field(plain_text(name), plain_text(unit), _BIT_TYPES[kind], style=style, category=category, bits=bits)
    where = f"{place} field {number}"
    if kind not in _TYPES:
        findings.append(Finding(where, f"its type {kind} is not known", "Copy the file anew from its source."))
        return None
    _, name, unit, style, scale, transform, digits = _NUMBER.unpack_from(content, at)
    if not (np.isfinite(scale) and np.isfinite(transform)):
        what = f"its scale {scale:g} and transform {transform:g} must be finite"
        findings.append(Finding(where, what, "Copy the file anew from its source."))
        return None
    called = plain_text(name) or f"field {number}"
    numbers = _decimal(scale), _decimal(transform)
    return Field(called, plain_text(unit), _TYPES[kind], *numbers, digits, style, category)


def _decimal(value: float) -> float:
    """The number that was meant: 0.1 where four bytes hold 0.10000000149."""
    return float(str(np.float32(value)))


def _bit_names(content: memoryview, index: int, count: int, region: tuple[int, int]) -> tuple[str, ...]:
    """The names of the bits, lowest first, between the fields and the data; empty ones where there are none."""
    begin, end = region
    at = index if index >= begin else begin + index
    names = bytes(content[at:end]).split(b"\0", count)[:count] if at < end else []
    return tuple(plain_text(name) for name in names) + ("",) * (count - len(names))


def plain_text(text: bytes) -> str:
    """The text up to the first zero byte, in UTF-8 or the Windows encoding."""
    text = text.partition(b"\0")[0]
    try:
        return text.decode("utf-8").strip()
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace").strip()
