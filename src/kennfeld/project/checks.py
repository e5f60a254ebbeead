"""Warnings about a problem that can be solved, but perhaps not as it was meant.

What a project file says about single samples: their weights, and how long points are held.

Whether a calibration can move from its initial values.

Whether the step of a model is short enough where a solver with a fixed step takes the place of its own.

Whether the method of the optimizer suits the problem.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles import unwritable
from kennfeld.calfiles.flash.description import IMAGE_ENDINGS
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import quoted
from kennfeld.graph import Graph
from kennfeld.graph.events import Event, events
from kennfeld.graph.factors import factors
from kennfeld.graph.traversal import dependent
from kennfeld.models import Model
from kennfeld.models.formula import expression
from kennfeld.optimize import Problem
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.lookup_coverage import Coverage
from kennfeld.optimize.problem import difference
from kennfeld.optimize.projection import project
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.optimize.strategies.global_search import FEW
from kennfeld.optimize.validation import unbounded
from kennfeld.optimize.zero_slopes import departure
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.model_step import clock_findings, is_timed
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.preprocessing.sample_weights import weight_findings
from kennfeld.preprocessing.settling import hold_of, is_settled
from kennfeld.preprocessing.units import compare, says_nothing
from kennfeld.project.model import coordinates_of, read_function
from kennfeld.project.schema import DIRECTIONS, ProjectFile
from kennfeld.project.seen_data import seen_test_data

__all__ = ["listed", "method_findings", "sample_findings", "settling_findings", "warnings_of", "weight_channels"]

_MOST = 100_000_000  # samples made of points; each takes 8 bytes a channel

_NEAR = 0.01  # of what a node varies
_USUAL = 0.95  # of the samples; events that move by a step make large differences in few
_HALVINGS = 6
_MOST_SAMPLES = 5_000
_MOST_STEPS = 1_000_000  # of one run

_NAMED = 4  # events that a warning names
_SHOWN = 6  # and parameters

_MISSING = 0.1  # share of samples without a value that is worth a word
_OUTSIDE = 0.05  # share of samples beyond the ends of an axis that is worth a word
_WORD = re.compile(r"[^\W\d][\w.]*\Z")  # a name that every format holds
_OF_SETS = (*IMAGE_ENDINGS, ".msq")  # formats that are written over a file, and hold what is in it
_ROUNDING = 1e-9  # of an axis; converted values miss its ends by as much

_Warning = tuple[str, str, str]


def weight_channels(file: ProjectFile) -> dict[str, str]:
    """The channels that criteria weigh their samples by, each with what it is for."""
    found = {}
    for entry in file.criteria:
        if entry.weight_channel:
            found[entry.weight_channel] = f"the weights of {entry.place}"
        for region in entry.regions:
            with suppress(InputError):  # reported with the other findings about weights
                found |= dict.fromkeys(expression(region.where, "").inputs, f"a region of {entry.place}")
    return found


def sample_findings(file: ProjectFile, problem: Problem, loaded: LoadedData) -> list[Finding]:
    """What is wrong with the weights of single samples."""
    training = [data for data in problem.datasets if data.use == "training" and data.weight > 0]
    return weight_findings(
        problem.criteria,
        training,
        lambda number: file.criteria[number].place,
        lambda data: loaded.places[data.name],
        list(loaded.offered),
    )


def settling_findings(graph: Graph, loaded: LoadedData) -> list[Finding]:
    """What is wrong with the holding of steady-state points."""
    found = []
    for data in loaded.datasets:
        if data.settling is None:
            continue
        place = loaded.places[data.name]
        if not is_settled(data, graph):
            message = "the function has no memory, so that its points need not be held"
            found.append(Finding(f"{place} settle", message, "Remove settle.", severity="warning"))
        elif data.settling.step is None:
            message = "the points are held, but no step of the model is given"
            found.append(Finding(f"{place} step", message, "Write step = ... in s, here or in [model]."))
        elif (total := data.samples * (each := hold_of(data, data.settling, None).samples)) > _MOST:
            message = f"{data.samples} points of {each} samples each are {total} samples, too many for memory"
            found.append(Finding(f"{place} settle", message, "Shorten settle, or take a larger step."))
    return found


def start_warning(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """A warning for each parameter that keeps others, or itself, at 0, with an initial value that does not.

    Nothing is compiled unless the formula has factors that are 0 at the start.
    """
    suspects = factors(problem.graph) & {name for name in problem.free_names if _at_zero(problem, name)}
    if not suspects or file.optimizer.method == "global" or not any(bound.count for bound in problem.training):
        return
    try:
        compiled = CompiledProblem(problem)
        limits = linear_limits(problem, compiled.values)
    except InputError:  # told by other checks
        return
    start, _ = project(compiled.start[: compiled.values.free], limits)
    off = None if start is None else departure(compiled, start, limits)
    if off is None:
        return
    for name in off.changed:
        others = " and ".join(other for other in off.stuck if other != name) or name
        message = f"the initial value is 0, and so all slopes of {others} are zero: no step could move from there"
        remedy = f"Write initial = {off.levels[name]:g}, or all values; a calibration starts there on its own."
        yield Finding(file.place(f"[parameters.{name}] initial"), message, remedy, severity="warning")


def _at_zero(problem: Problem, name: str) -> bool:
    return not np.any(problem.parameters[name].values)


class _Gap(NamedTuple):
    """How far a node of two runs is apart: `share` of what it varies."""

    node: str
    share: float


def step_warning(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """A warning where half the step gives other values, with the step that does not, as far as one is found.

    Each run starts with the values of the project, over the beginning of the first training dataset. Inputs keep still
    within the original step, so that the solver alone makes the difference.
    """
    bound = next(iter(problem.training), None) if problem.model.stepped else None
    if bound is None or "dt" not in bound.clock or bound.hold is not None or bound.count < 2:
        return
    step = problem.model.step or float(np.median(bound.clock["dt"]))
    trial = _StepTrial(file, problem, bound, step)
    first = trial.gap(1)
    if first is None or first.share <= _NEAR:
        return
    halvings = (2**k for k in range(1, _HALVINGS))
    parts = next((n for n in halvings if (gap := trial.gap(n)) is not None and gap.share <= _NEAR), 0)
    message = (
        f"with half the step of {step:g} s, {_step_findings(first)}: the step is too long for a solver with a fixed one"
    )
    remedy = f"Write step = {step / parts:g} under [model]." if parts else "Try much shorter ones: step under [model]."
    yield Finding(file.place("[model] step"), message, remedy, severity="warning")


def _step_findings(gap: _Gap) -> str:
    if np.isfinite(gap.share):
        return f"{gap.node} differs by {gap.share:.0%} of what it varies"
    return f"{gap.node} is a number where it was none, or the other way round"


class _StepTrial:
    """Runs of a problem's model with parts of its step, the inputs held."""

    def __init__(self, file: ProjectFile, problem: Problem, bound: BoundDataset, step: float) -> None:
        self.file, self.problem, self.bound, self.step = file, problem, bound, step
        names = problem.model.graph.names
        self.nodes = [one for one in dict.fromkeys(c.node for c in problem.criteria) if one in names]
        self._runs: dict[int, Float | None] = {1: self._run(problem.model, 1)}

    def gap(self, parts: int) -> _Gap | None:
        """The largest difference between a part of the step and half of it; None where one cannot be run."""
        one, other = self._values(parts), self._values(2 * parts)
        if one is None or other is None:
            return None
        gaps = [_Gap(name, _share(a, b)) for name, a, b in zip(self.nodes, one, other, strict=True)]
        return max(gaps, key=lambda gap: gap.share, default=None)

    def _values(self, parts: int) -> Float | None:
        if parts not in self._runs:
            model = self._model(parts) if parts * self._count <= _MOST_STEPS else None
            self._runs[parts] = self._run(model, parts) if model is not None else None
        return self._runs[parts]

    def _model(self, parts: int) -> Model | None:
        entry = replace(self.file.model, step=self.step / parts)
        findings: list[Finding] = []
        known, surrogates = list(self.problem.parameters), self.problem.model.surrogates
        try:
            found = read_function(replace(self.file, model=entry), known, surrogates, findings, self.problem.parameters)
        except InputError:
            return None
        return found.model if found is not None and not findings else None

    @property
    def _count(self) -> int:
        return min(self.bound.count, _MOST_SAMPLES)

    def _run(self, model: Model, parts: int) -> Float:
        """The nodes of the criteria at the original samples, Float[nodes, samples]."""
        count = self._count
        columns = {name: np.repeat(values[:count], parts) for name, values in self.bound.columns.items()}
        columns["dt"] = columns["dt"] / parts
        if "t" in columns:
            columns["t"] = columns["t"] + columns["dt"] * np.tile(np.arange(parts), count)
        starts = [parts * int(start) for start in self.bound.starts if start < count]
        compiled = NodeSimulator(model.graph, self.problem.parameters, self.nodes)
        with np.errstate(all="ignore"):
            return compiled.over(columns, parts * count, self.problem.parameters, starts)[:, ::parts]


def _share(one: Float, other: Float) -> float:
    """The usual difference over what the values vary; infinite where only one of both is a number."""
    known = np.isfinite(one)
    if not np.array_equal(known, np.isfinite(other)):
        return np.inf
    if not known.any():
        return 0.0
    varies = max(float(np.std(other[known])), 1e-9 * float(np.max(np.abs(other[known]))), 1e-300)
    return float(np.quantile(np.abs(one[known] - other[known]), _USUAL)) / varies


def method_findings(file: ProjectFile, problem: Problem) -> list[Finding]:
    """What a global search lacks: bounds; and a warning where it has too many values to search."""
    if file.optimizer.method != "global":
        return []
    found = unbounded(problem, lambda name: file.place(f"[parameters.{name}] bounds"))
    values = sum(int(np.count_nonzero(~problem.parameters[name].locked)) for name in problem.free_names)
    if values > FEW:
        message = f"{values} values are many for a search without gradients, which suits up to {FEW}"
        remedy = "Free fewer, use fewer breakpoints, or raise max_evaluations."
        found.append(Finding(file.place("[optimizer] method"), message, remedy, severity="warning"))
    return found


def event_warning(file: ProjectFile, problem: Problem) -> list[Finding]:
    """A warning where a descent follows derivatives that are blind to events of the model; one for all of them."""
    if file.optimizer.method == "global":
        return []
    outputs = [difference(i) for i in range(len(problem.criteria))]
    found = events(problem.graph, problem.free_names, outputs)
    if not found:
        return []
    model = problem.model
    place = next((model.places[event.name] for event in found if event.name in model.places), model.source)
    names = dict.fromkeys(name for event in found for name in event.parameters)
    decide = "decides" if len(names) == 1 else "decide"
    message = f"{listed(found)} when {_some(names)} {decide}, and derivatives do not see that"
    values = sum(problem.parameters[name].size for name in names)
    few = f"Free up to {FEW} values, and write" if values > FEW else "Write"
    remedy = f'{few} [optimizer] method = "global", and bounds for {_some(names) if values <= FEW else "them"}.'
    return [Finding(place, message, remedy, severity="warning")]


def _some(names: Collection[str]) -> str:
    shown = list(names) if len(names) <= _SHOWN else list(names)[: _SHOWN - 1]
    return ", ".join(shown) + (f" and {len(names) - len(shown)} more" if len(shown) < len(names) else "")


def listed(found: Sequence[Event]) -> str:
    """The events in words: `turned (floor) and fires (>) jump`."""
    words: dict[str, list[str]] = {}
    for event in found:
        name = event.name if event.name.isprintable() else ""
        words.setdefault(name or "a node without a name", []).append(event.word)
    shown = [f"{name} ({', '.join(dict.fromkeys(own))})" for name, own in list(words.items())[:_NAMED]]
    if len(words) > _NAMED:
        shown.append(f"{len(words) - _NAMED} more")
    return f"{', '.join(shown[:-1])} and {shown[-1]} jump" if len(shown) > 1 else f"{shown[0]} jumps"


def warnings_of(file: ProjectFile, problem: Problem, places: Mapping[str, str]) -> list[Finding]:
    """What is odd about the data, the units, the axes and the step."""
    found = [
        *_units(problem, places),
        *_channels(problem, places),
        *_axes(file, problem),
        *_beyond(file, problem),
        *_idle(file, problem),
        *_names(file, problem),
    ]
    warnings = [Finding(place, message, remedy, severity="warning") for place, message, remedy in found]
    warnings += [*_clocks(file, problem, places), *seen_test_data(file, problem, places)]
    return [*warnings, *event_warning(file, problem), *step_warning(file, problem), *start_warning(file, problem)]


def _clocks(file: ProjectFile, problem: Problem, places: Mapping[str, str]) -> Iterator[Finding]:
    """Time stamps that look like milliseconds, where the length of a second matters."""
    entries = file.datasets
    timed = any(e.raster or e.shift or e.unknown_shifts or e.warmup or e.max_gap or e.steady for e in entries)
    if timed or is_timed(problem.model.graph):
        for data in problem.datasets:
            yield from clock_findings(data, places[data.name])


def _units(problem: Problem, places: Mapping[str, str]) -> Iterator[_Warning]:
    """Channels in another unit than the function or the target's node says."""
    units = problem.model.graph.units
    pairs = [(name, problem.channels.get(name, name), "input") for name in problem.model.graph.inputs]
    pairs += [(c.node, c.target.name, "node") for c in problem.criteria if c.target.kind == "channel"]
    for data in problem.datasets:
        for name, channel, kind in dict.fromkeys(pairs):
            own, recorded = units.get(name, ""), data[channel].unit if channel in data else ""
            if says_nothing(own) or says_nothing(recorded) or (found := compare(recorded, own)) == "same":
                continue
            message = f"channel {channel} is in {recorded}, the {kind} {name} of the function in {own}"
            if found == "contrary":
                remedy = f'Name another channel, or state its unit: [units] {quoted(channel)} = "{own}".'
                yield places[data.name], f"{message}, which is another quantity", remedy
            else:
                yield places[data.name], message, "Convert it in [calculated], or correct the unit."


def _channels(problem: Problem, places: Mapping[str, str]) -> Iterator[_Warning]:
    """Channels with many gaps, and channels that never change."""
    training = [bound.dataset for bound in problem.training]
    names = [problem.channels.get(name, name) for name in problem.model.graph.inputs]
    names += [c.target.name for c in problem.criteria if c.target.kind == "channel"]
    for name in dict.fromkeys(names):
        known = [data[name].values[data.counting] for data in training if name in data]
        for data, values in zip((d for d in training if name in d), known, strict=True):
            share = float(np.mean(~np.isfinite(values))) if values.size else 0.0
            if share > _MISSING:
                yield places[data.name], f"channel {name} is missing in {share:.0%} of the samples", ""
        whole = np.concatenate(known) if known else np.empty(0)
        whole = whole[np.isfinite(whole)]
        if whole.size > 1 and np.all(whole == whole[0]):
            message = f"channel {name} is {whole[0]:g} throughout the training data"
            yield places[training[0].name], message, "Is it the right channel?"


def _axes(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Axes that say they carry something else than the function looks up with."""
    graph = problem.model.graph
    known = {*graph.inputs, *graph.names}
    for name in graph.parameters:
        entry = file.parameters.get(name)
        fed = coordinates_of(graph, name)
        axes = problem.parameters[name].axes if entry else ()
        for direction, axis, given in zip(DIRECTIONS, axes, fed, strict=False):
            own = entry is not None and direction in entry.axes
            if own and axis.input in known and given in known and axis.input != given:
                message = f"the axis carries {axis.input}, but the function looks {name} up with {given}"
                yield file.place(f"[parameters.{name}] {direction}"), message, "Are the axes exchanged?"


def _beyond(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Axes that the data leave at an end in many samples; only where no parameter can change that."""
    graph, parameters = problem.model.graph, problem.parameters
    tables = [name for name in graph.parameters if parameters[name].axes]
    coverage = Coverage(graph, parameters, tables, of_data_alone=True)
    tally: dict[tuple[str, int], list[float]] = {}
    for bound in problem.training:
        for block in coverage.blocks(bound):
            for i, x in enumerate(block.coordinates):
                _count(tally.setdefault((block.name, i), [0, 0, np.inf, -np.inf]), x, parameters[block.name], i)
    for (name, i), (outside, total, low, high) in tally.items():
        if total and outside / total > _OUTSIDE:
            points = parameters[name].axes[i].breakpoints
            message = (
                f"{outside / total:.0%} of the training samples lie beyond the axis, which ends at {points[0]:g} "
                f"and {points[-1]:g}; the data go from {low:g} to {high:g}"
            )
            yield file.place(f"[parameters.{name}] {DIRECTIONS[i]}"), message, "Widen the axis."


def _count(tally: list[float], x: Float, table: Parameter, axis: int) -> None:
    points = table.axes[axis].breakpoints
    known = x[np.isfinite(x)]
    if known.size:
        slack = _ROUNDING * (points[-1] - points[0])
        tally[0] += int(np.count_nonzero((known < points[0] - slack) | (known > points[-1] + slack)))
        tally[1] += known.size
        tally[2], tally[3] = min(tally[2], float(known.min())), max(tally[3], float(known.max()))


def _idle(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Criteria that no free parameter reaches, and free parameters that reach no criterion."""
    graph, free = problem.graph, set(problem.free_names)
    moving = dependent(graph, lambda node: node.op == "lookup" and node.payload in free)
    ends = [graph.names[difference(i)] for i in range(len(problem.criteria))]
    for entry, at in zip(file.criteria, ends, strict=True):
        if at not in moving:
            yield entry.place, f"no free parameter changes {entry.node}", "Is it the right node?"
    for name in problem.free_names:
        reached = dependent(graph, lambda node, name=name: node.op == "lookup" and node.payload == name)  # type: ignore[misc]
        if reached.isdisjoint(ends):
            yield file.place("[calibration] free"), f"{name} changes no criterion, so it keeps its start", ""


def _names(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Parameters that a format of the results has no name for, such as fields of blocks whose names hold blanks."""
    odd = [name for name in problem.graph.parameters if not _WORD.match(name) and name in problem.parameters]
    alone = ParameterSet(problem.parameters[name] for name in odd)
    for ending in file.calibration.output if odd else ():
        if ending in _OF_SETS:
            continue
        left = unwritable(alone, ending)
        if left:
            names = ", ".join(list(left)[:5]) + (f" and {len(left) - 5} more" if len(left) > 5 else "")
            message = f"{ending[1:]} will leave out {names}: {next(iter(left.values())).message}"
            yield file.place("[calibration] output"), message, "parameters.json holds every parameter."
