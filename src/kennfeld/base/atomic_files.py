"""Atomic writing of files: a file is written completely or not at all."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EACCES, EINVAL
from pathlib import Path

from kennfeld.base.watch_folder import note_temporary

PRIVATE = 0o600  # permissions of a file that only its owner can read
MAX_STEM = 40  # characters of the name of a file that are part of that of its temporary file
_ANY_WRITE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH


def write_whole(
    path: Path, content: bytes | str, *, durable: bool = False, private: bool = False, follow: bool = False
) -> None:
    """Write a temporary file and rename it, so that nobody sees half a file; text as UTF-8. See `replace_atomically`.

    With `durable` it is on the disk before the old file is removed: a power cut leaves one of the two. Raises
    `OSError`.
    """
    with replace_atomically(path, private=private, follow=follow) as temporary, temporary.open("wb") as file:
        file.write(content.encode("utf-8") if isinstance(content, str) else content)
        if durable:
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def replace_atomically(path: Path, *, private: bool = False, follow: bool = False) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces a file if the block raises no exception.

    The new file has the permissions of the old one, and its owner and group as far as the system allows. Other hard
    links to the old file keep the old content.

    Args:
        path: The file to write, whether or not it exists.
        private: Only its owner can read the new file, whatever the permissions of the old one.
        follow: A symbolic link stays one, and the file that it points to is replaced. Otherwise the link is replaced,
            since who made it may not be who writes.

    Yields:
        The path of an empty file in the same folder with the same extension.

    Raises:
        OSError: The file is write-protected, even for root, or is not a regular file, or the system cannot write.
    """
    target = Path(os.path.realpath(path)) if follow else path  # unlike resolve, it does not raise for cyclic links
    before = _replaceable(target, follow)
    # a name that nobody can guess or occupy, short enough for every name that the file may have
    temporary = target.with_name(f".{target.stem[:MAX_STEM]}.{os.getpid()}-{secrets.token_hex(4)}{target.suffix}")
    note_temporary(temporary)
    try:
        # private, until it has the permissions of the old file
        if private or before is not None:
            _create(temporary, PRIVATE)
        else:
            _create(temporary)
        if before is not None and not private:
            _make_like(temporary, before)
        yield temporary
        temporary.replace(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _replaceable(target: Path, follow: bool) -> os.stat_result | None:
    """Return the status of the file to be replaced, None if there is none; raise `OSError` if it must stay."""
    try:
        status = target.stat() if follow else target.lstat()
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(status.st_mode):
        return None
    if not stat.S_ISREG(status.st_mode):
        raise OSError(EINVAL, "it is a folder or a device, not a file", str(target))
    if not (status.st_mode & _ANY_WRITE and os.access(target, os.W_OK)):
        raise PermissionError(EACCES, "it is write-protected", str(target))
    return status


def _create(path: Path, permissions: int = 0o666) -> None:
    """Create an empty file; raise `FileExistsError` if there is one, or a link."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, permissions))


def _make_like(path: Path, before: os.stat_result) -> None:
    """Give a file, which only its owner can read so far, the owner, group and permissions of another one."""
    # only root may change the owner; others may still set the group
    for owner in (before.st_uid, -1) if hasattr(os, "chown") else ():
        with suppress(OSError):
            os.chown(path, owner, before.st_gid)
            break
    # last, as a change of the owner clears some permissions
    path.chmod(stat.S_IMODE(before.st_mode))
