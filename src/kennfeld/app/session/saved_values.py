"""The file of values that were edited or accepted, and the changes of the project file that name it."""

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.output_paths import within
from kennfeld.calfiles import read, write
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.project.table_schema import BREAKPOINT_KEYS
from kennfeld.project.value_forms import FREE

VALUES = "values.json"  # beside the project

KeyChange = tuple[tuple[str, ...], Any]  # path of a key of the project file, and its new value; None removes it


def values_saved_before(settings: Mapping[str, Any], folder: Path) -> ParameterSet:
    """Return the parameters that `VALUES` provides to a project; none if it is not among the initial files."""
    if VALUES not in _initial_files(settings):
        return ParameterSet()
    with suppress(InputError):
        return read(folder / VALUES)
    return ParameterSet()


def values_to_save(
    edited: Collection[str], now: ParameterSet, settings: Mapping[str, Any], folder: Path
) -> ParameterSet | None:
    """Return what `VALUES` is to hold: the edited parameters, and those saved before; None if none are edited.

    Args:
        edited: names of the parameters that were edited; breakpoints among them are not parameters.
        now: the present values.
        settings: the tables of the project file.
        folder: the folder of the project.
    """
    if not edited:
        return None
    names = [name for name in edited if name in now]
    earlier = values_saved_before(settings, folder)
    try:
        return earlier.with_parameters(*(now[name] for name in names)) if earlier else now.select(names)
    except ArgumentError:  # a group axis of theirs has changed
        return now.select(dict.fromkeys([*(name for name in earlier if name in now), *names]))


def write_edits(folder: Path, texts: Mapping[str, str], values: ParameterSet | None) -> None:
    """Write edited texts by their names, and values to `VALUES`; all paths are checked before the first is written.

    Raises:
        InputError: a file is outside of the folder, or cannot be written.
    """
    try:
        targets = {within(folder, name): text for name, text in texts.items()}
        target = within(folder, VALUES)
        for path, text in targets.items():
            # as bytes, so that line ends stay as they are
            write_whole(path, text.encode())
        if values is not None:
            write(values, target)
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise InputError.of(Location(str(error.filename or folder)), message, "Check the permissions.") from None


def naming_changes(settings: Mapping[str, Any], names: Iterable[str], moved: Collection[AxisKey]) -> list[KeyChange]:
    """Return the changes of a project file by which values are read from `VALUES`, the last of the initial files.

    Args:
        settings: the tables of the project file.
        names: the parameters whose values are saved.
        moved: axes whose breakpoints are saved with them; those that the project file states are removed.
    """
    files = _initial_files(settings)
    sections = settings.get("parameters", {})
    # a section overrides the initial files, and with them the saved values
    changes: list[KeyChange] = [
        (("parameters", name, "initial"), None) for name in names if "initial" in sections.get(name, {})
    ]
    if VALUES not in files:
        changes.append((("calibration", "initial"), [*files, VALUES]))
    for key in moved:
        path = ("parameters", key.owner, key.direction) if key.direction else ("axes", key.owner)
        # breakpoints that the project file states would override the saved ones; that they are free stays
        entry: Mapping[str, Any] = reduce(lambda section, name: section.get(name, {}), path, settings)
        changes += [((*path, name), None) for name in BREAKPOINT_KEYS if name in entry and entry[name] != FREE]
    return changes


def _initial_files(settings: Mapping[str, Any]) -> list[str]:
    files = settings.get("calibration", {}).get("initial", [])
    return files if isinstance(files, list) else [files]
