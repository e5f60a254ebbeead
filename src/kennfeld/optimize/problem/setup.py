"""The arguments of `calibrate`, and the problem that follows from them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kennfeld.base.errors import ArgumentError, Findings, InputError, Location, warn
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset, Use
from kennfeld.domain.free_axes import with_free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, Scalar
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.graph import Graph
from kennfeld.models import Model, bind_scalars, merge_start_values
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.overlap import overlap_findings
from kennfeld.optimize.problem.problem import Factor, Problem, Smoothness
from kennfeld.optimize.problem.storage import rounding_of, with_rounding
from kennfeld.optimize.problem.validation import check_problem, dataset_location
from kennfeld.preprocessing.coercion import Data, to_dataset
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
    rounding: RoundingMethod | None = None
    storage: str | Path | None = None
    step: Mapping[str, float] | None = None
    max_shift: float = MAX_SHIFT

    def problem(self) -> Problem:
        """Build and check the problem.

        Raises:
            InputError: the input cannot be used; lists all problems.
        """
        self._check_patterns()
        parameters, outputs = self._bounded_parameters()
        function = bind_scalars(model_of(self.model, parameters), parameters)
        criteria = self._all_criteria(function)
        channels = self.channels or {}
        inputs = {channels.get(name, name) for name in function.graph.inputs}
        datasets = self._datasets(function.graph, {*inputs, *(criterion.target.name for criterion in criteria)})
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
        for name in self.step or ():
            if name not in problem.parameters:
                raise ArgumentError(f"step: unknown parameter {name}. {nearest(name, problem.parameters)}".strip())
        rounding = rounding_of(self.rounding, self.storage, self.step or {}, self.max_shift)
        rounded, findings = with_rounding(problem, rounding, Location)
        warn(finding for finding in Findings(findings).finish() if finding.severity == "warning")
        return rounded

    def _check_patterns(self) -> None:
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
        return (Criterion(_output(function, self.node), self.target), *self.criteria)

    def _datasets(self, graph: Graph, used: Collection[str]) -> list[Dataset]:
        """Return training and test data with the channels in use."""
        return [*_as_datasets(self.data, "training", graph, used), *_as_datasets(self.test, "test", graph, used)]


def model_of(model: Model | str, parameters: ParameterSet) -> Model:
    """Return the model; formula text is parsed."""
    return model if isinstance(model, Model) else formula(model, parameters=list(parameters))


def start_parameters(start: Start, model: Model | str) -> ParameterSet:
    """Return the parameters as a set, with those that come with the model.

    Tables made in Python define their extrapolation, those read from files do not.
    """
    if not isinstance(start, ParameterSet):
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


def _as_datasets(data: Data | Sequence[Data], use: Use, graph: Graph, used: Collection[str]) -> list[Dataset]:
    several = isinstance(data, Sequence) and not isinstance(data, Mapping)
    parts: Sequence[Data] = data if several else [data]  # type: ignore[assignment,list-item]
    return [replace(to_dataset(part, f"{use}{i or ''}", graph, used), use=use) for i, part in enumerate(parts)]


def _output(model: Model, node: str | None) -> str:
    outputs = model.graph.outputs
    if node is None and len(outputs) != 1:
        raise ArgumentError(f"the model has several outputs ({', '.join(outputs)}); select one with node=")
    return node or outputs[0]
