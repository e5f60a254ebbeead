"""Reports the aspects of a parameter set that a format does not store."""

from collections.abc import Callable, Iterable

import numpy as np

from kennfeld.base.errors import Finding
from kennfeld.base.formatting import count_labels, holds_control_characters
from kennfeld.calfiles.format import FileFindings, Item
from kennfeld.calfiles.verbal_values import warn_about_kinds
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter

_USE_JSON = "Write it as .json to keep them."
_USE_PROJECT = "Keep them in a project file."
_GROUP_UNITS = "units of a group axis that differ between tables become that of the first table"


def _any_axis(has: Callable[[Axis], bool]) -> Callable[[Item], bool]:
    return lambda item: isinstance(item, Parameter) and any(map(has, item.axes))


def _any_table(has: Callable[[Parameter], bool]) -> Callable[[Item], bool]:
    return lambda item: isinstance(item, Parameter) and has(item)


def _has_line_breaks(item: Item) -> bool:
    units = [axis.unit for axis in item.axes] if isinstance(item, Parameter) else []
    return any(map(holds_control_characters, (item.unit, item.description, item.display_name, *units)))


# For each aspect: which items have it, what becomes of it, and the remedy.
_ASPECTS: dict[str, tuple[Callable[[Item], bool], str, str]] = {
    "descriptions": (lambda item: bool(item.description), "descriptions are left out", _USE_JSON),
    "inputs": (_any_axis(lambda axis: bool(axis.input)), "the inputs of axes are left out", _USE_JSON),
    "extrapolation": (
        _any_table(lambda table: bool(table.axes) and table.extrapolation != "clip"),
        "linear extrapolation is left out",
        _USE_JSON,
    ),
    "line breaks": (_has_line_breaks, "line breaks in units and descriptions become spaces", _USE_JSON),
    "falling axes": (
        _any_axis(lambda axis: axis.falling),
        "falling axes are written in rising order",
        "Write it as .json to keep their order.",
    ),
    "columns": (
        _any_table(lambda table: table.kind == "block" and table.values.ndim == 2 and table.values.shape[1] == 1),
        "blocks of a single column become blocks of one dimension",
        _USE_JSON,
    ),
    "infinities": (
        _any_table(lambda table: bool(np.isinf(table.values).any())),
        "infinite values become missing values",
        "Write it as .mat to keep them.",
    ),
    "bounds": (_any_table(lambda table: table.limited), "bounds are left out", _USE_PROJECT),
    "locks": (_any_table(lambda table: bool(table.locked.any())), "locks are left out", _USE_PROJECT),
    "free axes": (
        _any_axis(lambda axis: axis.free or axis.range is not None or axis.min_distance is not None),
        "free breakpoints and their limits are left out",
        _USE_PROJECT,
    ),
}


def find_losses(parameters: ParameterSet, lacks: Iterable[str], file: str) -> tuple[Finding, ...]:
    """Return a warning for each aspect that a format lacks: a key of `_ASPECTS`, "kinds" or "group units"."""
    findings = FileFindings(file)
    units = {axis.name: axis.unit for axis in parameters.axes}
    differs = _any_axis(lambda axis: bool(axis.name) and axis.unit != units.get(axis.name, axis.unit))
    aspects = _ASPECTS | {"group units": (differs, _GROUP_UNITS, _USE_JSON)}
    for aspect in lacks:
        if aspect == "kinds":
            warn_about_kinds(parameters, findings)
            continue
        has, becomes, remedy = aspects[aspect]
        names = list(dict.fromkeys(item.name for item in parameters.everything.values() if has(item)))
        if names:
            findings.warning(0, "", f"{becomes}: {count_labels(names)}", remedy)
    return findings.finish()
