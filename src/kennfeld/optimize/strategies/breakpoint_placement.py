"""Placement of free breakpoints by elimination from a dense axis.

The cost has a kink wherever a breakpoint meets a sample, so a descent from even breakpoints often ends far above the
best. Each free axis is therefore first made several times as dense, and fixed while all values are fitted; then the
breakpoints that matter least are removed until the original number remains. From there they move. The dense axis
contains the breakpoints that it was made from, so this can be repeated.

A breakpoint is removed by making every line of its tables straight there, a linear equality between values. In the
quadratic model the least increase of the cost under A z = 0 is (A z)' (A C A')^-1 (A z), where C is the inverse of its
matrix, and both z and C under the equality follow in closed form. The cheapest breakpoint is removed repeatedly.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.limits.linear_limits import breakpoint_bounds, linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.smoothing_continuation import SHORT_SCHEDULE, Continuation
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

MAX_PARTS = 8  # into which a cell of a free axis is divided
MAX_VALUES = 1000  # of the dense problem
MAX_VALUES_SINGLE = 2000  # if a single axis is dense
MAX_ROUNDS = 3
MIN_GAIN = 1e-3  # relative decrease of the cost for another round
RIDGE = 1e-4  # of each curvature: keeps directions that are not determined where the quadratic model is valid
STIFFNESS = 1e-6  # of the mean curvature: ties values without data to their neighbours
KINK_TOLERANCE = 1e-5  # relative change of the cost at which breakpoints only creep from one sample to the next
ROUNDING = 1e-12  # of the largest variance: avoids a division by zero for dependent lines
PAIRS = 2**14  # of lines whose covariances are held at once


class ProblemReport(Protocol):
    """Called after each accepted step; `compiled` is the problem that `values` belong to, if not the exact one."""

    def __call__(self, stage: str, line: Iteration, values: Float, compiled: CompiledProblem | None = None) -> None: ...


def axis_groups(problem: Problem) -> list[tuple[AxisKey, ...]]:
    """Return the free axes that are made dense together: all at once, or one by one if that is too much."""
    together = tuple(problem.free_axes)
    if cell_divisions(problem, together):
        return [together]
    return [(key,) for key in together if cell_divisions(problem, (key,))]


def cell_divisions(problem: Problem, keys: Collection[AxisKey]) -> dict[AxisKey, Int]:
    """Choose the number of parts of each cell, Int[cells], of some axes that keeps the dense problem moderate.

    Empty if no cell can be divided.
    """
    for parts in range(MAX_PARTS, 1, -1):
        divisions = {}
        for key in keys:  # no part is narrower than the minimum distance of breakpoints
            axis = problem.free_axes[key].axis
            room = np.diff(axis.breakpoints) / axis.least_distance * (1 + 1e-9)
            divisions[key] = np.clip(room, 1, parts).astype(np.int64)
        most = MAX_VALUES_SINGLE if len(divisions) == 1 else MAX_VALUES
        sizes = {name: problem.parameters[name].size for name in problem.free_names}
        for key, cells in divisions.items():
            for name in (name for name, _ in problem.free_axes[key].places if name in sizes):
                # lines of the table, times the breakpoints of the dense axis
                sizes[name] = sizes[name] // (cells.size + 1) * (int(cells.sum()) + 1)
        if sum(sizes.values()) <= most:
            return divisions if any((cells > 1).any() for cells in divisions.values()) else {}
    return {}


def subdivide(points: Float, parts: Int) -> Float:
    """Divide each cell into even parts, Int[cells]; the breakpoints, Float[points], are kept bit for bit.

    >>> subdivide(np.array([0.0, 1.0, 3.0]), np.array([1, 2])).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    cells = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(points), parts, strict=True)]
    return np.concatenate([*cells, points[-1:]])


def with_dense_axes(problem: Problem, parts: Mapping[AxisKey, Int]) -> Problem:
    """Return the problem on denser, fixed axes with Int[cells] parts, the same surfaces and roughness penalty."""
    tables: dict[str, Parameter] = {}
    scaled: dict[str, tuple[float, ...]] = {}
    for key, axis in problem.free_axes.items():
        cells = parts.get(key, np.ones(len(axis.axis) - 1, dtype=np.int64))
        dense = axis.axis.changed(breakpoints=subdivide(axis.axis.breakpoints, cells), free=False)
        for name, which in axis.places:
            factors = list(scaled.get(name, problem.factors(name)))
            # the roughness of a surface falls with the fourth power of the spacing, for which its factor makes up
            factors[which] *= (cells.sum() / max(cells.size, 1)) ** 4
            tables[name] = _resample(tables.get(name, problem.parameters[name]), which, dense)
            scaled[name] = tuple(factors)
    return replace(
        problem,
        parameters=problem.parameters.with_parameters(*tables.values()),
        smoothness={**problem.smoothness, **scaled},
        restraints={name: restraint for name, restraint in problem.restraints.items() if name not in tables},
    )


def _resample(table: Parameter, which: int, axis: Axis) -> Parameter:
    """Interpolate a table onto a denser axis; values between two locked ones are locked, with the wider bounds."""
    place = position(axis.breakpoints, table.axes[which].breakpoints, "clip")
    weights, _ = cell_weights(place, len(table.axes[which]))

    def both(array: Any) -> tuple[Any, Any]:
        # the breakpoints around a new one; both are the same at an old one
        left, right = (np.take(array, side(place).astype(np.int64), axis=which) for side in (np.floor, np.ceil))
        return left, right

    return table.changed(
        values=np.moveaxis(np.tensordot(weights, table.values, axes=(1, which)), 0, which),
        axes=tuple(axis if i == which else old for i, old in enumerate(table.axes)),
        lower=np.minimum(*both(table.lower)),
        upper=np.maximum(*both(table.upper)),
        locked=np.logical_and(*both(table.locked)),
    )


def coarsen(settings: SolverSettings) -> SolverSettings:
    """Return the settings of a descent in which breakpoints move, which noisy samples slow down to tiny steps."""
    return replace(settings, tolerance=max(settings.tolerance, KINK_TOLERANCE), damping_limited_ratio=np.inf)


class BreakpointPlacement:
    """A search for the breakpoints of a problem; `exact` is its compiled form.

    With `smoothed`, lookups on the dense axes are smoothed first if their coordinate depends on a free parameter.
    """

    def __init__(self, exact: CompiledProblem, *, smoothed: bool) -> None:
        self._problem, self._exact, self._smoothed = exact.problem, exact, smoothed
        self._objective = LeastSquaresObjective(exact)

    def descend(
        self, start: Float, limits: LinearLimits, settings: SolverSettings, report: ProblemReport
    ) -> SolverResult:
        """Place breakpoints in several rounds from a start, Float[values], then fit values with fixed breakpoints."""
        best = self._rounds(start, limits, coarsen(settings), report)
        if best.status == "stopped":
            return best
        fixed_breakpoints = self._with_fixed_breakpoints(limits, best.values)
        report_still = partial(report, "still")
        fixed = levenberg_marquardt(self._objective, best.values, fixed_breakpoints, settings, report_still)
        return fixed.with_effort_of([best, fixed])

    def _with_fixed_breakpoints(self, limits: LinearLimits, values: Float) -> LinearLimits:
        lower, upper = limits.lower.copy(), limits.upper.copy()
        for key, at in self._exact.values.moving.items():
            if at < self._exact.values.free:
                part = slice(at, at + len(self._problem.free_axes[key].axis))
                lower[part] = upper[part] = values[part]
        return replace(limits, lower=lower, upper=upper)

    def _rounds(
        self, start: Float, limits: LinearLimits, settings: SolverSettings, report: ProblemReport
    ) -> SolverResult:
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
        self,
        at: Float,
        keys: Collection[AxisKey],
        limits: LinearLimits,
        settings: SolverSettings,
        report: ProblemReport,
    ) -> SolverResult:
        """Fit on dense axes, choose breakpoints, and descend from there; the cost is infinite if that is impossible."""
        here = replace(self._problem, parameters=self._exact.parameters(at))
        parts = cell_divisions(here, keys)
        nowhere = SolverResult(at, np.inf, "converged", "", 0, 0)
        if not parts:
            return nowhere
        dense = _Dense(with_dense_axes(here, parts))
        fit = dense.descend(settings, report, smoothed=self._smoothed)
        if fit is None:
            return nowhere
        nowhere = replace(nowhere, iterations=fit.iterations, evaluations=fit.evaluations)
        if fit.cut_short:
            return replace(nowhere, status=fit.status, message=fit.message)
        # the values after elimination are of a quadratic model that knows no limits
        start, _ = project(self._eliminate(here, dense, keys, fit.values), limits)
        if start is None:
            return nowhere
        return _better(
            levenberg_marquardt(self._objective, start, limits, settings, partial(report, "placed")), nowhere
        )

    def _eliminate(self, here: Problem, dense: "_Dense", keys: Collection[AxisKey], values: Float) -> Float:
        """Return the free values of the problem: the remaining breakpoints of the dense axes, and the values there."""
        axes = {key: dense.axis(here, key) for key in keys}
        remaining, fitted = eliminate_breakpoints([*axes.values()], values, dense.inverse(values, [*axes.values()]))
        kept = dict(zip(keys, remaining, strict=True))
        parameters = dense.compiled.parameters(fitted)
        flat = self._exact.values.pack(here.parameters)
        for name in self._problem.free_names:
            table = parameters[name].values
            for key in keys:
                for which in (which for place, which in here.free_axes[key].places if place == name):
                    table = np.take(table, kept[key], axis=which)
            first = self._exact.values.offsets[name]
            flat[first : first + table.size] = table.ravel()
        for key, axis in axes.items():
            first = self._exact.values.moving[key]
            flat[first : first + kept[key].size] = axis.points[kept[key]]
        return flat[: self._exact.values.free]


def _better(best: SolverResult, last: SolverResult) -> SolverResult:
    lower = last if last.cost < best.cost else best
    if last.status == "stopped":
        lower = replace(lower, status=last.status, message=last.message)
    return lower.with_effort_of([best, last])


class _Dense:
    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.compiled = CompiledProblem(problem)
        self.objective = LeastSquaresObjective(self.compiled)
        self.limits = linear_limits(problem, self.compiled.values)

    def descend(self, settings: SolverSettings, report: ProblemReport, *, smoothed: bool) -> SolverResult | None:
        """Descend from the current surfaces; None if the limits cannot be satisfied."""
        begin, _ = project(self.objective.start, self.limits)
        if begin is None:
            return None
        quick = replace(settings, patience=2)
        smooth = Continuation.of(self.compiled) if smoothed else None
        report_dense = partial(report, "dense", compiled=self.compiled)
        if smooth is None:
            return levenberg_marquardt(self.objective, begin, self.limits, quick, report_dense)
        end, _ = smooth.descend(SHORT_SCHEDULE, begin, self.limits, quick, lambda _, *step: report_dense(*step))
        # the continuation has seen a part of many samples; the quadratic model is to be that of all
        if end.cut_short or not smooth.thinned:
            return end
        last = levenberg_marquardt(self.objective, end.values, self.limits, quick, report_dense)
        return last.with_effort_of([end, last])

    def axis(self, here: Problem, key: AxisKey) -> "DenseAxis":
        """Return a dense axis and the values on it, to be reduced to the number of breakpoints in `here`."""
        axis = here.free_axes[key]
        table, direction = axis.places[0]
        points = self.problem.parameters[table].axes[direction].breakpoints
        low, high = breakpoint_bounds(axis, here.parameters, here.held)
        # breakpoints with equal bounds, such as those of locks and pins, must not go
        stays = np.isin(points, axis.axis.breakpoints[low == high])
        stays[[0, -1]] = True
        lines = []
        for name, which in axis.places:
            shape = self.problem.parameters[name].values.shape
            grid = self.compiled.values.offsets[name] + np.arange(int(np.prod(shape))).reshape(shape)
            lines.append(np.moveaxis(grid, which, 0).reshape(points.size, -1))
        return DenseAxis(points, np.hstack(lines), stays, len(axis.axis))

    def inverse(self, values: Float, axes: Sequence["DenseAxis"]) -> Float:
        """Return the inverse of the Gauss-Newton matrix, 0 for values that cannot move.

        Values without data are tied to their neighbours along the dense axes.
        """
        whole = as_array(self.objective.normal(values)[1])
        diagonal = whole.diagonal().copy()
        for axis in axes:
            three = np.stack([axis.columns[i : len(axis.columns) - 2 + i].ravel() for i in range(3)], axis=1)
            bend = np.array([1.0, -2.0, 1.0])
            share = STIFFNESS * float(diagonal[axis.columns].mean())
            # adds (z1 - 2 z2 + z3)^2 for each three neighbours
            np.add.at(whole, (three[:, :, None], three[:, None, :]), share * np.outer(bend, bend))
        whole[np.diag_indices(len(whole))] += RIDGE * np.maximum(np.diag(whole), 1e-6 * diagonal.mean()) + 1e-300
        movable = np.ix_(*[np.flatnonzero(self.limits.movable)] * 2)
        inverse = np.zeros_like(whole)
        inverse[movable] = np.linalg.inv(whole[movable])
        return inverse


@dataclass(frozen=True)
class DenseAxis:
    """An axis with more breakpoints than `wanted`.

    `columns` are the indices of the values at each breakpoint, one column per line of a table. `stays` marks the
    breakpoints that must not be removed.
    """

    points: Float  # Float[points]
    columns: Int  # Int[points, lines]
    stays: Bool  # Bool[points]
    wanted: int


def eliminate_breakpoints(axes: Sequence[DenseAxis], values: Float, inverse: Float) -> tuple[list[Int], Float]:
    """Remove breakpoints until each axis has as many as wanted.

    Args:
        axes: dense axes.
        values: minimum of the quadratic model, Float[values].
        inverse: inverse of its matrix, Float[values, values]; 0 for values that cannot move.

    Returns:
        Indices of the remaining breakpoints of each axis, and the best values with them.

    >>> hat = DenseAxis(np.arange(4.0), np.arange(4)[:, None], np.array([True, False, False, True]), 3)
    >>> remaining, values = eliminate_breakpoints([hat], np.array([0.0, 1.0, 2.0, 0.0]), np.eye(4))
    >>> remaining[0].tolist(), values.round(6).tolist()
    ([0, 2, 3], [0.0, 1.0, 2.0, 0.0])
    """
    work = _Elimination(axes, values, inverse)
    while work.remove():
        pass
    return [np.array(kept) for kept in work.kept], work.values


class _Elimination:
    def __init__(self, axes: Sequence[DenseAxis], values: Float, inverse: Float) -> None:
        self.axes = axes
        self.values = values.copy()
        self.inverse = inverse.copy()
        self.kept = [list(range(axis.points.size)) for axis in axes]

    def remove(self) -> bool:
        """Remove the cheapest breakpoint; False if none can be removed."""
        candidates = [
            (cost, apart, which, at)
            for which, axis in enumerate(self.axes)
            if len(self.kept[which]) > axis.wanted
            for at, cost, apart in self._costs(which)
        ]
        if not candidates:
            return False
        # of equal costs, the breakpoint with the nearest neighbours goes
        _, _, which, at = min(candidates, key=lambda candidate: candidate[:2])
        columns, coefficients = self._rows(which, np.array([at]))
        self._straighten(columns[0], coefficients[0])
        del self.kept[which][at]
        return True

    def _rows(self, which: int, at: Int) -> tuple[Int, Float]:
        """Return columns Int[places, lines, 3] and coefficients Float[places, 3] of the equalities that remove each."""
        axis, kept = self.axes[which], np.array(self.kept[which])
        three = kept[at[:, None] + np.array([-1, 0, 1])]
        left, middle, right = axis.points[three].T
        # on a straight line, the middle value is (1 - share) left + share right
        share = (middle - left) / (right - left)
        coefficients = np.stack([share - 1, np.ones_like(share), -share], axis=1)
        return axis.columns[three].transpose(0, 2, 1), coefficients

    def _costs(self, which: int) -> Iterator[tuple[int, float, float]]:
        """Yield each breakpoint that may be removed, with the least increase of the cost.

        The distance of its neighbours, which comes last, breaks ties.
        """
        axis, kept = self.axes[which], self.kept[which]
        places = np.array([at for at in range(1, len(kept) - 1) if not axis.stays[kept[at]]], dtype=np.int64)
        at_once = max(1, PAIRS // axis.columns.shape[1] ** 2)
        for first in range(0, places.size, at_once):
            at = places[first : first + at_once]
            columns, coefficients = self._rows(which, at)
            # (A z)' (A C A')^-1 (A z)
            bend = np.einsum("pai,pi->pa", self.values[columns], coefficients)
            blocks = self.inverse[columns[:, :, None, :, None], columns[:, None, :, None, :]]
            spread = np.einsum("pabij,pi,pj->pab", blocks, coefficients, coefficients)
            costs = np.einsum("pa,pa->p", bend, _solve_ridged(spread, bend[:, :, None])[:, :, 0])
            points = axis.points[kept]
            yield from zip(at.tolist(), costs.tolist(), (points[at + 1] - points[at - 1]).tolist(), strict=True)

    def _straighten(self, columns: Int, coefficients: Float) -> None:
        """Update values and covariance for additional equalities."""
        # z -= C A' (A C A')^-1 A z,  C -= C A' (A C A')^-1 A C
        reach: Float = np.einsum("naj,j->na", self.inverse[:, columns], coefficients)
        spread = np.einsum("aib,i->ab", reach[columns], coefficients)
        gain = _solve_ridged(spread, reach.T)
        self.values -= gain.T @ (self.values[columns] @ coefficients)
        self.inverse -= reach @ gain


def _solve_ridged(spread: Float, right: Float) -> Float:
    """Solve systems Float[..., lines, lines] that may be singular."""
    largest = np.diagonal(spread, axis1=-2, axis2=-1).max(axis=-1, initial=0.0)
    floor = ROUNDING * largest[..., None, None] + 1e-300
    return np.asarray(np.linalg.solve(spread + floor * np.eye(spread.shape[-1]), right), dtype=np.float64)
