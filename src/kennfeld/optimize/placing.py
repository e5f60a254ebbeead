"""Where free breakpoints begin: chosen from a dense axis.

Moved one by one, breakpoints end wherever the next kink of the data catches them, and a descent from even ones often
ends far above the best. So each free axis is first made several times as dense and stands still while all values are
fitted; then the breakpoints that matter least are removed, until as many are left as there were (see `elimination`).
From there they move. Because the dense axis holds the breakpoints it was made from, this can be repeated.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.free_axes import AxisKey, FreeAxis
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.breakpoints import bounds_of
from kennfeld.optimize.elimination import Dense, eliminated
from kennfeld.optimize.gauss_newton import Descent, Iteration, Settings, gauss_newton
from kennfeld.optimize.limiting import limits_of
from kennfeld.optimize.limits import Limits
from kennfeld.optimize.objective import SumOfSquares
from kennfeld.optimize.problem import Compiled, Problem
from kennfeld.optimize.projection import project
from kennfeld.parameters import Axis, Parameter, ParameterSet

__all__ = ["Placing", "coarse", "densified", "thickened"]

PARTS = 8  # cells that a cell of a free axis is cut into
MOST_VALUES = 1000  # of the dense problem
ROUNDS = 3
GAIN = 1e-3  # relative fall of the cost for which another round is worth its time
STIFFNESS = 1e-6  # of the mean curvature: what ties values without data to their neighbours
CREEP = 1e-5  # relative change of the cost at which moving breakpoints only creep from one sample to the next
Report = Callable[[str, Iteration, Float, Compiled], None]


def coarse(settings: Settings) -> Settings:
    """Settings of a descent in which breakpoints move.

    The cost has a crease wherever a breakpoint meets a sample. Between noisy samples these catch a descent, which then
    creeps on in tiny steps that gain nothing but time.
    """
    return replace(settings, tolerance=max(settings.tolerance, CREEP), trusted=np.inf)


class Placing:
    """A search for the breakpoints of a problem; `exact` is its compiled form."""

    def __init__(self, problem: Problem, exact: Compiled) -> None:
        self._problem, self._exact = problem, exact
        self._objective = SumOfSquares(exact)

    def descend(self, start: Float, limits: Limits, settings: Settings, report: Report) -> Descent:
        """The best end of several rounds, its values then fitted while the breakpoints stand still."""
        best = self._rounds(start, limits, coarse(settings), report)
        if best.status == "stopped":
            return best
        still = gauss_newton(
            self._objective,
            best.values,
            self._standing(limits, best.values),
            settings,
            lambda line, values: report("still", line, values, self._exact),
        )
        iterations, evaluations = best.iterations + still.iterations, best.evaluations + still.evaluations
        return replace(still, iterations=iterations, evaluations=evaluations)

    def _standing(self, limits: Limits, values: Float) -> Limits:
        """The limits with every breakpoint where it is."""
        lower, upper = limits.lower.copy(), limits.upper.copy()
        for key, at in self._exact.values.moving.items():
            if at < self._exact.values.free:
                part = slice(at, at + len(self._problem.free_axes[key].axis))
                lower[part] = upper[part] = values[part]
        return replace(limits, lower=lower, upper=upper)

    def _rounds(self, start: Float, limits: Limits, settings: Settings, report: Report) -> Descent:
        best: Descent | None = None
        iterations = evaluations = 0
        for _ in range(ROUNDS):
            found = self._round(start if best is None else best.values, limits, settings, report)
            iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
            worth = best is None or found.cost < best.cost * (1 - GAIN)
            if best is None or found.cost < best.cost or found.status == "stopped":
                lower = found if best is None or found.cost < best.cost else best
                best = replace(lower, status=found.status, message=found.message)
            if not worth or best.status == "stopped":
                break
        assert best is not None
        return replace(best, iterations=iterations, evaluations=evaluations)

    def _round(self, at: Float, limits: Limits, settings: Settings, report: Report) -> Descent:
        """Dense fit, choice of breakpoints, and the descent from there."""
        stay = Descent(at, self._objective.cost(at), "converged", "", 0, 1)
        here = self._with_axes(self._parameters(at))
        parts = parts_of(here)
        if all(count == 1 for counts in parts.values() for count in counts):
            return stay
        dense = thickened(here, parts)
        compiled = Compiled(dense)
        quick = replace(settings, tolerance=max(settings.tolerance, 1e-5), patience=2)
        objective, narrow = SumOfSquares(compiled), limits_of(dense, compiled.values)
        begin, _ = project(objective.start, narrow)
        if begin is None:
            return stay
        found = gauss_newton(objective, begin, narrow, quick, lambda line, v: report("dense", line, v, compiled))
        effort = found.iterations, found.evaluations
        if found.status in ("stopped", "failed"):
            return replace(stay, status=found.status, message=found.message, iterations=effort[0])
        chosen, _ = project(self._chosen(here, dense, compiled, narrow, found.values), limits)
        if chosen is None:
            return stay
        moved = partial(report, "placed")
        end = gauss_newton(self._objective, chosen, limits, settings, lambda line, v: moved(line, v, self._exact))
        return replace(end, iterations=end.iterations + effort[0], evaluations=end.evaluations + effort[1])

    def _parameters(self, at: Float) -> ParameterSet:
        full = self._exact.start.copy()
        full[: at.size] = at
        return self._exact.values.unpack(full, self._problem.parameters)

    def _with_axes(self, parameters: ParameterSet) -> Problem:
        return replace(self._problem, parameters=parameters)

    def _chosen(self, here: Problem, dense: Problem, compiled: Compiled, limits: Limits, values: Float) -> Float:
        """Free values of the problem itself: the breakpoints that are left of the dense axes, and the values there."""
        _, matrix = SumOfSquares(compiled).normal(values)
        keys = list(here.free_axes)
        axes = [_dense(here, dense, compiled, key) for key in keys]
        inverse = _inverse(matrix, np.flatnonzero(limits.movable), axes)
        left, fitted = eliminated(axes, values, inverse)
        full = compiled.start.copy()
        full[: fitted.size] = fitted
        held = compiled.values.unpack(full, dense.parameters)
        kept = dict(zip(keys, left, strict=True))
        points = {key: axis.points[kept[key]] for key, axis in zip(keys, axes, strict=True)}
        return self._packed(here, held, points, kept)

    def _packed(
        self, here: Problem, held: ParameterSet, points: Mapping[AxisKey, Float], kept: Mapping[AxisKey, Int]
    ) -> Float:
        flat = self._exact.start.copy()
        for name in self._problem.free_names:
            values = held[name].values
            for key, axis in here.free_axes.items():
                for table, which in axis.places:
                    if table == name:
                        values = np.take(values, kept[key], axis=which)
            at = self._exact.values.offsets[name]
            flat[at : at + values.size] = values.ravel()
        for key, at in self._exact.values.moving.items():
            if key in points:
                flat[at : at + points[key].size] = points[key]
        return flat[: self._exact.values.free]


def parts_of(problem: Problem) -> dict[AxisKey, Int]:
    """Into how many parts to cut each cell of each free axis, so that the dense problem stays moderate."""
    for parts in range(PARTS, 1, -1):
        found = {key: _parts(axis.axis, parts) for key, axis in problem.free_axes.items()}
        if sum(_size(problem, name, found) for name in problem.free_names) <= MOST_VALUES:
            return found
    return {key: np.ones(len(axis.axis) - 1, dtype=np.int64) for key, axis in problem.free_axes.items()}


def _parts(axis: Axis, most: int) -> Int:
    """Parts of each cell, none narrower than breakpoints may be apart."""
    room = np.diff(axis.breakpoints) / axis.least_distance * (1 + 1e-9)
    return np.clip(room, 1, most).astype(np.int64)


def _size(problem: Problem, name: str, parts: Mapping[AxisKey, Int]) -> int:
    size = problem.parameters[name].size
    for key, axis in problem.free_axes.items():
        for table, _ in axis.places:
            if table == name:
                size = size // len(axis.axis) * (int(parts[key].sum()) + 1)
    return size


def densified(points: Float, parts: Int) -> Float:
    """Breakpoints with each cell cut into even parts; the given ones stay, bit for bit.

    >>> densified(np.array([0.0, 1.0, 3.0]), np.array([1, 2])).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    cells = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(points), parts, strict=True)]
    return np.concatenate([*cells, points[-1:]])


def thickened(problem: Problem, parts: Mapping[AxisKey, Int]) -> Problem:
    """The problem on denser axes that stand still; the same surfaces, the same price of roughness."""
    points = {key: densified(axis.axis.breakpoints, parts[key]) for key, axis in problem.free_axes.items()}
    tables, smoothness = [], dict(problem.smoothness)
    for name in {name: None for axis in problem.free_axes.values() for name, _ in axis.places}:
        table, factors = problem.parameters[name], list(problem.factors(name))
        for key, axis in problem.free_axes.items():
            for which in (which for place, which in axis.places if place == name):
                before, after = len(axis.axis), points[key].size
                table = _on(table, which, axis.axis.changed(breakpoints=points[key], free=False))
                factors[which] *= ((after - 1) / max(before - 1, 1)) ** 4
        tables.append(table)
        smoothness[name] = tuple(factors)
    return replace(problem, parameters=problem.parameters.with_parameters(*tables), smoothness=smoothness)


def _on(table: Parameter, which: int, axis: Axis) -> Parameter:
    """A table on a denser axis; what lies between two locked values is locked, its bounds are the wider ones."""
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


def _dense(here: Problem, dense: Problem, compiled: Compiled, key: AxisKey) -> Dense:
    axis: FreeAxis = here.free_axes[key]
    table, direction = axis.places[0]
    points = dense.parameters[table].axes[direction].breakpoints
    low, high = bounds_of(axis, here.parameters, here.held)
    stays = np.isin(points, axis.axis.breakpoints[low == high])
    stays[[0, -1]] = True
    lines = []
    for name, which in axis.places:
        shape = dense.parameters[name].values.shape
        grid = compiled.values.offsets[name] + np.arange(int(np.prod(shape))).reshape(shape)
        lines.append(np.moveaxis(grid, which, 0).reshape(points.size, -1))
    return Dense(points, np.hstack(lines), stays, len(axis.axis))


def _inverse(matrix: Float, movable: Int, axes: list[Dense]) -> Float:
    """The inverse of the matrix; values that no data inform are tied to their neighbours along the dense axes."""
    size = len(matrix)
    mean = float(np.diag(matrix).mean())
    whole = matrix.copy()
    for axis in axes:
        three = np.stack([axis.columns[i : len(axis.columns) - 2 + i].ravel() for i in range(3)], axis=1)
        bend = np.array([1.0, -2.0, 1.0])
        share = STIFFNESS * float(np.diag(matrix)[axis.columns].mean())
        np.add.at(whole, (three[:, :, None], three[:, None, :]), share * np.outer(bend, bend))
    whole[np.diag_indices(size)] += 1e-10 * np.maximum(np.diag(whole), 1e-6 * mean) + 1e-300
    found = np.zeros_like(whole)
    found[np.ix_(movable, movable)] = np.linalg.inv(whole[np.ix_(movable, movable)])
    return found
