"""Formats that other packages add by the entry point `kennfeld.formats`."""

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from kennfeld.errors import Finding, Location, warn
from kennfeld.files.file_format import FileFormat, Recogniser
from kennfeld.files.head import FileHead

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "kennfeld.formats"
_REMEDY = "Update or uninstall it."


@cache
def formats_of_plugins() -> tuple[FileFormat, ...]:
    """Return the formats of the packages that are installed; one that is broken is named in a warning and left out."""
    from importlib.metadata import entry_points  # 30 ms, which files of a known signature do not need

    formats, findings = [], []
    for entry in entry_points(group=GROUP):
        try:
            formats.append(_loaded(entry))
        except Exception as error:  # of any kind: it is foreign code
            findings.append(_broken(entry, error))
    warn(findings)
    return tuple(formats)


def _loaded(entry: "EntryPoint") -> FileFormat:
    loaded = entry.load()
    if not isinstance(loaded, FileFormat):
        raise TypeError(f"{entry.value} is of the type {type(loaded).__name__}, not FileFormat")
    return loaded if loaded.recognises is None else replace(loaded, recognises=_guarded(loaded))


def _guarded(known: FileFormat) -> Recogniser:
    """Return the recogniser of a format; if it fails, that is said once and the file is of another format."""
    is_broken = False

    def recognises(head: FileHead) -> bool:
        nonlocal is_broken
        try:
            return not is_broken and known.recognises is not None and bool(known.recognises(head))
        except Exception as error:  # of any kind: it is foreign code
            is_broken = True
            message = f"the format {known.name} cannot recognise files ({type(error).__name__}: {error})"
            warn([Finding(Location(), message, _REMEDY, severity="warning")])
            return False

    return recognises


def _broken(entry: "EntryPoint", error: Exception) -> Finding:
    package = "" if entry.dist is None else f" of the package {entry.dist.name}"
    message = f"the format {entry.name}{package} cannot be loaded ({type(error).__name__}: {error})"
    return Finding(Location(), message, _REMEDY, severity="warning")
