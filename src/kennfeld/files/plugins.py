"""Formats that other packages add by the entry point `kennfeld.formats`."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

from kennfeld.errors import Finding, Location, warn
from kennfeld.files.file_format import FileFormat

GROUP = "kennfeld.formats"


@cache
def formats_of_plugins() -> tuple[FileFormat, ...]:
    """Return the formats of the packages that are installed; one that is broken is named in a warning and left out."""
    formats, findings = [], []
    for entry in entry_points(group=GROUP):
        try:
            formats.append(_loaded(entry))
        except Exception as error:  # of any kind: it is foreign code
            findings.append(_broken(entry, error))
    warn(findings)
    return tuple(formats)


def _loaded(entry: EntryPoint) -> FileFormat:
    loaded = entry.load()
    if not isinstance(loaded, FileFormat):
        raise TypeError(f"{entry.value} is a {type(loaded).__name__}, not a FileFormat")
    return loaded


def _broken(entry: EntryPoint, error: Exception) -> Finding:
    package = "" if entry.dist is None else f" of the package {entry.dist.name}"
    message = f"the format {entry.name}{package} cannot be loaded ({type(error).__name__}: {error})"
    return Finding(Location(), message, "Update or uninstall it.", severity="warning")
