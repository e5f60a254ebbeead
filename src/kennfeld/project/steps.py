"""The steps of a project: names found among its parameters and criteria, locks as masks of grid points.

Which grid points of a table a lock means.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.errors import Finding
from kennfeld.optimize import Problem, Step
from kennfeld.optimize.lookup_coverage import Coverage, touched
from kennfeld.optimize.search.step_problem import check_steps
from kennfeld.parameters import Parameter
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.project.schema import DIRECTIONS, Lock, ProjectFile, Range, StepEntry

__all__ = ["build_steps", "grid_points_within", "lacking_axes", "uncovered_values"]


def lacking_axes(table: Parameter, part: Range) -> list[str]:
    """Directions of a range that the table does not have."""
    return [direction for direction in part if DIRECTIONS.index(direction) >= len(table.axes)]


def grid_points_within(table: Parameter, part: Range) -> Bool:
    """The grid points in a range of axis values, ends included."""
    inside = np.ones(table.values.shape, dtype=bool)
    for direction, (first, last) in part.items():
        which = DIRECTIONS.index(direction)
        points = table.axes[which].breakpoints
        shape = [-1 if i == which else 1 for i in range(table.values.ndim)]
        inside &= ((points >= first) & (points <= last)).reshape(shape)
    return inside


def uncovered_values(problem: Problem, names: Sequence[str]) -> dict[str, Bool]:
    """For each of these tables, the values that no training sample touches; an expansion has none."""
    coverage = Coverage(problem.model.graph, problem.parameters, names)
    kept = {name: problem.parameters[name] for name in names}
    seen = {name: np.full(table.values.shape, table.kind == "rbf") for name, table in kept.items()}
    for bound in problem.training:
        for name, mask in touched(coverage, problem.parameters, bound, _counting(problem)).items():
            seen[name] |= mask
    return {name: ~mask for name, mask in seen.items()}


def _counting(problem: Problem) -> Callable[[BoundDataset], Bool]:
    """The samples that count: without states those with a target, else all, since the later ones depend on them."""

    def counts(bound: BoundDataset) -> Bool:
        if problem.model.graph.states:
            return np.ones(bound.count, dtype=bool)
        scored = [np.isfinite(problem.target(criterion, bound)) for criterion in problem.criteria]
        return np.asarray(np.logical_or.reduce(scored))

    return counts


def build_steps(file: ProjectFile, problem: Problem, findings: list[Finding]) -> tuple[Step, ...]:
    """The steps of a project file, and findings about them."""
    made = [_Building(entry, problem, findings).step() for entry in file.steps]
    for number, entry in enumerate(file.steps, 1):
        mine = check_steps(problem, [made[number - 1]])
        findings += [replace(finding, place=finding.place.replace("step 1", entry.place, 1)) for finding in mine]
    if made and made[-1].reduces:
        message = "the sequence ends on a coarse grid: what lies between its points is interpolated"
        remedy = "Add a [[step]] without grid_reduction."
        findings.append(Finding(file.steps[-1].place, message, remedy, severity="warning"))
    return tuple(made)


class _Building:
    """One step on its way from the project file."""

    def __init__(self, entry: StepEntry, problem: Problem, findings: list[Finding]) -> None:
        self.entry, self.problem, self.findings = entry, problem, findings

    def step(self) -> Step:
        entry = self.entry
        return Step(
            name=entry.name,
            free=entry.free,
            lock=self._masks(entry.lock or {}),
            smoothness=self._by_axis("smoothness", entry.smoothness, 0.0),
            grid_reduction=self._by_axis("grid_reduction", entry.grid_reduction, 1) or 1,
            criteria=entry.criteria,
            max_iterations=entry.max_iterations,
            tolerance=entry.tolerance,
            continuation=entry.continuation,
        )

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self.findings.append(Finding(f"{self.entry.place} {key}", message, remedy))

    def _matched(self, pattern: str) -> list[Parameter]:
        return [p for name, p in self.problem.parameters.items() if name == pattern or fnmatchcase(name, pattern)]

    def _masks(self, locks: Mapping[str, Lock]) -> dict[str, Any]:
        """Masks by parameter; a pattern without a match stays, to be found with the others."""
        masks: dict[str, Any] = {}
        for pattern, lock in locks.items():
            found = self._matched(pattern)
            masks |= {p.name: self._mask(p, lock) for p in found} if found else {pattern: False}
        return masks

    def _mask(self, table: Parameter, lock: Lock) -> bool | Bool:
        if isinstance(lock, bool):
            return lock
        if lock == "no-data":
            looked_up = table.name in self.problem.model.graph.parameters
            return uncovered_values(self.problem, [table.name])[table.name] if looked_up else False
        held = np.zeros(table.values.shape, dtype=bool)
        for part in lock:
            beyond = lacking_axes(table, part)
            if beyond:
                self._report(f"lock {table.name}", f"{table.name} has no axis {beyond[0]}")
            else:
                held |= grid_points_within(table, part)
        return held

    def _by_axis(self, key: str, given: Any, default: float) -> Any:
        """A number for all tables, or by parameter a number or one an axis, in their order."""
        if not isinstance(given, Mapping):
            return given
        made: dict[str, Any] = {}
        for pattern, one in given.items():
            found = self._matched(pattern) if isinstance(one, Mapping) else []
            made |= (
                {p.name: self._an_axis_each(key, p, one, default, p.name == pattern) for p in found}
                if found
                else {pattern: one}
            )
        return {name: default if isinstance(one, Mapping) else one for name, one in made.items()}

    def _an_axis_each(
        self, key: str, table: Parameter, given: Mapping[str, float], default: float, exactly: bool
    ) -> tuple[Any, ...]:
        """One an axis; a pattern may name axes that some of its tables do not have."""
        known = DIRECTIONS[: len(table.axes)]
        for direction in given if exactly else ():
            if direction not in known:
                message = f"{table.name} has no axis {direction}"
                self._report(f"{key} {table.name}", message, f"It has {', '.join(known) or 'none'}.")
        return tuple(given.get(direction, default) for direction in known)
