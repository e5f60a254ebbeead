"""ZIP archives that take much more memory than they should: what unpacks to too much, or claims to hold it."""

import re
import zipfile
import zlib

__all__ = ["overgrown"]

LARGE = 100_000_000  # bytes; less than that harms nobody
DENSEST = 100  # times; the sheets of a workbook shrink to a tenth, to a thirtieth where they repeat themselves
_CHUNK = 1 << 20
_SHARED = "xl/sharedStrings.xml"
_HEAD = 4096  # bytes in which the root of the document stands
_COUNT = re.compile(rb'\b(?:uniqueC|c)ount\s*=\s*["\'](\d{1,30})')


def overgrown(archive: zipfile.ZipFile) -> str:
    """What is wrong with the sizes of an archive's members; empty where nothing is.

    A member may also state a size that is not its own, so what looks packed too badly is unpacked to see.
    """
    for member in archive.infolist():
        packed, size = member.compress_size, member.file_size
        if size < 2 * packed and packed * DENSEST > LARGE:
            size = max(size, _real_size(archive, member))
        if size > LARGE and size > DENSEST * packed:
            return f"{member.filename[:80]} holds {size / 1e6:.0f} MB or more, packed into {packed / 1e6:.1f} MB"
    return _claimed(archive)


def _claimed(archive: zipfile.ZipFile) -> str:
    """Whether the texts that the cells of a workbook share are said to be more than there can be.

    Readers make room for so many at once, and end the process where there is none.
    """
    if _SHARED not in archive.namelist():
        return ""
    with archive.open(_SHARED) as member:
        counts = [int(count) for count in _COUNT.findall(member.read(_HEAD))]
    if max(counts, default=0) <= archive.getinfo(_SHARED).file_size:
        return ""
    return f"{_SHARED} claims to hold {max(counts)} texts"


def _real_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """How much a member holds, as far as it takes to see that it is too much."""
    if member.compress_type != zipfile.ZIP_DEFLATED or archive.fp is None:
        return member.file_size
    most, found = max(LARGE, DENSEST * member.compress_size) + 1, 0
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
    # the header of a member repeats its name and states how long name and further fields are
    archive.fp.seek(member.header_offset + 26)
    lengths = archive.fp.read(4)
    archive.fp.seek(int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little"), 1)
    left = member.compress_size
    while found <= most and not unpacker.eof:
        waiting = unpacker.unconsumed_tail or archive.fp.read(min(_CHUNK, left))
        if not waiting:
            break
        left -= 0 if unpacker.unconsumed_tail else len(waiting)
        try:
            found += len(unpacker.decompress(waiting, _CHUNK))
        except zlib.error:
            break  # damaged, which its reader tells
    return found
