"""Placement of free breakpoints by elimination from a dense axis.

The cost has a kink wherever a breakpoint meets a sample, so a descent from even breakpoints often ends far above the
best. Each free axis is therefore first made several times as dense, and fixed while all values are fitted; then the
breakpoints that matter least are removed until the original number remains (see `breakpoint_elimination`). From there
they move. The dense axis contains the breakpoints that it was made from, so this can be repeated.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.free_axes import AxisKey
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import breakpoint_bounds, linear_limits
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Factor, Problem
from kennfeld.optimize.projection import project
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.breakpoint_elimination import DenseAxis, eliminate_breakpoints
from kennfeld.optimize.strategies.smoothing_continuation import SHORT_SCHEDULE, Continuation
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter

MAX_PARTS = 8  # into which a cell of a free axis is divided
MAX_VALUES = 1000  # of the dense problem
MAX_VALUES_SINGLE = 2000  # if a single axis is dense
MAX_ROUNDS = 3
MIN_GAIN = 1e-3  # relative decrease of the cost for another round
RIDGE = 1e-4  # of each curvature: keeps directions that are not determined where the quadratic model is valid
STIFFNESS = 1e-6  # of the mean curvature: ties values without data to their neighbours
KINK_TOLERANCE = 1e-5  # relative change of the cost at which breakpoints only creep from one sample to the next

Report = Callable[[str, Iteration, Float, CompiledProblem], None]


def axis_groups(problem: Problem) -> list[tuple[AxisKey, ...]]:
    """Return the free axes that are made dense together: all at once, or one by one if that is too much."""
    together = tuple(problem.free_axes)
    if cell_divisions(problem, together):
        return [together]
    return [(key,) for key in together if cell_divisions(problem, (key,))]


def cell_divisions(problem: Problem, keys: Collection[AxisKey]) -> dict[AxisKey, Int]:
    """Return the number of parts of each cell of some axes that keeps the dense problem moderate.

    Empty if no cell can be divided.
    """
    for parts in range(MAX_PARTS, 1, -1):
        divisions = {key: _parts(problem.free_axes[key].axis, parts) for key in keys}
        most = MAX_VALUES_SINGLE if len(divisions) == 1 else MAX_VALUES
        if sum(_size(problem, name, divisions) for name in problem.free_names) <= most:
            return divisions if any((cells > 1).any() for cells in divisions.values()) else {}
    return {}


def _parts(axis: Axis, most: int) -> Int:
    """Return the parts of each cell, none narrower than the minimum distance of breakpoints."""
    room = np.diff(axis.breakpoints) / axis.least_distance * (1 + 1e-9)
    return np.clip(room, 1, most).astype(np.int64)


def _size(problem: Problem, name: str, parts: Mapping[AxisKey, Int]) -> int:
    size = problem.parameters[name].size
    for key, cells in parts.items():
        for table, _ in problem.free_axes[key].places:
            if table == name:
                size = size // (cells.size + 1) * (int(cells.sum()) + 1)
    return size


def subdivide(points: Float, parts: Int) -> Float:
    """Divide each cell into even parts; the given breakpoints are kept bit for bit.

    >>> subdivide(np.array([0.0, 1.0, 3.0]), np.array([1, 2])).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    cells = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(points), parts, strict=True)]
    return np.concatenate([*cells, points[-1:]])


def with_dense_axes(problem: Problem, parts: Mapping[AxisKey, Int]) -> Problem:
    """Return the problem on denser, fixed axes, with the same surfaces and the same roughness penalty."""
    tables: dict[str, Parameter] = {}
    smoothness = dict(problem.smoothness)
    for key, axis in problem.free_axes.items():
        cells = parts.get(key, np.ones(len(axis.axis) - 1, dtype=np.int64))
        dense = axis.axis.changed(breakpoints=subdivide(axis.axis.breakpoints, cells), free=False)
        for name, which in axis.places:
            known = smoothness[name] if name in tables else problem.factors(name)
            factors: list[Factor] = [known] if isinstance(known, float | str) else [*known]
            factors[which] = float(factors[which]) * (cells.sum() / max(cells.size, 1)) ** 4
            tables[name] = _on(tables.get(name, problem.parameters[name]), which, dense)
            smoothness[name] = tuple(factors)
    return replace(
        problem,
        parameters=problem.parameters.with_parameters(*tables.values()),
        smoothness=smoothness,
        restraints={name: restraint for name, restraint in problem.restraints.items() if name not in tables},
    )


def _on(table: Parameter, which: int, axis: Axis) -> Parameter:
    """Interpolate a table onto a denser axis; values between two locked ones are locked, with the wider bounds."""
    place = position(axis.breakpoints, table.axes[which].breakpoints, "clip")
    weights, _ = cell_weights(place, len(table.axes[which]))
    left = np.floor(place).astype(np.int64)
    right = np.ceil(place).astype(np.int64)
    values = np.moveaxis(np.tensordot(weights, table.values, axes=(1, which)), 0, which)

    def both(array: Any) -> tuple[Any, Any]:
        return np.take(array, left, axis=which), np.take(array, right, axis=which)

    return table.changed(
        values=values,
        axes=tuple(axis if i == which else old for i, old in enumerate(table.axes)),
        lower=np.minimum(*both(table.lower)),
        upper=np.maximum(*both(table.upper)),
        locked=np.logical_and(*both(table.locked)),
    )


def coarse(settings: SolverSettings) -> SolverSettings:
    """Return the settings of a descent in which breakpoints move, which noisy samples slow down to tiny steps."""
    return replace(settings, tolerance=max(settings.tolerance, KINK_TOLERANCE), damping_limited_ratio=np.inf)


class BreakpointPlacement:
    """A search for the breakpoints of a problem; `exact` is its compiled form.

    With `smoothed`, lookups on the dense axes are smoothed first if their coordinate depends on a free parameter.
    """

    def __init__(self, problem: Problem, exact: CompiledProblem, *, smoothed: bool) -> None:
        self._problem, self._exact, self._smoothed = problem, exact, smoothed
        self._objective = LeastSquaresObjective(exact)

    def descend(self, start: Float, limits: LinearLimits, settings: SolverSettings, report: Report) -> SolverResult:
        """Place breakpoints in several rounds, then fit the values with fixed breakpoints."""
        best = self._rounds(start, limits, coarse(settings), report)
        if best.status == "stopped":
            return best
        fixed = levenberg_marquardt(
            self._objective,
            best.values,
            self._with_fixed_breakpoints(limits, best.values),
            settings,
            lambda line, values: report("still", line, values, self._exact),
        )
        return fixed.with_effort_of([best, fixed])

    def _with_fixed_breakpoints(self, limits: LinearLimits, values: Float) -> LinearLimits:
        lower, upper = limits.lower.copy(), limits.upper.copy()
        for key, at in self._exact.values.moving.items():
            if at < self._exact.values.free:
                part = slice(at, at + len(self._problem.free_axes[key].axis))
                lower[part] = upper[part] = values[part]
        return replace(limits, lower=lower, upper=upper)

    def _rounds(self, start: Float, limits: LinearLimits, settings: SolverSettings, report: Report) -> SolverResult:
        """Repeat rounds over all axes while they lower the cost."""
        best = SolverResult(start, self._objective.cost(start), "converged", "The cost no longer decreases.", 0, 1)
        for _ in range(MAX_ROUNDS):
            before = best.cost
            for keys in axis_groups(self._problem):
                best = _better(best, self._round(best.values, keys, limits, settings, report))
                if best.status == "stopped":
                    return best
            if not best.cost < before * (1 - MIN_GAIN):
                break
        return best

    def _round(
        self, at: Float, keys: Collection[AxisKey], limits: LinearLimits, settings: SolverSettings, report: Report
    ) -> SolverResult:
        """Fit on dense axes, choose breakpoints, and descend from there; the cost is infinite if that is impossible."""
        here = replace(self._problem, parameters=self._parameters(at))
        parts = cell_divisions(here, keys)
        nowhere = SolverResult(at, np.inf, "converged", "", 0, 0)
        if not parts:
            return nowhere
        dense = _Dense(with_dense_axes(here, parts))
        found = dense.descend(settings, report, smoothed=self._smoothed)
        if found is None:
            return nowhere
        nowhere = replace(nowhere, iterations=found.iterations, evaluations=found.evaluations)
        if found.status in ("stopped", "failed"):
            return replace(nowhere, status=found.status, message=found.message)
        chosen, _ = project(self._chosen(here, dense, keys, found.values), limits)
        if chosen is None:
            return nowhere
        end = levenberg_marquardt(
            self._objective,
            chosen,
            limits,
            settings,
            lambda line, values: report("placed", line, values, self._exact),
        )
        return _better(end, nowhere)

    def _parameters(self, at: Float) -> ParameterSet:
        full = self._exact.start.copy()
        full[: at.size] = at
        return self._exact.values.unpack(full, self._problem.parameters)

    def _chosen(self, here: Problem, dense: "_Dense", keys: Collection[AxisKey], values: Float) -> Float:
        """Return the free values of the problem: the remaining breakpoints of the dense axes, and the values there."""
        axes = {key: dense.axis(here, key) for key in keys}
        left, fitted = eliminate_breakpoints(list(axes.values()), values, dense.inverse(values, list(axes.values())))
        kept = dict(zip(keys, left, strict=True))
        held = dense.parameters(fitted)
        flat = self._exact.values.pack(here.parameters)
        for name in self._problem.free_names:
            table = held[name].values
            for key in keys:
                for which in (which for place, which in here.free_axes[key].places if place == name):
                    table = np.take(table, kept[key], axis=which)
            first = self._exact.values.offsets[name]
            flat[first : first + table.size] = table.ravel()
        for key, axis in axes.items():
            first = self._exact.values.moving[key]
            flat[first : first + kept[key].size] = axis.points[kept[key]]
        return flat[: self._exact.values.free]


def _better(best: SolverResult, found: SolverResult) -> SolverResult:
    """Return the lower of two ends, with the effort of both."""
    lower = found if found.cost < best.cost else best
    if found.status == "stopped":
        lower = replace(lower, status=found.status, message=found.message)
    return lower.with_effort_of([best, found])


class _Dense:
    """A problem on dense axes, compiled."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.compiled = CompiledProblem(problem)
        self.objective = LeastSquaresObjective(self.compiled)
        self.limits = linear_limits(problem, self.compiled.values)

    def descend(self, settings: SolverSettings, report: Report, *, smoothed: bool) -> SolverResult | None:
        """Descend from the current surfaces; None if the limits cannot be satisfied."""
        begin, _ = project(self.objective.start, self.limits)
        if begin is None:
            return None
        quick = replace(settings, patience=2)
        smooth = Continuation.of(self.problem, self.compiled) if smoothed else None

        def told(line: Iteration, values: Float) -> None:
            report("dense", line, values, self.compiled)

        if smooth is not None:
            return smooth.descend(SHORT_SCHEDULE, begin, self.limits, quick, lambda _, line, values: told(line, values))
        return levenberg_marquardt(self.objective, begin, self.limits, quick, told)

    def parameters(self, values: Float) -> ParameterSet:
        full = self.compiled.start.copy()
        full[: values.size] = values
        return self.compiled.values.unpack(full, self.problem.parameters)

    def axis(self, here: Problem, key: AxisKey) -> DenseAxis:
        """Return a dense axis and the values on it, to be reduced to the number of breakpoints in `here`."""
        axis = here.free_axes[key]
        table, direction = axis.places[0]
        points = self.problem.parameters[table].axes[direction].breakpoints
        low, high = breakpoint_bounds(axis, here.parameters, here.held)
        stays = np.isin(points, axis.axis.breakpoints[low == high])
        stays[[0, -1]] = True
        lines = []
        for name, which in axis.places:
            shape = self.problem.parameters[name].values.shape
            grid = self.compiled.values.offsets[name] + np.arange(int(np.prod(shape))).reshape(shape)
            lines.append(np.moveaxis(grid, which, 0).reshape(points.size, -1))
        return DenseAxis(points, np.hstack(lines), stays, len(axis.axis))

    def inverse(self, values: Float, axes: Sequence[DenseAxis]) -> Float:
        """Return the inverse of the Gauss-Newton matrix, 0 for values that cannot move.

        Values without data are tied to their neighbours along the dense axes.
        """
        _, matrix = self.objective.normal(values)
        whole, diagonal = matrix.copy(), np.diag(matrix)
        for axis in axes:
            three = np.stack([axis.columns[i : len(axis.columns) - 2 + i].ravel() for i in range(3)], axis=1)
            bend = np.array([1.0, -2.0, 1.0])
            share = STIFFNESS * float(diagonal[axis.columns].mean())
            np.add.at(whole, (three[:, :, None], three[:, None, :]), share * np.outer(bend, bend))
        whole[np.diag_indices(len(whole))] += RIDGE * np.maximum(np.diag(whole), 1e-6 * diagonal.mean()) + 1e-300
        movable = np.ix_(*[np.flatnonzero(self.limits.movable)] * 2)
        inverse = np.zeros_like(whole)
        inverse[movable] = np.linalg.inv(whole[movable])
        return inverse
