"""Says what a calibration that replaces the initial values of a project leaves out, adds, and exceeds."""

from collections.abc import Iterator

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.problem import Problem


def replaced_value_findings(problem: Problem, parameters: ParameterSet, location: Location) -> Iterator[Finding]:
    """Yield findings on the values of a calibration, in the order in which a user has to look at them.

    Args:
        problem: the problem whose initial values are replaced, with its bounds.
        parameters: the calibration, as it is read. It may be that of a whole control unit.
        location: the calibration, or the project.
    """
    needed = problem.model.graph.parameters
    kept = [name for name in needed if name not in parameters]
    surplus = [name for name in parameters if name not in needed]
    if kept and len(kept) == len(needed):
        message = "the calibration has no parameter of the function: the initial values are used"
        remedy = nearest(kept[0], surplus) or "Check the names in the calibration file."
        yield Finding(location, message, remedy, severity="warning")
    elif kept:
        message = f"initial values are used for {join_names(kept)}, which the calibration does not state"
        yield Finding(location, message, nearest(kept[0], surplus), severity="remark")
    if surplus and len(kept) < len(needed):
        message = f"the function does not use {join_names(surplus)}, which the calibration states"
        yield Finding(location, message, severity="remark")
    for name in needed:
        if name in parameters:
            yield from _beyond_bounds(problem.parameters[name], parameters[name], location)


def _beyond_bounds(initial: Parameter, table: Parameter, location: Location) -> Iterator[Finding]:
    lower, upper = (_on_shape(bound, table.values.shape) for bound in (initial.lower, initial.upper))
    if lower is None or upper is None:
        return
    outside = (table.values < lower) | (table.values > upper)
    if outside.any():
        at = tuple(np.argwhere(outside)[0])
        count, values = int(outside.sum()), table.values
        which = f"{count} of {values.size} values of {table.name} are" if values.size > 1 else f"{table.name} is"
        message = f"{which} outside the bounds of the project"
        such = f", such as {values[at]:g}" if values.size > 1 else f": {values[at]:g}"
        remedy = f"It must be {lower[at]:g} to {upper[at]:g}; it is used as it is."
        yield Finding(location, message + such, remedy, severity="warning")


def _on_shape(bound: Float, shape: tuple[int, ...]) -> Float | None:
    """Return bounds for a table of another size, None if they differ from value to value."""
    if bound.shape == shape:
        return bound
    return np.full(shape, bound.flat[0]) if bound.size and np.all(bound == bound.flat[0]) else None
