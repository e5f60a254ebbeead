"""Formats that other packages add by the entry point `kennfeld.formats`."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.base.errors import Finding, Location, warn
from kennfeld.files.file_format import FileFormat, Recogniser
from kennfeld.files.head import FileHead

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "kennfeld.formats"
_REMEDY = "Update or uninstall it."


@cache
def formats_of_plugins() -> tuple[FileFormat, ...]:
    """Return the formats of the packages that are installed; one that is broken is named in a warning and left out."""
    formats, findings = [], []
    for entry in _installed():
        try:
            formats.append(_loaded(entry))
        except Exception as error:  # of any kind: it is foreign code
            findings.append(_broken(entry, error))
    warn(findings)
    return tuple(formats)


def _installed() -> "Iterator[EntryPoint]":
    """Yield the entry points of installed packages.

    In notebooks and with `python -m`, Python also looks for modules in the present folder. That may be the project of a
    stranger, whose code does not run unasked.
    """
    from importlib.metadata import distributions  # 30 ms, which files of a known signature do not need

    here, names = Path.cwd().resolve(), set()
    places = [place for place in sys.path if place and Path(place).resolve() != here]
    for distribution in distributions(path=places):
        if distribution.name not in names:  # the first one of a name is imported
            names.add(distribution.name)
            yield from distribution.entry_points.select(group=GROUP)


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
