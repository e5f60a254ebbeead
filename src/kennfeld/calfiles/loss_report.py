"""What a parameter set loses in a file of a format that has no place for it."""

from collections.abc import Callable, Iterable

import numpy as np

from kennfeld.calfiles.format import Findings
from kennfeld.calfiles.verbal_values import remark_on_kinds
from kennfeld.errors import Finding
from kennfeld.formatting import holds_control_characters, join_limited
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = ["loss_remarks"]

Thing = Parameter | Text
_IN_JSON = "Write it as .json to keep them."
_IN_PROJECT = "A project file holds them."


def _of_axes(has: Callable[[Axis], bool]) -> Callable[[Thing], bool]:
    return lambda thing: isinstance(thing, Parameter) and any(map(has, thing.axes))


def _of_tables(has: Callable[[Parameter], bool]) -> Callable[[Thing], bool]:
    return lambda thing: isinstance(thing, Parameter) and has(thing)


def _has_line_breaks(thing: Thing) -> bool:
    units = [axis.unit for axis in thing.axes] if isinstance(thing, Parameter) else []
    return any(map(holds_control_characters, (thing.unit, thing.description, thing.display_name, *units)))


# For each aspect: which things have it, what becomes of it, and the remedy.
_ASPECTS: dict[str, tuple[Callable[[Thing], bool], str, str]] = {
    "descriptions": (lambda thing: bool(thing.description), "descriptions are left out", _IN_JSON),
    "inputs": (_of_axes(lambda axis: bool(axis.input)), "the inputs of axes are left out", _IN_JSON),
    "extrapolation": (
        _of_tables(lambda table: bool(table.axes) and table.extrapolation != "clip"),
        "linear extrapolation is left out",
        _IN_JSON,
    ),
    "line breaks": (_has_line_breaks, "line breaks in units and descriptions become blanks", _IN_JSON),
    "infinities": (
        _of_tables(lambda table: bool(np.isinf(table.values).any())),
        "infinite values become missing ones",
        "Write it as .mat to keep them.",
    ),
    "bounds": (_of_tables(lambda table: table.limited), "bounds are left out", _IN_PROJECT),
    "locks": (_of_tables(lambda table: bool(table.locked.any())), "locks are left out", _IN_PROJECT),
    "free axes": (
        _of_axes(lambda axis: axis.free or axis.range is not None or axis.min_distance is not None),
        "which breakpoints are free, and their limits, is left out",
        _IN_PROJECT,
    ),
}


def loss_remarks(parameters: ParameterSet, lacks: Iterable[str], file: str) -> tuple[Finding, ...]:
    """Return a remark on each aspect of a set that a format lacks: a key of `_ASPECTS`, "kinds" or "group units"."""
    notes = Findings(file)
    things = list(parameters.everything.values())
    for aspect in lacks:
        if aspect == "kinds":
            remark_on_kinds(parameters, notes)
            continue
        has, becomes, remedy = _ASPECTS.get(aspect, (_has_other_unit(parameters), _GROUP_UNITS, _IN_JSON))
        names = list(dict.fromkeys(thing.name for thing in things if has(thing)))
        if names:
            notes.remark(0, "", f"{becomes}: {join_limited(names)}", remedy)
    return notes.settle()


_GROUP_UNITS = "units of group axes that differ from table to table become that of the first table"


def _has_other_unit(parameters: ParameterSet) -> Callable[[Thing], bool]:
    """Find the tables that give a group axis another unit than the set does."""
    units = {axis.name: axis.unit for axis in parameters.axes}
    return _of_axes(lambda axis: bool(axis.name) and axis.unit != units.get(axis.name, axis.unit))
