"""Columns that belong to the samples of a compiled problem and are needed again: in memory, or next to a partition."""

from collections.abc import Sequence
from dataclasses import field
from typing import Any, Protocol

from numpy.typing import NDArray

from kennfeld.base.column_file import read_columns
from kennfeld.base.content_digest import digest_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.preprocessing.prepared_files import PreparedFiles, touch

RECENT = 2  # entries in memory

Columns = Sequence[NDArray[Any]]


class ColumnStorage(Protocol):
    """Keeps columns by key; what it has lost is computed again."""

    def read(self, key: str) -> list[NDArray[Any]] | None:
        """Return the columns of a key; None if there are none."""

    def write(self, key: str, columns: Columns) -> None:
        """Keep columns of floats or integers."""


@dataclass
class RecentColumns:
    """The latest columns, in memory.

    >>> kept = RecentColumns()
    >>> for key in ("first", "second", "third"):
    ...     kept.write(key, [])
    >>> kept.read("first"), kept.read("third")
    (None, [])
    """

    _entries: dict[str, list[NDArray[Any]]] = field(default_factory=dict)

    def read(self, key: str) -> list[NDArray[Any]] | None:
        """See `ColumnStorage`."""
        return self._entries.get(key)

    def write(self, key: str, columns: Columns) -> None:
        """See `ColumnStorage`."""
        self._entries.pop(key, None)
        while len(self._entries) >= RECENT:
            del self._entries[next(iter(self._entries))]
        self._entries[key] = list(columns)


@dataclass(frozen=True)
class StoredColumns:
    """Columns on disk, among the prepared files; `samples` is a digest of the samples that they belong to."""

    files: PreparedFiles
    samples: str

    def read(self, key: str) -> list[NDArray[Any]] | None:
        """See `ColumnStorage`."""
        path = self.files.path(digest_of(self.samples, key))
        stored = read_columns(path)
        if stored is None:
            return None
        touch(path)
        return stored.columns

    def write(self, key: str, columns: Columns) -> None:
        """See `ColumnStorage`."""
        self.files.keep(self.files.path(digest_of(self.samples, key)), iter(columns), {})
