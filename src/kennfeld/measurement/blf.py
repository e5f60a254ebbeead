"""Reader of the frames in Vector BLF files.

A file is a sequence of objects, most of them containers: compressed pieces of another sequence of objects, which may
begin in one container and end in the next. Frames are objects of fixed layouts, so all frames of one kind in a piece
are taken out at once.
"""

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.measurement.bus_frames import Frames, joined
from kennfeld.measurement.source import MeasurementFile

_FILE = struct.Struct("<4sL")  # signature and size of the header
_OBJECT = struct.Struct("<4sHHLL")  # signature, sizes of the header, its version, size of all, kind
_CONTAINER_HEAD = 16  # bytes after the head of a container: method of compression, size
_CONTAINER = 10
_PLAIN, _DEFLATE = 0, 2  # methods
_MOST_BYTES = 1 << 28  # of one piece
_PACKING = 1100  # maximum compression ratio of deflate
_GAP = 8  # bytes between objects at most
_REMOTE, _REMOTE_64 = 0x80, 0x10  # flags of frames without data
_TEN_MICROSECONDS = 1  # flag of a time stamp; else it is in ns
_HEADS = {1: 32, 2: 40}  # bytes of the two headers before an object, by version
_FLAGS_AT, _TIME_AT = 16, 24
_IDENTIFIER, _EXTENDED = (1 << 29) - 1, 1 << 31


class _Layout(NamedTuple):
    """The offsets of the parts of a frame object, from the end of its headers on; `bytes` are those of its payload."""

    bus: str
    flags: tuple[str, int]
    identifier: int
    length: int
    data: int
    bytes: int
    remote: int


# CAN message: bus u2, flags u1, length code u1, identifier u4, payload of 8 bytes
_CLASSIC = _Layout("<u2", ("u1", 2), 4, 3, 8, 8, _REMOTE)
# CAN FD message: bus u2, flags u1, code u1, identifier u4, two durations, FD flags, valid bytes u1 at 14, payload at 20
_FLEXIBLE = _Layout("<u2", ("u1", 2), 4, 14, 20, 64, _REMOTE)
# CAN FD message 64: bus u1, code u1, valid bytes u1, identifier u4 at 4, flags u4 at 12, payload at 40
_FLEXIBLE_64 = _Layout("u1", ("<u4", 12), 4, 2, 40, 64, _REMOTE_64)
_LAYOUTS = {1: _CLASSIC, 86: _CLASSIC, 100: _FLEXIBLE, 101: _FLEXIBLE_64}
_OTHERS = {  # objects that are not data frames of a CAN bus
    2: "error frames", 3: "overload frames", 4: "statistics", 5: "triggers", 6: "values of variables", 9: "events",
    11: "LIN frames", 57: "LIN frames", 29: "FlexRay frames", 41: "FlexRay frames", 50: "FlexRay frames",
    66: "FlexRay frames", 31: "states of the CAN driver", 71: "Ethernet frames", 113: "Ethernet frames",
    120: "Ethernet frames", 72: "values of variables", 73: "error frames", 104: "error frames", 90: "events",
    92: "events", 96: "comments", 65: "texts",
}  # fmt: skip
_MAX_LISTED = 4  # kinds in a message
_Places = dict[tuple[int, int], list[int]]  # places of objects by kind and version of their header


class _DamageError(Exception):
    """The rest of the file cannot be read."""


def read_frames(source: MeasurementFile) -> tuple[list[Frames], list[Finding]]:
    """Return the CAN frames; a warning if the file is cut off or damaged, so that the last ones are missing."""
    parts: list[Frames] = []
    others: Counter[int] = Counter()
    problem = ""
    with source.open() as file:
        try:
            for piece in _pieces(file, source.size, others):
                parts += piece
        except (_DamageError, struct.error, zlib.error, EOFError) as error:
            problem = str(error) or "the file ends too early"
    frames = [joined(parts)] if parts else []
    if not problem:
        if not any(map(len, frames)):
            raise InputError.of(source.location, _without_frames(others), "Record the CAN bus, or name another log.")
        return frames, []
    message = f"the BLF file is damaged or cut off ({problem})"
    remedy = "Copy it again from its source."
    if not frames:
        raise InputError.of(source.location, message, remedy)
    return frames, [_cut_off(source.location, message, len(frames[0]), remedy)]


def _without_frames(others: Mapping[int, int]) -> str:
    """Return what a file holds instead of data frames of a CAN bus."""
    names: Counter[str] = Counter()
    for kind, count in others.items():
        names[_OTHERS.get(kind, f"objects of kind {kind}")] += count
    listed = join_names([f"{count} {name}" for name, count in names.most_common(_MAX_LISTED)]) or "nothing"
    return f"holds no data frames of a CAN bus: it holds {listed}"


def _cut_off(location: Location, message: str, count: int, remedy: str) -> Finding:
    return Finding(location, f"{message}; the {count} frames before are read", remedy, severity="warning")


def _pieces(file: BinaryIO, size: int, others: Counter[int]) -> Iterator[list[Frames]]:
    """Yield the frames of each container."""
    head = file.read(_FILE.size)
    if len(head) < _FILE.size:
        raise _DamageError("its header is incomplete")
    _, length = _FILE.unpack(head)
    if not _FILE.size <= length <= 1 << 16 or len(file.read(length - _FILE.size)) < length - _FILE.size:
        raise _DamageError("its header is incomplete")
    # the first bytes of an object that ends in the next container
    rest = b""
    while head := file.read(_OBJECT.size):
        content, kind = _content(file, head, size)
        if kind != _CONTAINER:  # an uncompressed log has its objects here
            content = head + content
        piece = rest + content
        frames, end = _frames(piece, others)
        rest = piece[end:]
        yield frames
        if len(rest) > _MOST_BYTES:
            raise _DamageError("an object has no end")
    if rest.strip(b"\0"):
        raise _DamageError("the last object is incomplete")


def _content(file: BinaryIO, head: bytes, size: int) -> tuple[bytes, int]:
    """Return the content of an object of the file, unpacked, and its kind."""
    signature, _, _, length, kind = _OBJECT.unpack(head)
    if signature != b"LOBJ" or not _OBJECT.size <= length <= min(max(size, 1 << 20), _MOST_BYTES):
        raise _DamageError("an object has no valid header")
    content = file.read(length - _OBJECT.size)
    if len(content) < length - _OBJECT.size:
        raise _DamageError("the last object is incomplete")
    # Vector pads objects by `length % 4` bytes, not up to a multiple of 4
    file.read(length % 4)
    if kind != _CONTAINER:
        return content, kind
    if len(content) < _CONTAINER_HEAD:
        raise _DamageError("a container is too short")
    method, packed = struct.unpack_from("<H", content)[0], content[_CONTAINER_HEAD:]
    if method == _PLAIN:
        return packed, kind
    if method != _DEFLATE:
        raise _DamageError(f"unknown compression {method}")
    # unpacked no further than the limit: a few bytes of a damaged file may stand for gigabytes
    unpacker = zlib.decompressobj()
    unpacked = unpacker.decompress(packed, _MOST_BYTES)
    if unpacker.unconsumed_tail or not unpacker.eof:
        raise _DamageError("a container is incomplete")
    return unpacked, kind


def _frames(piece: bytes, others: Counter[int]) -> tuple[list[Frames], int]:
    """Return the frames of whole objects, in the order of their kinds, and where the incomplete rest begins.

    The kinds of other objects are counted in `others`.
    """
    places: _Places = defaultdict(list)
    at = 0
    unpack, head, most = _OBJECT.unpack_from, _OBJECT.size, len(piece)
    while True:
        begin = piece.find(b"LOBJ", at, at + _GAP + 4)
        if begin < 0:
            # within the last bytes, the signature may continue in the next container
            if at + _GAP + 4 <= most:
                raise _DamageError("an object is not where it should be")
            break
        if begin + head > most:
            break
        _, _, version, length, kind = unpack(piece, begin)
        if length < head or length > _MOST_BYTES:
            raise _DamageError("an object has no valid size")
        if begin + length > most:
            at = begin
            break
        if kind in _LAYOUTS:
            places[kind, version].append(begin)
        else:
            others[kind] += 1
        at = begin + length
    table = np.frombuffer(piece, np.uint8)
    return [part for key, begins in places.items() if (part := _of_kind(table, *key, begins)) is not None], at


def _of_kind(table: NDArray[np.uint8], kind: int, version: int, begins: list[int]) -> Frames | None:
    """Return the frames of all objects of one kind; None if their header is unknown."""
    layout, head = _LAYOUTS[kind], _HEADS.get(version, 0)
    places = np.array(begins, dtype=np.int64)
    sizes = _numbers(table, places, 8, "<u4")
    places = places[(sizes >= head + layout.data) & (head > 0)]
    if not places.size:
        return None
    unit = np.where(_numbers(table, places, _FLAGS_AT, "<u4") == _TEN_MICROSECONDS, 1e-5, 1e-9)
    time = _numbers(table, places, _TIME_AT, "<u8") * unit
    body = places + head
    identifier = _numbers(table, body, layout.identifier, "<u4").astype(np.int64)
    flags = _numbers(table, body, layout.flags[1], layout.flags[0])
    # an object may end after its valid bytes, before the whole payload of its layout
    room = _numbers(table, places, 8, "<u4").astype(np.int64) - head - layout.data
    lengths = np.minimum(_numbers(table, body, layout.length, "u1"), layout.bytes)
    width = int(lengths.max(initial=1))
    # Int[frames, bytes], positions in the piece; those behind its end read any byte, which becomes zero below
    columns = np.minimum((body + layout.data)[:, np.newaxis] + np.arange(width), table.size - 1)
    payload = table[columns]
    # bytes that the object does not hold are zeros, as in Vector's tools
    payload[np.arange(width) >= np.minimum(lengths, room)[:, np.newaxis]] = 0
    frames = Frames.of(
        "CAN",
        time,
        _numbers(table, body, 0, layout.bus),
        identifier & _IDENTIFIER,
        (identifier & _EXTENDED) != 0,
        lengths,
        payload,
    )
    return frames.select((flags & layout.remote) == 0)


def _numbers(table: NDArray[np.uint8], places: NDArray[np.int64], offset: int, kind: str) -> NDArray[Any]:
    """Return the numbers at an offset from places."""
    size = np.dtype(kind).itemsize
    return np.ascontiguousarray(table[places[:, np.newaxis] + (offset + np.arange(size))]).view(kind).ravel()
