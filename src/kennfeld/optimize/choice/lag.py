"""The lag of a recorded channel, found by the fit: the shift with which the model meets the data best.

First whole samples: fit, then try every lag within a window with the values of that fit, take the best, and fit
again, until it stays. Then the least cost of a fit at the neighbouring lags: the search goes on where a neighbour is
better, and the vertex of the parabola through the best three gives the fraction. No recorded value is interpolated for
that, since interpolation averages noise away and so favours lags between samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError, nearest
from kennfeld.optimize.choice.shifting import shifted
from kennfeld.optimize.limits.limiting import limits_of
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.objective import SumOfSquares
from kennfeld.optimize.problem import Compiled, Problem, difference
from kennfeld.optimize.scoring import Nodes
from kennfeld.optimize.solver.gauss_newton import Settings, gauss_newton
from kennfeld.parameters import ParameterSet

__all__ = ["WINDOW", "Shifts", "at_the_end", "moved", "with_shifts_found"]

WINDOW = 20  # samples to either side
ROUNDS = 5
NEAR = 0.05  # of a sample; a whole lag this close is taken
ROUGH = Settings(max_iterations=30, tolerance=1e-5, patience=2)

Shifts = Mapping[str, Mapping[str, float]]  # by dataset and channel; s, for steady-state data samples


def moved(problem: Problem, shifts: Shifts) -> Problem:
    """The problem with channels of its datasets shifted."""
    if not shifts:
        return problem
    datasets = tuple(shifted(data, shifts.get(data.name, {})) for data in problem.datasets)
    return replace(problem, datasets=datasets, unknown_shifts={})


def with_shifts_found(problem: Problem) -> tuple[Problem, dict[str, dict[str, float]]]:
    """The problem with the channels of `unknown_shifts` moved by their lags, and these lags.

    A lag is found for each training dataset that asks for it; a test dataset gets the median of these, so that it stays
    unseen. Raises `InputError` where a channel plays no part in the problem, or only test data ask for it.
    """
    sought = _checked(problem)
    search = _Search(problem, sought)
    lags = search.found()
    shifts: dict[str, dict[str, float]] = {}
    for at, lag in zip(sought, lags, strict=True):
        data = problem.datasets[at.dataset]
        shifts.setdefault(data.name, {})[at.channel] = _tidy(lag * _step(data))
    for data in problem.datasets:
        for channel in problem.unknown_shifts.get(data.name, ()):
            if channel not in shifts.get(data.name, {}):
                known = [found[channel] for found in shifts.values() if channel in found]
                shifts.setdefault(data.name, {})[channel] = float(np.median(known))
    return moved(problem, shifts), shifts


@dataclass(frozen=True)
class _Sought:
    """A channel of a dataset whose lag is to be found."""

    dataset: int
    channel: str


def _checked(problem: Problem) -> list[_Sought]:
    """The lags to be found on training data."""
    inputs = {problem.channels.get(name, name) for name in problem.model.graph.inputs}
    targets = {c.target.name for c in problem.criteria if problem.target_node(c) is None and c.target.name}
    used, findings, sought = inputs | targets, _same_names(problem), []
    for number, data in enumerate(problem.datasets):
        for channel in problem.unknown_shifts.get(data.name, ()):
            if channel not in used or channel not in data:
                mend = nearest(channel, used) or f"Name one of {', '.join(sorted(used))}."
                what = f"{channel} is neither an input of the function nor a target"
                findings.append(Finding(f"shift of dataset {data.name}", what, mend))
            elif data.use == "training" and data.weight > 0:
                sought.append(_Sought(number, channel))
    found = {at.channel for at in sought}
    for data in problem.datasets:
        for channel in problem.unknown_shifts.get(data.name, ()):
            if channel not in found and channel in used and channel in data:
                what = f"the shift of {channel} is found on training data, and none asks for it"
                findings.append(Finding(f"shift of dataset {data.name}", what, "Give a number."))
    if findings:
        raise InputError(list(dict.fromkeys(findings)))
    return sought


def _same_names(problem: Problem) -> list[Finding]:
    """Training datasets whose shifts could not be told apart."""
    names = [d.name for d in problem.datasets if d.use == "training" and problem.unknown_shifts.get(d.name)]
    return [
        Finding(f"dataset {name}", f"{names.count(name)} of them are to find a shift", "Give each a name of its own.")
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]


class _Search:
    """The search for all lags, in samples; whole ones together, then one by one."""

    def __init__(self, problem: Problem, sought: Sequence[_Sought]) -> None:
        self.problem, self.sought = problem, sought
        names = [difference(i) for i in range(len(problem.criteria))]
        self.nodes = Nodes(problem.graph, problem.parameters, names)
        self.costs: dict[tuple[float, ...], tuple[float, ParameterSet]] = {}

    def found(self) -> list[float]:
        lags = [0.0] * len(self.sought)
        parameters = self.problem.parameters
        for _ in range(ROUNDS):
            parameters = self._fitted(lags, parameters)[1]
            better = [self._likeliest(i, lags, parameters) for i in range(len(lags))]
            if better == lags:
                break
            lags = better
        for i in range(len(lags)):
            lags = self._climbed(i, lags)
        return [self._vertex(i, lags) for i in range(len(lags))]

    def _likeliest(self, which: int, lags: Sequence[float], parameters: ParameterSet) -> float:
        """The whole lag within the window that meets the data best with these values."""
        data = self._data(lags)
        at = self.sought[which]
        most = min(WINDOW, max(int(np.diff([*data[at.dataset].starts, data[at.dataset].samples]).max()) // 4, 1))
        trials = sorted(range(-most, most + 1), key=abs)
        errors = [self._error(data, at, lag - lags[which], parameters) for lag in trials]
        return float(trials[int(np.argmin(errors))])

    def _error(self, data: Sequence[Dataset], at: _Sought, lag: float, parameters: ParameterSet) -> float:
        """Mean square of the weighted errors on one dataset, with one channel moved further."""
        problem = self.problem
        dataset = data[at.dataset]
        bound = problem.bind(shifted(dataset, {at.channel: lag * _step(dataset)}))
        if not bound.count:
            return np.inf
        rows = self.nodes.values(bound, parameters)
        total = samples = 0.0
        for row, criterion in zip(rows, problem.criteria, strict=True):
            errors = row - problem.target(criterion, bound)
            known = np.isfinite(errors)
            total += criterion.weight * float(np.sum((errors[known] / criterion.scale) ** 2))
            samples += criterion.weight * int(known.sum())
        return total / samples if samples else np.inf

    def _climbed(self, which: int, lags: list[float]) -> list[float]:
        """The lags with one of them moved to where no neighbour allows a better fit."""
        parameters = self._fitted(lags, self.problem.parameters)[1]
        for _ in range(WINDOW):
            sides = [_changed(lags, which, step) for step in (-1.0, 1.0)]
            costs = [self._fitted(side, parameters)[0] for side in sides]
            best = int(np.argmin(costs))
            if costs[best] >= self._fitted(lags, parameters)[0] or abs(sides[best][which]) > WINDOW:
                break
            lags, parameters = sides[best], self._fitted(sides[best], parameters)[1]
        return lags

    def _vertex(self, which: int, lags: list[float]) -> float:
        """The vertex of the parabola through the costs at a lag and its neighbours; whole lags without time."""
        if self.problem.datasets[self.sought[which].dataset].time is None:
            return lags[which]
        parameters = self._fitted(lags, self.problem.parameters)[1]
        before, here, after = (self._fitted(_changed(lags, which, step), parameters)[0] for step in (-1.0, 0.0, 1.0))
        bend = before - 2 * here + after
        fraction = float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0
        return lags[which] + (fraction if abs(fraction) > NEAR else 0.0)

    def _fitted(self, lags: Sequence[float], start: ParameterSet) -> tuple[float, ParameterSet]:
        """The mean cost of a short fit, and its values; each set of lags is fitted once."""
        key = tuple(lags)
        if key not in self.costs:
            self.costs[key] = self._fit(self._data(lags), start)
        return self.costs[key]

    def _fit(self, data: tuple[Dataset, ...], start: ParameterSet) -> tuple[float, ParameterSet]:
        problem = replace(self.problem, datasets=data, parameters=start)
        compiled = Compiled(problem)
        limits = limits_of(problem, compiled.values)
        objective = SumOfSquares(compiled)
        begin, _ = project(objective.start, limits)
        if begin is None or not compiled.samples.count:
            return np.inf, start
        end = gauss_newton(objective, begin, limits, ROUGH)
        full = compiled.start.copy()
        full[: end.values.size] = end.values
        return end.cost / compiled.weights, compiled.values.unpack(full, start)

    def _data(self, lags: Sequence[float]) -> tuple[Dataset, ...]:
        data = list(self.problem.datasets)
        for at, lag in zip(self.sought, lags, strict=True):
            data[at.dataset] = shifted(data[at.dataset], {at.channel: lag * _step(data[at.dataset])})
        return tuple(data)


def at_the_end(problem: Problem, shifts: Shifts) -> str:
    """A sentence on shifts that reach the end of the window; empty where there are none."""
    ends = [
        f"{channel} in {data.name}"
        for data in problem.datasets
        for channel, shift in shifts.get(data.name, {}).items()
        if data.use == "training" and abs(shift) > (WINDOW - 0.6) * _step(data)
    ]
    if not ends:
        return ""
    return (
        f"The shift of {', '.join(ends)} reached the end of the window of {WINDOW} samples; shift it by a number first."
    )


def _changed(lags: Sequence[float], which: int, by: float) -> list[float]:
    return [lag + by * (i == which) for i, lag in enumerate(lags)]


def _step(data: Dataset) -> float:
    """S from sample to sample; 1 for steady-state data, which count in samples."""
    if data.time is None or data.samples < 2:
        return 1.0
    return float(np.median(np.delete(np.diff(data.time), data.starts[1:] - 1)))


def _tidy(seconds: float) -> float:
    """Without the noise of the last digits."""
    return float(f"{seconds:.6g}") + 0.0
