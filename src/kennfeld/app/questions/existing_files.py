"""The answers of commands that write files, if these exist and were not to be replaced."""

from collections.abc import Sequence

from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class ExistingFile:
    """A file that would be replaced; nothing was written."""

    exists: str


@dataclass(frozen=True)
class ExistingFiles:
    """Files that would be replaced; nothing was written."""

    existing: Sequence[str]
