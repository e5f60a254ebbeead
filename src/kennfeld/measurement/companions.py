"""The files of a recording: the one that is named, and those beside it that hold its values."""

from contextlib import suppress
from importlib import import_module
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.measurement.file_kind import FileKind, MeasurementFile

_READERS = {FileKind.DIADEM: "diadem", FileKind.TDM: "tdm_header"}  # each offers companions(source)


def files_of(source: MeasurementFile) -> list[Path]:
    """Return all files that a recording consists of, the named one first; some may be missing.

    Raises:
        OSError: it cannot be read.
    """
    files = [source.path]
    if source.kind in _READERS:
        with suppress(InputError, ValueError):  # reported when it is read
            files += import_module(f"kennfeld.measurement.{_READERS[source.kind]}").companions(source)
    return files
