"""The folder of a project as one file to download."""

import os
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from kennfeld.base.errors import ArgumentError

MAX_BYTES = 4_000_000_000  # of all files
MAX_FILES = 20_000


def write_archive(folder: Path, target: IO[bytes]) -> int:
    """Write the files of a folder as a ZIP archive, and return their number.

    Hidden files and folders, such as recovery files, are left out, and links are not followed.

    Raises:
        ArgumentError: there are too many files, or they are too large.
    """
    count = size = 0
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in archived_files(folder):
            size += path.stat().st_size
            count += 1
            if size > MAX_BYTES or count > MAX_FILES:
                limit = f"{MAX_FILES} files of {MAX_BYTES / 1e9:.0f} GB"
                raise ArgumentError(f"{folder.name} holds more than {limit}; copy the folder instead")
            archive.write(path, f"{folder.name}/{path.relative_to(folder).as_posix()}")
    return count


def archived_files(folder: Path) -> Iterator[Path]:
    """Yield the files of an archive, in the order of their paths."""
    for root, folders, files in os.walk(folder, followlinks=False):
        # in place, which is how os.walk learns what to enter, and in which order
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            path = Path(root) / name
            if not name.startswith(".") and path.is_file() and not path.is_symlink():
                yield path
