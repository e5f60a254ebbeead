"""Which grid points of a table a lock means."""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.optimize import Problem
from kennfeld.optimize.data.binding import Bound
from kennfeld.parameters import Parameter
from kennfeld.project.coverage import Coverage, touched
from kennfeld.project.schema import DIRECTIONS, Range

__all__ = ["lacking_axes", "untouched", "within"]


def lacking_axes(table: Parameter, part: Range) -> list[str]:
    """Directions of a range that the table does not have."""
    return [direction for direction in part if DIRECTIONS.index(direction) >= len(table.axes)]


def within(table: Parameter, part: Range) -> Bool:
    """The grid points in a range of axis values, ends included."""
    inside = np.ones(table.values.shape, dtype=bool)
    for direction, (first, last) in part.items():
        which = DIRECTIONS.index(direction)
        points = table.axes[which].breakpoints
        shape = [-1 if i == which else 1 for i in range(table.values.ndim)]
        inside &= ((points >= first) & (points <= last)).reshape(shape)
    return inside


def untouched(problem: Problem, names: Sequence[str]) -> dict[str, Bool]:
    """For each of these tables, the values that no training sample touches; an expansion has none."""
    coverage = Coverage(problem.model.graph, problem.parameters, names)
    kept = {name: problem.parameters[name] for name in names}
    seen = {name: np.full(table.values.shape, table.kind == "rbf") for name, table in kept.items()}
    for bound in problem.training:
        for name, mask in touched(coverage, problem.parameters, bound, _counting(problem)).items():
            seen[name] |= mask
    return {name: ~mask for name, mask in seen.items()}


def _counting(problem: Problem) -> Callable[[Bound], Bool]:
    """The samples that count: without states those with a target, else all, since the later ones depend on them."""

    def counts(bound: Bound) -> Bool:
        if problem.model.graph.states:
            return np.ones(bound.count, dtype=bool)
        scored = [np.isfinite(problem.target(criterion, bound)) for criterion in problem.criteria]
        return np.asarray(np.logical_or.reduce(scored))

    return counts
