"""The files of a recording: the one that is named, and those beside it that hold its values."""

from contextlib import suppress
from pathlib import Path

from kennfeld.base.errors import InputError
from kennfeld.files.file_format import call
from kennfeld.measurement.source import MeasurementFile


def files_of(source: MeasurementFile) -> list[Path]:
    """Return all files that a recording consists of, the named one first; some may be missing.

    Raises:
        OSError: it cannot be read.
    """
    files = [source.path]
    if source.reader.companions:
        with suppress(InputError, ValueError):  # reported when it is read
            files += call(source.reader.companions, source)
    return files
