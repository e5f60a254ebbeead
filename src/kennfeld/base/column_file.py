"""Files of long columns that are read by mapping them into memory: nothing is loaded before it is used.

The columns come first, each at a multiple of 64 bytes. A description in JSON, its length, the checksum of all before
and a signature end the file, so that columns can be written one after the other. A file is written whole or not at all,
and each process that reads it checks it once.
"""

import json
import mmap
import os
import struct
import time
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.atomic_files import replace_atomically

_SIGNATURE = b"kennfeld columns 2"
_ALIGNMENT = 64  # bytes
_KINDS = ("<f8", "<i8", "<u4", "|b1")
_LENGTH = struct.Struct("<Q")
_END = struct.Struct(f"<I{len(_SIGNATURE)}s")
_BLOCK = 1 << 20  # bytes
_SETTLED = 2_000_000_000  # ns; a file that was changed later than that before a look at it may change unnoticed
_checked: dict[Path, tuple[int, int, int, int]] = {}  # files whose checksum is right


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
    with replace_atomically(path) as temporary, temporary.open("w+b") as file:
        parts = []
        for column in columns:
            kind = next(kind for kind in _KINDS if column.dtype == np.dtype(kind))
            file.write(bytes(-file.tell() % _ALIGNMENT))
            parts.append([kind, file.tell(), column.size])
            file.write(np.ascontiguousarray(column).data)
        text = json.dumps({"columns": parts, "notes": dict(notes), "size": file.tell()}).encode()
        file.write(text)
        file.write(_LENGTH.pack(len(text)))
        size = file.tell()
        # the columns came one by one, so that the whole is read once more
        file.seek(0)
        file.write(_END.pack(_checksum(file, size), _SIGNATURE))


def read_columns(path: Path) -> ColumnFile | None:
    """Return the contents of a file; None if there is none, or if it is not as `write_columns` has written it."""
    try:
        with path.open("rb") as file:
            if not _is_whole(path, file):
                return None
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        end = len(content) - _END.size - _LENGTH.size
        (length,) = _LENGTH.unpack_from(content, end)
        description = json.loads(content[end - length : end])
        if description["size"] != end - length:
            return None
        columns = [np.frombuffer(content, kind, size, start) for kind, start, size in description["columns"]]
        return ColumnFile(description["notes"], columns)
    except (OSError, ValueError, KeyError, TypeError, struct.error):
        return None


def _is_whole(path: Path, file: BinaryIO) -> bool:
    """Return whether a file ends with its checksum and the signature; it is computed once, unless the file changes."""
    stat = os.fstat(file.fileno())
    identity = stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns
    if _checked.get(path) == identity:
        return True
    size = stat.st_size - _END.size
    file.seek(size)
    checksum, signature = _END.unpack(file.read())
    file.seek(0)
    if signature != _SIGNATURE or checksum != _checksum(file, size):
        return False
    if time.time_ns() - stat.st_ctime_ns > _SETTLED:
        _checked[path] = identity
    return True


def _checksum(file: BinaryIO, size: int) -> int:
    """Return the CRC-32 of the next bytes of a file, which are read, not mapped: they take no memory."""
    result = 0
    while size > 0:
        block = file.read(min(size, _BLOCK))
        if not block:
            break
        result, size = zlib.crc32(block, result), size - len(block)
    return result
