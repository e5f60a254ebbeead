"""Reader of MATLAB files of versions 5 to 7.2.

Layout: MathWorks, "MAT-File Format": after 128 bytes, elements of type, size and content, some of them compressed. An
array consists of flags, dimensions, name and content, which for structs and cells are arrays again. scipy reads these
files too, but crashes on corrupt ones; this reader checks every size.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.formatting import size_text
from kennfeld.matlab import mat_nodes as n

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHARACTERS, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_BYTE, _DOUBLE = 2, 9
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODED = {16: "utf-8", 17: "utf-16", 18: "utf-32"}
_FLOATING, _LAST_NUMERIC = (6, 7), 15  # double and single; 8 to 15 are integer classes
_COMPLEX, _LOGICAL = 0x800, 0x200
_CLASSES = {
    6: "double", 7: "single", 8: "int8", 9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64",
    15: "uint64",
}  # fmt: skip
_CODES = (2, 3, 4, 5, 6)  # types of characters stored as numbers
_MAX_DEPTH = 50
_MAX_DIMENSIONS = 32
_MAX_CLAIMED = 2**48  # values of an array that may be empty


def load(content: memoryview) -> dict[str, n.Node]:
    """Read the variables; raises `MatFileError` if the content is not a valid file."""
    return load_all(content).whole().variables


def load_all(content: memoryview, max_bytes: int = n.MAX_BYTES, max_nodes: int = n.MAX_NODES) -> n.MatFileContent:
    """Read all arrays, damaged ones included."""
    # the writer stores the characters MI as a 16-bit number
    order = "<" if bytes(content[126:128]) == b"IM" else ">"
    return read_elements(content, 128, order, max_bytes, max_nodes)


def read_elements(
    content: memoryview, begin: int, order: str, max_bytes: int = n.MAX_BYTES, max_nodes: int = n.MAX_NODES
) -> n.MatFileContent:
    """Read the arrays from an offset on, damaged ones included; `order` is "<" or ">", the byte order of the file."""
    reader, loaded, remaining = _ArrayReader(order, max_nodes), n.MatFileContent(), max_bytes
    try:
        for kind, at, raw in _iterate_elements(content, order, begin):
            if (element := _unpack(loaded, kind, raw, at, order, remaining)) is not None:
                remaining -= len(element)
                _store(loaded, *reader.array(element, 0))
    except n.MatFileError as error:
        loaded.lose(str(error))
    loaded.damage = loaded.damage or reader.damage
    return loaded


def _store(loaded: n.MatFileContent, name: str, node: n.Node) -> None:
    if name:
        loaded.variables[name] = node
        return
    # an array without a name is the subsystem, with the properties of objects
    loaded.further.append(node)
    if isinstance(node, n.MatUnreadable) and node.why:
        loaded.lose(node.why)


def _iterate_elements(content: memoryview, order: str, at: int) -> Iterator[tuple[int, int, memoryview]]:
    """Yield type, offset and content of each element, still compressed."""
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if at + 8 + length > len(content):
            raise n.MatFileError(f"the element at byte {at} claims {length} bytes")
        yield kind, at, content[at + 8 : at + 8 + length]
        # elements end at a multiple of 8 bytes, except for compressed ones
        at += 8 + length + (-length % 8 if kind != _COMPRESSED else 0)
    if any(content[at:]):
        raise n.MatFileError(f"the last {len(content) - at} bytes belong to no array")


def _unpack(
    loaded: n.MatFileContent, kind: int, raw: memoryview, at: int, order: str, remaining: int
) -> memoryview | None:
    """Return the content of an array; None for other elements, and for a corrupt one, after which reading continues."""
    try:
        kind, element = _inflate(raw, at, order, remaining) if kind == _COMPRESSED else (kind, raw)
    except n.MatFileError as error:
        loaded.lose(str(error))
        return None
    if len(element) > remaining:
        raise n.MatFileError(f"its arrays take more than {remaining} bytes")
    return element if kind == _MATRIX else None


def _inflate(packed: memoryview, at: int, order: str, max_bytes: int) -> tuple[int, memoryview]:
    unpacker = zlib.decompressobj()
    try:
        # only the tag is unpacked first: the size that it claims may be that of a bomb
        head = unpacker.decompress(packed, 8)
        kind, claimed = struct.unpack(f"{order}II", head)
        if claimed > min(n.MAX_COMPRESSION * (len(packed) + 8), max_bytes):
            raise n.MatFileError(f"the element at byte {at} claims {claimed} bytes in {len(packed)} compressed bytes")
        unpacked = unpacker.decompress(unpacker.unconsumed_tail, claimed) if claimed else b""
        unpacker.decompress(unpacker.unconsumed_tail, 8)  # checks the checksum
    except (zlib.error, struct.error):
        raise n.MatFileError(f"the compressed element at byte {at} is corrupt") from None
    if len(unpacked) < claimed:  # the end of the stream may be missing, as behind objects
        raise n.MatFileError(f"the compressed element at byte {at} is truncated")
    return kind, memoryview(unpacked)


class _ArrayReader:
    """Converts arrays to nodes and counts them; `damage` is the first damage found."""

    def __init__(self, order: str, most: int) -> None:
        self.order = order
        self.most = most
        self.count = 0
        self.dense = n.MAX_DENSE
        self.damage = ""

    def array(self, content: memoryview, depth: int) -> tuple[str, n.Node]:
        """Return name and node of an array; damage does not affect other arrays."""
        self._count_arrays(1)
        name = ""
        try:
            if depth > _MAX_DEPTH:
                raise n.MatFileError(f"arrays are nested more than {_MAX_DEPTH} deep")
            # an empty array in a cell may be an element of 0 bytes
            if not content:
                return "", n.MatNumbers(np.empty((0, 0)))
            parts = self._elements(content)
            flags = self._flags(parts)
            # an object has flags but no dimensions, and its name is one of its texts
            if flags & 0xFF == _OPAQUE:
                return self._opaque(list(parts), depth)
            shape = self._shape(parts)
            name = _text(*self._next(parts, "name"))
            return name, self._content(flags & 0xFF, flags, shape, parts, depth)
        except n.ArrayLimitError:
            raise
        except n.MatFileError as error:
            self.damage = self.damage or str(error)
            return name, n.MatUnreadable("damaged value", why=str(error))

    def _count_arrays(self, more: int) -> None:
        self.count += more
        if self.count > self.most:
            raise n.ArrayLimitError(f"it contains more than {self.most} arrays")

    def _flags(self, parts: Iterator[tuple[int, memoryview]]) -> int:
        _, raw = self._next(parts, "flags")
        return int.from_bytes(raw[:4].tobytes().ljust(4, b"\0"), "little" if self.order == "<" else "big")

    def _shape(self, parts: Iterator[tuple[int, memoryview]]) -> tuple[int, ...]:
        _, sizes = self._next(parts, "dimensions")
        shape = struct.unpack(f"{self.order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
        # a dimension of 0 would hide others, which numpy refuses if their product overflows
        if min(shape, default=0) < 0 or math.prod(filter(None, shape)) > _MAX_CLAIMED:
            raise n.MatFileError(f"an array claims {size_text(shape)} values")
        if not 2 <= len(shape) <= _MAX_DIMENSIONS:
            raise n.MatFileError(f"an array claims {len(shape)} dimensions")
        return shape

    def _opaque(self, parts: list[tuple[int, memoryview]], depth: int) -> tuple[str, n.Node]:
        """Read an object: its name unless it is nested, the system of its class, its class, its reference."""
        texts = [_text(*part) for part in parts if part[0] != _MATRIX]
        inner = next((content for kind, content in parts if kind == _MATRIX), None)
        if len(texts) < 2:
            raise n.MatFileError("an array has no class")
        reference = None if inner is None else self.array(inner, depth + 1)[1]
        return texts[0] if len(texts) > 2 else "", n.MatUnreadable(texts[-1] or "object", reference)

    def _content(self, kind: int, flags: int, shape: tuple[int, ...], parts: Any, depth: int) -> n.Node:
        if kind in (_STRUCT, _OBJECT):
            return self._structs(kind, shape, parts, depth)
        if kind == _CELL:
            return n.MatCells([self._inner(parts, depth) for _ in range(self._check_count(shape))], shape)
        if kind == _CHARACTERS:
            return _characters(*self._next(parts, "text"), shape, self.order) if math.prod(shape) else n.MatText("")
        if flags & _COMPLEX and kind <= _LAST_NUMERIC:
            return self._complex(kind, shape, parts)
        if kind == _SPARSE:
            return self._sparse(flags, shape, parts)
        if not _OBJECT < kind <= _LAST_NUMERIC:
            return n.MatUnreadable("function handle" if kind == _FUNCTION else "object")
        values = self._numbers(shape, *self._next(parts, "numbers")) if math.prod(shape) else np.empty(shape)
        name = "logical" if flags & _LOGICAL else _CLASSES[kind]
        return n.MatNumbers(values, kind not in _FLOATING or bool(flags & _LOGICAL), name)

    def _complex(self, kind: int, shape: tuple[int, ...], parts: Any) -> n.Node:
        if kind not in _FLOATING or not math.prod(shape):
            return n.MatUnreadable("complex numbers")
        real, imaginary = (self._numbers(shape, *self._next(parts, part)) for part in ("real part", "imaginary part"))
        return n.MatUnreadable("complex numbers", parts=(real, imaginary))

    def _sparse(self, flags: int, shape: tuple[int, ...], parts: Any) -> n.Node:
        if math.prod(shape) > self.dense:
            return n.MatUnreadable("sparse matrix")
        rows, starts = (_row(*self._next(parts, message), self.order) for message in ("rows", "columns"))
        kind, content = self._next(parts, "numbers")
        logical = bool(flags & _LOGICAL)
        is_mislabelled = logical and kind == _DOUBLE and len(content) == rows.size  # MATLAB writes bytes as doubles
        values = _row(_BYTE if is_mislabelled else kind, content, self.order)
        self.dense -= math.prod(shape)
        return n.MatNumbers(n.to_dense(shape, rows, starts, values), logical, "logical" if logical else "double")

    def _structs(self, kind: int, shape: tuple[int, ...], parts: Any, depth: int) -> n.Node:
        if kind == _OBJECT:
            self._next(parts, "class")
        _, width = self._next(parts, "length of the names")
        _, names = self._next(parts, "names")
        each = max(int.from_bytes(bytes(width[:4]), "little" if self.order == "<" else "big"), 1)
        fields = [_text(1, names[k : k + each]) for k in range(0, len(names), each)]
        # the limit holds for the values of all fields together, before any of them is read
        count = self._check_count((*shape, max(len(fields), 1))) // max(len(fields), 1)
        self._count_arrays(count)
        elements = [n.MatStruct({name: self._inner(parts, depth) for name in fields}) for _ in range(count)]
        return elements[0] if count == 1 else n.MatStructArray(elements, shape)

    def _inner(self, parts: Any, depth: int) -> n.Node:
        kind, content = self._next(parts, "content")
        return self.array(content, depth + 1)[1] if kind == _MATRIX else n.MatUnreadable("data")

    def _check_count(self, shape: tuple[int, ...]) -> int:
        """Return the number of arrays that a cell array or struct claims to contain, up to the limit."""
        if math.prod(shape) > self.most:
            raise n.MatFileError(f"an array claims {size_text(shape)} values")
        return math.prod(shape)

    def _numbers(self, shape: tuple[int, ...], kind: int, content: memoryview) -> NDArray[Any]:
        """Return numbers in the stored type, which may be smaller than their class."""
        values = _row(kind, content, self.order)
        if math.prod(shape) * values.itemsize != len(content):
            raise n.MatFileError(f"an array claims {size_text(shape)} values in {len(content)} bytes")
        return values.reshape(shape, order="F")

    def _elements(self, content: memoryview) -> Iterator[tuple[int, memoryview]]:
        """Yield type and content of the elements of an array."""
        at = 0
        while at + 8 <= len(content):
            kind, size = struct.unpack_from(f"{self.order}II", content, at)
            small = kind >> 16
            # small element: sizes of 1 to 4 bytes are stored in the upper half of the type, and the content in place of
            # the size
            if small:
                yield kind & 0xFFFF, content[at + 4 : at + 4 + min(small, 4)]
                at += 8
                continue
            if at + 8 + size > len(content):
                raise n.MatFileError(f"an element of {size} bytes exceeds its array of {len(content)} bytes")
            yield kind, content[at + 8 : at + 8 + size]
            # padding to 8 bytes
            at += 8 + size + -size % 8

    def _next(self, parts: Iterator[tuple[int, memoryview]], message: str) -> tuple[int, memoryview]:
        part = next(parts, None)
        if part is None:
            raise n.MatFileError(f"an array has no {message}")
        return part


def _row(kind: int, content: memoryview, order: str) -> NDArray[Any]:
    """Return all numbers of an element."""
    if kind not in _STORED:
        raise n.MatFileError(f"an array is stored in an unknown type {kind}")
    stored = np.dtype(order + _STORED[kind])
    return np.frombuffer(content[: len(content) // stored.itemsize * stored.itemsize], stored)


def _text(kind: int, content: memoryview) -> str:
    """Decode a name up to its first zero byte."""
    return bytes(content).partition(b"\0")[0].decode(_ENCODED.get(kind, "utf-8"), errors="replace")


def _characters(kind: int, content: memoryview, shape: tuple[int, ...], order: str) -> n.MatText:
    """Decode a character array, stored in column-major order."""
    if kind in _ENCODED:
        # without a suffix, Python decodes in the byte order of the machine
        ending = {"<": "-le", ">": "-be"}[order] if kind > 16 else ""
        letters = bytes(content).decode(_ENCODED[kind] + ending, errors="replace")
    elif kind in _CODES:
        codes = _row(kind, content, order).astype(np.int64).clip(0, 0x10FFFF)
        letters = "".join(map(chr, codes.tolist()))
    else:
        letters = bytes(content).decode("latin-1")
    return n.split_text_rows(letters, shape[0])
