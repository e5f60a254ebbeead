"""Recordings in compressed files and ZIP archives, which are unpacked to a temporary file while they are read."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import BinaryIO

from kennfeld.archives import find_oversized
from kennfeld.errors import InputError
from kennfeld.formatting import join_names, nearest
from kennfeld.measurement.file_kind import FileKind, MeasurementFile, locate

_CHUNK = 1 << 20  # bytes
_HARMLESS = 1_000_000_000  # bytes; unpacked content up to this size is never refused
_MAX_RATIO = 200  # of unpacked to packed size beyond that; recordings shrink to a thirtieth at best
_MAX_LISTED = 8  # members in a message
_WITH_OTHERS = (FileKind.DIADEM, FileKind.TDM)  # their values are in other files beside them
_BZIP2, _XZ = b"BZh", b"\xfd7zXZ"


@contextmanager
def unpacked(source: MeasurementFile, reads_gzip: bool) -> Iterator[MeasurementFile]:
    """Yield the recording within a compressed file or archive; the file itself if it is neither.

    Args:
        source: the file; of a ZIP archive with several recordings, its sheet is the name of a member.
        reads_gzip: the reader of this kind unpacks gzip itself.

    Raises:
        InputError: the content is damaged or suspiciously large, or several members may be meant.
    """
    member = ""
    if source.kind is FileKind.ZIP:
        member, content = _members(source)
    elif source.kind is FileKind.PACKED or (source.packed and not reads_gzip):
        content = _single(source)
    else:
        yield source
        return
    with TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder:
        name, stream, sheet = content
        path = Path(folder) / name
        size = _write(source, stream, path)
        inner = locate(path, sheet)
        if member and inner.kind in _WITH_OTHERS:
            _write_others(source, member, Path(folder), size)
        if inner.packed or inner.kind in (FileKind.ZIP, FileKind.PACKED):
            raise InputError.of(source.location, f"{name} in it is compressed as well", "Unpack it first.")
        label = f"{source.name}#{name}" if source.kind is FileKind.ZIP else source.name
        yield replace(inner, label=label)


def _single(source: MeasurementFile) -> tuple[str, BinaryIO, str | None]:
    """Return name and content of the file in a file that was compressed by gzip, bzip2 or xz."""
    name = source.path.stem or source.name
    if source.packed:
        return name, source.open(), source.sheet
    start = source.start(8)
    if start.startswith(_BZIP2):
        import bz2

        return name, bz2.open(source.path, "rb"), source.sheet  # type: ignore[return-value]
    if start.startswith(_XZ):
        import lzma

        return name, lzma.open(source.path, "rb"), source.sheet  # type: ignore[return-value]
    remedy = "Unpack it first; gzip, bzip2, xz and ZIP can be read."
    raise InputError.of(source.location, "this is a compressed file", remedy)


def _members(source: MeasurementFile) -> tuple[str, tuple[str, BinaryIO, str | None]]:
    """Return the member of an archive that is meant, and its name and content."""
    try:
        return _open_member(source)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError, ValueError, KeyError):
        raise _damaged(source) from None


def _damaged(source: MeasurementFile) -> InputError:
    message = "the compressed file is damaged or cut off"
    return InputError.of(source.location, message, "Copy it again from its source.")


def _open_member(source: MeasurementFile) -> tuple[str, tuple[str, BinaryIO, str | None]]:
    with zipfile.ZipFile(source.path) as archive:
        if oversized := find_oversized(archive):
            raise InputError.of(source.location, f"suspicious archive: {oversized}", "Unpack it first.")
        chosen = _choose(source, _files(archive))
        if archive.getinfo(chosen).flag_bits & 1:
            raise InputError.of(source.location, f"{chosen} in it is encrypted", "Unpack it first.")
        return chosen, (PurePosixPath(chosen).name, archive.open(chosen), None)  # type: ignore[return-value]


def _files(archive: zipfile.ZipFile) -> list[str]:
    return [each.filename for each in archive.infolist() if not each.is_dir() and not _is_hidden(each.filename)]


def _write_others(source: MeasurementFile, member: str, folder: Path, size: int) -> None:
    """Write the other members in the folder of one; `size` bytes are unpacked already."""
    own = PurePosixPath(member)
    try:
        with zipfile.ZipFile(source.path) as archive:
            for each in map(PurePosixPath, _files(archive)):
                if each.parent == own.parent and each.name != own.name:
                    stream: BinaryIO = archive.open(str(each))  # type: ignore[assignment]
                    size += _write(source, stream, folder / each.name, size)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError, ValueError, KeyError):
        raise _damaged(source) from None


def _is_hidden(member: str) -> bool:
    """Return whether a member is a note of an operating system."""
    return any(part.startswith((".", "__MACOSX")) for part in PurePosixPath(member).parts)


def _choose(source: MeasurementFile, members: list[str]) -> str:
    if source.sheet is None:
        if len(members) == 1:
            return members[0]
        if not members:
            raise InputError.of(source.location, "the archive holds no files", "Is it the right file?")
        message = f"the archive holds {len(members)} files: {join_names(members, _MAX_LISTED)}"
        raise InputError.of(source.location, message, f"Name one: {source.name}#{members[0]}.")
    matches = [each for each in members if source.sheet in (each, PurePosixPath(each).name)]
    if len(matches) == 1:
        return matches[0]
    message = f"the archive has {len(matches) or 'no'} files named {source.sheet}"
    remedy = nearest(source.sheet, members) or f"It has {join_names(members, _MAX_LISTED)}."
    raise InputError.of(source.location, message, remedy)


def _write(source: MeasurementFile, stream: BinaryIO, path: Path, before: int = 0) -> int:
    """Write the content of a stream to a file and return its size; raise `InputError` if it is damaged or too large.

    The `before` bytes of other files that were unpacked count too.
    """
    packed = source.path.stat().st_size
    limit = max(_HARMLESS, _MAX_RATIO * packed)
    size = 0
    try:
        with stream, path.open("wb") as file:
            while chunk := stream.read(_CHUNK):
                size += len(chunk)
                if before + size > limit:
                    message = f"its {packed / 1e6:.1f} MB unpack to more than {limit / 1e6:.0f} MB"
                    raise InputError.of(source.location, message, "Unpack it first if you trust it.")
                file.write(chunk)
    except InputError:
        raise
    except Exception as error:  # of many kinds: one for each way to compress
        if isinstance(error, OSError) and error.errno is not None:
            message = f"cannot be unpacked ({error.strerror})"
            raise InputError.of(
                source.location, message, "Make room for temporary files, or unpack it first."
            ) from None
        raise _damaged(source) from None
    return size
