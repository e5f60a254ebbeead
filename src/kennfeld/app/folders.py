"""Paths that a page may name: files within an open folder, links resolved."""

import re
from pathlib import Path

from kennfeld.errors import ArgumentError

MAX_NAME = 200  # characters of a file name
_UNSAFE = re.compile(r'[\x00-\x1f\x7f<>:"/\\|?*]')


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
    if not path.is_relative_to(root):
        raise ArgumentError(f"{name[:MAX_NAME]!r} is outside of {root.name}")
    if not exists:
        raise ArgumentError(f"{name[:MAX_NAME]!r} is not a file")
    return path


def free_path(folder: Path, name: str) -> Path:
    """Return the path for a new file of a folder; a number is added if the name is taken.

    >>> free_path(Path("."), "../../a:b?.csv").name
    'a_b_.csv'
    """
    plain = _UNSAFE.sub("_", name.replace("\\", "/").rpartition("/")[2])[-MAX_NAME:].strip(". ") or "file"
    path, number = folder / plain, 2
    while path.exists():
        path = folder / f"{Path(plain).stem}-{number}{Path(plain).suffix}"
        number += 1
    return path
