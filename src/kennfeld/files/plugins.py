"""Formats and importers that other packages add by the entry points `kennfeld.formats` and `kennfeld.importers`."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kennfeld.base.errors import Finding, Location, warn
from kennfeld.files.file_format import FileFormat
from kennfeld.files.head import FileHead

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

FORMATS, IMPORTERS = "kennfeld.formats", "kennfeld.importers"
_WORDS = {FORMATS: "format", IMPORTERS: "importer"}
_REMEDY = "Update or uninstall it."
_T = TypeVar("_T")


@cache
def formats_of_plugins() -> tuple[FileFormat, ...]:
    """Return the formats of the packages that are installed, and those of their importers."""
    # an importer is known by its formats here, since this layer does not know its class
    imported = (known for importer in plugins_of(IMPORTERS, object) for known in _formats_of(importer))
    return tuple(map(_guarded, (*plugins_of(FORMATS, FileFormat), *imported)))


def _formats_of(importer: Any) -> tuple[FileFormat, ...]:
    formats = getattr(importer, "formats", ())
    return tuple(each for each in formats if isinstance(each, FileFormat)) if isinstance(formats, tuple) else ()


def plugins_of(group: str, kind: type[_T]) -> tuple[_T, ...]:
    """Return what installed packages add to a group; what cannot be loaded is named in a warning and left out."""
    loaded, findings = [], []
    for entry in _installed():
        if entry.group != group:
            continue
        try:
            loaded.append(_loaded(entry, kind))
        except Exception as error:  # of any kind: it is foreign code
            findings.append(_broken(entry, error))
    warn(findings)
    return tuple(loaded)


def forget_plugins() -> None:
    """Look for packages anew when they are needed next, because some were installed meanwhile."""
    formats_of_plugins.cache_clear()
    _installed.cache_clear()


@cache
def _installed() -> "tuple[EntryPoint, ...]":
    return tuple(_entry_points())


def _entry_points() -> "Iterator[EntryPoint]":
    """Yield the entry points of installed packages.

    In notebooks and with `python -m`, Python also looks for modules in the present folder. That may be the project of a
    stranger, whose code does not run unasked.
    """
    from importlib.metadata import distributions  # 30 ms, which files of a known signature do not need

    here = Path.cwd().resolve()
    places = [place for place in sys.path if place and Path(place).resolve() != here]
    installed = [
        (each, [entry for entry in each.entry_points if entry.group in _WORDS]) for each in distributions(path=places)
    ]
    # names stand in metadata with whole documents, which take longer to parse than all else
    if not any(entries for _, entries in installed):
        return
    names = set()
    for distribution, entries in installed:
        if distribution.name not in names:  # the first one of a name is imported
            names.add(distribution.name)
            yield from entries


def _loaded(entry: "EntryPoint", kind: type[_T]) -> _T:
    loaded = entry.load()
    if not isinstance(loaded, kind):
        raise TypeError(f"{entry.value} is of the type {type(loaded).__name__}, not {kind.__name__}")
    return loaded


def _guarded(known: FileFormat) -> FileFormat:
    """Return a format whose recogniser fails only once: a warning reports it, and the files are of another format."""
    if known.recognises is None:
        return known
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

    return replace(known, recognises=recognises)


def _broken(entry: "EntryPoint", error: Exception) -> Finding:
    package = "" if entry.dist is None else f" of the package {entry.dist.name}"
    message = f"the {_WORDS[entry.group]} {entry.name}{package} cannot be loaded ({type(error).__name__}: {error})"
    return Finding(Location(), message, _REMEDY, severity="warning")
