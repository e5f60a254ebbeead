"""How clearly a lag stands out among the others, in words.

The lag of a recorded channel, found by the fit: the shift with which the model meets the data best.

First whole samples: a fit at every lag within a window, each from the values of the neighbouring one; the best few are
fitted again from the start. A fit at one lag does not tell which other lag is better: with points in any order, the
values that suit a wrong lag suit no other. All fits are judged on the same samples, those that every lag leaves.

Then the least cost at the neighbouring lags: the search goes on where a neighbour is better, and the vertex of the
parabola through the best three gives the fraction. No recorded value is interpolated for that, since interpolation
averages noise away and so favours lags between samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.projection import project
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.zero_slopes import departure
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.time_shift import shift_channels

__all__ = ["moved", "with_shifts_found"]

CLEAR = 10.0  # likelihood ratio, as a difference of -2 log L, from which another lag is ruled out
APART = 2.0  # samples from a lag in time, within which others must be about as good
NEAR_END = 0.6  # samples

WINDOW = 20  # samples to either side
ROUNDS = 3  # scans of a lag, where there are several
LIKELY = 3  # lags that are fitted again from the start
NEAR = 0.05  # of a sample; a whole lag this close is taken
ROUGH = SolverSettings(max_iterations=30, tolerance=1e-5, patience=2)
SCAN = SolverSettings(max_iterations=5, tolerance=1e-2, patience=1)

Shifts = Mapping[str, Mapping[str, float]]  # by dataset and channel; s, for steady-state data samples


@dataclass(frozen=True)
class Minimum:
    """The lag of a channel, and the mean costs of fits at all lags of the window, in samples.

    `shift` is the lag in its `unit`: in s, for steady-state points in samples; `step` is that of a sample. So many
    samples are `scored`.
    """

    channel: str
    dataset: str
    shift: float
    step: float
    unit: Literal["s", "samples"]
    lag: float
    most: int
    costs: Mapping[float, float]
    scored: int

    @property
    def at_the_end(self) -> bool:
        """Whether it lies at the end of the window."""
        return abs(self.lag) > self.most - NEAR_END

    @property
    def rival(self) -> float:
        """The best of the other lags; of those in time, of the ones that are not its neighbours."""
        near = 0.5 if self.unit == "samples" else APART
        others = [lag for lag in self.costs if abs(lag - self.lag) > near] or list(self.costs)
        return min(others, key=lambda lag: self.costs[lag])

    @property
    def clear(self) -> bool:
        """Whether the data rule out the rival, were all errors independent."""
        best, other = min(self.costs.values()), self.costs[self.rival]
        if not (np.isfinite(other) and best > 0):
            return not other <= best
        return self.scored * float(np.log(other / best)) > CLEAR

    def __str__(self) -> str:
        best, other = (float(np.sqrt(cost)) for cost in (min(self.costs.values()), self.costs[self.rival]))
        where = f"{self.channel} in {self.dataset}"
        shift, rival = f"{self.shift:g} {self.unit}", f"{self.rival * self.step:g} {self.unit}"
        if self.clear:
            return f"The shift of {where}, {shift}, is clear: the error is {best:.4g} there, {other:.4g} at {rival}."
        return (
            f"The shift of {where} is not clear: the error is {best:.4g} at {shift} and {other:.4g} at {rival}. "
            "Give it as a number."
        )


def sentence_on(minima: Sequence[Minimum]) -> str:
    """Sentences on lags, those at the end of their window first."""
    said = []
    for most in sorted({m.most for m in minima if m.at_the_end}):
        names = ", ".join(f"{m.channel} in {m.dataset}" for m in minima if m.at_the_end and m.most == most)
        said.append(
            f"The shift of {names} reached the end of the window of {most} samples; shift it by a number first."
        )
    return " ".join([*said, *(str(m) for m in minima if not m.at_the_end)])


def moved(problem: Problem, shifts: Shifts) -> Problem:
    """The problem with channels of its datasets shifted."""
    if not shifts:
        return problem
    datasets = tuple(shift_channels(data, shifts.get(data.name, {})) for data in problem.datasets)
    return replace(problem, datasets=datasets, unknown_shifts={})


def with_shifts_found(problem: Problem) -> tuple[Problem, dict[str, dict[str, float]], str]:
    """The problem with the channels of `unknown_shifts` moved by their lags, these lags, and how clear they are.

    A lag is found for each training dataset that asks for it; a test dataset gets the median of these, so that it stays
    unseen. Raises `InputError` where a channel plays no part in the problem, or only test data ask for it.
    """
    sought = _checked(problem)
    search = _ShiftSearch(problem, sought)
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
    minima = [search.minimum(i, lag, shifts) for i, lag in enumerate(lags)]
    return moved(problem, shifts), shifts, sentence_on(minima)


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
                remedy = nearest(channel, used) or f"Name one of {', '.join(sorted(used))}."
                message = f"{channel} is neither an input of the function nor a target"
                findings.append(Finding(f"shift of dataset {data.name}", message, remedy))
            elif data.use == "training" and data.weight > 0:
                sought.append(_Sought(number, channel))
    found = {at.channel for at in sought}
    for data in problem.datasets:
        for channel in problem.unknown_shifts.get(data.name, ()):
            if channel not in found and channel in used and channel in data:
                message = f"the shift of {channel} is found on training data, and none asks for it"
                findings.append(Finding(f"shift of dataset {data.name}", message, "Give a number."))
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


class _ShiftSearch:
    """The search for all lags, in samples; one after the other, again where another one has changed."""

    def __init__(self, problem: Problem, sought: Sequence[_Sought]) -> None:
        self.problem, self.sought = problem, sought
        self.most = [_widest(problem.datasets[at.dataset]) for at in sought]
        self.fits: dict[tuple[SolverSettings, tuple[float, ...]], tuple[float, ParameterSet]] = {}
        self.scans: dict[int, dict[float, float]] = {}
        data = self._data([0.0] * len(sought))
        self.compiled = CompiledProblem(replace(problem, datasets=data))
        self.begin = self._begin()

    def _begin(self) -> ParameterSet:
        """The start, moved off a saddle."""
        limits = linear_limits(self.problem, self.compiled.values)
        objective = LeastSquaresObjective(self.compiled)
        kept, _ = project(objective.start, limits)
        off = None if kept is None else departure(self.compiled, kept, limits)
        return self.problem.parameters if off is None else self._parameters(off.values, self.problem.parameters)

    def found(self) -> list[float]:
        lags = [0.0] * len(self.sought)
        for _ in range(ROUNDS):
            before = list(lags)
            for which in range(len(lags)):
                lags = self._best(which, lags)
            if lags == before or len(lags) == 1:
                break
        for i in range(len(lags)):
            lags = self._climbed(i, lags)
        return [self._vertex(i, lags) for i in range(len(lags))]

    def _best(self, which: int, lags: Sequence[float]) -> list[float]:
        """The lags with one of them at the best place within the window."""
        costs = self._scan(which, lags)
        self.scans[which] = costs
        likely = sorted(costs, key=lambda lag: (costs[lag], abs(lag)))[:LIKELY]
        for lag in likely:
            trial = _at(lags, which, lag)
            costs[lag] = min(costs[lag], self._fit(trial, self.begin, ROUGH)[0])
        return _at(lags, which, min(likely, key=lambda lag: (costs[lag], abs(lag))))

    def _scan(self, which: int, lags: Sequence[float]) -> dict[float, float]:
        """The cost of a fit at every whole lag of the window, from where the search is outwards."""
        here, most = round(lags[which]), self.most[which]
        cost, parameters = self._fitted(_at(lags, which, here), self.begin, SCAN)
        costs = {float(here): cost}
        for side in (range(here + 1, most + 1), range(here - 1, -most - 1, -1)):
            near = parameters
            for lag in side:
                costs[float(lag)], near = self._fitted(_at(lags, which, lag), near, SCAN)
        return costs

    def _climbed(self, which: int, lags: list[float]) -> list[float]:
        """The lags with one of them moved to where no neighbour allows a better fit."""
        parameters = self._fitted(lags, self.begin, ROUGH)[1]
        for _ in range(WINDOW):
            sides = [_at(lags, which, lags[which] + step) for step in (-1.0, 1.0)]
            costs = [self._fitted(side, parameters, ROUGH)[0] for side in sides]
            best = int(np.argmin(costs))
            if costs[best] >= self._fitted(lags, parameters, ROUGH)[0] or abs(sides[best][which]) > self.most[which]:
                break
            lags, parameters = sides[best], self._fitted(sides[best], parameters, ROUGH)[1]
        return lags

    def _vertex(self, which: int, lags: list[float]) -> float:
        """The vertex of the parabola through the costs at a lag and its neighbours; whole lags without time."""
        if self.problem.datasets[self.sought[which].dataset].time is None:
            return lags[which]
        parameters = self._fitted(lags, self.begin, ROUGH)[1]
        near = [_at(lags, which, lags[which] + step) for step in (-1.0, 0.0, 1.0)]
        before, here, after = (self._fitted(at, parameters, ROUGH)[0] for at in near)
        bend = before - 2 * here + after
        fraction = float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0
        return lags[which] + (fraction if abs(fraction) > NEAR else 0.0)

    def minimum(self, which: int, lag: float, shifts: Shifts) -> Minimum:
        """What the scan says of a lag that was found."""
        at = self.sought[which]
        data = self.problem.datasets[at.dataset]
        shift = shifts[data.name][at.channel]
        scored = int(np.count_nonzero(self._data([0.0] * len(self.sought))[at.dataset].counting))
        return Minimum(
            channel=at.channel,
            dataset=data.name,
            shift=shift,
            step=_step(data),
            unit="samples" if data.time is None else "s",
            lag=lag,
            most=self.most[which],
            costs=self.scans[which],
            scored=scored,
        )

    def _fitted(
        self, lags: Sequence[float], start: ParameterSet, settings: SolverSettings
    ) -> tuple[float, ParameterSet]:
        """The mean cost of a short fit, and its values; each set of lags is fitted once with each settings."""
        key = settings, tuple(lags)
        if key not in self.fits:
            self.fits[key] = self._fit(lags, start, settings)
        return self.fits[key]

    def _fit(self, lags: Sequence[float], start: ParameterSet, settings: SolverSettings) -> tuple[float, ParameterSet]:
        problem = replace(self.problem, datasets=self._data(lags), parameters=start)
        compiled = self.compiled.over(problem)
        limits = linear_limits(problem, compiled.values)
        objective = LeastSquaresObjective(compiled, by_rows=settings is not SCAN)
        begin, _ = project(objective.start, limits)
        if begin is None or not compiled.samples.count:
            return np.inf, start
        end = levenberg_marquardt(objective, begin, limits, settings)
        return end.cost / compiled.weights, self._parameters(end.values, start)

    def _parameters(self, values: Float, start: ParameterSet) -> ParameterSet:
        full = self.compiled.values.pack(start)
        full[: values.size] = values
        return self.compiled.values.unpack(full, start)

    def _data(self, lags: Sequence[float]) -> tuple[Dataset, ...]:
        """The datasets with their channels moved; only samples are scored that every lag of the window leaves."""
        data = list(self.problem.datasets)
        for at, lag, most in zip(self.sought, lags, self.most, strict=True):
            own = data[at.dataset]
            data[at.dataset] = _inner(shift_channels(own, {at.channel: lag * _step(own)}), most)
        return tuple(data)


def _widest(data: Dataset) -> int:
    """How many samples to either side a lag is sought."""
    longest = int(np.diff([*data.starts, data.samples]).max())
    return min(WINDOW, max(longest // 4, 1))


def _inner(data: Dataset, margin: int) -> Dataset:
    """The dataset with the ends of its pieces not scored; at least half of each piece is."""
    inside = np.zeros(data.samples, dtype=bool)
    for piece in data.pieces:
        left_out = min(margin, (piece.stop - piece.start) // 4)
        inside[piece.start + left_out : piece.stop - left_out] = True
    return replace(data, scored=inside if data.scored is None else inside & data.scored)


def _at(lags: Sequence[float], which: int, lag: float) -> list[float]:
    return [float(lag) if i == which else other for i, other in enumerate(lags)]


def _step(data: Dataset) -> float:
    """S from sample to sample; 1 for steady-state data, which count in samples."""
    if data.time is None or data.samples < 2:
        return 1.0
    return float(np.median(np.delete(np.diff(data.time), data.starts[1:] - 1)))


def _tidy(seconds: float) -> float:
    """Without the noise of the last digits."""
    return float(f"{seconds:.6g}") + 0.0
