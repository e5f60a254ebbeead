"""Files of long columns that are read by mapping them into memory: nothing is loaded before it is used.

The columns come first, each at a multiple of 64 bytes. A description in JSON, its length and a signature end the file,
so that columns can be written one after the other. A file is written whole or not at all.
"""

import json
import mmap
import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.atomic_files import replace_atomically

_SIGNATURE = b"kennfeld columns 1"
_ALIGNMENT = 64  # bytes
_KINDS = ("<f8", "<i8", "<u4", "|b1")
_END = struct.Struct(f"<Q{len(_SIGNATURE)}s")


class ColumnFile(NamedTuple):
    """The contents of a file: notes, and read-only columns that the system loads when they are used."""

    notes: dict[str, Any]
    columns: list[NDArray[Any]]


def write_columns(path: Path, columns: Iterable[NDArray[Any]], notes: Mapping[str, Any]) -> None:
    """Write columns of floats, integers or truth values, and notes that JSON can hold; raises `OSError`.

    Args:
        path: the file; its folder is created.
        columns: each an array of one dimension, made when it is written.
        notes: read after the last column was made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_atomically(path) as temporary, temporary.open("wb") as file:
        parts = []
        for column in columns:
            kind = next(kind for kind in _KINDS if column.dtype == np.dtype(kind))
            file.write(bytes(-file.tell() % _ALIGNMENT))
            parts.append([kind, file.tell(), column.size])
            file.write(np.ascontiguousarray(column).data)
        text = json.dumps({"columns": parts, "notes": dict(notes), "size": file.tell()}).encode()
        file.write(text)
        file.write(_END.pack(len(text), _SIGNATURE))


def read_columns(path: Path) -> ColumnFile | None:
    """Return the contents of a file; None if there is no such file, or if it was not written by `write_columns`."""
    try:
        with path.open("rb") as file:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        length, signature = _END.unpack_from(content, len(content) - _END.size)
        if signature != _SIGNATURE:
            return None
        end = len(content) - _END.size
        description = json.loads(content[end - length : end])
        if description["size"] != end - length:
            return None
        columns = [np.frombuffer(content, kind, size, start) for kind, start, size in description["columns"]]
        return ColumnFile(description["notes"], columns)
    except (OSError, ValueError, KeyError, TypeError, struct.error):
        return None
