"""Reads MATLAB files of versions 5 to 7.2 into a tree.

Layout: MathWorks, "MAT-File Format": after 128 bytes, elements of type, size and content, some of them compressed; an
array holds the elements flags, dimensions, name and content, which for structs and cells are arrays again. scipy reads
this too, but ends the process on files that are garbled, so it is read here, with every size checked.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.matlab.mat_nodes import (
    MOST_BYTES,
    MOST_DENSE,
    MOST_NODES,
    PACKING,
    MatCells,
    MatFileContent,
    MatFileError,
    MatNumbers,
    MatStruct,
    MatStructArray,
    MatText,
    MatUnreadable,
    Node,
    TooManyError,
    dense,
    text_in_rows,
)

__all__ = ["elements_from"]

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHARACTERS, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODED = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_FLOATING, _LAST_NUMERIC = (6, 7), 15  # the classes double and single; those up to 15 are of integers
_COMPLEX, _LOGICAL = 0x800, 0x200
_CLASSES = {6: "double", 7: "single", 8: "int8", 9: "uint8", 10: "int16", 11: "uint16"}
_CODES = (2, 3, 4, 5, 6)  # the types in which characters stand as numbers
_DEEPEST = 50
_MOST_DIMENSIONS = 32
_MOST_CLAIMED = 2**48  # values of an array that may be empty
_CLASSES |= {12: "int32", 13: "uint32", 14: "int64", 15: "uint64"}


def load(content: memoryview) -> dict[str, Node]:
    """The variables of a file with this content; `DamageError` where it is none that MATLAB writes."""
    return load_all(content).whole().variables


def load_all(content: memoryview, most_bytes: int = MOST_BYTES, most_nodes: int = MOST_NODES) -> MatFileContent:
    """All arrays of a file with this content, the damaged ones among them."""
    order = "<" if bytes(content[126:128]) == b"IM" else ">"
    return elements_from(content, 128, order, most_bytes, most_nodes)


def elements_from(
    content: memoryview, begin: int, order: str, most_bytes: int = MOST_BYTES, most_nodes: int = MOST_NODES
) -> MatFileContent:
    """The arrays that stand from a byte on, the damaged ones among them; `order` is < or >, as the file says."""
    reader, found, left = _ArrayReader(order, most_nodes), MatFileContent(), most_bytes
    try:
        for kind, at, raw in _framed(content, order, begin):
            if (element := _unpacked(found, kind, raw, at, order, left)) is not None:
                left -= len(element)
                _take(found, *reader.array(element, 0))
    except MatFileError as error:
        found.lose(str(error))
    found.damage = found.damage or reader.damage
    return found


def _take(found: MatFileContent, name: str, node: Node) -> None:
    if name:
        found.variables[name] = node
        return
    found.further.append(node)
    if isinstance(node, MatUnreadable) and node.why:
        found.lose(node.why)


def _framed(content: memoryview, order: str, at: int) -> Iterator[tuple[int, int, memoryview]]:
    """Type, place and content of each element of the file, packed as it is."""
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if at + 8 + length > len(content):
            raise MatFileError(f"the element at byte {at} claims {length} bytes")
        yield kind, at, content[at + 8 : at + 8 + length]
        at += 8 + length + (-length % 8 if kind != _COMPRESSED else 0)
    if any(content[at:]):
        raise MatFileError(f"the {len(content) - at} bytes at its end belong to no array")


def _unpacked(found: MatFileContent, kind: int, raw: memoryview, at: int, order: str, left: int) -> memoryview | None:
    """The content of an array; None for other elements, and for one that is garbled, which does not end the file."""
    try:
        kind, element = _inflated(raw, at, order, left) if kind == _COMPRESSED else (kind, raw)
    except MatFileError as error:
        found.lose(str(error))
        return None
    if len(element) > left:
        raise MatFileError(f"its arrays are of more than {left} bytes")
    return element if kind == _MATRIX else None


def _inflated(packed: memoryview, at: int, order: str, most_bytes: int) -> tuple[int, memoryview]:
    unpacker = zlib.decompressobj()
    try:
        head = unpacker.decompress(packed, 8)
        kind, claimed = struct.unpack(f"{order}II", head)
        if claimed > min(PACKING * (len(packed) + 8), most_bytes):
            raise MatFileError(f"the element at byte {at} claims {claimed} bytes of {len(packed)} packed ones")
        found = unpacker.decompress(unpacker.unconsumed_tail, claimed) if claimed else b""
        unpacker.decompress(unpacker.unconsumed_tail, 8)  # which compares the checksum
    except (zlib.error, struct.error):
        raise MatFileError(f"the packed element at byte {at} is garbled") from None
    if len(found) < claimed:  # an end of the stream may be missing: MATLAB does not write it behind objects
        raise MatFileError(f"the packed element at byte {at} is cut off")
    return kind, memoryview(found)


class _ArrayReader:
    """Turns arrays into nodes and counts them; `damage` is the first that it found."""

    def __init__(self, order: str, most: int) -> None:
        self.order = order
        self.most = most
        self.count = 0
        self.dense = MOST_DENSE
        self.damage = ""

    def array(self, content: memoryview, depth: int) -> tuple[str, Node]:
        """Name and node of an array with this content; damage does not reach beyond it."""
        self._counted(1)
        name = ""
        try:
            if depth > _DEEPEST:
                raise MatFileError(f"arrays are nested more than {_DEEPEST} deep")
            if not content:
                return "", MatNumbers(np.empty((0, 0)))
            parts = self._elements(content)
            flags = self._flags(parts)
            if flags & 0xFF == _OPAQUE:
                return self._opaque(list(parts), depth)
            shape = self._shape(parts)
            name = _text(*self._next(parts, "name"))
            return name, self._content(flags & 0xFF, flags, shape, parts, depth)
        except TooManyError:
            raise
        except MatFileError as error:
            self.damage = self.damage or str(error)
            return name, MatUnreadable("damaged value", why=str(error))

    def _counted(self, more: int) -> None:
        self.count += more
        if self.count > self.most:
            raise TooManyError(f"it holds more than {self.most} arrays")

    def _flags(self, parts: Iterator[tuple[int, memoryview]]) -> int:
        _, raw = self._next(parts, "flags")
        return int.from_bytes(raw[:4].tobytes().ljust(4, b"\0"), "little" if self.order == "<" else "big")

    def _shape(self, parts: Iterator[tuple[int, memoryview]]) -> tuple[int, ...]:
        _, sizes = self._next(parts, "dimensions")
        shape = struct.unpack(f"{self.order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
        if min(shape, default=0) < 0 or math.prod(filter(None, shape)) > _MOST_CLAIMED:
            raise MatFileError(f"an array claims {' x '.join(map(str, shape))} values")
        if not 2 <= len(shape) <= _MOST_DIMENSIONS:
            raise MatFileError(f"an array claims {len(shape)} dimensions")
        return shape

    def _opaque(self, parts: list[tuple[int, memoryview]], depth: int) -> tuple[str, Node]:
        """An object: its name, unless it stands within others, the system of its class, its class, its reference."""
        texts = [_text(*part) for part in parts if part[0] != _MATRIX]
        inner = next((content for kind, content in parts if kind == _MATRIX), None)
        if len(texts) < 2:
            raise MatFileError("an array lacks its class")
        reference = None if inner is None else self.array(inner, depth + 1)[1]
        return texts[0] if len(texts) > 2 else "", MatUnreadable(texts[-1] or "object", reference)

    def _content(self, kind: int, flags: int, shape: tuple[int, ...], parts: Any, depth: int) -> Node:
        if kind in (_STRUCT, _OBJECT):
            return self._structs(kind, shape, parts, depth)
        if kind == _CELL:
            return MatCells([self._inner(parts, depth) for _ in range(self._claimed(shape))], shape)
        if kind == _CHARACTERS:
            return _characters(*self._next(parts, "text"), shape, self.order) if math.prod(shape) else MatText("")
        if flags & _COMPLEX and kind <= _LAST_NUMERIC:
            return MatUnreadable("complex numbers")
        if kind == _SPARSE:
            return self._sparse(flags, shape, parts)
        if not _OBJECT < kind <= _LAST_NUMERIC:
            return MatUnreadable("function handle" if kind == _FUNCTION else "object")
        values = self._numbers(shape, *self._next(parts, "numbers")) if math.prod(shape) else np.empty(shape)
        name = "logical" if flags & _LOGICAL else _CLASSES[kind]
        return MatNumbers(values, kind not in _FLOATING or bool(flags & _LOGICAL), name)

    def _sparse(self, flags: int, shape: tuple[int, ...], parts: Any) -> Node:
        if math.prod(shape) > self.dense:
            return MatUnreadable("sparse matrix")
        rows, starts, values = (self._row(*self._next(parts, message)) for message in ("rows", "columns", "numbers"))
        self.dense -= math.prod(shape)
        logical = bool(flags & _LOGICAL)
        return MatNumbers(dense(shape, rows, starts, values), logical, "logical" if logical else "double")

    def _structs(self, kind: int, shape: tuple[int, ...], parts: Any, depth: int) -> Node:
        if kind == _OBJECT:
            self._next(parts, "class")
        _, width = self._next(parts, "length of the names")
        _, names = self._next(parts, "names")
        each = max(int.from_bytes(bytes(width[:4]), "little" if self.order == "<" else "big"), 1)
        fields = [_text(1, names[k : k + each]) for k in range(0, len(names), each)]
        count = self._claimed((*shape, max(len(fields), 1))) // max(len(fields), 1)
        self._counted(count)
        elements = [MatStruct({name: self._inner(parts, depth) for name in fields}) for _ in range(count)]
        return elements[0] if count == 1 else MatStructArray(elements, shape)

    def _inner(self, parts: Any, depth: int) -> Node:
        kind, content = self._next(parts, "content")
        return self.array(content, depth + 1)[1] if kind == _MATRIX else MatUnreadable("data")

    def _claimed(self, shape: tuple[int, ...]) -> int:
        """How many arrays a cell array or a struct says that it holds; no more than there may be."""
        if math.prod(shape) > self.most:
            raise MatFileError(f"an array claims {' x '.join(map(str, shape))} values")
        return math.prod(shape)

    def _numbers(self, shape: tuple[int, ...], kind: int, content: memoryview) -> NDArray[Any]:
        """The numbers in the type in which they are stored, which may be smaller than that of their class."""
        stored = self._stored(kind)
        if math.prod(shape) * stored.itemsize != len(content):
            raise MatFileError(f"an array claims {' x '.join(map(str, shape))} values in {len(content)} bytes")
        return np.frombuffer(content, stored).reshape(shape, order="F")

    def _row(self, kind: int, content: memoryview) -> NDArray[Any]:
        """All numbers of an element."""
        stored = self._stored(kind)
        return np.frombuffer(content[: len(content) // stored.itemsize * stored.itemsize], stored)

    def _stored(self, kind: int) -> np.dtype[Any]:
        if kind not in _STORED:
            raise MatFileError(f"an array is stored in an unknown type {kind}")
        return np.dtype(self.order + _STORED[kind])

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
                raise MatFileError(f"an element of {size} bytes stands within {len(content)} bytes")
            yield kind, content[at + 8 : at + 8 + size]
            at += 8 + size + -size % 8

    def _next(self, parts: Iterator[tuple[int, memoryview]], message: str) -> tuple[int, memoryview]:
        found = next(parts, None)
        if found is None:
            raise MatFileError(f"an array lacks its {message}")
        return found


def _text(kind: int, content: memoryview) -> str:
    """A name; up to its first zero byte."""
    return bytes(content).partition(b"\0")[0].decode(_ENCODED.get(kind, "utf-8"), errors="replace")


def _characters(kind: int, content: memoryview, shape: tuple[int, ...], order: str) -> MatText:
    """An array of characters, of which the first of all rows come first."""
    if kind in _ENCODED:
        ending = {"<": "-le", ">": "-be"}[order] if kind > 16 else ""
        letters = bytes(content).decode(_ENCODED[kind] + ending, errors="replace")
    elif kind in _CODES:
        stored = np.dtype(order + _STORED[kind])
        codes = np.frombuffer(content[: len(content) // stored.itemsize * stored.itemsize], stored)
        letters = "".join(map(chr, codes.astype(np.int64).clip(0, 0x10FFFF).tolist()))
    else:
        letters = bytes(content).decode("latin-1")
    return text_in_rows(letters, shape[0])
