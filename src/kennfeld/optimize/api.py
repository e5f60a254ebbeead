"""`calibrate` and `simulate`: the Python interface to calibration problems."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from kennfeld.constraints import Equality, Limit, Pin, Shape
from kennfeld.criteria import Criterion
from kennfeld.dataset import Dataset, Use
from kennfeld.errors import ArgumentError, Finding, InputError, warn
from kennfeld.formatting import nearest
from kennfeld.free_axes import with_free_axes
from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.traversal import rewrite
from kennfeld.models import Model, merge_start_values
from kennfeld.models.formula import formula
from kennfeld.optimize.options import Options
from kennfeld.optimize.overlap import overlap_findings
from kennfeld.optimize.problem import Factor, Problem, Smoothness
from kennfeld.optimize.quality import NodeSimulator
from kennfeld.optimize.result import Progress, Result
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.validation import check_limits, delay_findings, matrix_findings, step_findings
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter, Scalar
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.coercion import Data, to_dataset
from kennfeld.preprocessing.model_step import clock_findings, is_timed, recorded_samples, refine_step
from kennfeld.preprocessing.sample_weights import weight_findings
from kennfeld.preprocessing.time_shift import shift_channels

Start = ParameterSet | Mapping[str, float | Parameter]


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
    limits: Mapping[str, tuple[float, float]] | Sequence[Limit] | None = None,
    pins: Sequence[Pin] = (),
    constraints: Sequence[Shape | Equality] = (),
    channels: Mapping[str, str] | None = None,
    shift: Mapping[str, float | Literal["auto"]] | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Result:
    """Find the values with which the model reproduces the data.

    Args:
        model: a model, or formula text.
        data: training data; several datasets, or columns by name (a dict, a DataFrame). A column called `time`, or a
            DataFrame's index of dates, is the time of the samples in s; another unit stands in its name, `time [ms]`.
            A function with a step of its own reads inputs interpolated onto that step.
        start: the current calibration, or numbers by name for models of scalars alone.
        target: the channel that the model's output shall follow, or a number; or give `criteria` instead.
        node: the output that follows the target, if the model has several.
        criteria: several targets, with weights and losses.
        test: data that are scored but not fitted.
        free: glob patterns of the parameters to fit; the others keep their start.
        free_axes: glob patterns of the axes whose breakpoints to fit: group axes by name, others as `Table.x`. Axes
            made with `Axis(..., free=True)` are fitted in any case.
        smoothness: factor for all tables, or by parameter, or by parameter and axis; "auto" in place of a factor
            chooses it from the data.
        limits: lower and upper bound by name: of all values of a parameter, in its unit, or of a node at every scored
            training sample, which may be an expression over nodes and channels; or a list of `Limit`.
        pins: exact values at given coordinates.
        constraints: ranges of slope or curvature along an axis (`Shape`), and sums of values (`Equality`).
        channels: the channel of a model input, if the names differ.
        shift: time shift of channels of all data, value(t) = recorded(t - shift), in s, or in samples for steady-state
            points; "auto" estimates it for each training dataset.
        options: iterations, tolerance, continuation, starts, steps.
        progress: called after each accepted step; may raise `Stop`.

    Returns:
        The result; a fit that fails is a result too, see `Result.status`.

    Raises:
        InputError: the input cannot be used; lists all problems.

    >>> data = {"x": [0.0, 1.0, 2.0, 3.0], "y": [1.0, 3.0, 5.0, 7.0]}
    >>> result = calibrate("model = a + b * x", data, {"a": 0.0, "b": 0.0}, target="y")
    >>> result.status, round(result.parameters["b"].value, 9)
    ('converged', 2.0)
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
    return run(problem, options or Options(), progress)


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
    limits: Mapping[str, tuple[float, float]] | Sequence[Limit] | None = None,
    pins: Sequence[Pin] = (),
    constraints: Sequence[Shape | Equality] = (),
    channels: Mapping[str, str] | None = None,
    shift: Mapping[str, float | Literal["auto"]] | None = None,
) -> Problem:
    """Return the problem that `calibrate` solves; same arguments and errors."""
    if isinstance(free_axes, str):
        raise ArgumentError(f"free_axes={free_axes!r} must be a list of patterns: free_axes=[{free_axes!r}]")
    bounds, outputs = split_limits(limits or {}, given := with_free_axes(_parameters(start, model), free_axes))
    parameters = given.with_parameters(*(given[name].with_bounds(*pair) for name, pair in bounds.items()))
    ready = bind_scalars(model if isinstance(model, Model) else formula(model, parameters=list(parameters)), parameters)
    if target is not None:
        criteria = (Criterion(_output(ready, node), target), *criteria)
    inputs = {(channels or {}).get(name, name) for name in ready.graph.inputs}
    asked = {*inputs, *(criterion.target.name for criterion in criteria)}
    training = _datasets(data, "training", ready.graph, asked)
    scored = _datasets(test, "test", ready.graph, asked)
    if isinstance(free, str):
        raise ArgumentError(f"free={free!r} must be a list of patterns: free=[{free!r}]")
    tables = _factors(smoothness, parameters)
    datasets, unknown = _shift_datasets((*training, *scored), shift or {})
    datasets = _on_step(ready, datasets, inputs, unknown)
    problem = Problem(
        ready,
        datasets,
        parameters,
        tuple(criteria),
        tuple(free),
        tables,
        tuple(pins),
        channels or {},
        tuple(constraints),
        outputs,
        unknown,
    )
    _check(problem)
    warn(overlap_findings(problem, lambda data: f"dataset {data.name}"))
    return problem


def simulate(model: Model | str, data: Data, parameters: Start, channels: Mapping[str, str] | None = None) -> Dataset:
    """Return the named nodes of the model at the samples of the data.

    Args:
        model: a model, or formula text.
        data: a dataset, or columns by name, as `calibrate` takes them.
        parameters: the calibration, or numbers by name.
        channels: the channel of a model input, if the names differ.

    Returns:
        A channel for each named node, Float[samples].

    Raises:
        InputError: an input or a parameter of the model is missing, or the data do not fit its step.

    >>> simulate("y = 2 * x + k", {"x": [1.0, 2.0]}, {"k": 1.0})["y"].values
    array([3., 5.])
    """
    values = _parameters(parameters, model)
    ready = bind_scalars(model if isinstance(model, Model) else formula(model, parameters=list(values)), values)
    inputs = {(channels or {}).get(name, name) for name in ready.graph.inputs}
    dataset = to_dataset(data, "data", ready.graph, inputs)
    findings = check_inputs(ready.graph, [dataset], values, channels or {})
    findings += step_findings(ready, [dataset], ready.step, lambda data: f"dataset {data.name}")
    findings += delay_findings(ready, 0)
    if findings:
        raise InputError(findings)
    finer = _on_step(ready, [replace(dataset, scored=None, warmup=0.0)], inputs)[0]
    bound = bind_inputs(finer, ready.graph, channels or {}, ready.step)
    nodes = NodeSimulator(ready.graph, values).dataset(bound, values)
    return nodes if finer.scored is None else recorded_samples(nodes, bound.scored)


def bind_scalars(model: Model, parameters: ParameterSet) -> Model:
    """Turn inputs of the model that are scalar parameters of the set into lookups."""
    names = {name for name in model.graph.inputs if name in parameters and not parameters[name].coordinates}
    if not names:
        return model

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        op, _, payload = model.graph.nodes[at]
        if op == "input" and payload in names:
            return b.lookup(payload)
        return b.node(op, args, payload)

    return replace(model, graph=rewrite(model.graph, resolve))


def _parameters(given: Start, model: Model | str) -> ParameterSet:
    """Return the parameters as a set, with those that come with the model.

    Tables made in Python define their extrapolation, those read from files do not.
    """
    if not isinstance(given, ParameterSet):
        given = ParameterSet(p if isinstance(p, Parameter) else Scalar(name, p) for name, p in given.items())
    if not isinstance(model, Model):
        return given
    return merge_start_values(model.carried, given, continued=given.origin is not None)


def split_limits(
    limits: Mapping[str, tuple[float, float]] | Sequence[Limit], parameters: ParameterSet
) -> tuple[dict[str, tuple[float, float]], tuple[Limit, ...]]:
    """Split limits into bounds of parameters by name, and limits of outputs."""
    if not isinstance(limits, Mapping):
        return {}, tuple(limits)
    bounds = {name: pair for name, pair in limits.items() if name in parameters}
    return bounds, tuple(Limit(name, *pair) for name, pair in limits.items() if name not in parameters)


def _factors(given: Factor | Smoothness, parameters: ParameterSet) -> dict[str, tuple[Factor, ...]]:
    """Return the checked smoothness factors of each axis of each table."""
    by_name = given if isinstance(given, Mapping) else dict.fromkeys(parameters, given)
    factors: dict[str, tuple[Factor, ...]] = {}
    for name, value in by_name.items():
        if name not in parameters:
            raise ArgumentError(f"smoothness: unknown parameter {name}. {nearest(name, parameters)}".strip())
        axes = len(parameters[name].axes)
        single = isinstance(value, str) or np.ndim(value) == 0
        checked = [_factor(factor) for factor in ((value,) * axes if single else value)]  # type: ignore[union-attr]
        if len(checked) != axes or None in checked:
            raise ArgumentError(
                f'smoothness of {name} must be >= 0 or "auto", or one such value for each of its {axes} axes, '
                f"got {value!r}"
            )
        factors[name] = tuple(factor for factor in checked if factor is not None)
    return factors


def _factor(given: Any) -> Factor | None:
    """Return a valid factor, else None."""
    if isinstance(given, str):
        return "auto" if given == "auto" else None
    try:
        factor = float(given)
    except (TypeError, ValueError):
        return None
    return factor if 0 <= factor < np.inf else None


def _shift_datasets(
    datasets: Sequence[Dataset], shift: Mapping[str, float | Literal["auto"]]
) -> tuple[tuple[Dataset, ...], dict[str, tuple[str, ...]]]:
    """Apply known shifts; return the datasets, and by dataset the channels whose shift is to be estimated."""
    channels = {channel for data in datasets for channel in data}
    for name, by in shift.items():
        if name not in channels:
            raise ArgumentError(f"shift: unknown channel {name}. {nearest(name, channels)}".strip())
        if not _is_shift(by):
            raise ArgumentError(f'shift={by!r} of {name} must be a finite number or "auto"')
    known = {name: float(by) for name, by in shift.items() if by != "auto"}
    unknown = tuple(name for name, by in shift.items() if by == "auto")
    return tuple(shift_channels(data, known) for data in datasets), {
        d.name: unknown for d in datasets
    } if unknown else {}


def _is_shift(given: Any) -> bool:
    return given == "auto" if isinstance(given, str) else bool(np.ndim(given) == 0 and np.isfinite(given))


def _datasets(given: Data | Sequence[Data], use: Use, graph: Graph, asked: Collection[str]) -> list[Dataset]:
    several = isinstance(given, Sequence) and not isinstance(given, Mapping)
    parts: Sequence[Data] = given if several else [given]  # type: ignore[assignment,list-item]
    return [replace(to_dataset(d, f"{use}{i or ''}", graph, asked), use=use) for i, d in enumerate(parts)]


def _on_step(
    model: Model, datasets: Sequence[Dataset], inputs: Collection[str], unknown: Collection[str] = ()
) -> tuple[Dataset, ...]:
    """Interpolate datasets onto the model's own step; `unknown` names those with a shift to be estimated."""
    if not is_timed(model.graph):
        return tuple(datasets)
    for data in datasets:
        warn(clock_findings(data, f"dataset {data.name}"))
    if model.step is None:
        return tuple(datasets)
    refined: list[Dataset] = []
    findings: list[Finding] = []
    for data in datasets:
        place = f"dataset {data.name}"
        try:
            refined.append(refine_step(data, model.step, inputs, place))
        except InputError as error:
            findings += error.findings
            continue
        if refined[-1] is not data and data.name in unknown:
            message = f"cannot estimate a shift: the model's step of {model.step:g} s is finer than that of the data"
            findings.append(Finding(place, message, f"Resample the data to {model.step:g} s, or set the shift in s."))
    if findings:
        raise InputError(findings)
    return tuple(refined)


def _output(model: Model, node: str | None) -> str:
    outputs = model.graph.outputs
    if node is not None:
        return node
    if len(outputs) != 1:
        raise ArgumentError(f"the model has several outputs ({', '.join(outputs)}); select one with node=")
    return outputs[0]


def _check(problem: Problem) -> None:
    findings = check_inputs(problem.model.graph, problem.datasets, problem.parameters, problem.channels)
    findings += step_findings(problem.model, problem.datasets, problem.model.step, lambda d: f"dataset {d.name}")
    for name in problem.channels:
        if name not in problem.model.graph.inputs:
            remedy = nearest(name, problem.model.graph.inputs)
            findings.append(Finding("channels", f"unknown input {name}", remedy))
    for pin in problem.pins:
        if not np.all(np.isfinite((*pin.at, pin.value))):
            findings.append(Finding(f"pin of {pin.parameter}", f"{pin.value} at {list(pin.at)} is not finite"))
    training = [data for data in problem.datasets if data.use == "training" and data.weight > 0]
    weights = weight_findings(
        problem.criteria, training, lambda i: f"criterion on {problem.criteria[i].node}", lambda d: f"dataset {d.name}"
    )
    findings += [finding for finding in weights if finding.severity == "error"]
    names = problem.model.graph.names
    channels = {channel for data in problem.datasets for channel in data}
    for criterion in problem.criteria:
        for node in (criterion.node, problem.target_node(criterion)):
            if node is not None and node not in names:
                remedy = nearest(node, [*names, *channels])
                findings.append(Finding("criterion", f"unknown node or channel {node}", remedy))
    findings += [] if findings else delay_findings(problem.model, problem.free_size)
    findings += [] if findings else matrix_findings("parameters", problem.free_size)
    findings += [] if findings else check_limits(problem)
    if findings:
        raise InputError(findings)


def check_inputs(
    graph: Graph, datasets: Sequence[Dataset], parameters: ParameterSet, channels: Mapping[str, str]
) -> list[Finding]:
    """Report inputs without a channel, lookups without a parameter, and tables with a different number of axes."""
    findings = []
    for name, count in graph.parameters.items():
        if name not in parameters:
            remedy = nearest(name, parameters)
            findings.append(Finding("function", f"unknown parameter {name}", remedy))
        elif parameters[name].coordinates != count:
            has = parameters[name].coordinates
            findings.append(Finding("function", f"{name} is looked up with {count} coordinates, but has {has} axes"))
    for dataset in datasets:
        for name in graph.inputs:
            channel = channels.get(name, name)
            if channel not in dataset:
                remedy = nearest(channel, dataset) or f"It has {', '.join(list(dataset)[:12])}."
                findings.append(Finding(f"dataset {dataset.name}", f"no channel named {channel}", remedy))
    return findings
