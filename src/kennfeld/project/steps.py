"""Builds the steps of a project: patterns resolved to parameters, locks to masks of grid points."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.errors import Findings
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.table_parts import grid_points_within, missing_directions
from kennfeld.optimize.problem.options import Step
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.lookup_coverage import Coverage, touched
from kennfeld.optimize.search.step_problem import check_steps
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.project.label_selection import expand_lists
from kennfeld.project.run_schema import StepEntry
from kennfeld.project.schema import ProjectFile
from kennfeld.project.value_forms import DIRECTIONS, Lock


def uncovered_values(problem: Problem, names: Sequence[str]) -> dict[str, Bool]:
    """Mark the values that no training sample touches, Bool of each table's shape; none of an expansion or a layer."""
    kept, layers = {name: problem.parameters[name] for name in names}, problem.model.graph.layers
    seen = {name: np.full(t.values.shape, t.kind == "rbf" or name in layers) for name, t in kept.items()}
    for part in problem.each(_covered_values, tuple(names)):
        for name, mask in part.items():
            seen[name] |= mask
    return {name: ~mask for name, mask in seen.items()}


def _covered_values(problem: Problem, names: Sequence[str]) -> dict[str, Bool]:
    """Return masks of the values that a training sample touches, by table."""
    coverage = Coverage(problem.model.graph, problem.parameters, names)
    seen: dict[str, Bool] = {}
    for bound in problem.training:
        for name, mask in touched(coverage, problem.parameters, bound, _counting(problem)).items():
            seen[name] = seen[name] | mask if name in seen else mask
    return seen


def _counting(problem: Problem) -> Callable[[BoundDataset], Bool]:
    """Select samples with a target, or all of a model with states, as later samples depend on them."""

    def counts(bound: BoundDataset) -> Bool:
        if problem.model.graph.states:
            return np.ones(bound.count, dtype=bool)
        scored = [np.isfinite(problem.target(criterion, bound)) for criterion in problem.criteria]
        return np.asarray(np.logical_or.reduce(scored))

    return counts


def build_steps(file: ProjectFile, problem: Problem, findings: Findings) -> tuple[Step, ...]:
    """Return the steps of a project file; add findings about them."""
    steps = [_StepBuilder(entry, problem, findings, file.folder).step() for entry in file.steps]
    for number, entry in enumerate(file.steps, 1):
        # one at a time, so that each finding goes to its own section
        for finding in check_steps(problem, [steps[number - 1]]):
            path = str(finding.location).removeprefix("step 1").strip()
            findings.add(replace(finding, location=entry.location.within(path)))
    if steps and steps[-1].reduces:
        message = "the last step has a coarse grid; values between its points are interpolated"
        findings.warning(file.steps[-1].location, message, "Add a [[step]] without grid_reduction.")
    return tuple(steps)


class _StepBuilder:
    def __init__(self, entry: StepEntry, problem: Problem, findings: Findings, folder: Path) -> None:
        self.entry, self.problem, self.findings, self.folder = entry, problem, findings, folder

    def step(self) -> Step:
        entry = self.entry
        return Step(
            name=entry.name,
            free=None if entry.free is None else self._free(entry.free),
            lock=self._masks(entry.lock or {}),
            smoothness=self._by_axis("smoothness", entry.smoothness, 0.0),
            grid_reduction=self._by_axis("grid_reduction", entry.grid_reduction, 1) or 1,
            criteria=entry.criteria,
            max_iterations=entry.max_iterations,
            tolerance=entry.tolerance,
            continuation=entry.continuation,
        )

    def _free(self, patterns: Sequence[str]) -> tuple[str, ...]:
        """Return patterns with label lists replaced by their labels."""
        parameters, place = self.problem.parameters, self.entry.location.within("free")
        used = [name for name in self.problem.model.graph.parameters if name in parameters]
        return expand_lists(patterns, self.folder, parameters, used, place, self.findings)

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self.findings.error(self.entry.location.within(key), message, remedy)

    def _matching(self, pattern: str) -> list[Parameter]:
        return [p for name, p in self.problem.parameters.items() if name == pattern or fnmatchcase(name, pattern)]

    def _masks(self, locks: Mapping[str, Lock]) -> dict[str, Any]:
        """Return masks by parameter; a pattern without a match is kept, and reported by `check_steps`."""
        masks: dict[str, Any] = {}
        for pattern, lock in locks.items():
            matches = self._matching(pattern)
            locked = {p.name: self._mask(p, lock) for p in matches} if matches else {pattern: False}
            if matches and lock and isinstance(lock, tuple) and not any(map(np.any, locked.values())):
                place = self.entry.location.within(f"lock {pattern}")
                self.findings.warning(place, "no grid point is in these ranges")
            masks |= locked
        return masks

    def _mask(self, table: Parameter, lock: Lock) -> bool | Bool:
        if isinstance(lock, bool):
            return lock
        if lock == "no-data":
            looked_up = table.name in self.problem.model.graph.parameters
            return uncovered_values(self.problem, [table.name])[table.name] if looked_up else False
        locked = np.zeros(table.values.shape, dtype=bool)
        for part in lock:
            beyond = missing_directions(table, part)
            if beyond:
                self._report(f"lock {table.name}", f"{table.name} has no axis {beyond[0]}")
            else:
                locked |= grid_points_within(table, part)
        return locked

    def _by_axis(self, key: str, setting: Any, default: float) -> Any:
        """Return a number for all tables, or by parameter a number or one per axis."""
        if not isinstance(setting, Mapping):
            return setting
        values: dict[str, Any] = {}
        for pattern, value in setting.items():
            matches = self._matching(pattern) if isinstance(value, Mapping) else []
            for p in matches:
                values[p.name] = self._per_axis(key, p, value, default, p.name == pattern)
            if not matches:
                values[pattern] = default if isinstance(value, Mapping) else value
        return values

    def _per_axis(
        self, key: str, table: Parameter, setting: Mapping[str, float], default: float, exactly: bool
    ) -> tuple[Any, ...]:
        """Return one number per axis; a pattern may name axes that some of its tables do not have."""
        known = DIRECTIONS[: len(table.axes)]
        for direction in setting if exactly else ():
            if direction not in known:
                message = f"{table.name} has no axis {direction}"
                self._report(f"{key} {table.name}", message, f"It has {', '.join(known) or 'none'}.")
        return tuple(setting.get(direction, default) for direction in known)
