"""The file of values that were edited or accepted, and the changes of the project file that name it."""

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read
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
