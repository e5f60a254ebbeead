"""Errors of the system about files, in the words of findings."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_state import note_opened
from kennfeld.base.formatting import nearest


def nearest_file(path: Path) -> str:
    """Return a question that offers the most similar name in the folder of a missing file, or an empty string."""
    return nearest(path.name, (other.name for other in path.parent.iterdir())) if path.parent.is_dir() else ""


def files_beside(path: Path) -> list[str]:
    """Return the names of the files in the folder of a path; none if there is no such folder."""
    return [other.name for other in path.parent.iterdir() if other.is_file()] if path.parent.is_dir() else []


def files_alike(path: Path) -> list[str]:
    """Return the names of the files beside a missing one that have its ending, sorted."""
    ending = path.suffix.casefold()
    return sorted(name for name in files_beside(path) if Path(name).suffix.casefold() == ending)


@contextmanager
def convert_errors(
    path: Path | str, message: str, remedy: str = "", *, missing: str = "", advice: str = ""
) -> Iterator[None]:
    """Convert an `OSError` within the block to an `InputError`, and note that the file is opened.

    Args:
        path: the file or folder; what is remembered of it is so only while it is the same, see `while_unchanged`.
        message: what is impossible, such as "cannot be read"; the reason of the system follows.
        remedy: the remedy.
        missing: the message if the file does not exist, by default `message`.
        advice: the remedy with `missing` if no other file has a similar name.

    Raises:
        InputError: the system cannot read or write the file.
    """
    note_opened(Path(path))
    try:
        yield
    except OSError as error:
        if missing and isinstance(error, FileNotFoundError):
            raise InputError.of(Location.of_file(path), missing, nearest_file(Path(path)) or advice) from None
        raise InputError.of(Location.of_file(path), f"{message}: {error.strerror or error}", remedy) from None
