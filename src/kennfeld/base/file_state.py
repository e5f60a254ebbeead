"""The state of files: by it, everything that is remembered of a file knows whether the file is still the same.

Size and times tell that a file has changed, but not that it has not: two exports of one second can agree in both. So
the content counts, and size and times only save reading it again once they are old enough to be trusted.
"""

import hashlib
import os
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from threading import Lock
from typing import Any, ParamSpec, TypeVar

from kennfeld.base.lazy_dataclass import dataclass

_P = ParamSpec("_P")
_R = TypeVar("_R")

SETTLED = 2_000_000_000  # ns; a file that was changed shorter before a look at it may change unnoticed
ABSENT = "absent"  # the content of a file that does not exist

_known: OrderedDict[Path, "FileState"] = OrderedDict()  # of this process
_KNOWN = 4096  # entries
_seen: dict[Path, "FileVersion"] = {}  # by `version_of`
_collections: list[dict[Path, tuple[int, ...]]] = []  # that are under way
_lock = Lock()


@dataclass(frozen=True)
class FileState:
    """A file when its content was hashed.

    Attributes:
        size: in bytes.
        changed: when the content was changed, and when anything of the file was; ns.
        at: when it was hashed; ns.
        content: the hash; of a folder, that of the names in it.
        number: that of the file in its file system.
    """

    size: int
    changed: tuple[int, int]
    at: int
    content: str
    number: int = 0

    @classmethod
    def of(cls, path: Path) -> "FileState":
        """Return the present state of a file or folder. Raises `OSError`."""
        # before the look at the file, so that a change during it counts as recent
        at, stat = time.time_ns(), path.stat()
        if path.is_dir():
            content = digest(
                "\0".join(sorted(entry.name for entry in path.iterdir())).encode("utf-8", "surrogateescape")
            )
        else:
            with path.open("rb") as file:
                content = hashlib.file_digest(file, _hash).hexdigest()
        return cls(stat.st_size, (stat.st_mtime_ns, stat.st_ctime_ns), at, content, stat.st_ino)

    @classmethod
    def from_json(cls, note: Mapping[str, Any]) -> "FileState":
        """Return a state that was noted. Raises `ValueError`, `KeyError` or `TypeError` if the note is damaged."""
        first, second = note["changed"]
        content = note["content"]
        if not (isinstance(content, str) and content.isalnum()):  # it is part of names and patterns of files
            raise ValueError(f"{content!r} is not a hash")
        return cls(int(note["size"]), (int(first), int(second)), int(note["at"]), content, int(note["number"]))

    def describes(self, stat: os.stat_result) -> bool:
        """Return whether a file has this size, these times and this number."""
        return (self.size, *self.changed, self.number) == _times_of(stat)

    def holds(self, stat: os.stat_result) -> bool:
        """Return whether the file is certainly unchanged, without reading its content."""
        return self.describes(stat) and self.at - max(self.changed) > SETTLED


def content_of(path: Path) -> str:
    """Return the hash of a file's content, or of the names in a folder; `ABSENT` if there is no such file.

    A file that has not changed is read once in a process.

    Raises:
        OSError: it cannot be read.
    """
    path = path.absolute()
    try:
        stat = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return ABSENT
    with _lock:
        known = _known.get(path)
    if known is None or not known.holds(stat):
        known = FileState.of(path)
        with _lock:
            _known[path] = known
            while len(_known) > _KNOWN:
                _known.popitem(last=False)
    return known.content


def version_of(paths: Iterable[Path]) -> str:
    """Return a text that differs if a file does: in its size, in a time, or in its content while that is recent."""
    return digest(repr([(str(path.absolute()), _version_of(path)) for path in paths]).encode())


def _version_of(path: Path) -> tuple[tuple[int, ...], str]:
    """Return size, times and content; the same in a process while the file is the same, though it settles."""
    times, path = _times(path), path.absolute()
    seen = _seen.get(path)
    if seen is None or not seen.is_present:
        try:
            seen = FileVersion(path, times, "" if _is_settled(times) else content_of(path))
        except OSError:
            return times, f"unreadable at {time.time_ns()}"  # equals no other version
        _seen[path] = seen
    return seen.times, seen.content


def _is_settled(times: tuple[int, ...]) -> bool:
    """Return whether size and times are old enough to tell that a file has not changed."""
    return not times or time.time_ns() - max(times[1:3]) > SETTLED


def digest(content: bytes) -> str:
    """Return the hash of a content."""
    hashed = _hash()
    hashed.update(content)
    return str(hashed.hexdigest())


def _hash() -> Any:
    return hashlib.blake2b(digest_size=20)


def note_opened(path: Path) -> None:
    """Let what is being read depend on a file that is opened for it, or that is looked for in vain."""
    path = path.absolute()
    for collection in tuple(_collections):
        # the first look counts, as the file may change while it is read
        collection.setdefault(path, _times(path))


@contextmanager
def opened_files() -> Iterator[dict[Path, tuple[int, ...]]]:
    """Collect size and times of all files that are noted within the block, by whatever thread."""
    collection: dict[Path, tuple[int, ...]] = {}
    _collections.append(collection)
    try:
        yield collection
    finally:
        # by identity: two collections under way may be equal
        _collections[:] = [each for each in _collections if each is not collection]


@dataclass(frozen=True)
class FileVersion:
    """A file when it was read.

    Attributes:
        path: absolute.
        times: size, when content and file were changed, in ns, and number; empty if there was no file.
        content: its hash; empty if size and times are old enough to tell.
    """

    path: Path
    times: tuple[int, ...]
    content: str

    @classmethod
    def seen(cls, path: Path, times: tuple[int, ...]) -> "FileVersion":
        """Return the version whose size and times were seen before it was read, whatever it is now."""
        try:
            return cls(path, times, "" if _is_settled(times) else content_of(path))
        except OSError:
            return cls(path, times, "")

    def now(self) -> "FileVersion":
        """Return the present version of the same file."""
        return FileVersion.seen(self.path, _times(self.path))

    @property
    def is_present(self) -> bool:
        """True if the file is still the same."""
        try:
            return _times(self.path) == self.times and (not self.content or content_of(self.path) == self.content)
        except OSError:
            return False


def while_unchanged(most: int) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Keep the results of a function while all files that it opens are the same.

    They are those of its arguments that are paths, and those that it, or what it calls, passes to `note_opened`. A path
    means the same file whatever the present folder. Errors are not kept.

    Args:
        most: number of results that are kept.
    """

    def decorate(read: Callable[_P, _R]) -> Callable[_P, _R]:
        kept: OrderedDict[Hashable, tuple[list[FileVersion], _R]] = OrderedDict()

        @wraps(read)
        def look_up(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            key = (*map(_absolute, args), *((name, _absolute(value)) for name, value in sorted(kwargs.items())))
            with _lock:
                entry = kept.get(key)
                if entry is not None:
                    kept.move_to_end(key)
            if entry is not None and all(version.is_present for version in entry[0]):
                # what is read around this depends on the same files
                for version in entry[0]:
                    note_opened(version.path)
                return entry[1]
            with opened_files() as opened:
                for value in (*args, *kwargs.values()):
                    if isinstance(value, Path):
                        note_opened(value)
                result = read(*args, **kwargs)
            versions = [FileVersion.seen(*item) for item in opened.items()]
            if all(version.is_present for version in versions):  # none changed while it was read
                with _lock:
                    kept[key] = versions, result
                    kept.move_to_end(key)
                    while len(kept) > most:
                        kept.popitem(last=False)
            return result

        return look_up

    return decorate


def _absolute(value: Any) -> Hashable:
    return value.absolute() if isinstance(value, Path) else value


def _times(path: Path) -> tuple[int, ...]:
    """Return size and times of a file, nothing if there is none."""
    try:
        return _times_of(path.stat())
    except (OSError, ValueError):
        return ()


def _times_of(stat: os.stat_result) -> tuple[int, ...]:
    """Return size, times and number of a file: of two with equal times, a renamed folder leads to the other one."""
    return stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino
