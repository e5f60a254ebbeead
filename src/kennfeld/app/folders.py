"""Paths that a page may name: files within an open folder; links are resolved to read, and refused to write."""

import os
from pathlib import Path

from kennfeld.base.errors import ArgumentError
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.output_paths import plain_name, within

MAX_NAME = 200  # characters of a name in messages


def confined(folder: Path, name: str) -> Path:
    """Return the path of a file within a folder.

    Raises:
        ArgumentError: it leaves the folder, also by a symbolic link, or is not a file.
    """
    root = folder.resolve()
    try:
        path = (root / name).resolve()
        exists = path.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        raise ArgumentError(f"{name[:MAX_NAME]!r} is not a path: {error}") from None
    # checked before existence, so that nobody can ask which files exist elsewhere
    if not path.is_relative_to(root):
        raise ArgumentError(f"{name[:MAX_NAME]!r} is outside of {root.name}")
    if not exists:
        raise ArgumentError(f"{name[:MAX_NAME]!r} is not a file")
    return path


def writable(folder: Path, name: str | Path) -> Path:
    """Return the path of a file or folder to write within a folder.

    Raises:
        InputError: it leaves the folder, or a part of it is a symbolic link.
    """
    with convert_errors(name, "cannot be written", "Name a file in the folder of the project, without links."):
        return within(folder, name)


def free_path(folder: Path, name: str) -> Path:
    """Return the path for a new file of a folder; a number is added if the name is taken.

    >>> free_path(Path("."), "../../a:b?.csv").name
    'a_b_.csv'
    """
    plain = plain_name(name)
    path, number = folder / plain, 2
    while os.path.lexists(path):  # a link that leads nowhere is taken, too
        path = folder / f"{Path(plain).stem}-{number}{Path(plain).suffix}"
        number += 1
    return path
