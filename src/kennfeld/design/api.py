"""`design`: what to measure next, from a project, from a result, or from nothing."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location, warn
from kennfeld.base.formatting import count_noun, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.bench_order import arrange
from kennfeld.design.coverage import never
from kennfeld.design.design_result import Design, Watch
from kennfeld.design.doubts import doubts
from kennfeld.design.filling_design import fill_region, plan_manoeuvres
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.limits_of_design import beyond_axes, measured_inputs, region_of
from kennfeld.design.measured_kinds import MeasuredKind, kind_of, measured_kinds
from kennfeld.design.point_design import design_points
from kennfeld.design.project_data import ProjectData, has_recordings
from kennfeld.design.region import BenchRegion
from kennfeld.design.segment_design import design_segments, reduce_recordings
from kennfeld.design.space_filling import fill
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Progress, Result
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.unit_conflicts import convert_units, wanted_units
from kennfeld.preprocessing.coercion import Data, to_dataset
from kennfeld.project import Project
from kennfeld.project.design_table import DesignEntry
from kennfeld.project.forms import form_of, keys_of
from kennfeld.project.section import KeyLocation, Section

POINTS, SEGMENTS = 20, 15  # of a design that states no number
_WEIGHTS = "\0weights"
CANDIDATES = 1000  # points of the region among which those by the fit are chosen
PLACE = Location("design")


@dataclass(frozen=True)
class Request:
    """The question that a design answers, see `design`."""

    n: int | None = None
    segments: int | None = None
    reduce: bool = False
    keep: int | None = None
    names: tuple[str, ...] = ()
    direction: int | None = None

    def check(self) -> None:
        """Raise `InputError` for requests that contradict each other."""
        findings = Findings()
        kinds = [self.n is not None, self.segments is not None, self.reduce]
        if sum(kinds) > 1:
            findings.error(PLACE, "points (n), segments and reduce exclude each other", "Ask for one of them.")
        for name, value in (("n", self.n), ("segments", self.segments), ("keep", self.keep)):
            if value is not None and not _is_count(value):
                findings.error(Location(name), f"must be an integer >= 1, got {value!r}")
        if self.keep is not None and not self.reduce:
            findings.error(Location("keep"), "keep requires reduce", "Add --reduce.")
        if self.names and self.direction is not None:
            findings.error(PLACE, "a design is for named parameters or for a direction", "State one of them.")
        if (self.names or self.direction is not None) and (self.reduce or self.segments):
            findings.error(PLACE, "segments are chosen for the whole function", "Ask for points with n.")
        findings.finish()


def _is_count(value: Any) -> bool:
    return isinstance(value, Integral | np.integer) and int(value) >= 1


def design(
    fit: Project | Result | None = None,
    *,
    n: int | None = None,
    segments: int | None = None,
    reduce: bool = False,
    keep: int | None = None,
    candidates: Data | Sequence[Data] | Sequence[str] = (),
    use: Data | Parameter | Sequence[Data | Parameter] | Sequence[str] = (),
    names: Sequence[str] = (),
    direction: int | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Design:
    """Find out what to measure next.

    Args:
        fit: a project, which is calibrated first; a result of this process; or None for a design that needs no fit.
        n: number of steady points; by default 20 for data without time stamps.
        segments: number of pieces of the candidates to drive; by default 15 for recordings.
        reduce: find the recordings of the training data that add nothing.
        keep: number of recordings that `reduce` keeps.
        candidates: recordings or points to choose from: datasets, or for a project also paths and patterns. By default
            points are chosen from the ranges.
        use: the operation that matters, like `candidates`; by default training and test data. Without a project also
            maps of weights over channels, whose grid points count by their values, and datasets with `weight_channel`.
        names: patterns of the parameters that points should determine.
        direction: number of the direction of `result.trust` that points should determine, from 1.
        progress: called after each accepted step of the fit.
        settings: keys of `[design]`, which override those of the project: ranges, where, forbidden, curves, envelope,
            slew, wait, hard, method, model, centres, blocks, replicates, repeat, length, warmup, manoeuvres,
            max_seconds, seed.

    Returns:
        Points in the order of the bench, segments, or recordings to drop, with the deviation of each value before and
        as predicted.

    Raises:
        InputError: the project has errors, the limits leave no room, or candidates cannot be used.
        ArgumentError: an unknown setting.

    >>> made = design(n=30, ranges={"speed": (800, 6000), "load": (10, 100)}, where=["load < speed / 40"])
    >>> len(made.points), all(point["load"] < point["speed"] / 40 for point in made.points)
    (30, True)
    """
    request = Request(n, segments, reduce, keep, tuple(names), direction)
    request.check()
    proposal = _design(fit, request, candidates, use, progress, settings)
    warn(finding for finding in proposal.findings if finding.severity == "warning")
    return proposal


def _design(
    fit: Project | Result | None,
    request: Request,
    candidates: Any,
    use: Any,
    progress: Progress | None,
    settings: Mapping[str, Any],
) -> Design:
    if isinstance(fit, Project):
        return design_project(fit, request, _texts(candidates), _texts(use), progress, settings)
    entry = with_settings(DesignEntry(), settings)
    if fit is None:
        if request.reduce or request.segments or request.names or request.direction is not None:
            raise InputError.of(PLACE, "this design requires a fit", "Give a project or a result.")
        region = region_of(entry, PLACE)
        supplied = _datasets(candidates, "candidates", None)
        return _without_fit(entry, region, request, supplied)
    fitted = FittedFunction.of(fit)
    problem = fitted.problem
    supplied = _datasets(candidates, "candidates", problem)
    return _around(fitted, entry, request, supplied, _datasets(use, "use", problem), PLACE)


@dataclass(frozen=True, eq=False)
class ProjectDesign:
    """The design of a project, with what it was made from.

    Attributes:
        design: the design.
        fitted: the fit; None for a design without one.
        candidates: recordings, points or planned manoeuvres that were chosen from.
    """

    design: Design
    fitted: FittedFunction | None = None
    candidates: tuple[Dataset, ...] = ()


def design_project(
    project: Project,
    request: Request,
    candidates: Sequence[str] = (),
    use: Sequence[str] = (),
    progress: Progress | None = None,
    settings: Mapping[str, Any] | None = None,
    watch: Watch = never,
) -> Design:
    """Return the design of a project; see `design`. Warnings are among its findings.

    A search that `watch` ends returns what it has chosen so far, and says so.
    """
    return made_design(project, request, candidates, use, progress, settings, watch=watch).design


def made_design(
    project: Project,
    request: Request,
    candidates: Sequence[str] = (),
    use: Sequence[str] = (),
    progress: Progress | None = None,
    settings: Mapping[str, Any] | None = None,
    values: ParameterSet | None = None,
    *,
    near: bool = False,
    watch: Watch = never,
) -> ProjectDesign:
    """Return the design of a project with its fit; see `ProjectData.fit` for the values that this begins from.

    `watch` is asked during the choice, not during the fit.
    """
    request.check()
    entry = with_settings(project.file.design, settings or {})
    place = project.file.location("design")
    needs_fit = request.reduce or request.segments is not None or bool(request.names) or request.direction is not None
    if not needs_fit and entry.manoeuvres and request.n is None:
        return ProjectDesign(plan_manoeuvres(entry, _project_region(project, entry, place)))
    if not needs_fit and (entry.method != "auto" or not has_recordings(project)):
        data = ProjectData.of(project, candidates, ()) if candidates else None
        region = _project_region(project, entry, place)
        proposal = _without_fit(entry, region, request, data.candidates if data else ())
        if entry.method == "auto":
            message = "there are no recordings: the points fill the ranges, and are not chosen for the function"
            finding = Finding(place, message, "Measure them, then run kennfeld design again.", severity="warning")
            proposal = replace(proposal, findings=(finding, *proposal.findings))
        return ProjectDesign(proposal)
    data = ProjectData.of(project, candidates, [*use, *(() if use else entry.use)], entry.use_weight)
    planned = _planned(entry, data.problem, place) if request.segments is not None and entry.manoeuvres else []
    fitted, findings = data.fit(progress, values, near=near)
    offered = (*data.candidates, *planned)
    proposal = _around(fitted, entry, request, offered, data.use, place, [*data.findings, *findings], watch)
    return ProjectDesign(proposal, fitted, offered)


def _planned(entry: DesignEntry, problem: Problem, place: Location) -> list[Dataset]:
    """Return planned manoeuvres as candidates."""
    channels = _input_channels(problem)
    region = region_of(entry, place, measured_inputs(problem.fitted_datasets, channels), channels)
    tables = plan_manoeuvres(entry, region).tables
    return [Dataset.of(table.name, dict(table.columns), time=table.time) for table in tables]


def _around(
    fitted: FittedFunction,
    entry: DesignEntry,
    request: Request,
    candidates: Sequence[Dataset],
    use: Sequence[Dataset],
    place: Location,
    findings: Sequence[Finding] = (),
    watch: Watch = never,
) -> Design:
    """Return a design around a fit."""
    problem, watch = fitted.problem, _until(entry.max_seconds, watch)
    known = [*findings, *doubts(fitted)]
    # the weights of training data say how far they are trusted, not how often a sample occurs
    use = use or [replace(data, weight_channel="") for data in problem.datasets]
    if request.reduce:
        proposal = reduce_recordings(fitted, problem.fitted_datasets, use, request.keep, entry.seed, watch)
    elif request.segments is not None or (request.n is None and _drives(problem, request)):
        if not candidates:
            remedy = "Name recordings, or time tables of planned manoeuvres, with --from."
            raise InputError.of(place, "there is nothing to choose segments from", remedy)
        count = SEGMENTS if request.segments is None else request.segments
        proposal = design_segments(fitted, candidates, use, count, entry.length, entry.warmup, entry.seed, watch)
    else:
        proposal = _points_around(fitted, entry, request, candidates, use, place, watch)
    return replace(proposal, findings=(*known, *proposal.findings))


def _until(seconds: float | None, watch: Watch) -> Watch:
    """Return the same watch, which also ends a choice that has lasted so long from now on."""
    if seconds is None:
        return watch
    end = time.monotonic() + seconds
    return lambda made: watch(made) or time.monotonic() >= end


def _drives(problem: Problem, request: Request) -> bool:
    """Return True if the training data are recordings over time, and nothing asks for points."""
    asked = request.names or request.direction is not None
    return not asked and all(data.time is not None for data in problem.fitted_datasets)


def _points_around(
    fitted: FittedFunction,
    entry: DesignEntry,
    request: Request,
    candidates: Sequence[Dataset],
    use: Sequence[Dataset],
    place: Location,
    watch: Watch,
) -> Design:
    problem = fitted.problem
    channels = _input_channels(problem)
    kind = kind_of(measured_kinds(fitted), candidates)
    if problem.model.graph.states and kind.example.settling is None:
        message = "a function with memory has no steady points unless they settle"
        raise InputError.of(place, message, "Ask for segments, or write settle = ... in the dataset of the points.")
    findings: list[Finding] = []
    measured = measured_inputs([d for d in problem.fitted_datasets if _is_like(fitted, d, kind)], channels)
    region = region_of(entry, place, measured, channels)
    if candidates:
        columns = {name: np.concatenate([data[name].values for data in candidates]) for name in channels}
        columns = _inside(columns, region if _states_limits(entry) else None, problem, findings)
    else:
        columns = fill(region, CANDIDATES, "sobol", entry.seed)

    def arranged(proposal: Design, chosen: Int) -> Design:
        own = replace(proposal, findings=(*findings, *proposal.findings))
        return _arranged(own, columns, chosen, entry)

    proposal, chosen = design_points(
        fitted,
        columns,
        POINTS if request.n is None else request.n,
        use,
        kind=kind,
        names=request.names,
        direction=request.direction,
        seed=entry.seed,
        watch=lambda made: watch(lambda: arranged(*made())),
    )
    return arranged(proposal, chosen)


def _is_like(fitted: FittedFunction, data: Dataset, kind: MeasuredKind) -> bool:
    return any(own.example is data or own.criteria == kind.criteria for own in measured_kinds(fitted)) and all(
        criterion.target.kind == "number" or criterion.target.name in data or criterion.target.kind == "node"
        for criterion in kind.criteria
    )


def _states_limits(entry: DesignEntry) -> bool:
    return bool(entry.ranges or entry.where or entry.forbidden or entry.curves or entry.envelope)


def _inside(
    columns: dict[str, Float], region: BenchRegion | None, problem: Problem, findings: list[Finding]
) -> dict[str, Float]:
    """Return the candidates within the limits, and say how many lie outside of them or of the axes."""
    count = len(next(iter(columns.values())))
    if region is not None:
        region.require_room(columns, PLACE)
        inside = region.admits(columns)
        if not inside.all():
            message = f"{count_noun(int(np.sum(~inside)), 'candidate')} of {count} lie outside the limits of [design]"
            findings.append(Finding(PLACE, f"{message} and are left out", severity="remark"))
        columns = {name: values[inside] for name, values in columns.items()}
    beyond = beyond_axes(problem, columns)
    if beyond.any():
        message = f"{count_noun(int(beyond.sum()), 'candidate')} of {beyond.size} lie beyond the axes of a table"
        findings.append(Finding(PLACE, message, "Lookups clip there.", severity="warning"))
    return columns


def _without_fit(entry: DesignEntry, region: BenchRegion, request: Request, candidates: Sequence[Dataset]) -> Design:
    if entry.manoeuvres and request.n is None:
        return plan_manoeuvres(entry, region)
    count = POINTS if request.n is None else request.n
    supplied = None
    if candidates:
        supplied = {name: np.concatenate([data[name].values for data in candidates]) for name in region.ranges}
    proposal, columns = fill_region(entry, region, count, supplied)
    return _arranged(proposal, columns, np.arange(len(next(iter(columns.values())))), entry)


def _arranged(proposal: Design, columns: Mapping[str, Float], chosen: Int, entry: DesignEntry) -> Design:
    """Return the design with its points in the order of the bench."""
    run = arrange(
        {name: values[chosen] for name, values in columns.items()},
        hard=entry.hard,
        slew=entry.slew,
        blocks=entry.blocks,
        replicates=entry.replicates,
        repeat_every=entry.repeat,
        wait=entry.wait,
        seed=entry.seed,
    )
    points = tuple({name: float(values[k]) for name, values in run.columns.items()} for k in range(len(run.kind)))
    seconds = float(run.ramp.sum() + run.wait.sum())
    takes = (
        f"The bench takes {seconds:.0f} s: {run.ramp.sum():.0f} s of ramps and {run.wait.sum():.0f} s of waiting.",
    )
    return replace(proposal, points=points, run=run, sentences=(*proposal.sentences, *(takes if seconds > 0 else ())))


def _project_region(project: Project, entry: DesignEntry, place: Location) -> BenchRegion:
    """Return the region of a project without a fit; its data are read only if the ranges do not say all."""
    if entry.ranges and not entry.envelope:
        return region_of(entry, place)
    if not has_recordings(project):
        return region_of(entry, place)
    problem = project.problem()
    channels = _input_channels(problem)
    return region_of(entry, place, measured_inputs(problem.fitted_datasets, channels), channels)


def _input_channels(problem: Problem) -> list[str]:
    return list(dict.fromkeys(problem.channels.get(name, name) for name in problem.model.graph.inputs))


def with_settings(entry: DesignEntry, settings: Mapping[str, Any]) -> DesignEntry:
    """Return settings with some of them replaced, as Python or the command line state them.

    Raises:
        ArgumentError: an unknown name.
        InputError: values that cannot be used.
    """
    known = [part.name for part in fields(DesignEntry)]
    for name in settings:
        if name not in known:
            raise ArgumentError(f"unknown setting {name} of a design. {nearest(name, known)}".strip())
    stated = {name: _as_toml(value) for name, value in settings.items() if value is not None}
    section = Section(stated, KeyLocation("design"), Findings())
    forms = {name: form_of(part) for name, part in keys_of(DesignEntry).items() if name in settings}
    default = DesignEntry()  # None states the default
    changed: dict[str, Any] = {
        name: form.read(section, name) if name in stated else getattr(default, name) for name, form in forms.items()
    }
    section.findings.finish()
    return replace(entry, **changed)


def _as_toml(value: Any) -> Any:
    """Return a value of Python as a project file holds it, so that the same checks apply."""
    if is_dataclass(value) and not isinstance(value, type):
        return {part.name: _as_toml(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, Mapping):
        return {key: _as_toml(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [_as_toml(item) for item in value] if isinstance(value, list | tuple) else value


def _grid_of(weights: Parameter) -> Dataset:
    """Return the grid points of a table of weights as steady points.

    Raises:
        ArgumentError: an axis has no channel, or a weight is negative or not finite.
    """
    channels = [axis.input for axis in weights.axes]
    if not channels or not all(channels):
        raise ArgumentError(f"each axis of the weights {weights.name} requires a channel: Axis(..., input='Speed')")
    if not (np.isfinite(weights.values).all() and (weights.values >= 0).all() and weights.values.any()):
        raise ArgumentError(f"the weights {weights.name} must be finite and >= 0, and some must be > 0")
    grid = np.meshgrid(*(axis.breakpoints for axis in weights.axes), indexing="ij")
    # no channel of a user has this name
    columns = {name: each.ravel() for name, each in zip(channels, grid, strict=True)}
    return Dataset.of(weights.name, {**columns, _WEIGHTS: weights.values.ravel()}, weight_channel=_WEIGHTS)


def _texts(supplied: Any) -> tuple[str, ...]:
    items = [supplied] if isinstance(supplied, str) else list(supplied)
    for item in items:
        if not isinstance(item, str):
            raise ArgumentError(f"candidates of a project must be paths or patterns, got {type(item).__name__}")
    return tuple(items)


def _datasets(supplied: Any, name: str, problem: Problem | None) -> list[Dataset]:
    """Return data of Python as datasets with the channels that the function reads."""
    listed: list[Any] = [supplied] if isinstance(supplied, Mapping | Parameter) else list(supplied)
    items: list[Any] = [_grid_of(item) if isinstance(item, Parameter) else item for item in listed]
    if problem is None:
        return [item if isinstance(item, Dataset) else Dataset.of(name, item) for item in items]
    graph, asked = problem.model.graph, set(_input_channels(problem))
    asked |= {criterion.target.name for criterion in problem.criteria}
    asked |= {item.weight_channel for item in items if isinstance(item, Dataset)} - {""}
    own, located = problem.fitted_datasets, [to_dataset(item, name, graph, asked) for item in items]
    # in the units of the function, or else of the training data, in which points are chosen
    located = convert_units([*own, *located], wanted_units(graph, problem.channels))[len(own) :]
    missing = [
        Finding(Location(f"{name} {data.name}"), f"has no channel {channel}", nearest(channel, data))
        for data in located
        for channel in _input_channels(problem)
        if channel not in data
    ]
    if missing:
        raise InputError(missing)
    return located
