"""A fit of some values of one table, with everything else held."""

from collections.abc import Sequence
from dataclasses import replace
from glob import escape

import numpy as np

from kennfeld.app.session.value_edits import require_cells
from kennfeld.base.arrays import Bool
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Pin
from kennfeld.domain.free_axes import with_fixed_axes
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.limits.linear_limits import grid_points
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Factor, Problem
from kennfeld.optimize.search.step_problem import with_fixed_limits
from kennfeld.optimize.tuning.shift_estimation import apply_shifts
from kennfeld.project.value_forms import DIRECTIONS


@dataclass(frozen=True)
class FittedPart:
    """Values of one table that are fitted alone.

    Attributes:
        name: the table.
        cells: numbers of the values in C order.
        title: what they are, for the history: `MapX at 3000, 40`.
    """

    name: str
    cells: Sequence[int]
    title: str


def part_problem(problem: Problem, part: FittedPart, before: Result | None = None) -> Problem:
    """Return the problem in which a part is free, and all other values, breakpoints and shifts are held.

    Args:
        problem: with the present values.
        part: what is free; locked values of it stay locked.
        before: the last fit of all values, whose shifts and smoothness from the data are kept.

    Raises:
        ArgumentError: nothing of the part may be fitted.
    """
    if part.name not in problem.free_names:
        raise ArgumentError(f"{part.name} is fixed: set it free to fit values of it")
    table = problem.parameters[part.name]
    require_cells(table, part.cells)
    cells = np.array(part.cells, dtype=np.int64)
    locked = np.ones(table.size, dtype=bool)
    locked[cells] = table.locked.ravel()[cells]
    if locked.all():
        raise ArgumentError(f"{part.title} is locked: unlock it to fit it")
    parameters = problem.parameters.with_parameters(table.changed(locked=locked.reshape(table.values.shape)))
    # a pin that only concerns locked values could not be met if they do not meet it yet
    pins = tuple(pin for pin in problem.pins if pin.parameter != part.name or not _is_locked(pin, table, locked))
    if before is not None and before.shifts:
        problem = apply_shifts(problem, before.shifts)
    return with_fixed_limits(
        replace(
            problem,
            parameters=with_fixed_axes(parameters, problem.free_axes),
            pins=pins,
            free=(escape(part.name),),
            smoothness={**problem.smoothness, **_chosen(problem, before, part.name)},
        )
    )


def _is_locked(pin: Pin, table: Parameter, locked: Bool) -> bool:
    return bool(locked[grid_points(table, pin.at)[0]].all())


def _chosen(problem: Problem, before: Result | None, name: str) -> dict[str, Sequence[Factor]]:
    """Return the smoothness of a table that the last fit has chosen: a few values would choose another one."""
    if before is None or name not in before.smoothness:
        return {}
    by_axis, present = before.smoothness[name], problem.factors(name)
    return {name: [by_axis.get(direction, own) for direction, own in zip(DIRECTIONS, present, strict=False)]}


def part_options(options: Options) -> Options:
    """Return the options of such a fit: from the present values, in one step."""
    return replace(options, starts=1, steps=())
