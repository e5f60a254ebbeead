"""Replaces files of a folder together: all of them or none, even if the process is killed or the power fails.

New files are written into a hidden folder within the folder, `.kennfeld-TOKEN`, and renamed into place at the end. A
process that is killed before the first rename leaves the folder as it was. One that is killed later leaves a list of
its files, and the next process that uses the folder renames the rest. A lock file distinguishes the hidden folder of a
running process from that of a dead one.

A folder may come from a stranger, hidden folders included, and its list then names what the stranger likes: only plain
names of regular files are renamed, and no link is followed.
"""

import json
import os
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from errno import EINVAL, ELOOP
from pathlib import Path
from typing import BinaryIO

from kennfeld.base.output_paths import is_link, is_plain_name

PREFIX = ".kennfeld-"
MAX_SYNCS = 16  # files at the same time
LOCK, NAMES, BEFORE = "lock", "names", "before"
_SCRATCH = re.compile(re.escape(PREFIX) + r"[0-9a-f]+")


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """Yield a new hidden folder within `folder`, which is made if needed; it is removed at the end in any case.

    Leftovers of dead processes are finished or removed first. Raises `OSError`.
    """
    finish_interrupted(folder)
    scratch, lock = _new_scratch(folder)
    try:
        yield scratch
    finally:
        lock.close()
        shutil.rmtree(scratch, ignore_errors=True)


def _new_scratch(folder: Path) -> tuple[Path, BinaryIO]:
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        scratch = folder / f"{PREFIX}{secrets.token_hex(8)}"
        try:
            scratch.mkdir()
        except FileNotFoundError:  # another process made the folder, and removed it empty just now
            continue
        lock = _lock(scratch)
        if lock is not None:
            return scratch, lock


def _lock(scratch: Path) -> BinaryIO | None:
    """Return the open lock file of a scratch folder, or None if another process holds it or has removed the folder."""
    try:
        file = _open_lock(scratch / LOCK)
    except OSError:
        return None
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # another process may have finished and removed the folder between opening and locking
        if (scratch / LOCK).exists():
            return file
    except OSError:
        pass
    file.close()
    return None


def _open_lock(path: Path) -> BinaryIO:
    """Open a lock file, which is created if needed; raise `OSError` for a link, a pipe or a device."""
    if is_link(path):  # for Windows, where the flag is missing
        raise OSError(ELOOP, "it is a symbolic link", str(path))
    # O_NONBLOCK: opening a pipe would wait for its other end
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    number = os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise OSError(EINVAL, "it is not a file", str(path))
    return os.fdopen(number, "ab")


def finish_interrupted(folder: Path) -> None:
    """Finish the renames of killed processes in `folder`, and remove their scratch folders.

    A scratch folder that cannot be finished is kept.
    """
    try:
        leftovers = [path for path in folder.iterdir() if _is_scratch(path)]
    except (FileNotFoundError, NotADirectoryError):
        return
    for scratch in leftovers:
        lock = _lock(scratch)
        if lock is None:
            continue
        with lock, suppress(OSError):
            for name in _list_unfinished(scratch):
                (scratch / name).replace(folder / name)
            _sync_folder(folder)
            lock.close()  # Windows cannot remove open files
            shutil.rmtree(scratch, ignore_errors=True)


def _is_scratch(path: Path) -> bool:
    return _SCRATCH.fullmatch(path.name) is not None and path.is_dir() and not is_link(path)


def _list_unfinished(scratch: Path) -> list[str]:
    """Return the names of the complete new files that have not been renamed yet, in order.

    A list that this module cannot have written is ignored.
    """
    try:
        names = [] if is_link(scratch / NAMES) else json.loads((scratch / NAMES).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    if not isinstance(names, list) or not all(isinstance(name, str) and is_plain_name(name) for name in names):
        return []
    # a file that is not here any more was renamed before the process ended
    return [name for name in names if (scratch / name).is_file() and not is_link(scratch / name)]


def move(names: Sequence[str], scratch: Path, folder: Path) -> None:
    """Rename finished files from `scratch` into `folder`, in order. If one cannot be replaced, the others are put back.

    Everything is on the disk before the first file of the folder is replaced. Raises `OSError`.
    """
    # contents first: after a power failure, a renamed file without them would be empty
    _sync_together(_sync, [scratch / name for name in names])
    (scratch / BEFORE).mkdir()
    for name in names:
        if (folder / name).exists():
            _duplicate(folder / name, scratch / BEFORE / name)
    # from now on, the next process finishes the renames; half a list is invalid JSON
    (scratch / NAMES).write_text(json.dumps(list(names)), encoding="utf-8")
    _sync(scratch / NAMES)
    _sync_together(_sync_folder, [scratch, folder])
    moved: list[str] = []
    try:
        for name in names:
            # before the rename, as an interrupt may come right behind it
            moved.append(name)
            (scratch / name).replace(folder / name)
    except BaseException:
        # first, so that no other process finishes what is being undone
        (scratch / NAMES).unlink(missing_ok=True)
        for name in moved:
            _restore(scratch / BEFORE / name, folder / name)
        raise
    _sync_folder(folder)


def _duplicate(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # not every file system has hard links
        shutil.copy2(source, target)


def _restore(before: Path, path: Path) -> None:
    with suppress(OSError):
        if before.exists():
            before.replace(path)
        else:
            path.unlink(missing_ok=True)


def _sync_together(sync: Callable[[Path], None], paths: Sequence[Path]) -> None:
    """Write paths through to the disk at the same time, which takes it hardly longer than one."""
    with ThreadPoolExecutor(MAX_SYNCS) as pool:
        list(pool.map(sync, paths))


def _sync(path: Path) -> None:
    """Write a file through to the disk, where some file systems first report that there is no space."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Write a folder's names through to the disk, on systems that can."""
    if sys.platform == "win32":
        return
    with suppress(OSError):
        entry = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(entry)
        finally:
            os.close(entry)
