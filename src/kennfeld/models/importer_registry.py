"""All importers: the guests of this package, and those that other packages add."""

from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

from kennfeld.files.file_format import FileFormat, Reference, Role
from kennfeld.files.plugins import IMPORTERS, plugins_of
from kennfeld.models.importer import Importer


def importer_of(name: str) -> Importer | None:
    """Return the importer of a file by its ending; None for formula text and for files of other kinds."""
    ending = Path(name).suffix.casefold()
    return next((each for each in _each() if ending in each.endings), None) if ending not in ("", ".kf") else None


def importer_of_format(known: FileFormat) -> Importer | None:
    """Return the importer of files of a format; None if there is none."""
    if known.role not in (Role.FUNCTION, Role.PROGRAM):
        return None
    return next((each for each in _each() if any(own.name == known.name for own in each.formats)), None)


def describer_of(known: FileFormat) -> Reference:
    """Return the function that describes files of a format: its own, or that of an importer; empty for neither."""
    described = (each for importer in _each() for each in importer.describes)
    return known.describe or next((describe for own, describe in described if own.name == known.name), "")


def updater_of(known: FileFormat) -> Reference:
    """Return the function that writes a copy of a file of a format with other values; empty for none."""
    updated = (each for importer in _each() for each in importer.updates)
    return next((update for own, update in updated if own.name == known.name), "")


def importers() -> tuple[Importer, ...]:
    """Return all importers."""
    return (*_own(), *_others())


def _each() -> Iterator[Importer]:
    """Yield the importers; those of other packages, which take longer to list, only if they are needed."""
    yield from _own()
    yield from _others()


@cache
def _own() -> tuple[Importer, ...]:
    """Return the importers of this package: `IMPORTER` of the module `importer` in each folder of `importers`."""
    # an installation may lack the folder
    guests = find_spec("kennfeld.importers")
    places = [] if guests is None else guests.submodule_search_locations or []
    modules = (f"kennfeld.importers.{each.name}.importer" for each in iter_modules(places) if each.ispkg)
    return tuple(import_module(name).IMPORTER for name in modules)


@cache
def _others() -> tuple[Importer, ...]:
    return plugins_of(IMPORTERS, Importer)
