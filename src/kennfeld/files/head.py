"""The beginning of a file, unpacked and decoded once: all that recognition looks at."""

import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from io import BufferedIOBase, BytesIO
from pathlib import Path, PurePosixPath
from typing import BinaryIO, cast

from kennfeld.base.archives import ZIP_ERRORS
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import nearest_file
from kennfeld.base.file_state import note_opened
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import decode
from kennfeld.files.limited_stream import limited
from kennfeld.files.xml_root import xml_root

HEAD_SIZE = 65536  # bytes or characters that tell what a file is

ZIP = (b"PK\x03\x04", b"PK\x05\x06")  # the second one is an archive without members
_OPENERS = {"gzip": "gzip", "bzip2": "bz2", "xz": "lzma"}  # module of the standard library by packing
_PACKINGS = ((b"\x1f\x8b", "gzip"), (b"BZh", "bzip2"), (b"\xfd7zXZ", "xz"))
_PACKED_ENDINGS = (".gz", ".bz2", ".xz")
_NESTED = 200_000_000  # bytes of an archive within a compressed file, such as a workbook, that are unpacked to list it
DAMAGED = "the compressed file is damaged or cut off"
COPY = "Copy it again from its source."


@dataclass(frozen=True)
class FileHead:
    """The first 64 KB of a file, or of the file that is compressed in it.

    Attributes:
        path: the file.
        raw: the first bytes, unpacked.
        packing: "gzip", "bzip2" or "xz" if the file is compressed, else empty.
        member: the member of a ZIP archive that `raw` belongs to, else empty.
        archive: the head of that archive.
    """

    path: Path
    raw: bytes
    packing: str = ""
    member: str = ""
    archive: "FileHead | None" = None

    @property
    def name(self) -> str:
        """The name of the file that is read, without the ending of its packing."""
        if self.member:
            return PurePosixPath(self.member).name
        return self.path.stem if self.packing and self.path.suffix.lower() in _PACKED_ENDINGS else self.path.name

    @property
    def ending(self) -> str:
        """The ending of that name, in lower case."""
        return Path(self.name).suffix.lower()

    @cached_property
    def text(self) -> str:
        """The decoded text with LF line ends and without a byte order mark; empty for binary content."""
        # what is cut off may end within a character
        return "" if self.is_binary else decode(self.raw, whole=len(self.raw) < HEAD_SIZE)

    @cached_property
    def words(self) -> str:
        """The text in lower case, without leading blanks."""
        return self.text.lstrip().lower()

    @cached_property
    def root(self) -> str:
        """The name of the root if the text is an XML document; empty for other content."""
        return xml_root(self.text)

    @property
    def is_binary(self) -> bool:
        """True if it contains NUL bytes and is not UTF-16."""
        return b"\0" in self.raw and not self.raw.startswith((b"\xff\xfe", b"\xfe\xff"))

    @property
    def is_blank(self) -> bool:
        """True if it contains nothing but blanks and control characters that count as such."""
        return not self.raw.strip() or not (self.is_binary or self.text.strip())

    @cached_property
    def members(self) -> tuple[str, ...]:
        """The names of the members if the content is a ZIP archive, compressed or not; none if it is damaged."""
        if not self.raw.startswith(ZIP):
            return ()
        try:
            with self._opened() as archive:
                return tuple(archive.namelist())
        except (*ZIP_ERRORS, OSError, InputError):
            return ()

    def first_bytes(self, member: str, size: int) -> bytes:
        """Return the first bytes of a member of the archive; empty if it has none of this name."""
        if member not in self.members:
            return b""
        try:
            with self._opened() as archive, open_member(archive, member) as stream:
                return stream.read(size)
        except (*ZIP_ERRORS, OSError):
            raise InputError.of(Location(self.path.name), DAMAGED, COPY) from None

    def whole(self, limit: int = -1) -> bytes:
        """Return the whole content, unpacked, or its first `limit` bytes."""
        if self.archive is not None:
            return self.archive.first_bytes(self.member, limit)
        with guarded(self.path.name), open_unpacked(self.path, self.packing) as stream:
            return stream.read(limit)

    def head_of(self, member: str) -> "FileHead":
        """Return the head of a member of the archive."""
        return replace(self, raw=self.first_bytes(member, HEAD_SIZE), packing="", member=member, archive=self)

    def _opened(self) -> zipfile.ZipFile:
        # zipfile has to seek, so what is packed is unpacked into memory
        return zipfile.ZipFile(BytesIO(self._unpacked) if self.packing or self.archive is not None else self.path)

    @cached_property
    def _unpacked(self) -> bytes:
        return self.whole(_NESTED)


def read_head(path: Path) -> FileHead:
    """Return the head of a file; raises `InputError` if there is none, or if it cannot be unpacked."""
    note_opened(path)
    if path.is_dir():
        raise InputError.of(Location.of_file(path), "this is a folder and cannot be read", "Name a file in it.")
    if not path.exists():
        remedy = "Check the path: the folder does not exist."
        if path.parent.is_dir():
            remedy = nearest_file(path) or "Check the path."
        raise InputError.of(Location.of_file(path), "there is no such file", remedy)
    with guarded(path.name):
        with path.open("rb") as stream:
            raw = stream.read(HEAD_SIZE)
        packing = next((packing for mark, packing in _PACKINGS if raw.startswith(mark)), "")
        if packing:
            with open_unpacked(path, packing) as stream:
                raw = stream.read(HEAD_SIZE)
    return FileHead(path, raw, packing)


def open_unpacked(path: Path, packing: str) -> BinaryIO:
    """Open a file that is compressed in this way, or the file itself for an empty `packing`.

    Reading the stream raises `InputError` if it unpacks to far more than the size of the file.
    """
    if not packing:
        return path.open("rb")
    opener: Callable[..., BufferedIOBase] = import_module(_OPENERS[packing]).open
    return limited(opener(path, "rb"), path.name, path.stat().st_size)


def open_member(archive: zipfile.ZipFile, member: str) -> BinaryIO:
    """Open a member of a ZIP archive, with the same limit."""
    return limited(
        cast(BufferedIOBase, archive.open(member)), PurePosixPath(member).name, archive.getinfo(member).compress_size
    )


@contextmanager
def guarded(name: str) -> Iterator[None]:
    """Convert errors of the system and of decompression within the block to an `InputError`."""
    try:
        yield
        return
    except OSError as error:
        if error.errno is not None:  # those of decompression have none
            message = f"cannot be read ({error.strerror or error})"
            raise InputError.of(Location(name), message, "Check the file.") from None
    except Exception as error:
        # by its name, as lzma is imported only for files that need it
        if not isinstance(error, EOFError | zlib.error | zipfile.BadZipFile) and type(error).__name__ != "LZMAError":
            raise
    raise InputError.of(Location(name), DAMAGED, COPY)
