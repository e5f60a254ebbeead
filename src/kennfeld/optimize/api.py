"""`calibrate` and `simulate`: the Python interface to calibration problems."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from kennfeld.base.errors import ArgumentError, Findings, InputError, warn
from kennfeld.base.formatting import nearest
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset, Use
from kennfeld.domain.free_axes import with_free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter, Scalar
from kennfeld.graph import Graph
from kennfeld.models import Model, bind_scalars, merge_start_values
from kennfeld.models.formula import formula
from kennfeld.optimize.fit.result import Progress, Result
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.overlap import overlap_findings
from kennfeld.optimize.problem.problem import Factor, Problem, Smoothness
from kennfeld.optimize.problem.validation import (
    check_inputs,
    check_problem,
    dataset_location,
    delay_findings,
    step_findings,
    weight_warnings,
)
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.search.multistart import run
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.coercion import Data, to_dataset
from kennfeld.preprocessing.model_step import clock_findings, recorded_samples, refine_step
from kennfeld.preprocessing.skipped_samples import SkippedSamples
from kennfeld.preprocessing.time_shift import shift_channels

Start = ParameterSet | Mapping[str, float | Parameter]
Limits = Mapping[str, tuple[float, float]] | Sequence[Limit]
Shift = Mapping[str, float | Literal["auto"]]


def calibrate(
    model: Model | str,
    data: Data | Sequence[Data],
    start: Start,
    target: str | float | None = None,
    *,
    node: str | None = None,
    criteria: Sequence[Criterion] = (),
    test: Data | Sequence[Data] = (),
    free: Sequence[str] = ("*",),
    free_axes: Sequence[str] = (),
    smoothness: Factor | Smoothness = 0.0,
    limits: Limits | None = None,
    pins: Sequence[Pin] = (),
    constraints: Sequence[Shape | Equality] = (),
    channels: Mapping[str, str] | None = None,
    shift: Shift | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Result:
    """Find the values with which the model reproduces the data.

    Args:
        model: a model, or formula text.
        data: training data; several datasets, or columns by name (a dict, a DataFrame). A column `time`, or an index of
            dates, is the time in s; `time [ms]` in ms. A function with its own step reads inputs interpolated onto it.
        start: the current calibration, or numbers by name for models of scalars alone.
        target: the channel that the model's output shall follow, or a number; or give `criteria` instead.
        node: the output that follows the target, if the model has several.
        criteria: several targets, with weights and losses.
        test: data that are scored but not fitted.
        free: glob patterns of the parameters to fit; the others keep their start.
        free_axes: patterns of axes whose breakpoints to fit (`Group`, `Table.x`), like those of `Axis(..., free=True)`.
        smoothness: factor for all tables, or by parameter and axis; "auto" in its place chooses it from the data.
        limits: lower and upper bound by name: of all values of a parameter, in its unit, or of a node at every scored
            training sample, which may be an expression over nodes and channels; or a list of `Limit`.
        pins: exact values at given coordinates.
        constraints: ranges of slope or curvature along an axis (`Shape`), and sums of values (`Equality`).
        channels: the channel of a model input, if the names differ.
        shift: by channel, value(t) = recorded(t - shift), in s, steady-state points in samples; "auto" by dataset.
        options: iterations, tolerance, continuation, starts, steps.
        progress: called after each accepted step; may raise `Stop`.

    Returns:
        The result; a fit that fails is a result too, see `Result.status`.

    Raises:
        InputError: the input cannot be used; lists all problems.

    >>> calibrate("y = a + b * x", {"x": [0.0, 1.0, 2.0], "m": [1.0, 3.0, 5.0]}, {"a": 0.0, "b": 0.0}, "m").status
    'converged'
    """
    problem = build_problem(
        model,
        data,
        start,
        target,
        node=node,
        criteria=criteria,
        test=test,
        free=free,
        free_axes=free_axes,
        smoothness=smoothness,
        limits=limits,
        pins=pins,
        constraints=constraints,
        channels=channels,
        shift=shift,
    )
    result = run(problem, options or Options(), progress)
    return replace(result, warnings=(*weight_warnings(problem), *result.warnings))


def build_problem(
    model: Model | str,
    data: Data | Sequence[Data],
    start: Start,
    target: str | float | None = None,
    *,
    node: str | None = None,
    criteria: Sequence[Criterion] = (),
    test: Data | Sequence[Data] = (),
    free: Sequence[str] = ("*",),
    free_axes: Sequence[str] = (),
    smoothness: Factor | Smoothness = 0.0,
    limits: Limits | None = None,
    pins: Sequence[Pin] = (),
    constraints: Sequence[Shape | Equality] = (),
    channels: Mapping[str, str] | None = None,
    shift: Shift | None = None,
) -> Problem:
    """Return the problem that `calibrate` solves; same arguments and errors."""
    for name, patterns in (("free_axes", free_axes), ("free", free)):
        if isinstance(patterns, str):
            raise ArgumentError(f"{name}={patterns!r} must be a list of patterns: {name}=[{patterns!r}]")
    unbounded = with_free_axes(_parameters(start, model), free_axes)
    bounds, outputs = _split_limits(limits or {}, unbounded)
    parameters = unbounded.with_parameters(*(unbounded[name].with_bounds(*pair) for name, pair in bounds.items()))
    function = bind_scalars(_model(model, parameters), parameters)
    if target is not None:
        criteria = (Criterion(_output(function, node), target), *criteria)
    inputs = {(channels or {}).get(name, name) for name in function.graph.inputs}
    used = {*inputs, *(criterion.target.name for criterion in criteria)}
    datasets = [*_datasets(data, "training", function.graph, used), *_datasets(test, "test", function.graph, used)]
    factors = _factors(smoothness, parameters)
    shifted, unknown = _shift_datasets(datasets, shift or {})
    problem = Problem(
        function,
        _on_step(function, shifted, inputs, unknown),
        parameters,
        tuple(criteria),
        tuple(free),
        factors,
        tuple(pins),
        channels or {},
        tuple(constraints),
        outputs,
        unknown,
    )
    check_problem(problem).finish()
    warn(overlap_findings(problem, dataset_location))
    return problem


def simulate(model: Model | str, data: Data, parameters: Start, channels: Mapping[str, str] | None = None) -> Dataset:
    """Return the named nodes of the model at the samples of the data.

    Args:
        model: a model, or formula text.
        data: a dataset, or columns by name, as `calibrate` takes them.
        parameters: the calibration, or numbers by name.
        channels: the channel of a model input, if the names differ.

    Returns:
        A channel for each named node, Float[samples]. Samples at which an input has no value are left out; a warning,
        which is among the `findings` of the dataset as well, says which.

    Raises:
        InputError: an input or a parameter of the model is missing, or the data do not fit its step.

    >>> simulate("y = 2 * x + k", {"x": [1.0, 2.0]}, {"k": 1.0})["y"].values
    array([3., 5.])
    """
    values = _parameters(parameters, model)
    function = bind_scalars(_model(model, values), values)
    graph, channels = function.graph, channels or {}
    inputs = {channels.get(name, name) for name in graph.inputs}
    dataset = to_dataset(data, "data", graph, inputs)
    findings = Findings(check_inputs(graph, [dataset], values, channels))
    findings.add(*step_findings(function, [dataset], function.step, dataset_location), *delay_findings(function, 0))
    findings.finish()
    finer = _on_step(function, [replace(dataset, scored=None, warmup=0.0)], inputs)[0]
    bound = bind_inputs(finer, graph, channels, function.step)
    nodes = NodeSimulator(graph, values).dataset(bound, values)
    skipped = SkippedSamples.of(bound, channels, restarts=bool(graph.states), recorded=finer.scored)
    if skipped is not None:
        nodes = replace(nodes, findings=(skipped.finding(dataset_location(dataset)),))
        warn(nodes.findings)
    return nodes if finer.scored is None else recorded_samples(nodes, bound.scored)


def _model(model: Model | str, parameters: ParameterSet) -> Model:
    return model if isinstance(model, Model) else formula(model, parameters=list(parameters))


def _parameters(start: Start, model: Model | str) -> ParameterSet:
    """Return the parameters as a set, with those that come with the model.

    Tables made in Python define their extrapolation, those read from files do not.
    """
    if not isinstance(start, ParameterSet):
        start = ParameterSet(p if isinstance(p, Parameter) else Scalar(name, p) for name, p in start.items())
    if not isinstance(model, Model):
        return start
    return merge_start_values(model.carried, start, continued=start.origin is not None)


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


def _datasets(data: Data | Sequence[Data], use: Use, graph: Graph, used: Collection[str]) -> list[Dataset]:
    several = isinstance(data, Sequence) and not isinstance(data, Mapping)
    parts: Sequence[Data] = data if several else [data]  # type: ignore[assignment,list-item]
    return [replace(to_dataset(part, f"{use}{i or ''}", graph, used), use=use) for i, part in enumerate(parts)]


def _on_step(
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


def _output(model: Model, node: str | None) -> str:
    outputs = model.graph.outputs
    if node is None and len(outputs) != 1:
        raise ArgumentError(f"the model has several outputs ({', '.join(outputs)}); select one with node=")
    return node or outputs[0]
