"""Reads MATLAB files of version 4 into a tree.

Layout: MathWorks, "MAT-File Format": for each array type, rows, columns, imaginary part, length of the name, name,
numbers by columns. The type is MOPT: byte order, 0, type of the numbers, and full, text or sparse.
"""

import struct

import numpy as np

from kennfeld.matlab.tree import DamageError, Node, Numbers, Text, Unreadable

__all__ = ["load"]

_STORED = ("f8", "f4", "i4", "i2", "u2", "u1")
_FULL, _TEXT = 0, 1


def load(content: memoryview) -> dict[str, Node]:
    """The variables of a file with this content; `DamageError` where it is none that MATLAB writes."""
    found, at = {}, 0
    while at + 20 <= len(content):
        order = "<" if struct.unpack_from("<i", content, at)[0] in range(1000) else ">"
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", content, at)
        if kind // 1000 != (order == ">") or kind % 1000 // 10 >= len(_STORED) or min(rows, columns, length) < 0:
            raise DamageError(f"at byte {at} stands no array")
        stored = np.dtype(order + _STORED[kind % 1000 // 10])
        begin, size = at + 20 + length, rows * columns * stored.itemsize
        at = begin + size * (2 if imaginary else 1)
        if at > len(content):
            raise DamageError(f"the array at byte {begin - 20 - length} claims {rows} x {columns} values")
        name = bytes(content[begin - length : begin]).partition(b"\0")[0].decode("latin-1")
        values = np.frombuffer(content[begin : begin + size], stored).reshape((rows, columns), order="F")
        found[name] = _node(values, kind % 10, bool(imaginary))
    return found


def _node(values: np.ndarray, form: int, is_complex: bool) -> Node:
    if form == _TEXT:
        codes = np.nan_to_num(values.astype(np.float64)).clip(0, 0x10FFFF).astype(int)
        return Text("\n".join("".join(map(chr, row)) for row in codes.tolist()))
    if form != _FULL:
        return Unreadable("sparse matrix")
    return Unreadable("complex numbers") if is_complex else Numbers(values)
