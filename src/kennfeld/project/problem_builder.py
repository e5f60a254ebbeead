"""Builds the problem of a project from all files it names. Problems are collected, not raised."""

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, Fix, InputError, Keys, Location
from kennfeld.base.formatting import join_names, most_similar, nearest, toml_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Limit
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.external_function import CodeNotRunError
from kennfeld.models import ambiguity, ambiguous_names, bind_scalars, merge_start_values
from kennfeld.optimize.limits.projection import infeasible
from kennfeld.optimize.problem.limit_nodes import channels_of
from kennfeld.optimize.problem.options import Step
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.unit_conflicts import wanted_units
from kennfeld.optimize.problem.validation import (
    check_limits,
    delay_findings,
    have_targets,
    matrix_findings,
    step_findings,
    trajectory_findings,
)
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.calculated import Calculated, parse_calculated
from kennfeld.preprocessing.pipeline import LoadedData, Loader, load_datasets
from kennfeld.preprocessing.recordings import INPUT, ChannelRequest
from kennfeld.project.axes import Axes, axis_location, check_free_axes
from kennfeld.project.checks import check_method, check_settling, check_weights, weight_channels
from kennfeld.project.criteria_builder import Constraints, build_constraints, build_criteria
from kennfeld.project.initial_calibration import read_initial
from kennfeld.project.model import (
    ProjectModel,
    axis_count_finding,
    call_remedy,
    defines_values,
    find_undefined,
    initial_level,
    read_function,
    read_surrogates,
    undefined_names,
)
from kennfeld.project.parameter_tables import Tables, build_tables
from kennfeld.project.partitioned_loading import PartitionedLoading
from kennfeld.project.recording_parameters import (
    check_recording_parameters,
    names_per_recording,
    with_values_per_recording,
)
from kennfeld.project.schema import ProjectFile
from kennfeld.project.simulation_files import SIMULATIONS, require_simulation_format
from kennfeld.project.steps import build_steps, uncovered_values
from kennfeld.project.storage_rounding import add_rounding

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate


MAX_REMARKS = 6  # on a model's import


@dataclass(frozen=True, eq=False)
class ProjectProblem:
    """The problem of a project, None if a finding is an error, and how long reading took."""

    findings: tuple[Finding, ...]
    problem: Problem | None
    seconds: float
    locations: dict[str, Location]  # of the datasets, by name
    steps: tuple[Step, ...] = ()


def assemble(file: ProjectFile, load: Loader = load_datasets, further: Sequence[str] = ()) -> ProjectProblem:
    """Read all files that a project file names and build the problem.

    Args:
        file: the project file.
        load: reads the recordings.
        further: channels that are read as well, if recordings have them.
    """
    began = time.perf_counter()
    builder = ProblemBuilder(file, load, further)
    problem, steps = None, tuple[Step, ...]()
    try:
        problem = builder.problem()
        if problem is not None:
            steps = build_steps(file, problem, builder.findings)
    except InputError as error:
        builder.findings.add(*error.findings)
    except ArgumentError as error:
        builder.findings.error(Location(file.path.name), str(error))
    findings, locations = tuple(dict.fromkeys(builder.findings)), dict(builder.loaded.locations)
    valid = None if builder.findings.has_errors else problem
    return ProjectProblem(findings, valid, time.perf_counter() - began, locations, steps)


def failed(findings: Sequence[Finding]) -> ProjectProblem:
    """Return a problem whose files cannot be read at all."""
    return ProjectProblem(tuple(findings), None, 0.0, {})


class ProblemBuilder:
    """Builds a problem from a project file, adding to `findings`."""

    def __init__(self, file: ProjectFile, load: Loader = load_datasets, further: Sequence[str] = ()) -> None:
        self._load, self._further = load, further
        self.file = file
        self.findings = Findings()
        self.loaded = LoadedData()
        self.function: ProjectModel | None = None
        self.known: list[str] = []  # names of parameters
        self.undefined: list[str] = []
        self.surrogates: tuple[Surrogate, ...] = ()

    def _without_texts_of(self, values: ParameterSet, initial: ParameterSet) -> ParameterSet:
        """Return initial values without the texts that are numbers in the function, such as labels of enumerations."""
        names = [text.name for text in initial.texts if text.name in values]
        if not names:
            return initial
        message = f"{join_names(names)}: numbers in the function, but texts in a file; the numbers are used"
        location = self.file.location("calibration", "initial")
        self.findings.add(Finding(location, message, severity="warning"))
        texts = [text for text in initial.texts if text.name not in values]
        return ParameterSet(initial.parameters, texts, initial.axes, initial.others, origin=initial.origin)

    def _check_results(self) -> None:
        """Report formats of the simulation whose package is missing, before a search rather than after it."""
        for ending in (each for each in self.file.calibration.results if each in SIMULATIONS):
            try:
                require_simulation_format(Path(f"simulation{ending}"))
            except InputError as error:
                location = self.file.location("calibration", "results")
                self.findings.add(*(replace(finding, location=location) for finding in error.findings))

    def problem(self) -> Problem | None:
        """Build the problem; return None if a finding is an error."""
        file, findings = self.file, self.findings
        # first of all: a package that is missing would be noticed after hours of search
        self._check_results()
        calculated = parse_calculated(file)
        self.surrogates = read_surrogates(file, findings)
        initial = self._with_surrogates(read_initial(file, findings))
        # in formula text, a name that is neither a node nor one of these is an input
        known = [*(initial or ()), *file.parameters]
        self.function = self._function(known, initial)
        if initial is not None and self.function is not None and self.function.model.values:
            values = self.function.model.values
            origin = values.origin if initial.origin is None else initial.origin
            # the initial files override the values that the function itself has
            initial = merge_start_values(values, self._without_texts_of(values, initial)).from_origin(origin)
        self.loaded = self._load(file, self._request(calculated, known_all=initial is not None), calculated)
        # after the data: an undefined name that is a channel of theirs is a missing declaration
        self._report_undefined()
        self._report_ambiguous(initial or ParameterSet())
        findings.add(*calculated.findings, *self.loaded.findings)
        # quantiles of a part of the data would be wrong breakpoints
        whole = self.loaded.datasets if self.loaded.complete and self.loaded.datasets else None
        partitioned = self._load if isinstance(self._load, PartitionedLoading) else None
        quantiles = None if partitioned is None else partitioned.quantiles
        axes = Axes(file, self.function, whole, initial or ParameterSet(), findings, quantiles)
        # without all values it is unknown what a section overrides, and false errors would follow
        unknown = initial is None or (self.function is None and defines_values(file))
        tables = None if initial is None or unknown else build_tables(file, initial, axes, self.function, findings)
        criteria = build_criteria(file, self.function, self.loaded, findings)
        self._check_group_axes(initial or ParameterSet())
        self._check_datasets()
        self._check_shifts()
        if tables is not None and self.function is not None:
            self._check_tables(tables, self.function)
        constraints = Constraints()
        if tables is not None:
            constraints = build_constraints(file, tables, self.function, findings)
        if findings.has_errors or tables is None or self.function is None:
            return None
        problem = self._problem(self.function, tables, criteria, constraints)
        problem = add_rounding(file, problem, tables.parameters.origin, findings)
        if partitioned is not None:
            problem = replace(problem, partitions=partitioned.partitions(problem))
        findings.add(*check_free_axes(file, problem))
        findings.add(*delay_findings(problem.model, problem.free_size))
        findings.add(*matrix_findings(file.location("calibration", "free"), problem.free_size))
        findings.add(*trajectory_findings(problem, partial(axis_location, file)))
        weights = check_weights(file, problem, self.loaded)
        if not any(finding.severity == "error" for finding in weights):  # samples of weight 0 have no target
            self._check_samples(problem)
        self._check_limits(problem)
        findings.add(*check_method(file, problem), *weights)
        return None if findings.has_errors else self._feasible(self._lock_uncovered(problem, tables))

    def _with_surrogates(self, initial: ParameterSet | None) -> ParameterSet | None:
        """Add the expansions of the surrogates, which are never fitted, to the initial parameters."""
        for surrogate in self.surrogates:
            if surrogate.name in self.file.parameters or surrogate.name in (initial or ()):
                message = f"{surrogate.name} is also the name of a parameter"
                self.findings.error(self.file.location("surrogates", surrogate.name), message, "Rename the surrogate.")
        if initial is None or not self.surrogates:
            return initial
        from kennfeld.surrogate.surrogate_file import as_parameters

        return as_parameters(self.surrogates).merged(initial).from_origin(initial.origin)

    def _feasible(self, problem: Problem) -> Problem | None:
        """Return the problem, None if its constraints cannot be satisfied together."""
        findings = infeasible(problem)
        whole = Location(self.file.path.name)
        for finding in findings:
            self.findings.add(replace(finding, location=whole) if str(finding.location) == "constraints" else finding)
        return None if findings else problem

    def _problem(
        self, function: ProjectModel, tables: Tables, criteria: tuple[Criterion, ...], constraints: Constraints
    ) -> Problem:
        return Problem(
            model=bind_scalars(function.model, tables.parameters, self._recorded_inputs(function)),
            datasets=tuple(self.loaded.datasets),
            parameters=tables.parameters,
            criteria=criteria,
            free=tables.patterns,
            smoothness=tables.smoothness,
            pins=constraints.pins,
            channels=dict(self.file.channels),
            constraints=constraints.linear,
            limits=constraints.limits,
            unknown_shifts=dict(self.loaded.unknown_shifts),
        )

    def _function(self, known: list[str], initial: ParameterSet | None) -> ProjectModel | None:
        """Read the function. Undefined parameters are reported only if all initial files could be read."""
        if len(self.surrogates) < len(self.file.surrogates):
            return None  # calls of missing surrogates would be false errors
        function = read_function(self.file, known, self.surrogates, self.findings, initial)
        if function is None:
            return None
        self.findings.add(*check_recording_parameters(self.file, function))
        function = with_values_per_recording(function, names_per_recording(self.file))
        for surrogate in self.surrogates:
            if surrogate.name not in function.graph.parameters:
                keys = ("surrogates", surrogate.name)
                fixes = [Fix.remove(keys)]
                self.findings.warning(self.file.location(*keys), "the function does not call it", fixes=fixes)
        known = [*known, *function.model.values]
        if initial is not None:
            self.known, self.undefined = known, undefined_names(function, known)
        for name in self.file.parameters:
            if name not in function.graph.parameters:
                self._report_unused(name, function, known)
        self._add_remarks(function.model.remarks)
        inputs = function.graph.inputs
        for name in self.file.channels:
            if name not in inputs:
                remedy = nearest(name, inputs) or f"Its inputs are {', '.join(inputs[:12])}."
                keys, similar = ("channels", name), most_similar(name, inputs)
                is_free = bool(similar) and similar not in self.file.channels
                fixes = [Fix.rename(keys, similar, self.file.channels[name])] if is_free else []
                fixes.append(Fix.remove(keys))
                self.findings.error(self.file.location(*keys), f"unknown input {name}", remedy, fixes=fixes)
        return function

    def _recorded_inputs(self, function: ProjectModel) -> set[str]:
        channels = {name for data in self.loaded.datasets for name in data}
        return {name for name in function.graph.inputs if self.file.channels.get(name, name) in channels}

    def _report_ambiguous(self, initial: ParameterSet) -> None:
        """Report names that are parameters because of the initial values, but channels of the data as well."""
        if self.function is None:
            return
        model, unstated = self.function.model, initial.without(self.file.parameters)
        for data in self.loaded.datasets:
            for name in ambiguous_names(model, unstated, data):
                self.findings.add(ambiguity(model, name, "the initial values", f"dataset {data.name}"))

    def _report_undefined(self) -> None:
        """Report undefined names, those of channels of the data as undeclared inputs."""
        if self.function is not None and self.undefined:
            channels = {name for name in self.undefined if any(name in data for data in self.loaded.datasets)}
            self.findings.add(*find_undefined(self.function, self.known, channels))

    def _report_unused(self, name: str, function: ProjectModel, known: list[str]) -> None:
        """Report the section of a parameter that the function does not use."""
        path, entry = ("parameters", name), self.file.parameters[name]
        fixes = [Fix.remove(path)]
        called = call_remedy(name) if entry.axes else ""
        if not defines_values(self.file):
            remedy = called or nearest(name, [n for n in function.graph.parameters if n not in known])
            self.findings.warning(self.file.location(*path), f"the function does not use {name}", remedy, fixes)
        elif ":" in name and entry.initial is not None:
            message = "the block requires this field to be constant; it has the value given here and is not fitted"
            self.findings.remark(self.file.location(*path), message)
        elif entry.initial is not None or entry.axes:  # otherwise the missing value is reported
            remedy = called or nearest(name, function.graph.parameters)
            self.findings.warning(self.file.location(*path), f"the function does not use {name}", remedy, fixes)

    def _add_remarks(self, remarks: Sequence[Finding]) -> None:
        """Add the first remarks on deviations of the imported model."""
        more = [f"and {len(remarks) - MAX_REMARKS} more; see kennfeld info"] if len(remarks) > MAX_REMARKS else []
        location = self.file.location("model", "file")
        for remark in (*remarks[:MAX_REMARKS], *more):
            self.findings.remark(location, str(remark))

    def _request(self, calculated: Calculated, *, known_all: bool) -> ChannelRequest:
        """Return the channels to read. If parameters are unknown, an input may be a scalar and its channel missing."""
        file, function = self.file, self.function
        inputs = function.graph.inputs if function else ()
        # reversed: of several inputs with one channel, the message names the first
        needed = {file.channels.get(name, name): f"{INPUT}{name} of the function" for name in reversed(inputs)}
        axes = [*file.axes.values(), *(axis for entry in file.parameters.values() for axis in entry.axes.values())]
        nodes = {*inputs, *(function.graph.names if function else ())}
        quantiles = {a.input: f"the input of {a.location}" for a in axes if a.quantiles and a.input and function}
        targets = {
            entry.target.name: f"the target of {entry.location}"
            for entry in file.criteria
            if entry.target.kind in ("channel", "name")
        }
        if function is not None:
            limits = [Limit(entry.node, entry.lower, entry.upper, entry.where) for entry in file.limits]
            targets |= {file.channels.get(n, n): "a limit" for n in channels_of(function.model, limits)}
        regions = weight_channels(file)
        optional = {**regions, **targets}
        optional = dict.fromkeys(self._undeclared(), "an input that the function does not declare") | optional
        optional |= {name: why for name, why in quantiles.items() if name not in nodes}
        optional |= dict.fromkeys(self._further, "a channel that may be missing in the function")
        self._check_calculated(calculated, [*needed, *optional])
        if not known_all:
            optional, needed = {**needed, **optional}, {}
        complete = function is not None
        return ChannelRequest(
            needed,
            optional,
            frozenset(needed),
            self._units(),
            frozenset(regions),
            self._places_of_channels(inputs),
            self._step(),
            complete,
            names_are_open=not defines_values(file),
        )

    def _places_of_channels(self, inputs: Sequence[str]) -> dict[str, tuple[Keys, ...]]:
        """Return the keys that name each channel for an input of the function or for a target."""
        places: dict[str, tuple[Keys, ...]] = {}
        for name in inputs:
            channel = self.file.channels.get(name, name)
            places[channel] = (*places.get(channel, ()), ("channels", name))
        for entry in self.file.criteria:
            keys = (*entry.location.keys, "target")
            if entry.target.kind in ("channel", "name"):
                own = (*keys, "channel") if entry.target.kind == "channel" else keys
                places[entry.target.name] = (*places.get(entry.target.name, ()), own)
        return places

    def _undeclared(self) -> list[str]:
        """Return the names without coordinates that may be inputs, although they are parameters or undefined."""
        if self.function is None:
            return []
        axes, undeclared = self.function.graph.parameters, self.function.model.undeclared
        undefined = [name for name in self.undefined if not axes[name]]
        # a section of the project says that a name is a parameter
        stated = {*undefined, *self.file.parameters}
        return [*undefined, *(name for name in axes if name in undeclared and name not in stated)]

    def _units(self) -> dict[str, tuple[str, str]]:
        """Return the units of channels in the function."""
        if self.function is None:
            return {}
        targets = ((e.node, e.target.name) for e in self.file.criteria if e.target.kind in ("channel", "name"))
        return wanted_units(self.function.graph, self.file.channels, targets)

    def _check_calculated(self, calculated: Calculated, names: list[str]) -> None:
        """Warn of unused calculated channels."""
        # a search in the text is enough to keep a needless warning away
        conditions = " ".join(f"{entry.where} {entry.weight_channel}" for entry in self.file.datasets)
        conditions += " ".join(["", *(part.channel for entry in self.file.datasets for part in entry.steady)])
        if self.function is None:
            return
        used = {*calculated.needed(names), *calculated.broken}
        for name in calculated.graphs:
            if (
                name not in used
                and name not in conditions
                and not any(name in graph.inputs for graph in calculated.graphs.values())
            ):
                fixes = [Fix.remove(("calculated", name))]
                self.findings.warning(self.file.location("calculated", name), "unused channel", fixes=fixes)

    def _step(self) -> float | None:
        """Return the model's step in s, None if its result does not depend on it."""
        if self.function is None or not self.function.graph.is_timed:
            return None
        return self.file.model.step or self.function.model.step

    def _check_datasets(self) -> None:
        entries = self.file.datasets
        if entries and not any(entry.is_fitted for entry in entries):
            remedy = 'Write use = "training" and a weight > 0 in one of them.'
            fixes = [
                Fix(
                    f"Fit {entry.name or entry.files[0]}",
                    # by its own keys: entries that are off count, too
                    (((*entry.location.keys, "use"), None), ((*entry.location.keys, "weight"), None)),
                )
                for entry in entries[:3]
                if entry.files
            ]
            self.findings.error(self.file.location("dataset"), "no dataset is used for training", remedy, fixes=fixes)
        if self.function is None:
            return
        self.findings.add(*check_settling(self.function.graph, self.loaded))
        locations = self.loaded.locations
        own_step = step_findings(self.function.model, self.loaded.datasets, self._step(), lambda d: locations[d.name])
        self.findings.add(*own_step)
        if not self.function.graph.clocks:
            return
        for data in self.loaded.datasets:
            if data.time is None and data.settling is None:
                message = f"the function requires time steps, but dataset {data.name} has no time stamps"
                remedy = "Name the time channel `time`, or write settle = ... if these are steady-state points."
                self.findings.error(self.loaded.locations[data.name], message, remedy)

    def _check_group_axes(self, initial: ParameterSet) -> None:
        """Warn of group axes that no table names."""
        axes = [axis for entry in self.file.parameters.values() for axis in entry.axes.values()]
        own = {axis.name for axis in initial.axes}
        for name, section in self.file.axes.items():
            # a step alone applies to an axis of the initial files as it is
            applies = name in own and section.inherits and not section.is_free
            if not applies and not any(axis.group == name for axis in axes):
                remedy = f"Write x = {{ axis = {toml_text(name)} }} under [parameters.NAME] of each table on it."
                message, fixes = "no table of this file uses the axis", [Fix.remove(("axes", name))]
                self.findings.warning(self.file.location("axes", name), message, remedy, fixes)

    def _check_shifts(self) -> None:
        """Report shifts that cannot be estimated."""
        step, sought = self._step(), self.loaded.unknown_shifts
        training = {n for d in self.loaded.datasets if d.use == "training" for n in sought.get(d.name, ())}
        for data in self.loaded.datasets:
            location = self.loaded.locations[data.name].within("shift")
            entry_keys = location.keys
            for channel in sought.get(data.name, ()):
                if channel not in training:
                    message = f'shift = "auto" for {channel} must be set on a training dataset'
                    fixes = [Fix.remove((*entry_keys, "shift", channel))]
                    remedy = 'Write "auto" in a training dataset too, or a number here.'
                    self.findings.error(location, message, remedy, fixes=fixes)
            if sought.get(data.name) and data.scored is not None and step is not None and data.time is not None:
                own = [entry.raster for entry in self.file.datasets if entry.raster]
                # samples of a finer step lie between the scored ones, whose targets are not known there
                if np.median(np.diff(data.time)) < 0.999 * np.median(np.diff(data.time[data.scored])) and not own:
                    message = f"no shift can be estimated: the model's step of {step:g} s is below that of the data"
                    fixes = [Fix.set((*entry_keys, "raster"), step)]
                    self.findings.error(location, message, f"Write raster = {step:g}, or a number.", fixes=fixes)

    def _check_tables(self, tables: Tables, function: ProjectModel) -> None:
        """Report wrong numbers of axes, missing values, and if nothing is free."""
        for name, count in function.graph.parameters.items():
            if name not in tables.parameters:
                continue
            parameter = tables.parameters[name]
            has = parameter.coordinates
            if has != count:
                self.findings.add(axis_count_finding(function, name, parameter.kind, has))
            missing = np.argwhere(~np.isfinite(parameter.values))
            if missing.size:
                at = ", ".join(str(int(i) + 1) for i in missing[0])
                message = f"{len(missing)} of {parameter.size} initial values of {name} are not finite"
                where = f", the first at {at}" if at else ""
                remedy = "Complete the file, or write initial = ... in its section."
                level = initial_level(function.graph, name)
                fixes = [Fix.set(("parameters", name, "initial"), level)]
                location = self.file.location("parameters", name, "initial")
                self.findings.error(location, message + where, remedy, fixes=fixes)
        if not tables.free and any(name in tables.parameters for name in function.graph.parameters):
            self.findings.error(
                self.file.location("calibration", "free"),
                "no parameter of the function is free",
                'Write free = ["*"] in [calibration].',
                fixes=[Fix("Free all", ((("calibration", "free"), ["*"]),))],
            )

    def _check_limits(self, problem: Problem) -> None:
        """Report invalid output limits."""
        for finding in check_limits(problem) if problem.limits else ():
            location = Location(self.file.path.name, path=f"[[{finding.location}]]")
            self.findings.add(replace(finding, location=location))

    def _check_samples(self, problem: Problem) -> None:
        """Report datasets without complete samples, and criteria without a target value."""
        for bound in problem.training:
            if not bound.count:
                location = self.loaded.locations[bound.dataset.name]
                message = f"no sample of dataset {bound.dataset.name} has all inputs: {_missing_shares(problem, bound)}"
                self.findings.error(location, message, "Check these channels, or max_gap.")
        if not any(bound.count for bound in problem.training):
            return
        for entry, known in zip(self.file.criteria, have_targets(problem), strict=True):
            if not known:
                message = f"no training sample has a target for {entry.node}"
                remedy = "Check its target channel and the conditions of the datasets."
                self.findings.error(entry.location, message, remedy)

    def _lock_uncovered(self, problem: Problem, tables: Tables) -> Problem:
        """Lock the values that no training sample touches, of parameters with lock = "no-data"."""
        names = [name for name in tables.locked_without_data if name in problem.model.graph.parameters]
        if not names:
            return problem
        try:
            uncovered = uncovered_values(problem, names)
        except CodeNotRunError as error:
            for refusal in error.findings:
                message = f'lock = "no-data" has no effect, because code of {refusal.location} was not run'
                self.findings.remark(self.file.location("parameters", names[0], "lock"), message)
            return problem
        changed = [problem.parameters[name].changed(locked=mask) for name, mask in uncovered.items()]
        return replace(problem, parameters=problem.parameters.with_parameters(*changed))


def _missing_shares(problem: Problem, bound: BoundDataset) -> str:
    """Return the input channels with most missing samples, and their shares."""
    shares = {}
    for name in problem.model.graph.inputs:
        channel = problem.channels.get(name, name)
        shares[channel] = float(np.mean(~np.isfinite(bound.dataset[channel].values)))
    worst = sorted((c for c in shares if shares[c] > 0), key=lambda c: -shares[c])[:3]
    return ", ".join(f"{name} is missing in {shares[name]:.0%}" for name in worst) or "the data are empty"
