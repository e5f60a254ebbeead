"""Machine code that was compiled before, in a folder of the user.

A file is one module, named by the hash of what it was compiled from. Its content is preceded by a hash of its own, so
that a damaged file is ignored. It may be deleted at any time; if anything fails, the code is compiled.
"""

import os
from contextlib import suppress
from functools import cache
from hashlib import blake2b
from itertools import count
from pathlib import Path

from kennfeld.base.atomic_files import write_whole

VARIABLE = "KENNFELD_CACHE"  # names another folder; empty keeps nothing
LARGEST = 64_000_000  # bytes of the folder
LIMITED_EVERY = 50  # kept codes of a process: all files are looked at, thousands of small ones in a full folder
_HASH = 32  # bytes
_OTHERS = 0o022  # permission of others to write
_KEPT = count()


def key_of(*parts: str) -> str:
    """Return the name under which code that depends on these texts is kept."""
    return blake2b("\0".join(parts).encode(), digest_size=_HASH).hexdigest()


def read_code(key: str) -> bytes | None:
    """Return the code of a key; None if there is none, or if somebody else may have written it."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        with (folder / key).open("rb") as file:
            # of the open file, which nobody can exchange after the check
            if not is_own(os.fstat(file.fileno())):
                return None
            content = file.read()
        os.utime(folder / key)  # it is used
    except OSError:
        return None
    code = content[_HASH:]
    return code if content[:_HASH] == _hash(key, code) else None


def keep_code(key: str, code: bytes) -> None:
    """Keep the code of a key, and remove what was not used for the longest time if there is too much."""
    folder = cache_folder()
    if folder is None:
        return
    with suppress(OSError):
        write_whole(folder / key, _hash(key, code) + code)
        if next(_KEPT) % LIMITED_EVERY == 0:
            _limit(folder)


@cache
def cache_folder() -> Path | None:
    """Return the folder of the code, which is created; None if there is none that others cannot write."""
    name = os.environ.get(VARIABLE)
    if name == "":
        return None
    with suppress(OSError, RuntimeError):
        folder = Path(name) if name else Path.home() / ".kennfeld" / "code"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_own(folder.stat()):
            return folder
    return None


def is_own(status: os.stat_result) -> bool:
    """Return if a file or folder belongs to the user, and nobody else can write it."""
    if not hasattr(os, "getuid"):  # Windows protects the folder of the user
        return True
    return status.st_uid == os.getuid() and not status.st_mode & _OTHERS


def _hash(key: str, code: bytes) -> bytes:
    # keyed, so that the content of another name is not taken for it
    return blake2b(code, key=bytes.fromhex(key), digest_size=_HASH).digest()


def _limit(folder: Path) -> None:
    with os.scandir(folder) as files:
        entries = sorted((entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in files)
    excess = sum(size for _, size, _ in entries) - LARGEST
    for _, size, path in entries:
        if excess <= 0:
            return
        Path(path).unlink(missing_ok=True)
        excess -= size
