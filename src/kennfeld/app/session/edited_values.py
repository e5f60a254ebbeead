"""Values that were edited or fitted, put on the tables of the project as it is now.

Values belong to the breakpoints that they were given for. If those of the project change, by an edit or by another
program, the values are interpolated, as those of initial files are. Breakpoints that a run has moved are kept with the
values, named as by `breakpoints_by_name`, and apply as long as their axes are free.
"""

from collections.abc import Mapping

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding, Location
from kennfeld.domain.free_axes import AxisKey, breakpoints_by_name, free_axes, with_labelled
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.graph.interpolation import regrid

REMEDY = "Undo the change of the breakpoints, or check the values."


def fit_onto(own: Parameter, other: Parameter) -> Parameter:
    """Return a parameter with the values of another one, interpolated if its axes differ.

    Raises:
        ArgumentError: the other one is of another kind, or an expansion whose fixed parts differ.
    """
    tables = own.axes and len(own.axes) == len(other.axes)
    if own.values.shape != other.values.shape and not tables:
        raise ArgumentError(f"{own.name} is a {own.kind} of another size than the {other.kind} of the file")
    if len(own.axes) != len(other.axes) or (own.kind == "rbf") != (other.kind == "rbf"):
        raise ArgumentError(f"{own.name} is a {own.kind} here and a {other.kind} in the file")
    if isinstance(own, RBF) and isinstance(other, RBF) and not own.has_form_of(other):
        raise ArgumentError(f"{own.name} has another kernel or other kinks in the file, which its values do not hold")
    if not tables or own.kind == "rbf":
        return own.with_values(other.values)
    return own.with_values(regrid(other.values, other.axes, own.axes, other.extrapolation))


def moved_breakpoints(parameters: ParameterSet) -> dict[str, Float]:
    """Return the breakpoints of all free axes, by the names under which they are kept with values."""
    return breakpoints_by_name({key: axis.axis.breakpoints for key, axis in free_axes(parameters).items()})


def moved_axes(initial: ParameterSet, now: ParameterSet) -> list[AxisKey]:
    """Return the free axes whose present breakpoints are not the initial ones."""
    before, after = ({key: axis.axis.breakpoints for key, axis in free_axes(each).items()} for each in (initial, now))
    return [key for key, points in before.items() if not np.array_equal(points, after[key])]


def with_edits(
    initial: ParameterSet, values: Mapping[str, Float], tables: Mapping[str, Parameter]
) -> tuple[ParameterSet, tuple[Finding, ...]]:
    """Put edited values on the initial parameters, and return a warning for each table whose breakpoints have changed.

    Args:
        initial: the parameters as the project reads them; returned as they are if there is nothing to change.
        values: by table the values, and breakpoints of free axes by their names.
        tables: by table the one for which the values were given; those of others are taken as they are.
    """
    moved, changed, findings = _with_moved(initial, values), [], []
    for name, array in values.items():
        if name not in initial:
            continue
        own, given = moved[name], tables.get(name)
        try:
            if given is None or own.has_grid_of(given):
                # values whose table is not known are taken only if they fit as they are
                changed += [own.with_values(array)] if np.shape(array) == own.values.shape else []
                continue
            changed.append(fit_onto(own, given.with_values(array)))
            message = f"the breakpoints of {name} have changed: its unsaved values were interpolated"
        except ArgumentError:
            message = f"{name} has become another kind of table: its unsaved values are not used"
        findings.append(Finding(Location(), message, REMEDY, severity="warning"))
    return (moved.with_parameters(*changed) if changed else moved), tuple(findings)


def _with_moved(initial: ParameterSet, values: Mapping[str, Float]) -> ParameterSet:
    """Return the parameters with the breakpoints of their free axes among the values, as far as they are possible."""
    own = moved_breakpoints(initial)
    # first, as the values of tables stand at these breakpoints
    moved = {name: values[name] for name in own if name in values and np.shape(values[name]) == own[name].shape}
    if not any(not np.array_equal(points, own[name]) for name, points in moved.items()):
        return initial
    try:
        return with_labelled(initial, moved)
    except ArgumentError:  # the limits of an axis have changed
        return initial
