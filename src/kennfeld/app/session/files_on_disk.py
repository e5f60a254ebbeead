"""The files of a project as the session has read or written them last, so that it overwrites nothing unseen.

Another program, or another app, may write the same files. An edit begins from what was read, or what a page showed.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_state import FileVersion
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class Conflict:
    """A file that another program has changed: its name, its text on disk, and that of the session, if it has one."""

    file: str
    disk: str
    own: str


@dataclass(frozen=True)
class DiskChange:
    """A file of a project that has changed since it was read: its name, and how: `was deleted`."""

    file: str
    change: str

    def __str__(self) -> str:
        return f"{self.file} {self.change}"

    @classmethod
    def of(cls, path: Path, folder: Path, version: FileVersion | None = None) -> "DiskChange":
        """Return how a file differs from the version that was read; None if none was."""
        name = path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)
        if not path.is_file():
            return cls(name, "was deleted")
        if version is None or not version.times:
            return cls(name, "is new")
        before, now = _size(version.times[0]), _size(version.now().times[0])
        return cls(name, "has another content" if before == now else f"has {now} instead of {before}")


def _size(count: int) -> str:
    """Return a number of bytes in a few digits: 24.1 kB."""
    if count < 1000:
        return f"{count} bytes"
    unit, letter = (1e3, "k") if count < 1e6 else (1e6, "M") if count < 1e9 else (1e9, "G")
    return f"{count / unit:.4g} {letter}B"


class FilesOnDisk:
    """The texts of files as they were when they were read or written last.

    Args:
        folder: the folder of the files.
        texts: files that have been read, by their name relative to the folder.
        values: a file that is not edited as text, and written as a whole.

    Attributes:
        known: the texts by name; None for a file that did not exist.
    """

    def __init__(self, folder: Path, texts: Mapping[str, str], values: str) -> None:
        self._folder, self._values = folder, values
        self.known: dict[str, str | None] = {**texts, values: self._text(values)}

    def note(self, names: Iterable[str]) -> None:
        """Note files that are edited for the first time, as they are on disk."""
        for name in names:
            if name not in self.known:
                self.known[name] = self._text(name)

    def read(self, names: Iterable[str]) -> None:
        """Note files, and that of the values, as they are on disk now."""
        self.known.update({name: self._text(name) for name in (*names, self._values)})

    def changed(self, names: Iterable[str]) -> list[DiskChange]:
        """Return which of these files another program has changed."""
        texts = {name: self._text(name) for name in names}
        return [
            DiskChange(name, "was deleted" if text is None else "has another content")
            for name, text in texts.items()
            if text != self.known.get(name)
        ]

    def conflicts(self, names: Iterable[str], texts: Mapping[str, str]) -> list[Conflict]:
        """Return which of these files another program has changed to something else than the texts."""
        conflicts = []
        for name in dict.fromkeys(names):
            disk = self._text(name)
            # a program that wrote the same text as the session is in no conflict with it
            if disk is not None and disk not in (self.known.get(name), texts.get(name)):
                conflicts.append(Conflict(name, disk, texts.get(name, "")))
        return conflicts

    def _text(self, name: str) -> str | None:
        """Return the text of a file, with its line ends; None if it does not exist."""
        try:
            return (self._folder / name).read_bytes().decode("utf-8", "replace")
        except OSError:
            return None


def text_or_none(path: Path) -> str | None:
    """Return the text of a file as `read_exactly` does; None if it cannot be read."""
    try:
        return read_exactly(path)
    except InputError:
        return None


def read_exactly(path: Path) -> str:
    """Return the text of a file with its line ends and byte order mark. Raises `InputError` if it is not UTF-8."""
    try:
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InputError.of(Location(str(path)), f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError.of(Location(path.name), "is not text in UTF-8") from None
