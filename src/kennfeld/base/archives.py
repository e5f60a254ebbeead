"""Copies of archives with other contents, and protection against those that unpack to far more than their size.

One rule decides for all formats which files unpack, or claim to unpack, to too much.
"""

import io
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping

from kennfeld.base.process_limits import memory_bound

# what `zipfile` raises for damaged archives and unusual ways of compression, beside `OSError`
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, KeyError)
_PER_BYTE = 12  # bytes of memory that a byte of text takes while it is read: a column with one digit a row
_CHUNK = 1 << 20
_BEST_RATIO = 1032  # of Deflate
_SHARED = "xl/sharedStrings.xml"
_HEAD = 4096  # bytes that contain the root element of the document
_COUNT = re.compile(rb'\b(?:uniqueC|c)ount\s*=\s*["\'](\d{1,30})')


def most_unpacked(packed: int) -> int:
    """Return the bytes that a file of so many packed bytes may unpack to, so that its text keeps `memory_bound`.

    Recordings shrink to a thirtieth as a rule, and logs of a machine at rest to a hundredth.

    >>> most_unpacked(0) // 10**6, most_unpacked(200_000) // 10**6
    (33, 50)
    """
    return memory_bound(packed) // _PER_BYTE


def find_oversized(archive: zipfile.ZipFile) -> str:
    """Return why an archive's members are too large, each or all of them; empty if they are not.

    A member may also state a false size, so one that seems to be compressed too little is unpacked as a check.
    """
    total = 0
    for member in archive.infolist():
        packed, size = member.compress_size, member.file_size
        # a small size that many packed bytes state may be false, as they can unpack to 1032 times as much
        if size < 2 * packed and packed * _BEST_RATIO > most_unpacked(packed):
            size = max(size, _real_size(archive, member))
        if size > most_unpacked(packed):
            return f"{member.filename[:80]} holds {size / 1e6:.0f} MB or more, packed into {packed / 1e6:.1f} MB"
        total += size
    whole = _size_of(archive)
    if total > most_unpacked(whole):  # members may share their packed bytes
        return f"its members hold {total / 1e6:.0f} MB, packed into {whole / 1e6:.1f} MB"
    if _SHARED not in archive.namelist():
        return ""
    # readers allocate memory for as many texts as a workbook claims, and abort the process if there is not enough
    with archive.open(_SHARED) as file:
        claimed = max(map(int, _COUNT.findall(file.read(_HEAD))), default=0)
    return f"{_SHARED} claims to hold {claimed} texts" if claimed > archive.getinfo(_SHARED).file_size else ""


def _size_of(archive: zipfile.ZipFile) -> int:
    """Return the bytes of the archive itself."""
    return archive.fp.seek(0, io.SEEK_END) if archive.fp is not None else 0


def _real_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Return the unpacked size of a member, counted only until it is too large."""
    if member.compress_type != zipfile.ZIP_DEFLATED or archive.fp is None:
        return member.file_size
    limit, size = most_unpacked(member.compress_size) + 1, 0
    # plain Deflate, without the header of zlib
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
    # the header of a member repeats its name and states how long name and further fields are
    archive.fp.seek(member.header_offset + 26)
    lengths = archive.fp.read(4)
    archive.fp.seek(int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little"), 1)
    remaining = member.compress_size
    while size <= limit and not unpacker.eof:
        data = unpacker.unconsumed_tail or archive.fp.read(min(_CHUNK, remaining))
        if not data:
            break
        remaining -= 0 if unpacker.unconsumed_tail else len(data)
        try:
            size += len(unpacker.decompress(data, _CHUNK))
        except zlib.error:
            break  # damaged; reported by the reader
    return size


def with_members(raw: bytes, contents: Mapping[str, bytes]) -> bytes:
    """Return an archive with other contents of some members, by name; all others stay as they are."""
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as before, zipfile.ZipFile(result, "w") as after:
        after.comment = before.comment
        for member in before.infolist():
            content = contents.get(member.filename)
            # the entry keeps the date and the attributes of the member
            after.writestr(member, before.read(member) if content is None else content, member.compress_type)
    return result.getvalue()


def iterate_chunks(archive: zipfile.ZipFile, member: str | zipfile.ZipInfo, overlap: int) -> Iterator[bytes]:
    """Yield the unpacked content of a member in parts that overlap by so many bytes."""
    tail = b""
    with archive.open(member) as stream:
        while chunk := stream.read(_CHUNK):
            yield tail + chunk
            tail = chunk[-overlap:]
