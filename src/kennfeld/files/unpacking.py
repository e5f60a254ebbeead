"""Files within compressed files and ZIP archives, unpacked to a temporary file while they are read."""

import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import BinaryIO, NamedTuple

from kennfeld.base.archives import ZIP_ERRORS, find_oversized
from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.files.head import COPY, DAMAGED, FileHead, open_member, open_unpacked

_CHUNK = 1 << 20  # bytes
_MAX_LISTED = 8  # members in a message
_ENCRYPTED = 1  # flag of a member
_UNPACK = "Unpack it first."


class Unpacked(NamedTuple):
    """A file on disk that was unpacked, and its name in messages."""

    path: Path
    label: str


@contextmanager
def unpacked(head: FileHead, member: str = "", *, with_others: bool = False) -> Iterator[Unpacked]:
    """Yield the file within a compressed file or a ZIP archive, unpacked to a temporary folder.

    Args:
        head: the compressed file, the archive, or a member of it.
        member: the member of an archive, its only one by default.
        with_others: unpack the other members in its folder beside it, too.

    Raises:
        InputError: the content is damaged or suspiciously large, or several members may be meant.
    """
    location = Location(head.path.name)
    with TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder:
        if head.packing:
            path = Path(folder) / (head.path.stem or head.path.name)
            _write(head.path, open_unpacked(head.path, head.packing), path)
            yield Unpacked(path, head.path.name)
            return
        if head.archive is not None:
            head, member = head.archive, head.member
        chosen = choose_member(head, member)
        # the name alone, as the path of a member may lead out of the folder
        path = Path(folder) / PurePosixPath(chosen).name
        try:
            with zipfile.ZipFile(head.path) as archive:
                if oversized := find_oversized(archive):
                    raise InputError.of(location, f"suspicious archive: {oversized}", _UNPACK)
                if archive.getinfo(chosen).flag_bits & _ENCRYPTED:
                    raise InputError.of(location, f"{chosen} in it is encrypted", _UNPACK)
                for each in (chosen, *(_neighbours(head, chosen) if with_others else ())):
                    _write(head.path, open_member(archive, each), path.with_name(PurePosixPath(each).name))
        except (*ZIP_ERRORS, OSError):
            raise InputError.of(location, DAMAGED, COPY) from None
        yield Unpacked(path, f"{head.path.name}#{path.name}")


def files_in(head: FileHead) -> list[str]:
    """Return the members of a ZIP archive that are files, without the notes of operating systems."""
    return [name for name in head.members if not name.endswith("/") and not _is_hidden(name)]


def only_member(head: FileHead, member: str) -> str:
    """Return the member of a ZIP archive that an address names, or its only one; empty if several may be meant."""
    names = files_in(head)
    matches = [each for each in names if not member or member in (each, PurePosixPath(each).name)]
    return matches[0] if len(matches) == 1 else ""


def choose_member(head: FileHead, member: str) -> str:
    """Return the member of a ZIP archive that is meant; raise `InputError` if that is not one."""
    location, names = Location(head.path.name), files_in(head)
    chosen = only_member(head, member)
    if chosen:
        return chosen
    if not head.members:
        message = "this ZIP archive (an Excel file, perhaps) is damaged or cut off"
        raise InputError.of(location, message, COPY)
    if not names:
        raise InputError.of(location, "the archive holds no files", "Is it the right file?")
    if not member:
        message = f"the archive holds {len(names)} files: {join_names(names, _MAX_LISTED)}"
        raise InputError.of(location, message, f"Name one: {head.path.name}#{names[0]}.")
    count = sum(member in (each, PurePosixPath(each).name) for each in names)
    remedy = nearest(member, names) or f"It has {join_names(names, _MAX_LISTED)}."
    raise InputError.of(location, f"the archive has {count or 'no'} files named {member}", remedy)


def _neighbours(head: FileHead, member: str) -> list[str]:
    own = PurePosixPath(member)
    return [name for name in files_in(head) if PurePosixPath(name).parent == own.parent and name != member]


def _is_hidden(member: str) -> bool:
    return any(part.startswith((".", "__MACOSX")) for part in PurePosixPath(member).parts)


def _write(packed: Path, stream: BinaryIO, path: Path) -> None:
    """Write the content of a stream to a file; raise `InputError` if it is damaged or too large."""
    location = Location(packed.name)
    try:
        with stream, path.open("wb") as file:
            shutil.copyfileobj(stream, file, _CHUNK)
    except InputError:
        raise
    except Exception as error:  # of many kinds: one for each way to compress
        # errors of the system have a number, those of decompression have none
        if isinstance(error, OSError) and error.errno is not None:
            message = f"cannot be unpacked ({error.strerror})"
            raise InputError.of(location, message, "Make room for temporary files, or unpack it first.") from None
        raise InputError.of(location, DAMAGED, COPY) from None
