"""Reads MATLAB files of versions 5 to 7.2 into a tree.

Layout: MathWorks, "MAT-File Format": after 128 bytes, elements of type, size and content, some of them compressed; an
array holds the elements flags, dimensions, name and content, which for structs and cells are arrays again. scipy reads
this too, but ends the process on files that are garbled, so it is read here, with every size checked.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.matlab.tree import (
    MOST_BYTES,
    MOST_NODES,
    PACKING,
    Cells,
    DamageError,
    Node,
    Numbers,
    Struct,
    Structs,
    Text,
    Unreadable,
)

__all__ = ["Loaded", "elements_from", "load", "load_all"]

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHARACTERS, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODED = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_FLOATING, _LAST_NUMERIC = (6, 7), 15  # the classes double and single; those up to 15 are of integers
_COMPLEX, _LOGICAL = 0x800, 0x200
_CLASSES = {6: "double", 7: "single", 8: "int8", 9: "uint8", 10: "int16", 11: "uint16"}
_CLASSES |= {12: "int32", 13: "uint32", 14: "int64", 15: "uint64"}
_DEEPEST = 50


def load(content: memoryview) -> dict[str, Node]:
    """The variables of a file with this content; `DamageError` where it is none that MATLAB writes."""
    return load_all(content).variables


@dataclass
class Loaded:
    """The variables of a file, and the arrays without a name behind them, where objects keep their properties."""

    variables: dict[str, Node] = field(default_factory=dict)
    further: list[Node] = field(default_factory=list)


def load_all(content: memoryview, most_bytes: int = MOST_BYTES) -> Loaded:
    """All arrays of a file with this content."""
    return elements_from(content, 128, "<" if bytes(content[126:128]) == b"IM" else ">", most_bytes)


def elements_from(content: memoryview, begin: int, order: str, most_bytes: int = MOST_BYTES) -> Loaded:
    """The arrays that stand from a byte on; `order` is < or >, as the file says."""
    reader, found, total = _Reader(order), Loaded(), 0
    for kind, element in _unpacked(content, order, begin, most_bytes):
        total += len(element)
        if total > most_bytes:
            raise DamageError(f"its arrays are of more than {most_bytes} bytes")
        if kind == _MATRIX:
            name, node = reader.array(element, 0)
            if name:
                found.variables[name] = node
            else:
                found.further.append(node)
    return found


def _unpacked(content: memoryview, order: str, at: int, most_bytes: int) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each element of the file."""
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if at + 8 + length > len(content):
            raise DamageError(f"the element at byte {at} claims {length} bytes")
        element = content[at + 8 : at + 8 + length]
        yield _inflated(element, at, order, most_bytes) if kind == _COMPRESSED else (kind, element)
        at += 8 + length + (-length % 8 if kind != _COMPRESSED else 0)
    if any(content[at:]):
        raise DamageError(f"the {len(content) - at} bytes at its end belong to no array")


def _inflated(packed: memoryview, at: int, order: str, most_bytes: int) -> tuple[int, memoryview]:
    unpacker = zlib.decompressobj()
    try:
        head = unpacker.decompress(packed, 8)
        kind, claimed = struct.unpack(f"{order}II", head)
        if claimed > min(PACKING * (len(packed) + 8), most_bytes):
            raise DamageError(f"the element at byte {at} claims {claimed} bytes of {len(packed)} packed ones")
        found = unpacker.decompress(unpacker.unconsumed_tail, claimed) if claimed else b""
        unpacker.decompress(unpacker.unconsumed_tail, 8)  # which compares the checksum
    except (zlib.error, struct.error):
        raise DamageError(f"the packed element at byte {at} is garbled") from None
    if len(found) < claimed or not unpacker.eof:
        raise DamageError(f"the packed element at byte {at} is cut off")
    return kind, memoryview(found)


class _Reader:
    """Turns arrays into nodes and counts them."""

    def __init__(self, order: str) -> None:
        self.order = order
        self.count = 0

    def array(self, content: memoryview, depth: int) -> tuple[str, Node]:
        """Name and node of an array with this content."""
        self.count += 1
        if self.count > MOST_NODES:
            raise DamageError(f"it holds more than {MOST_NODES} arrays")
        if depth > _DEEPEST:
            raise DamageError(f"arrays are nested more than {_DEEPEST} deep")
        if not content:
            return "", Numbers(np.empty((0, 0)))
        parts = self._elements(content)
        _, flags = self._next(parts, "flags")
        (said,) = struct.unpack(f"{self.order}I", flags[:4].tobytes().ljust(4, b"\0"))
        kind = said & 0xFF
        if kind == _OPAQUE:
            return self._opaque(list(parts), depth)
        _, sizes = self._next(parts, "dimensions")
        shape = struct.unpack(f"{self.order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
        if min(shape, default=0) < 0:
            raise DamageError(f"an array claims {' x '.join(map(str, shape))} values")
        name = _text(*self._next(parts, "name"))
        return name, self._content(kind, said, shape, parts, depth)

    def _opaque(self, parts: list[tuple[int, memoryview]], depth: int) -> tuple[str, Node]:
        """An object: its name, unless it stands within others, the system of its class, its class, its reference."""
        texts = [_text(*part) for part in parts if part[0] != _MATRIX]
        inner = next((content for kind, content in parts if kind == _MATRIX), None)
        if len(texts) < 2:
            raise DamageError("an array lacks its class")
        reference = None if inner is None else self.array(inner, depth + 1)[1]
        return texts[0] if len(texts) > 2 else "", Unreadable(texts[-1] or "object", reference)

    def _content(self, kind: int, flags: int, shape: tuple[int, ...], parts: Any, depth: int) -> Node:
        if kind in (_STRUCT, _OBJECT):
            return self._structs(kind, shape, parts, depth)
        if kind == _CELL:
            return Cells([self._inner(parts, depth) for _ in range(self._claimed(shape))], shape)
        if kind == _CHARACTERS:
            return Text(_characters(*self._next(parts, "text"), shape, self.order) if math.prod(shape) else "")
        if kind == _SPARSE:
            return Unreadable("sparse matrix")
        if flags & _COMPLEX:
            return Unreadable("complex numbers")
        if not _OBJECT < kind <= _LAST_NUMERIC:
            return Unreadable("function handle" if kind == _FUNCTION else "object")
        values = self._numbers(shape, *self._next(parts, "numbers")) if math.prod(shape) else np.empty(shape)
        name = "logical" if flags & _LOGICAL else _CLASSES[kind]
        return Numbers(values, kind not in _FLOATING or bool(flags & _LOGICAL), name)

    def _structs(self, kind: int, shape: tuple[int, ...], parts: Any, depth: int) -> Node:
        if kind == _OBJECT:
            self._next(parts, "class")
        _, width = self._next(parts, "length of the names")
        _, names = self._next(parts, "names")
        each = max(int.from_bytes(bytes(width[:4]), "little" if self.order == "<" else "big"), 1)
        fields = [_text(1, names[k : k + each]) for k in range(0, len(names), each)]
        count = self._claimed((*shape, max(len(fields), 1))) // max(len(fields), 1)
        elements = [Struct({name: self._inner(parts, depth) for name in fields}) for _ in range(count)]
        return elements[0] if count == 1 else Structs(elements, shape)

    def _inner(self, parts: Any, depth: int) -> Node:
        kind, content = self._next(parts, "content")
        return self.array(content, depth + 1)[1] if kind == _MATRIX else Unreadable("data")

    def _claimed(self, shape: tuple[int, ...]) -> int:
        """How many arrays a cell array or a struct says that it holds; no more than there may be."""
        if math.prod(shape) > MOST_NODES:
            raise DamageError(f"an array claims {' x '.join(map(str, shape))} values")
        return math.prod(shape)

    def _numbers(self, shape: tuple[int, ...], kind: int, content: memoryview) -> NDArray[Any]:
        """The numbers in the type in which they are stored, which may be smaller than that of their class."""
        if kind not in _STORED:
            raise DamageError(f"an array is stored in an unknown type {kind}")
        stored = np.dtype(self.order + _STORED[kind])
        if math.prod(shape) * stored.itemsize != len(content):
            raise DamageError(f"an array claims {' x '.join(map(str, shape))} values in {len(content)} bytes")
        return np.frombuffer(content, stored).reshape(shape, order="F")

    def _elements(self, content: memoryview) -> Iterator[tuple[int, memoryview]]:
        """Type and content of the elements of an array."""
        at = 0
        while at + 8 <= len(content):
            kind, size = struct.unpack_from(f"{self.order}II", content, at)
            small = kind >> 16
            if small:
                yield kind & 0xFFFF, content[at + 4 : at + 4 + min(small, 4)]
                at += 8
                continue
            if at + 8 + size > len(content):
                raise DamageError(f"an element of {size} bytes stands within {len(content)} bytes")
            yield kind, content[at + 8 : at + 8 + size]
            at += 8 + size + -size % 8

    def _next(self, parts: Iterator[tuple[int, memoryview]], what: str) -> tuple[int, memoryview]:
        found = next(parts, None)
        if found is None:
            raise DamageError(f"an array lacks its {what}")
        return found


def _text(kind: int, content: memoryview) -> str:
    """A name; up to its first zero byte."""
    return bytes(content).partition(b"\0")[0].decode(_ENCODED.get(kind, "utf-8"), errors="replace")


def _characters(kind: int, content: memoryview, shape: tuple[int, ...], order: str) -> str:
    """The rows of an array of characters, one below the other."""
    if kind in _ENCODED:
        ending = {"<": "-le", ">": "-be"}[order] if kind > 16 else ""
        letters = bytes(content).decode(_ENCODED[kind] + ending, errors="replace")
    elif kind in (2, 4):
        codes = np.frombuffer(
            content[: len(content) // int(_STORED[kind][1]) * int(_STORED[kind][1])], order + _STORED[kind]
        )
        letters = "".join(map(chr, codes.tolist()))
    else:
        letters = bytes(content).decode("latin-1")
    rows = shape[0]
    return "\n".join(letters[row::rows].rstrip() for row in range(rows)) if 1 < rows <= len(letters) else letters
