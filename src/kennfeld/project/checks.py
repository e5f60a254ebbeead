"""Warnings about a problem that can be solved, but perhaps not as it was meant."""

import re
from collections.abc import Iterator, Mapping

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles import unwritable
from kennfeld.calfiles.flash import IMAGE_ENDINGS
from kennfeld.errors import Finding
from kennfeld.graph.lowering import dependent
from kennfeld.measurement.conversion import compare, says_nothing
from kennfeld.optimize import Problem
from kennfeld.optimize.data.model_step import clock_findings, is_timed
from kennfeld.optimize.problem import difference
from kennfeld.parameters import Parameter, ParameterSet
from kennfeld.project.coverage import Coverage
from kennfeld.project.function import coordinates_of
from kennfeld.project.method import event_warning
from kennfeld.project.schema import DIRECTIONS, ProjectFile
from kennfeld.project.seen_data import seen_test_data
from kennfeld.project.start_check import start_warning
from kennfeld.project.step_check import step_warning
from kennfeld.project.toml import quoted

__all__ = ["warnings_of"]

_MISSING = 0.1  # share of samples without a value that is worth a word
_OUTSIDE = 0.05  # share of samples beyond the ends of an axis that is worth a word
_WORD = re.compile(r"[^\W\d][\w.]*\Z")  # a name that every format holds
_OF_SETS = (*IMAGE_ENDINGS, ".msq")  # formats that are written over a file, and hold what is in it
_ROUNDING = 1e-9  # of an axis; converted values miss its ends by as much


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
    warnings = [Finding(place, what, mend, severity="warning") for place, what, mend in found]
    warnings += [*_clocks(file, problem, places), *seen_test_data(file, problem, places)]
    return [*warnings, *event_warning(file, problem), *step_warning(file, problem), *start_warning(file, problem)]


def _clocks(file: ProjectFile, problem: Problem, places: Mapping[str, str]) -> Iterator[Finding]:
    """Time stamps that look like milliseconds, where the length of a second matters."""
    entries = file.datasets
    timed = any(e.raster or e.shift or e.unknown_shifts or e.warmup or e.max_gap or e.steady for e in entries)
    if timed or is_timed(problem.model.graph):
        for data in problem.datasets:
            yield from clock_findings(data, places[data.name])


_Warning = tuple[str, str, str]


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
            what = f"channel {channel} is in {recorded}, the {kind} {name} of the function in {own}"
            if found == "contrary":
                mend = f'Name another channel, or state its unit: [units] {quoted(channel)} = "{own}".'
                yield places[data.name], f"{what}, which is another quantity", mend
            else:
                yield places[data.name], what, "Convert it in [calculated], or correct the unit."


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
            what = f"channel {name} is {whole[0]:g} throughout the training data"
            yield places[training[0].name], what, "Is it the right channel?"


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
                what = f"the axis carries {axis.input}, but the function looks {name} up with {given}"
                yield file.place(f"[parameters.{name}] {direction}"), what, "Are the axes exchanged?"


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
            what = (
                f"{outside / total:.0%} of the training samples lie beyond the axis, which ends at {points[0]:g} "
                f"and {points[-1]:g}; the data go from {low:g} to {high:g}"
            )
            yield file.place(f"[parameters.{name}] {DIRECTIONS[i]}"), what, "Widen the axis."


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
            what = f"{ending[1:]} will leave out {names}: {next(iter(left.values())).what}"
            yield file.place("[calibration] output"), what, "parameters.json holds every parameter."
