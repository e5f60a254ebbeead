"""The arguments of `calibrate`, and the problem that follows from them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, Findings, InputError, Location, warn
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset, Use
from kennfeld.domain.free_axes import with_free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, Scalar
from kennfeld.graph import Graph
from kennfeld.models import Model, ambiguity, ambiguous_names, bind_scalars, merge_start_values
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.overlap import overlap_findings
from kennfeld.optimize.problem.problem import Factor, Problem, Smoothness
from kennfeld.optimize.problem.unit_conflicts import convert_units, target_channels, unit_warnings, wanted_units
from kennfeld.optimize.problem.validation import check_problem, dataset_location
from kennfeld.preprocessing.coercion import Data, names_of, to_dataset
from kennfeld.preprocessing.model_step import clock_findings, refine_step
from kennfeld.preprocessing.time_shift import shift_channels

Start = ParameterSet | Mapping[str, float | Parameter]
Limits = Mapping[str, tuple[float, float]] | Sequence[Limit]
Shift = Mapping[str, float | Literal["auto"]]


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
    smoothness: Factor | Smoothness = 0.0
    limits: Limits | None = None
    pins: Sequence[Pin] = ()
    constraints: Sequence[Shape | Equality] = ()
    channels: Mapping[str, str] | None = None
    shift: Shift | None = None

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
        return problem

    def _check_arguments(self) -> None:
        if self.criteria and self.target is not None:
            remedy = f"add Criterion(node, {self.target!r}) to the criteria"
            raise ArgumentError(f"target={self.target!r} and criteria cannot be combined; {remedy}")
        if self.criteria and self.node is not None:
            raise ArgumentError(f"node={self.node!r} belongs to target; each of the criteria names its own node")
        for name, patterns in (("free_axes", self.free_axes), ("free", self.free)):
            if isinstance(patterns, str):
                raise ArgumentError(f"{name}={patterns!r} must be a list of patterns: {name}=[{patterns!r}]")

    def _bounded_parameters(self) -> tuple[ParameterSet, tuple[Limit, ...]]:
        """Return the start with free axes and bounds, and the limits of outputs."""
        unbounded = with_free_axes(start_parameters(self.start, self.model), self.free_axes)
        bounds, outputs = _split_limits(self.limits or {}, unbounded)
        return unbounded.with_parameters(
            *(unbounded[name].with_bounds(*pair) for name, pair in bounds.items())
        ), outputs

    def _all_criteria(self, function: Model) -> tuple[Criterion, ...]:
        if self.target is None:
            return tuple(self.criteria)
        return (Criterion(_output(function, self.node), self.target),)

    def _datasets(self, graph: Graph, used: Collection[str]) -> list[Dataset]:
        """Return training and test data with the channels in use."""
        return [*_as_datasets(self.data, "training", graph, used), *_as_datasets(self.test, "test", graph, used)]


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
    for name in start if not isinstance(start, ParameterSet) else ():
        if name not in graph.parameters and name not in model.declared:
            yield Finding(
                Location("start"), f"the model does not use {name}", nearest(name, graph.parameters), "", "warning"
            )


def model_of(model: Model | str, parameters: ParameterSet) -> Model:
    """Return the model; formula text is parsed."""
    return model if isinstance(model, Model) else formula(model, parameters=list(parameters))


def start_parameters(start: Start, model: Model | str) -> ParameterSet:
    """Return the parameters as a set, with those that come with the model.

    Tables made in Python define their extrapolation, those read from files do not.
    """
    if not isinstance(start, ParameterSet):
        wrong = [(key, p.name) for key, p in start.items() if isinstance(p, Parameter) and p.name != key]
        if wrong:
            raise ArgumentError(f"start: the parameter under {wrong[0][0]!r} is called {wrong[0][1]}; use its name")
        start = ParameterSet(p if isinstance(p, Parameter) else Scalar(name, p) for name, p in start.items())
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


def _split_limits(limits: Limits, parameters: ParameterSet) -> tuple[dict[str, tuple[float, float]], tuple[Limit, ...]]:
    if not isinstance(limits, Mapping):
        return {}, tuple(limits)
    bounds = {name: pair for name, pair in limits.items() if name in parameters}
    return bounds, tuple(Limit(name, *pair) for name, pair in limits.items() if name not in parameters)


def _factors(smoothness: Factor | Smoothness, parameters: ParameterSet) -> dict[str, tuple[Factor, ...]]:
    """Return the checked smoothness factors of each axis of each table."""
    by_name = smoothness if isinstance(smoothness, Mapping) else dict.fromkeys(parameters, smoothness)
    factors: dict[str, tuple[Factor, ...]] = {}
    for name, value in by_name.items():
        if name not in parameters:
            raise ArgumentError(f"smoothness: unknown parameter {name}. {nearest(name, parameters)}".strip())
        axes = len(parameters[name].axes)
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
    channels = {channel for data in datasets for channel in data}
    for name, by in shift.items():
        if name not in channels:
            raise ArgumentError(f"shift: unknown channel {name}. {nearest(name, channels)}".strip())
        if not (by == "auto" if isinstance(by, str) else np.ndim(by) == 0 and np.isfinite(by)):
            raise ArgumentError(f'shift={by!r} of {name} must be a finite number or "auto"')
    known = {name: float(by) for name, by in shift.items() if by != "auto"}
    unknown = tuple(name for name, by in shift.items() if by == "auto")
    shifted = [shift_channels(data, known) for data in datasets]
    return shifted, dict.fromkeys((data.name for data in datasets), unknown) if unknown else {}


def _parts(data: Data | Sequence[Data]) -> Sequence[Data]:
    """Return several datasets as such; a single one as a sequence."""
    several = isinstance(data, Sequence) and not isinstance(data, Mapping | str)
    return data if several else [data]  # type: ignore[return-value,list-item]


def _as_datasets(data: Data | Sequence[Data], use: Use, graph: Graph, used: Collection[str]) -> list[Dataset]:
    parts = enumerate(_parts(data))
    return [replace(to_dataset(part, f"{use}{i or ''}", graph, used), use=use) for i, part in parts]


def _output(model: Model, node: str | None) -> str:
    outputs = model.graph.outputs
    if node is None and len(outputs) != 1:
        raise ArgumentError(f"the model has several outputs ({', '.join(outputs)}); select one with node=")
    return node or outputs[0]
