"""Plausibility checks of a problem: sample weights, settling, the start, the step, the method, data, units and axes.

The step check runs the model with half its step, as a fixed-step solver may replace a model's own solver.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Findings, Fix, InputError, Keys, Location
from kennfeld.base.formatting import join_names, quoted, toml_text
from kennfeld.calfiles import unwritable
from kennfeld.domain.constraints import Shape
from kennfeld.domain.file_spans import short_names
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.graph import Graph
from kennfeld.graph.external_function import CodeNotRunError, function_remarks
from kennfeld.graph.factors import factors
from kennfeld.graph.node import NEXT_STEP, STEP, TIME
from kennfeld.graph.traversal import coordinates_of, dependents
from kennfeld.models import Model
from kennfeld.models.formula import expression
from kennfeld.optimize.ends.equal_neurons import REMEDY, describe, equal_neurons
from kennfeld.optimize.ends.repeats import repeat_findings
from kennfeld.optimize.ends.zero_slopes import departure
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.doubtful_arguments import find_crossed
from kennfeld.optimize.problem.problem import Problem, difference
from kennfeld.optimize.problem.unit_conflicts import axis_unit_conflicts, unit_conflicts
from kennfeld.optimize.problem.validation import unbounded
from kennfeld.optimize.quality.lookup_coverage import Coverage
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.search.isolated_call import isolated
from kennfeld.optimize.strategies.jumps import FEW, MAX_NAMES, find_jumps
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.model_step import clock_findings
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.preprocessing.sample_weights import weight_findings
from kennfeld.preprocessing.settling import is_settled, plan_hold
from kennfeld.project.model import read_function
from kennfeld.project.schema import ProjectFile
from kennfeld.project.seen_data import seen_test_data
from kennfeld.project.simulation_files import SIMULATIONS
from kennfeld.project.value_forms import DIRECTIONS

MAX_HELD_SAMPLES = 100_000_000  # each takes 8 bytes per channel

STEP_TOLERANCE = 0.01  # difference of a node, relative to its standard deviation
DIFFERENCE_QUANTILE = 0.95  # of the samples; events that move by a step cause large differences in few
MAX_HALVINGS = 6
MAX_STEP_SAMPLES = 5_000
MAX_STEPS = 1_000_000  # of one run


MAX_MISSING = 0.1  # share of samples without a value
MAX_OUTSIDE = 0.05  # share of samples outside an axis
_WORD = re.compile(r"[^\W\d][\w.]*\Z")  # a name that is valid in every format
_OF_SETS = (*IMAGE_ENDINGS, ".msq", ".par", ".esdl", ".axl", ".amd")  # formats that update an existing file
AXIS_TOLERANCE = 1e-9  # of the width of an axis, for rounding in unit conversions

_Warning = tuple[Location, str, str] | tuple[Location, str, str, list[Fix]]


def weight_channels(file: ProjectFile) -> dict[str, str]:
    """Return the channels that weight the samples of criteria, each with its purpose."""
    purposes = {}
    for entry in file.criteria:
        if entry.weight_channel:
            purposes[entry.weight_channel] = f"the weights of {entry.location}"
        for region in entry.regions:
            with suppress(InputError):  # reported with the other findings about weights
                purposes |= dict.fromkeys(expression(region.where, Location()).inputs, f"a region of {entry.location}")
    return purposes


def check_weights(file: ProjectFile, problem: Problem, loaded: LoadedData) -> list[Finding]:
    """Report wrong weights of samples."""
    return weight_findings(
        problem.criteria,
        problem.fitted_datasets,
        lambda number: file.criteria[number].location,
        lambda data: loaded.locations[data.name],
        list(loaded.offered),
    )


def check_settling(graph: Graph, loaded: LoadedData) -> list[Finding]:
    """Report steady-state points that cannot or need not be held until the model has settled."""
    findings = []
    for data in loaded.datasets:
        if data.settling is None:
            continue
        location = loaded.locations[data.name]
        if not is_settled(data, graph):
            message = "settle has no effect: the function has no states"
            fixes = (Fix.remove((*location.keys, "settle")),)
            place = location.within("settle")
            findings.append(Finding(place, message, "Remove settle.", severity="warning", fixes=fixes))
        elif data.settling.step is None:
            message = "settle requires a time step, but neither the dataset nor the model defines one"
            findings.append(Finding(location.within("step"), message, "Write step = ... in s, here or in [model]."))
        elif (total := data.samples * (each := plan_hold(data, data.settling, None).samples)) > MAX_HELD_SAMPLES:
            message = (
                f"{data.samples} points of {each} samples each are {total} samples, which exceeds {MAX_HELD_SAMPLES}"
            )
            findings.append(Finding(location.within("settle"), message, "Shorten settle, or use a larger step."))
    return findings


def check_start(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """Warn of parameters whose initial value 0 makes the gradient of other parameters vanish, and of equal neurons.

    Nothing is compiled unless factors of products, or weights of a layer, are all 0 at the start.
    """
    equal = equal_neurons(problem.graph, problem.parameters)
    for name in equal if file.optimizer.method != "global" else ():
        if problem.parameters[name].values.any():  # the search leaves weights that are 0 by itself
            yield Finding(file.location("parameters", name), describe(name, equal), REMEDY, severity="warning")
    candidates = (factors(problem.graph) | problem.graph.layers) & {
        name for name in problem.free_names if not problem.parameters[name].values.any()
    }
    if not candidates or file.optimizer.method == "global" or not any(bound.count for bound in problem.training):
        return
    try:
        compiled = CompiledProblem(problem)
        limits = linear_limits(problem, compiled.values)
    except CodeNotRunError:
        raise
    except InputError:  # reported by other checks
        return
    start, _ = project(compiled.start[: compiled.values.free], limits)
    off = None if start is None else departure(LeastSquaresObjective(compiled), compiled, start, limits)
    if off is None:
        return
    for name in off.changed:
        others = " and ".join(other for other in off.stuck if other != name) or name
        message = f"the initial value is 0, so the gradient of {others} is zero and no step can change it"
        remedy = f"Write initial = {off.levels[name]:g}, or all values. By default, a calibration starts at this value."
        if name in off.layers:
            message = "all weights are 0, so that the gradient is zero and no step can change them"
            remedy = f"{REMEDY} By default, a calibration starts with different ones."
        yield Finding(file.location("parameters", name, "initial"), message, remedy, severity="warning")


def check_slopes(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """Remark how the derivatives of functions of other tools are computed; these are loaded."""
    for text in function_remarks(problem.graph.nodes):
        yield Finding(file.location("model", "file"), text, severity="remark")


class _Gap(NamedTuple):
    """Difference of a node between two runs, relative to its standard deviation."""

    node: str
    share: float


def check_step(file: ProjectFile, problem: Problem) -> Iterator[Finding]:
    """Warn if halving the step changes the criteria's nodes, and suggest a step that is short enough.

    Each run covers the beginning of the first training dataset with the initial values. Inputs are held over the
    original step, so that differences are those of the solver.
    """
    bound = next(iter(problem.training), None) if problem.model.stepped else None
    if bound is None or NEXT_STEP not in bound.clock or bound.hold is not None or bound.count < 2:
        return
    step = problem.model.step or float(np.median(bound.clock[NEXT_STEP]))
    trial = _StepTrial(file, problem, bound, step)
    first = trial.gap(1)
    if first is None or first.share <= STEP_TOLERANCE:
        return
    # lazily: each trial compiles the model anew
    halvings = (2**k for k in range(1, MAX_HALVINGS))
    parts = next((n for n in halvings if (gap := trial.gap(n)) is not None and gap.share <= STEP_TOLERANCE), 0)
    effect = f"which values of {first.node} are finite"
    if np.isfinite(first.share):
        effect = f"{first.node} by {first.share:.0%} of its standard deviation"
    message = f"step = {step:g} s is too long for the fixed-step solver: halving it changes {effect}"
    remedy = f"Write step = {step / parts:g} under [model]." if parts else "Try a much shorter step under [model]."
    fixes = (Fix.set(("model", "step"), float(f"{step / parts:g}")),) if parts else ()
    yield Finding(file.location("model", "step"), message, remedy, severity="warning", fixes=fixes)


class _StepTrial:
    """Runs a problem's model with fractions of its step, the inputs held."""

    def __init__(self, file: ProjectFile, problem: Problem, bound: BoundDataset, step: float) -> None:
        self.file, self.problem, self.bound, self.step = file, problem, bound, step
        names = problem.model.graph.names
        self.nodes = [node for node in dict.fromkeys(c.node for c in problem.criteria) if node in names]
        self._runs: dict[int, Float | None] = {1: self._run(problem.model, 1)}

    def gap(self, parts: int) -> _Gap | None:
        """Return the largest difference between 1/`parts` of the step and half of that, None if one cannot be run."""
        coarse, fine = self._values(parts), self._values(2 * parts)
        if coarse is None or fine is None:
            return None
        gaps = [_Gap(name, _relative_difference(a, b)) for name, a, b in zip(self.nodes, coarse, fine, strict=True)]
        return max(gaps, key=lambda gap: gap.share, default=None)

    def _values(self, parts: int) -> Float | None:
        if parts not in self._runs:
            model = self._model(parts) if parts * self._count <= MAX_STEPS else None
            self._runs[parts] = self._run(model, parts) if model is not None else None
        return self._runs[parts]

    def _model(self, parts: int) -> Model | None:
        entry = replace(self.file.model, step=self.step / parts)
        findings = Findings()
        known, surrogates = list(self.problem.parameters), self.problem.model.surrogates
        try:
            function = read_function(
                replace(self.file, model=entry), known, surrogates, findings, self.problem.parameters
            )
        except InputError:
            return None
        return function.model if function is not None and not findings else None

    @property
    def _count(self) -> int:
        return min(self.bound.count, MAX_STEP_SAMPLES)

    def _run(self, model: Model, parts: int) -> Float:
        """Return the nodes of the criteria at the original samples, Float[nodes, samples]."""
        count = self._count
        # inputs are held, so that both runs see the same signal
        columns = {name: np.repeat(values[:count], parts) for name, values in self.bound.columns.items()}
        number, fine = np.tile(np.arange(parts), count), columns[NEXT_STEP] / parts
        columns[NEXT_STEP] = fine
        if STEP in columns:
            # the step before the first fine sample is a part of the original step before it
            columns[STEP] = np.where(number > 0, fine, columns[STEP] / parts)
        if TIME in columns:
            columns[TIME] = columns[TIME] + fine * number
        starts = [parts * int(start) for start in self.bound.starts if start < count]
        compiled = NodeSimulator(model.graph, self.problem.parameters, self.nodes)
        with np.errstate(all="ignore"):
            return compiled.over(columns, parts * count, self.problem.parameters, starts)[:, ::parts]


def _relative_difference(left: Float, right: Float) -> float:
    """Return the 95 % quantile of the difference over the standard deviation, inf if other values are finite."""
    known = np.isfinite(left)
    if not np.array_equal(known, np.isfinite(right)):
        return np.inf
    if not known.any():
        return 0.0
    # the rounding of a constant node does not count as a difference
    scale = max(float(np.std(right[known])), 1e-9 * float(np.max(np.abs(right[known]))), 1e-300)
    return float(np.quantile(np.abs(left[known] - right[known]), DIFFERENCE_QUANTILE)) / scale


def check_method(file: ProjectFile, problem: Problem) -> list[Finding]:
    """Report missing bounds of a global search, and warn of too many values."""
    if file.optimizer.method != "global":
        return []
    findings = unbounded(problem, lambda name: file.location("parameters", name, "bounds"))
    values = sum(int(np.count_nonzero(~problem.parameters[name].locked)) for name in problem.free_names)
    if values > FEW:
        message = f"{values} values are too many for a search without gradients, which suits up to {FEW}"
        remedy = "Free fewer, use fewer breakpoints, or raise max_evaluations."
        findings.append(Finding(file.location("optimizer", "method"), message, remedy, severity="warning"))
    return findings


def check_events(file: ProjectFile, problem: Problem) -> list[Finding]:
    """Warn, once, if derivatives do not account for events of the model."""
    if file.optimizer.method == "global":
        return []
    return [*find_jumps(problem, "[optimizer] ")]


@isolated
def find_warnings(file: ProjectFile, problem: Problem, locations: Mapping[str, Location]) -> list[Finding]:
    """Return the warnings about data, units, axes, free parameters, step and start.

    Checks for which code of other files would have to run, and may not, are named in remarks.
    """
    problems = [
        *_units(file, problem, locations),
        *_channels(problem, locations),
        *_unscored_files(problem, locations),
        *_axes(file, problem),
        *_idle(file, problem),
        *_locked(file, problem),
        *_names(file, problem),
        *_unread_class(file),
        *_unwritten_simulation(file, problem),
    ]
    warnings = [_warning(*problem) for problem in problems]
    warnings += [*_clocks(file, problem, locations), *_restarts(problem, locations)]
    warnings += seen_test_data(file, problem, locations)
    # partitions are represented by excerpts here, in which repeated points say nothing
    if problem.partitions is None:
        warnings += repeat_findings(problem, lambda data: locations[data.name])
    beyond = (_warning(*entry) for entry in _beyond(file, problem))
    # checks that evaluate the function, lazily: code of other files may be refused
    evaluating = {
        "limits in the wrong order": find_crossed(problem, problem.parameters),
        "samples outside of axes": beyond,
        "how derivatives are computed": check_slopes(file, problem),
        "jumps": check_events(file, problem),
        "the step": check_step(file, problem),
        "initial values that make derivatives vanish": check_start(file, problem),
    }
    checked = (_unless_refused(findings, subject, file) for subject, findings in evaluating.items())
    return [*warnings, *(finding for findings in checked for finding in findings)]


def _warning(location: Location, message: str, remedy: str, fixes: Sequence[Fix] = ()) -> Finding:
    return Finding(location, message, remedy, severity="warning", fixes=tuple(fixes))


def _unless_refused(findings: Iterable[Finding], subject: str, file: ProjectFile) -> list[Finding]:
    """Return the findings of a check; a remark if code that it evaluates was not run."""
    try:
        # generators raise while they run, that is here
        return list(findings)
    except CodeNotRunError as error:
        [refusal] = error.findings
        message = f"not checked, because code of {refusal.location} was not run: {subject}"
        return [Finding(Location(file.path.name), message, severity="remark")]


def _clocks(file: ProjectFile, problem: Problem, locations: Mapping[str, Location]) -> Iterator[Finding]:
    """Yield warnings about time stamps that look like milliseconds, if the unit of time matters."""
    entries = file.datasets
    timed = any(e.raster or e.shift or e.warmup or e.max_gap or e.steady for e in entries)
    if timed or problem.model.graph.is_timed:
        for data in problem.datasets:
            yield from clock_findings(data, locations[data.name])


def _restarts(problem: Problem, locations: Mapping[str, Location]) -> Iterator[Finding]:
    """Yield a remark for each dataset within whose recordings states start anew, after gaps or pauses."""
    for data in problem.datasets if problem.graph.states and problem.partitions is None else ():
        bound = problem.bind(data)
        count = bound.starts.size - data.piece_starts.size
        if count > 0 and data.time is not None and bound.hold is None:
            times = "once" if count == 1 else f"{count} times"
            message = f"the states of the function start anew {times} within recordings, after gaps in inputs or pauses"
            remedy = "If they should not, write max_gap = ... in s, above the length of the gaps."
            yield Finding(locations[data.name], message, remedy, severity="remark")


def _units(file: ProjectFile, problem: Problem, locations: Mapping[str, Location]) -> Iterator[_Warning]:
    """Yield channels whose unit differs from that of the function's input or node, and axes that differ from these."""
    graph = problem.model.graph
    criteria = [criterion for criterion in problem.criteria if criterion.target.kind == "channel"]
    for conflict in unit_conflicts(graph, problem.datasets, problem.channels, criteria):
        remedy = "Convert it in [calculated], or correct the unit."
        if conflict.contrary:
            stated = f"[units] {quoted(conflict.channel)} = {toml_text(conflict.unit)}"
            remedy = f"Name another channel, or state its unit: {stated}."
        keys = ("units", conflict.channel)
        fixes = [Fix(f"{conflict.channel} is in {conflict.unit}", ((keys, conflict.unit),))]
        yield locations[conflict.dataset.name], conflict.message, remedy, fixes
    for name, at, message, remedy in axis_unit_conflicts(graph, problem.parameters, problem.datasets, problem.channels):
        yield file.location("parameters", name, DIRECTIONS[at]), message, remedy


def _channels(problem: Problem, locations: Mapping[str, Location]) -> Iterator[_Warning]:
    """Yield channels with many gaps, and constant channels."""
    training = [bound.dataset for bound in problem.training]
    names = [problem.channels.get(name, name) for name in problem.model.graph.inputs]
    names += [c.target.name for c in problem.criteria if c.target.kind == "channel"]
    for name in dict.fromkeys(names):
        levels, count = set[float](), 0
        for data in (data for data in training if name in data):
            values, counting = data[name].values, data.counting
            known = counting & np.isfinite(values)
            scored, finite = int(np.count_nonzero(counting)), int(np.count_nonzero(known))
            if scored and (scored - finite) / scored > MAX_MISSING:
                share = (scored - finite) / scored
                yield locations[data.name], f"channel {name} is missing in {share:.0%} of the samples", ""
            if finite:
                first = float(values[np.argmax(known)])
                # NaN marks a channel that varies; a set of all its values would be large
                levels |= {first, *([np.nan] if np.any(known & (values != first)) else ())}
            count += finite
        if count > 1 and len(levels) == 1:
            message = f"channel {name} is constant ({levels.pop():g}) in the training data"
            yield locations[training[0].name], message, "Is it the right channel?"


def _unscored_files(problem: Problem, locations: Mapping[str, Location]) -> Iterator[_Warning]:
    """Yield the files of a dataset that hold no value of a target which others of its files hold."""
    targets = dict.fromkeys(c.target.name for c in problem.criteria if c.target.kind == "channel")
    for data in problem.datasets if problem.partitions is None else ():  # else they are excerpts
        files = data.files
        for name in targets if files is not None else ():
            known = np.isfinite(data[name].values) if name in data else np.zeros(0, dtype=bool)
            empty = [path for path, own in files.parts(known) if not own.any()] if files and known.any() else []
            if files and empty:
                short = short_names(files.names)
                message = (
                    f"no value of {name}, so that no sample is scored, in {join_names([short[p] for p in empty], 6)}"
                )
                yield locations[data.name], message, ""


def _axes(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield axes whose input differs from the coordinate of the lookup."""
    graph = problem.model.graph
    known = {*graph.inputs, *graph.names}
    for name in graph.parameters:
        entry = file.parameters.get(name)
        coordinates = coordinates_of(graph, name)
        axes = problem.parameters[name].axes if entry else ()
        for direction, axis, looked_up in zip(DIRECTIONS, axes, coordinates, strict=False):
            own = entry is not None and direction in entry.axes
            if own and axis.input in known and looked_up in known and axis.input != looked_up:
                message = f"the input of the axis is {axis.input}, but the function looks {name} up with {looked_up}"
                yield file.location("parameters", name, direction), message, "Are the axes swapped?"


def _beyond(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield axes that many samples exceed, if the coordinate depends on data alone."""
    graph, parameters = problem.model.graph, problem.parameters
    tables = [name for name in graph.parameters if parameters[name].axes]
    coverage = Coverage(graph, parameters, tables, of_data_alone=True)
    tally: dict[tuple[str, int], list[float]] = {}
    for bound in problem.training:
        for block in coverage.blocks(bound):
            for i, x in enumerate(block.coordinates):
                _count(tally.setdefault((block.name, i), [0, 0, np.inf, -np.inf]), x, parameters[block.name], i)
    for (name, i), (outside, total, low, high) in tally.items():
        if total and outside / total > MAX_OUTSIDE:
            points = parameters[name].axes[i].breakpoints
            message = (
                f"{outside / total:.0%} of the training samples are outside the axis, {points[0]:g} to {points[-1]:g}; "
                f"the data range from {low:g} to {high:g}"
            )
            fixes = _extended(file, name, i, (tally[name, i][2], tally[name, i][3]))
            yield file.location("parameters", name, DIRECTIONS[i]), message, "Extend the axis.", fixes


def _extended(file: ProjectFile, name: str, direction: int, reach: tuple[float, float]) -> list[Fix]:
    """Return the fix that moves the ends of an axis of the project file to those of the data."""
    entry = file.parameters.get(name)
    axis = None if entry is None else entry.axes.get(DIRECTIONS[direction])
    if axis is None or axis.group or len(points := axis.points) < 2:
        return []
    low, high = min(reach[0], float(points[0])), max(reach[1], float(points[-1]))
    moved = [float(f"{low:.4g}") if low < points[0] else low, *map(float, points[1:-1]), high]
    moved[-1] = float(f"{high:.4g}") if high > points[-1] else high
    keys: Keys = ("parameters", name, DIRECTIONS[direction])
    if axis.breakpoints and isinstance(axis.breakpoints, tuple):
        changes: tuple[tuple[Keys, Any], ...] = (((*keys, "breakpoints"), moved),)
    else:
        changes = (((*keys, "begin"), moved[0]), ((*keys, "end"), moved[-1]))
    return [Fix(f"Extend it to {moved[0]:g} … {moved[-1]:g}", changes)]


def _count(tally: list[float], x: Float, table: Parameter, axis: int) -> None:
    points = table.axes[axis].breakpoints
    known = x[np.isfinite(x)]
    if known.size:
        slack = AXIS_TOLERANCE * (points[-1] - points[0])
        tally[0] += int(np.count_nonzero((known < points[0] - slack) | (known > points[-1] + slack)))
        tally[1] += known.size
        tally[2], tally[3] = min(tally[2], float(known.min())), max(tally[3], float(known.max()))


def _idle(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield criteria that no free parameter affects, and free parameters that affect no criterion."""
    graph, free = problem.graph, set(problem.free_names)
    moving = dependents(graph, lambda node: node.parameter in free)
    ends = [graph.names[difference(i)] for i in range(len(problem.criteria))]
    for entry, at in zip(file.criteria, ends, strict=True):
        if at not in moving:
            yield entry.location, f"no free parameter affects {entry.node}", "Is it the right node?"
    for name in problem.unscored_names:
        kept = " and keeps its initial value" if _keeps_start(problem, name) else ""
        message = f"{name} affects no criterion with a weight{kept}"
        fixes = [Fix(f"Fix {name}", ((("parameters", name, "free"), False),))]
        yield file.location("calibration", "free"), message, "", fixes


def _locked(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield that nothing can be fitted, if all values are locked, as tables of literals in a Simulink model are."""
    names = problem.free_names
    if names and not problem.free_axes and all(problem.parameters[name].locked.all() for name in names):
        message = f"no value can be fitted: {join_names(names, MAX_NAMES)} {'is' if len(names) == 1 else 'are'} locked"
        unlocked = next((name for name in names if name not in file.parameters), None)
        remedy = "Remove lock." if unlocked is None else f"A section [parameters.{quoted(unlocked)}] unlocks a table."
        yield file.location("calibration", "free"), message, remedy


def _keeps_start(problem: Problem, name: str) -> bool:
    """Return if nothing moves a parameter that the data do not: no smoothness, no limit that names it, no rounding."""
    table = problem.parameters[name]
    smooth = any(problem.factors(name)) or any(problem.automatic(name))
    outside = np.any((table.values < table.lower) | (table.values > table.upper))
    named = {pin.parameter for pin in problem.pins}
    for constraint in problem.constraints:
        named |= {constraint.parameter} if isinstance(constraint, Shape) else {t.parameter for t in constraint.terms}
    return not (smooth or outside or name in named or problem.limits or problem.rounding)


def _unread_class(file: ProjectFile) -> Iterator[_Warning]:
    """Yield the output as a file of ASCET or CANape if none was read that the values can be written into."""
    read = (file.model.file, *file.calibration.files)
    if ".esdl" in file.calibration.output and not any(name.lower().endswith(".esdl") for name in read):
        message = "esdl requires one ESDL class as the function or among the initial files"
        yield file.location("calibration", "output"), message, "Write another format."
    if ".par" in file.calibration.output and not any(name.lower().endswith(".par") for name in read[1:]):
        message = "par requires a parameter file of CANape among the initial files"
        yield file.location("calibration", "output"), message, "Write another format."
    for ending in (".axl", ".amd"):
        if ending in file.calibration.output and not any(name.lower().endswith(ending) for name in read):
            message = f"{ending[1:]} requires such a file as the function or among the initial files"
            yield file.location("calibration", "output"), message, "Write another format."


def _unwritten_simulation(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield formats of the simulation that a calibration in partitions does not write."""
    simulations = [ending for ending in file.calibration.results if ending in SIMULATIONS]
    if simulations and problem.partitions is not None:
        message = "the simulation of data in partitions is not among the results"
        remedy = "`kennfeld simulate -o simulation.mf4` writes it."
        yield file.location("calibration", "results"), message, remedy


def _names(file: ProjectFile, problem: Problem) -> Iterator[_Warning]:
    """Yield parameters whose name a format of the results cannot represent."""
    odd = [name for name in problem.graph.parameters if not _WORD.match(name) and name in problem.parameters]
    alone = ParameterSet(problem.parameters[name] for name in odd)
    for ending in file.calibration.output if odd else ():
        if ending in _OF_SETS:
            continue
        unsupported = unwritable(alone, ending)
        if unsupported:
            names = join_names(list(unsupported), MAX_NAMES)
            message = f"{ending[1:]} cannot hold {names}: {next(iter(unsupported.values())).message}"
            yield file.location("calibration", "output"), message, "parameters.json holds every parameter."
