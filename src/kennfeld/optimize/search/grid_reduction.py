"""Grid reduction: tables on every nth of their breakpoints, interpolated back to the full grid afterwards."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Int
from kennfeld.constraints import Equality, Term
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.linear_limits import grid_points
from kennfeld.optimize.problem import Factor, Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter


def kept_breakpoints(count: int, factor: int) -> Int:
    """Return the breakpoints kept if every nth is: the ends, and others spread evenly between them.

    >>> kept_breakpoints(10, 2), kept_breakpoints(6, 2), kept_breakpoints(9, 2), kept_breakpoints(3, 5)
    (array([0, 2, 4, 7, 9]), array([0, 2, 5]), array([0, 2, 4, 6, 8]), array([0, 2]))
    """
    size = min(count, max(2, -(-count // factor)))
    numbers: Int = np.round(np.linspace(0, count - 1, size)).astype(np.int64)
    return numbers


def reduce_table(parameter: Parameter, factors: Sequence[int], points: Sequence[Int] = ()) -> Parameter:
    """Return a table at the kept breakpoints, with the bounds and locks of these grid points.

    Those of the grid `points`, given as flat indices, are always kept. Axes leave their group, whose other tables keep
    all breakpoints.
    """
    needed = [np.unravel_index(each, parameter.values.shape) for each in points]
    places = [
        np.unique(np.concatenate([kept_breakpoints(len(axis), factor), *(at[i] for at in needed)]))
        for i, (axis, factor) in enumerate(zip(parameter.axes, factors, strict=True))
    ]
    if all(place.size == len(axis) for place, axis in zip(places, parameter.axes, strict=True)):
        return parameter
    chosen = np.ix_(*places)
    axes = [
        Axis(axis.breakpoints[place], axis.input, axis.unit) for axis, place in zip(parameter.axes, places, strict=True)
    ]
    arrays = {name: getattr(parameter, name)[chosen] for name in ("values", "lower", "upper", "locked")}
    return parameter.changed(axes=tuple(axes), **arrays)


def refine_table(coarse: Parameter, like: Parameter) -> Parameter:
    """Interpolate a reduced table to all grid points of `like`, whose locked values and bounds are kept."""
    values = coarse.values
    for i, (before, after) in enumerate(zip(coarse.axes, like.axes, strict=True)):
        if len(before) != len(after):
            place = position(after.breakpoints, before.breakpoints, "clip")
            weights = cell_weights(place, len(before))[0]
            values = np.moveaxis(np.tensordot(weights, values, axes=(1, i)), 0, i)
    return like.with_values(np.where(like.locked, like.values, np.clip(values, like.lower, like.upper)))


def penalty_ratio(full: Parameter, coarse: Parameter, axis: int) -> float:
    """Return the ratio of the roughness along an axis on the coarse grid to that on the full grid, for one surface.

    A surface with the second derivative c along the axis has second differences c h^2, h being the mean spacing, on
    even and on uneven axes; so R = lines (N - 2) / N (c h^2)^2. The ratio is exact if c is constant. For a curve of
    many points on twice the spacing it is 16. It is 1 if a grid is too small to have a roughness.
    """
    sizes = [_size(table, axis) for table in (full, coarse)]
    return sizes[1] / sizes[0] if min(sizes) > 0 else 1.0


def _size(table: Parameter, axis: int) -> float:
    count = len(table.axes[axis])
    if count < 3:
        return 0.0
    points = table.axes[axis].breakpoints
    spacing = float(points[-1] - points[0]) / (count - 1)
    return table.size / count * (count - 2) / count * spacing**4


def reduce_problem(problem: Problem, factors: Mapping[str, Sequence[int]]) -> Problem:
    """Return the problem with the named tables on coarse grids.

    Smoothness factors are scaled so that a surface keeps its penalty; automatic ones are chosen on the coarse grid.
    Breakpoints around pins and around values in equalities are kept, so that these can be satisfied as before; so is
    the grid of a table whose values are summed.
    """
    tables = {
        name: reduce_table(problem.parameters[name], each, list(_needed(problem, name)))
        for name, each in factors.items()
    }
    changed = [table for name, table in tables.items() if table is not problem.parameters[name]]
    if not changed:
        return problem
    rescaled: dict[str, list[Factor]] = {
        table.name: [
            "auto" if automatic else factor / penalty_ratio(problem.parameters[table.name], table, axis)
            for axis, (automatic, factor) in enumerate(
                zip(problem.automatic(table.name), problem.factors(table.name), strict=True)
            )
        ]
        for table in changed
    }
    parameters = problem.parameters.with_parameters(*changed)
    restraints = {name: each for name, each in problem.restraints.items() if name not in rescaled}
    smoothness = {**problem.smoothness, **rescaled}
    return replace(problem, parameters=parameters, smoothness=smoothness, restraints=restraints)


def _needed(problem: Problem, name: str) -> Iterator[Int]:
    """Return the grid points used by pins and equalities."""
    terms = [Term(pin.parameter, pin.at) for pin in problem.pins]
    terms += [term for each in problem.constraints if isinstance(each, Equality) for term in each.terms]
    for term in terms:
        if term.parameter == name:
            yield grid_points(problem.parameters[name], term.at)[0]


def refine_parameters(coarse: ParameterSet, full: ParameterSet) -> ParameterSet:
    """Interpolate reduced tables to the grids of `full`."""
    return full.with_parameters(
        *(
            full[name].with_values(table.values)
            if table.values.shape == full[name].values.shape
            else refine_table(table, full[name])
            for name, table in coarse.items()
        )
    )
