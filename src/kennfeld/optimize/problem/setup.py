"""The arguments of `calibrate`, and the problem that follows from them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location, warn, warn_deprecated
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset, Use
from kennfeld.domain.free_axes import axis_keys, with_free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.graph import Graph
from kennfeld.models import Model, ambiguity, ambiguous_names, bind_scalars, merge_start_values
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.arguments import (
    Bounds,
    Factors,
    Limits,
    ProblemArguments,
    Shift,
    Start,
    check_kinds,
    factors_by_axis,
    parameters_of,
    shift_of,
)
from kennfeld.optimize.problem.overlap import overlap_findings
from kennfeld.optimize.problem.problem import Factor, Problem
from kennfeld.optimize.problem.storage import rounding_of, with_rounding
from kennfeld.optimize.problem.unit_conflicts import convert_units, target_channels, unit_warnings, wanted_units
from kennfeld.optimize.problem.validation import check_problem, dataset_location
from kennfeld.preprocessing.coercion import Data, names_of, to_dataset
from kennfeld.preprocessing.model_step import clock_findings, refine_step
from kennfeld.preprocessing.time_shift import shift_channels


@dataclass(frozen=True, eq=False)
class ProblemSetup:
    """A problem as a user states it; see `calibrate` for the meaning of each argument."""

    model: Model | str
    data: Data | Sequence[Data]
    start: Start
    target: str | float | None = None
    node: str | None = None
    criteria: Sequence[Criterion] = ()
    test: Data | Sequence[Data] = ()
    free: Sequence[str] = ("*",)
    free_axes: Sequence[str] = ()
    smoothness: Factors = 0.0
    bounds: Mapping[str, Bounds] | None = None
    limits: Limits | None = None
    pins: Sequence[Pin] = ()
    constraints: Sequence[Shape | Equality] = ()
    channels: Mapping[str, str] | None = None
    shift: Shift | None = None
    rounding: RoundingMethod | None = None
    storage: str | Path | None = None
    step: Mapping[str, float] | None = None
    max_shift: float = MAX_SHIFT

    def problem(self) -> Problem:
        """Build and check the problem.

        Raises:
            InputError: the input cannot be used; lists all problems.
        """
        self._check_arguments()
        parameters, outputs = self._bounded_parameters()
        channels = self.channels or {}
        function = bound_model(self.model, parameters, [*_parts(self.data), *_parts(self.test)], channels)
        warn(unused_names(self.start, function))
        criteria = self._all_criteria(function)
        inputs = {channels.get(name, name) for name in function.graph.inputs}
        datasets = self._datasets(function.graph, {*inputs, *(criterion.target.name for criterion in criteria)})
        wanted = wanted_units(function.graph, channels, target_channels(criteria))
        datasets = convert_units(datasets, wanted)
        warn(unit_warnings(function.graph, datasets, parameters, channels, criteria))
        factors = _factors(self.smoothness, parameters)
        shifted, unknown = _shift_datasets(datasets, self.shift or {})
        problem = Problem(
            function,
            on_model_step(function, shifted, inputs, unknown),
            parameters,
            criteria,
            tuple(self.free),
            factors,
            tuple(self.pins),
            channels,
            tuple(self.constraints),
            outputs,
            unknown,
        )
        check_problem(problem).finish()
        warn(overlap_findings(problem, dataset_location))
        return self._rounded(problem)

    def _rounded(self, problem: Problem) -> Problem:
        """Return the problem with bounds and breakpoints that can be stored, if its end is rounded."""
        if self.rounding is None:
            if self.storage is not None or self.step:
                name = "step" if self.storage is None else "storage"
                raise ArgumentError(f'{name} requires rounding: add rounding="joint"')
            return problem
        axes = {str(key): key for key in axis_keys(problem.parameters) if str(key) not in problem.parameters}
        steps = dict(self.step or {})
        for name in steps:
            if name not in problem.parameters and name not in axes:
                remedy = nearest(name, [*problem.parameters, *axes])
                raise ArgumentError(f"step: unknown parameter or axis {name}. {remedy}".strip())
        of_axes = {axes[name]: steps.pop(name) for name in [*steps] if name in axes}
        rounding = rounding_of(self.rounding, self.storage, steps, self.max_shift, of_axes)
        rounded, findings = with_rounding(problem, rounding, Location)
        warn(finding for finding in Findings(findings).finish() if finding.severity == "warning")
        return rounded

    def _check_arguments(self) -> None:
        for name, patterns in (("free_axes", self.free_axes), ("free", self.free)):
            if isinstance(patterns, str):
                raise ArgumentError(f"{name}={patterns!r} must be a list of patterns: {name}=[{patterns!r}]")
        check_kinds(vars(self))
        if self.criteria and self.target is not None:
            remedy = f"add Criterion(node, {self.target!r}) to the criteria"
            raise ArgumentError(f"target={self.target!r} and criteria cannot be combined; {remedy}")
        if self.criteria and self.node is not None:
            raise ArgumentError(f"node={self.node!r} belongs to target; each of the criteria names its own node")

    def _bounded_parameters(self) -> tuple[ParameterSet, tuple[Limit, ...]]:
        """Return the start with free axes and bounds, and the limits of outputs."""
        unbounded = with_free_axes(start_parameters(self.start, self.model), self.free_axes)
        former, outputs = _split_limits(self.limits or {}, unbounded)
        bounds = {**former, **(self.bounds or {})}
        if unknown := [name for name in bounds if name not in unbounded]:
            raise ArgumentError(f"bounds: unknown parameter {unknown[0]}. {nearest(unknown[0], unbounded)}".strip())
        bounded = (unbounded[name].with_bounds(*pair) for name, pair in bounds.items())
        return unbounded.with_parameters(*bounded), outputs

    def _all_criteria(self, function: Model) -> tuple[Criterion, ...]:
        if self.target is None:
            return tuple(self.criteria)
        return (Criterion(_output(function, self.node), self.target),)

    def _datasets(self, graph: Graph, used: Collection[str]) -> list[Dataset]:
        """Return training and test data with the channels in use."""
        return [*_as_datasets(self.data, "training", graph, used), *_as_datasets(self.test, "test", graph, used)]


def problem_of(
    model: Model | str | Problem,
    data: Data | Sequence[Data] | None,
    start: Start | None,
    target: str | float | None,
    arguments: ProblemArguments,
    caller: str,
) -> Problem:
    """Return the problem of a call that takes one as its first argument, or all that states one.

    Raises:
        ArgumentError: it has both, or lacks data or start.
    """
    if not isinstance(model, Problem):
        for name, value in (("data", data), ("start", start)):
            if value is None:
                raise ArgumentError(f"{caller} requires {name}, unless its first argument is a problem")
        return ProblemSetup(model, data, start, target, **arguments).problem()  # type: ignore[arg-type]
    defaults: dict[str, Any] = {part.name: part.default for part in fields(ProblemSetup)}
    defaults |= {"data": None, "start": None}
    stated = {"data": data, "start": start, "target": target, **arguments}
    if others := [name for name, value in stated.items() if _is_stated(value, defaults[name])]:
        raise ArgumentError(f"{caller}(problem) takes no {join_names(others)}: the problem states them")
    return model


def _is_stated(value: Any, default: Any) -> bool:
    # data may be arrays, whose comparison is no truth value
    return value is not default and not (isinstance(value, float | int | tuple) and value == default)


def bound_model(
    model: Model | str, parameters: ParameterSet, data: Sequence[Data], channels: Mapping[str, str]
) -> Model:
    """Return the model for some data: names that the data hold as channels are inputs, not parameters.

    Raises:
        InputError: formula text uses names without declaring them that are parameters as well as channels.
    """
    function = model_of(model, parameters)
    recorded = [names_of(part) for part in data]
    for at, names in enumerate(recorded):
        if ambiguous := ambiguous_names(function, parameters, names):
            name = getattr(data[at], "name", "")
            place = f"dataset {name}" if isinstance(name, str) and name else "the data"
            raise InputError(ambiguity(function, each, "the start", place) for each in ambiguous)
    known = {name for names in recorded for name in names}
    inputs = {name for name in function.graph.inputs if channels.get(name, name) in known}
    return bind_scalars(function, parameters, inputs)


def unused_names(start: Start, model: Model) -> Iterator[Finding]:
    """Yield warnings for names of a dict that the model does not use; a set may be that of a whole control unit."""
    graph = model.graph
    for name in start if isinstance(start, Mapping) and not isinstance(start, ParameterSet) else ():
        if name not in graph.parameters and name not in model.declared:
            yield Finding(
                Location("start"), f"the model does not use {name}", nearest(name, graph.parameters), severity="warning"
            )


def model_of(model: Model | str, parameters: ParameterSet) -> Model:
    """Return the model; formula text is parsed."""
    return model if isinstance(model, Model) else formula(model, parameters=list(parameters))


def start_parameters(start: Start, model: Model | str) -> ParameterSet:
    """Return the parameters as a set, with those that come with the model.

    Tables made in Python define their extrapolation, those read from files do not.
    """
    start = parameters_of(start)
    if not isinstance(model, Model):
        return start
    return merge_start_values(model.carried, start, continued=start.origin is not None)


def on_model_step(
    model: Model, datasets: Sequence[Dataset], inputs: Collection[str], unknown: Collection[str] = ()
) -> tuple[Dataset, ...]:
    """Interpolate datasets onto the model's own step; `unknown` names those with a shift to be estimated."""
    if not model.graph.is_timed:
        return tuple(datasets)
    for data in datasets:
        warn(clock_findings(data, dataset_location(data)))
    if model.step is None:
        return tuple(datasets)
    refined: list[Dataset] = []
    findings = Findings()
    for data in datasets:
        location = dataset_location(data)
        try:
            refined.append(refine_step(data, model.step, inputs, location))
        except InputError as error:
            findings.add(*error.findings)
            continue
        if refined[-1] is not data and data.name in unknown:
            message = f"cannot estimate a shift: the model's step of {model.step:g} s is finer than that of the data"
            findings.error(location, message, f"Resample the data to {model.step:g} s, or set the shift in s.")
    findings.finish()
    return tuple(refined)


def _split_limits(limits: Limits, parameters: ParameterSet) -> tuple[dict[str, Bounds], tuple[Limit, ...]]:
    """Return bounds that are stated as limits, as they were called before, and the limits of outputs."""
    if not isinstance(limits, Mapping):
        return {}, tuple(limits)
    bounds = {name: pair for name, pair in limits.items() if name in parameters}
    for name, pair in bounds.items():
        warn_deprecated(f"limits of the parameter {name} are bounds: write bounds={{{name!r}: {pair!r}}}")
    others = {name: pair for name, pair in limits.items() if name not in parameters}
    return bounds, tuple(Limit(name, *(_unbounded(*pair))) for name, pair in others.items())


def _unbounded(lower: float | None, upper: float | None) -> tuple[float, float]:
    return -np.inf if lower is None else lower, np.inf if upper is None else upper


def _factors(smoothness: Factors, parameters: ParameterSet) -> dict[str, tuple[Factor, ...]]:
    """Return the checked smoothness factors of each axis of each table."""
    by_name = smoothness if isinstance(smoothness, Mapping) else dict.fromkeys(parameters, smoothness)
    factors: dict[str, tuple[Factor, ...]] = {}
    for name, value in by_name.items():
        if name not in parameters:
            raise ArgumentError(f"smoothness: unknown parameter {name}. {nearest(name, parameters)}".strip())
        axes = len(parameters[name].axes)
        if isinstance(value, Mapping):
            value = factors_by_axis(value, name, axes)
        single = isinstance(value, str) or np.ndim(value) == 0
        values = [_factor(factor) for factor in ((value,) * axes if single else value)]  # type: ignore[union-attr]
        factors[name] = tuple(factor for factor in values if factor is not None)
        if len(values) != axes or None in values:
            raise ArgumentError(
                f'smoothness of {name} must be >= 0 or "auto", or one such value for each of its {axes} axes, '
                f"got {value!r}"
            )
    return factors


def _factor(value: Any) -> Factor | None:
    """Return a valid factor, else None."""
    if isinstance(value, str):
        return "auto" if value == "auto" else None
    try:
        factor = float(value)
    except (TypeError, ValueError):
        return None
    return factor if 0 <= factor < np.inf else None


def _shift_datasets(datasets: Sequence[Dataset], shift: Shift) -> tuple[list[Dataset], dict[str, tuple[str, ...]]]:
    """Apply known shifts; return the datasets, and by dataset the channels whose shift is to be estimated."""
    names = [data.name for data in datasets]
    shifted, unknown = [], {}
    for data in datasets:
        own = shift_of(shift, data.name, names)
        _check_shifts(own, {channel for each in datasets for channel in each})
        known = {name: float(by) for name, by in own.items() if by != "auto"}
        shifted.append(shift_channels(data, known))
        if sought := tuple(name for name, by in own.items() if by == "auto"):
            unknown[data.name] = sought
    return shifted, unknown


def _check_shifts(shift: Mapping[str, Any], channels: Collection[str]) -> None:
    for name, by in shift.items():
        if name not in channels:
            raise ArgumentError(f"shift: unknown channel {name}. {nearest(name, channels)}".strip())
        if not (by == "auto" if isinstance(by, str) else np.ndim(by) == 0 and np.isfinite(by)):
            raise ArgumentError(f'shift={by!r} of {name} must be a finite number or "auto"')


def _parts(data: Data | Sequence[Data]) -> Sequence[Data]:
    """Return several datasets as such; a single one as a sequence."""
    several = isinstance(data, Sequence) and not isinstance(data, Mapping | str)
    return data if several else [data]  # type: ignore[return-value,list-item]


def _as_datasets(data: Data | Sequence[Data], use: Use, graph: Graph, used: Collection[str]) -> list[Dataset]:
    datasets = [to_dataset(part, f"{use}{i or ''}", graph, used) for i, part in enumerate(_parts(data))]
    return [each if each.use == use else replace(each, use=use) for each in datasets]


def _output(model: Model, node: str | None) -> str:
    outputs = model.graph.outputs
    if node is None and len(outputs) != 1:
        raise ArgumentError(f"the model has several outputs ({', '.join(outputs)}); select one with node=")
    return node or outputs[0]
