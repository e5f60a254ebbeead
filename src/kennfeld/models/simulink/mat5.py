"""Variables of MAT-files of level 5, objects of classes included.

The layout is that of the "MAT-File Format" of The MathWorks; that of objects (array class 17 and the subsystem) is
described by the mat-io project. The values inside a Simulink file have the same form without the header of a file.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float

__all__ = ["Mat5Error", "Opaque", "Plain", "Reader", "Unread", "elements"]

_COMPRESSED, _MATRIX = 15, 14
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_NUMBERS = range(6, 16)
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17
_KINDS = {6: "double", 7: "single", 8: "int8", 9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32"}
_KINDS |= {14: "int64", 15: "uint64", 1: "cell", 2: "struct", 4: "char", 5: "double"}
_COMPLEX, _LOGICAL = 0x0800, 0x0200
_DEEPEST = 40
_LARGEST = 200_000_000  # bytes that a compressed variable may take
_MOST_DENSE = 4_000_000  # values of all sparse matrices together


class Mat5Error(Exception):
    """The bytes are no variable of this format; the text says what is wrong."""


@dataclass(frozen=True)
class Opaque:
    """An object of a class: what is in it stands elsewhere, under the numbers in `reference`."""

    kind: str
    reference: "Plain"


@dataclass(frozen=True)
class Unread:
    """A value of a sort that nobody here can use."""

    why: str


# numbers, texts, structs, arrays of structs or cells, objects
Plain = Float | str | Mapping[str, "Plain"] | tuple["Plain", ...] | Opaque | Unread


@dataclass(frozen=True)
class Element:
    """One data element: its type and its bytes."""

    type: int
    raw: memoryview


def elements(raw: bytes | memoryview, order: str) -> Iterator[Element]:
    """The data elements of some bytes; `order` is "<" or ">". Raises `Mat5Error` where they are cut off."""
    view, at = memoryview(raw), 0
    while at + 8 <= len(view):
        kind, size = struct.unpack_from(f"{order}II", view, at)
        if kind >> 16:
            kind, size, start, step = kind & 0xFFFF, kind >> 16, at + 4, 8
        else:
            start, step = at + 8, 8 + size + (-size % 8 if kind != _COMPRESSED else 0)
        if size > len(view) - start:
            raise Mat5Error("it is cut off")
        if kind:
            yield Element(kind, view[start : start + size])
        at += step


class Reader:
    """Reads the arrays of one file."""

    def __init__(self, order: str = "<") -> None:
        self.order = order
        self.dense = _MOST_DENSE

    def unpacked(self, element: Element) -> Element:
        """The element itself, or the one that is compressed within."""
        if element.type != _COMPRESSED:
            return element
        unpacker = zlib.decompressobj()
        try:
            raw = unpacker.decompress(element.raw, _LARGEST)
        except zlib.error as error:
            raise Mat5Error(f"it cannot be unpacked: {error}") from None
        if unpacker.unconsumed_tail:
            raise Mat5Error("it unpacks to far more than a variable holds")
        inner = next(elements(raw, self.order), None)
        if inner is None or inner.type == _COMPRESSED:
            raise Mat5Error("nothing is packed within")
        return inner

    def array(self, element: Element, depth: int = 0) -> tuple[str, str, Plain]:
        """The name, class and value of an array."""
        if element.type != _MATRIX:
            raise Mat5Error("it is no array")
        if depth > _DEEPEST:
            raise Mat5Error(f"it is more than {_DEEPEST} levels deep")
        parts = list(elements(element.raw, self.order)) if element.raw else []
        if not parts:
            return "", "double", np.zeros((0, 0))
        flags = self._integers(parts[0])
        if not flags.size:
            raise Mat5Error("its flags are missing")
        kind = int(flags[0]) & 0xFF
        if kind == _OPAQUE:
            return self._opaque(parts[1:], depth)
        if len(parts) < 3:
            raise Mat5Error("its size or its name is missing")
        shape = tuple(int(n) for n in self._integers(parts[1]))
        if len(shape) < 2 or len(shape) > 30 or min(shape) < 0:
            raise Mat5Error("its size makes no sense")
        name = bytes(parts[2].raw).decode("utf-8", "replace")
        return name, self._kind(kind, int(flags[0])), self._value(kind, int(flags[0]), shape, parts[3:], depth)

    def _kind(self, kind: int, flags: int) -> str:
        return "logical" if flags & _LOGICAL else _KINDS.get(kind, f"class {kind}")

    def _value(self, kind: int, flags: int, shape: tuple[int, ...], parts: list[Element], depth: int) -> Plain:
        if kind in _NUMBERS:
            return Unread("it is complex") if flags & _COMPLEX else self._numbers(shape, parts)
        if kind == _CHAR:
            return self._text(shape, parts)
        if kind == _CELL:
            return tuple(self.array(part, depth + 1)[2] for part in parts)
        if kind == _STRUCT:
            return self._struct(shape, parts, depth)
        if kind == _SPARSE:
            return self._sparse(shape, flags, parts)
        return Unread("it is an object of an old class" if kind == _OBJECT else f"it is of the array class {kind}")

    def _numbers(self, shape: tuple[int, ...], parts: list[Element]) -> Float:
        values = self._raw_numbers(parts[0]) if parts else np.zeros(0)
        if values.size != int(np.prod(shape, dtype=float)):
            raise Mat5Error("it has not as many values as its size says")
        return values.astype(np.float64).reshape(shape, order="F")

    def _text(self, shape: tuple[int, ...], parts: list[Element]) -> Plain:
        if not parts:
            return ""
        text = self._characters(parts[0])
        rows = shape[0]
        if rows <= 1:
            return text
        return tuple(text[row::rows].rstrip() for row in range(rows)) if rows <= len(text) else ""

    def _characters(self, part: Element) -> str:
        order = "le" if self.order == "<" else "be"
        if part.type in _TEXTS:
            encoding = _TEXTS[part.type] if part.type == 16 else f"{_TEXTS[part.type]}-{order}"
            return bytes(part.raw).decode(encoding, "replace")
        return "".join(chr(code) if 0 <= code < 0x110000 else "?" for code in self._integers(part).tolist())

    def _struct(self, shape: tuple[int, ...], parts: list[Element], depth: int) -> Plain:
        if len(parts) < 2:
            raise Mat5Error("the names of its fields are missing")
        lengths = self._integers(parts[0])
        length = int(lengths[0]) if lengths.size else 0
        raw = bytes(parts[1].raw)
        if length <= 0:
            names = []
        else:
            cells = [raw[at : at + length] for at in range(0, len(raw), length)]
            names = [cell.split(b"\0")[0].decode("utf-8", "replace") for cell in cells]
        values = [self.array(part, depth + 1) for part in parts[2:]]
        if names and len(values) % len(names):
            raise Mat5Error("it has not as many values as fields")
        count = len(values) // len(names) if names else 0
        made = tuple({name: values[at * len(names) + n][2] for n, name in enumerate(names)} for at in range(count))
        return made[0] if len(made) == 1 and shape == (1, 1) else made

    def _sparse(self, shape: tuple[int, ...], flags: int, parts: list[Element]) -> Plain:
        if flags & _COMPLEX or len(parts) < 3 or len(shape) != 2 or shape[0] * shape[1] > self.dense:
            return Unread("it is a sparse matrix that is complex or too large")
        rows, starts = self._integers(parts[0]), self._integers(parts[1])
        values = self._raw_numbers(parts[2]).astype(np.float64)
        if starts.size != shape[1] + 1 or starts[0] != 0 or np.any(np.diff(starts) < 0) or starts[-1] > values.size:
            raise Mat5Error("its sparse columns make no sense")
        count = int(starts[-1])
        if count > rows.size or (count and (rows[:count].min() < 0 or rows[:count].max() >= shape[0])):
            raise Mat5Error("its sparse rows make no sense")
        self.dense -= shape[0] * shape[1]
        full = np.zeros(shape)
        full[rows[:count], np.repeat(np.arange(shape[1]), np.diff(starts))] = values[:count]
        return full

    def _opaque(self, parts: list[Element], depth: int) -> tuple[str, str, Plain]:
        """An object: its name (left out within other values), the system of its class, its class, its numbers."""
        texts = [bytes(part.raw).decode("utf-8", "replace") for part in parts if part.type in (1, 16)]
        inner = next((part for part in parts if part.type == _MATRIX), None)
        if len(texts) < 2 or inner is None:
            raise Mat5Error("its class is missing")
        kind, name = texts[-1], texts[0] if len(texts) > 2 else ""
        return name, kind, Opaque(kind, self.array(inner, depth + 1)[2])

    def _raw_numbers(self, part: Element) -> "np.ndarray[tuple[int, ...], np.dtype[np.generic]]":
        if part.type not in _TYPES:
            raise Mat5Error(f"its values are of the unknown type {part.type}")
        dtype = np.dtype(self.order + _TYPES[part.type])
        return np.frombuffer(part.raw, dtype=dtype, count=len(part.raw) // dtype.itemsize)

    def _integers(self, part: Element) -> "np.ndarray[tuple[int, ...], np.dtype[np.int64]]":
        found = self._raw_numbers(part)
        if found.dtype.kind == "f":
            raise Mat5Error("a count is no whole number")
        return found.astype(np.int64)
