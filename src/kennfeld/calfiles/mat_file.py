"""MATLAB data files (.mat), versions 4 to 7.3, as variables.

Versions 4 and 5 are read here, because a damaged or hostile file may claim sizes that it does not hold; the layout is
that of MathWorks, *MAT-File Format*. Version 7.3 is HDF5.
"""

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.calfiles.mat_hdf5 import hdf5_variables
from kennfeld.calfiles.matlab_values import Opaque, Struct, Value, holds_samples, parameters_of
from kennfeld.errors import InputError

__all__ = ["is_calibration_mat", "read_mat", "recognises_mat"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes before the HDF5 part
_HEADER = 128
_MOST_BYTES = 200_000_000  # unpacked
_MOST_VALUES = 20_000_000
_MOST_DEPTH = 40
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_COMPRESSED, _MATRIX = 15, 14
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_CLASSES = {_SPARSE: "sparse matrix", _FUNCTION: "function handle"}
_OLD_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
_OLD_NAME = re.compile(rb"[A-Za-z]\w{0,62}\0")


class DamagedError(Exception):
    """The bytes are not what the format asks for; the text says where."""


def recognises_mat(source: Source) -> bool:
    """Whether a file, of which the beginning may suffice, is a MATLAB data file."""
    raw = source.raw
    is_hdf5 = raw.startswith(_HDF5) or raw[_USER_BLOCK : _USER_BLOCK + len(_HDF5)] == _HDF5
    return raw.startswith(b"MATLAB 5.0 MAT-file") or is_hdf5 or _old_header(raw, 0) is not None


def read_mat(source: Source) -> Content:
    """The parameters of a data file: plain numbers, vectors, matrices, texts, structs with axes and values.

    Raises `InputError` where it is damaged or holds recorded samples; objects that only MATLAB reads are remarked.
    """
    notes = Notes(source.name)
    version, variables = _variables(source)
    samples = holds_samples(variables)
    if samples:
        what = f"holds recorded samples ({samples}), not a calibration"
        notes.error(0, "", what, "Name it as a file of a dataset.")
        notes.settle()
    return Content(f"MATLAB {version}", parameters_of(variables, notes), notes.settle())


def is_calibration_mat(source: Source) -> bool:
    """Whether a data file holds a calibration rather than recorded samples."""
    try:
        variables = _variables(source)[1]
    except InputError:
        return False
    plain = any(isinstance(value, (Struct, np.ndarray)) for value in variables.values())
    return plain and not holds_samples(variables)


def _variables(source: Source) -> tuple[str, dict[str, Value]]:
    raw = source.raw
    try:
        if raw.startswith(b"MATLAB 5.0"):
            return "5", _Reader(raw).variables()
        if _old_header(raw, 0) is not None:
            return "4", dict(_old_variables(raw))
        return "7.3", hdf5_variables(raw)
    except (DamagedError, ValueError, RecursionError) as error:
        mend = "The file may be cut off or damaged: save it anew in MATLAB."
        raise InputError.of(source.name, f"cannot be read as MATLAB data: {error}", mend) from None


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview
    end: int  # where the next one begins


class _Reader:
    """Version 5 to 7.2: elements with a tag, of which the matrices hold elements again."""

    def __init__(self, raw: bytes) -> None:
        if len(raw) < _HEADER:
            raise DamagedError(f"it ends within its header of {_HEADER} bytes")
        mark = raw[126:128]
        if mark not in (b"IM", b"MI"):
            raise DamagedError(f"its header ends in {mark!r} instead of the mark of the byte order")
        self.order = "<" if mark == b"IM" else ">"
        self.raw = raw
        self.left = _MOST_BYTES
        self.values_left = _MOST_VALUES

    def variables(self) -> dict[str, Value]:
        found: dict[str, Value] = {}
        view = memoryview(self.raw)
        subsystem = int(np.frombuffer(self.raw[116:124], f"{self.order}u8")[0])  # what objects refer to
        at = _HEADER
        while at + 8 <= len(view):
            element = self._element(view, at)
            if element.kind == _COMPRESSED:
                inner = memoryview(self._unpacked(element.data))
                element, after = self._element(inner, 0), at + 8 + len(element.data)
            else:
                after = element.end
            if element.kind == _MATRIX and at != subsystem:
                name, value = self._matrix(element.data, 0)
                if name:
                    found[name] = value
            at = after
        if at < len(view):
            raise DamagedError(f"{len(view) - at} bytes at its end belong to no variable")
        return found

    def _unpacked(self, packed: memoryview) -> bytes:
        unpacker = zlib.decompressobj()
        try:
            made = unpacker.decompress(packed, self.left)
        except zlib.error as error:
            raise DamagedError(f"a compressed variable is damaged ({error})") from None
        if unpacker.unconsumed_tail:
            raise DamagedError(f"it unpacks to more than {_MOST_BYTES // 1_000_000} MB")
        self.left -= len(made)
        return made

    def _element(self, view: memoryview, at: int) -> _Element:
        if at + 8 > len(view):
            raise DamagedError(f"it ends within an element at byte {at}")
        first, size = (int(number) for number in np.frombuffer(view[at : at + 8], f"{self.order}u4"))
        if first >> 16:  # a small element, whose data are within its tag
            kind, size = first & 0xFFFF, first >> 16
            if size > 4:
                raise DamagedError(f"an element at byte {at} claims {size} bytes in its tag")
            return _Element(kind, view[at + 4 : at + 4 + size], at + 8)
        if at + 8 + size > len(view):
            raise DamagedError(f"an element at byte {at} claims {size} bytes, {len(view) - at - 8} are left")
        padded = size if first == _COMPRESSED else size + -size % 8
        return _Element(first, view[at + 8 : at + 8 + size], at + 8 + padded)

    def _parts(self, view: memoryview) -> Iterator[_Element]:
        at = 0
        while at < len(view):
            element = self._element(view, at)
            yield element
            at = element.end

    def _matrix(self, view: memoryview, depth: int) -> tuple[str, Value]:
        if depth > _MOST_DEPTH:
            raise DamagedError(f"it nests more than {_MOST_DEPTH} levels deep")
        parts = self._parts(view)
        flags = int(self._integers(self._next(parts), "u4")[0]) if len(view) else 6
        kind = flags & 0xFF
        if not len(view):
            return "", np.zeros((0, 0))
        if kind == _OPAQUE:
            words = [bytes(self._next(parts).data).decode("latin-1") for _ in range(3)]
            return words[0], Opaque(words[2])
        shape = tuple(int(size) for size in self._integers(self._next(parts), "i4"))
        name = bytes(self._next(parts).data).decode("latin-1")
        if kind in _CLASSES or (flags & 0x0800 and kind != _CHAR):
            return name, Opaque(_CLASSES.get(kind, "complex number"))
        if len(shape) < 2 or len(shape) > 32 or min(shape) < 0:
            raise DamagedError(f"the variable {name[:40]!r} has the size {shape[:8]}")
        return name, self._content(kind, shape, parts, depth)

    def _content(self, kind: int, shape: tuple[int, ...], parts: Iterator[_Element], depth: int) -> Value:
        if kind == _CHAR:
            return self._characters(shape, next(parts, None))
        if kind == _CELL:
            return [self._matrix(part.data, depth + 1)[1] for part in self._matrices(parts, prod(shape))]
        if kind in (_STRUCT, _OBJECT):
            class_name = bytes(self._next(parts).data).decode("latin-1") if kind == _OBJECT else ""
            structs = self._structs(shape, parts, depth)
            return Opaque(class_name) if class_name else structs[0] if len(structs) == 1 else structs
        return self._numbers(shape, self._next(parts))

    def _structs(self, shape: tuple[int, ...], parts: Iterator[_Element], depth: int) -> list[Value]:
        length = int(self._integers(self._next(parts), "i4")[0])
        listed = bytes(self._next(parts).data)
        if length < 1:
            raise DamagedError("a struct has field names of no length")
        cut = (listed[at : at + length] for at in range(0, len(listed), length))
        names = [one.partition(b"\0")[0].decode("latin-1") for one in cut]
        if not names:
            return [Struct()] if prod(shape) == 1 else []
        values = [self._matrix(part.data, depth + 1)[1] for part in self._matrices(parts, prod(shape) * len(names))]
        rows = (values[at : at + len(names)] for at in range(0, len(values), len(names)))
        return [Struct(dict(zip(names, row, strict=True))) for row in rows]

    def _matrices(self, parts: Iterator[_Element], count: int) -> Iterator[_Element]:
        for at in range(count):
            part = next(parts, None)
            if part is None or part.kind != _MATRIX:
                raise DamagedError(f"a list of {count} entries ends after {at}")
            yield part

    def _numbers(self, shape: tuple[int, ...], part: _Element) -> Float:
        numbers = self._values(part)
        self.values_left -= len(numbers)
        if self.values_left < 0:
            raise DamagedError(f"it holds more than {_MOST_VALUES} values, which no calibration has")
        if len(numbers) != prod(shape):
            raise DamagedError(f"an array of size {shape[:8]} has {len(numbers)} numbers")
        array: Float = numbers.astype(np.float64).reshape(shape, order="F")
        return array

    def _characters(self, shape: tuple[int, ...], part: _Element | None) -> str:
        if part is None or not len(part.data):
            return ""
        encoding = _ENCODINGS.get(part.kind)
        if encoding is None:
            raise DamagedError(f"a text is stored as numbers of type {part.kind}")
        if encoding in ("utf-16", "utf-32"):
            encoding += "-le" if self.order == "<" else "-be"
        text = bytes(part.data).decode(encoding, errors="replace")
        rows = shape[0]
        return text if rows == 1 else "\n".join(text[row::rows].rstrip() for row in range(min(rows, len(text))))

    def _values(self, part: _Element) -> Any:
        kind = _TYPES.get(part.kind)
        if kind is None:
            raise DamagedError(f"an array is stored as numbers of type {part.kind}")
        if len(part.data) % int(kind[1]):
            raise DamagedError(f"an array of {len(part.data)} bytes is cut within a number")
        return np.frombuffer(part.data, self.order + kind)

    def _integers(self, part: _Element, kind: str) -> Any:
        if len(part.data) < 4 or len(part.data) % 4 or len(part.data) > 4096:
            raise DamagedError("the size of a variable is missing")
        return np.frombuffer(part.data, self.order + kind)

    def _next(self, parts: Iterator[_Element]) -> _Element:
        part = next(parts, None)
        if part is None:
            raise DamagedError("a variable ends too early")
        return part


@dataclass(frozen=True)
class _Old:
    """The header of a variable in version 4."""

    order: str
    type: str
    kind: int  # 0 numbers, 1 text, 2 sparse
    shape: tuple[int, int]
    is_complex: bool
    name: str
    begin: int

    @property
    def end(self) -> int:
        return self.begin + prod(self.shape) * int(self.type[1]) * (1 + self.is_complex)


def _old_header(raw: bytes, at: int) -> _Old | None:
    """The header of version 4 at a place; None where there is none."""
    if len(raw) < at + 22:
        return None
    for order in "<>":
        code, rows, columns, is_complex, length = (int(n) for n in np.frombuffer(raw[at : at + 20], f"{order}i4"))
        thousands, rest = divmod(code, 1000)
        digits = (rest // 100, rest // 10 % 10, rest % 10)
        fits = thousands == "<>".index(order) and digits[0] == 0 and digits[1] < len(_OLD_TYPES) and digits[2] < 3
        if code < 0 or not fits or is_complex not in (0, 1) or min(rows, columns) < 0 or not 1 < length < 65:
            continue
        named = raw[at + 20 : at + 20 + length]
        if _OLD_NAME.fullmatch(named):
            kind = order + _OLD_TYPES[digits[1]]
            name = named[:-1].decode("ascii")
            return _Old(order, kind[1:], digits[2], (rows, columns), bool(is_complex), name, at + 20 + length)
    return None


def _old_variables(raw: bytes) -> Iterator[tuple[str, Value]]:
    at = 0
    while at < len(raw):
        head = _old_header(raw, at)
        if head is None:
            raise DamagedError(f"no variable begins at byte {at}")
        if head.end > len(raw):
            raise DamagedError(f"{head.name} claims more values than the file holds")
        numbers = np.frombuffer(raw[head.begin : head.end], head.order + head.type)
        array = numbers[: prod(head.shape)].astype(np.float64).reshape(head.shape, order="F")
        if head.kind == 2 or head.is_complex:
            yield head.name, Opaque("sparse matrix" if head.kind == 2 else "complex number")
        elif head.kind == 1:
            yield head.name, "".join(chr(int(code)) for code in array.ravel() if 0 <= code < 0xD800)
        else:
            yield head.name, array
        at = head.end
