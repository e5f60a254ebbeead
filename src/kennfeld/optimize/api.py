"""`calibrate`, `problem` and `simulate`: the Python interface to calibration problems."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Unpack, overload

from kennfeld.base.errors import Findings, warn
from kennfeld.domain.constraints import Equality, Pin, Shape
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.storage import MAX_SHIFT, RoundingMethod
from kennfeld.models import Model
from kennfeld.optimize.fit.result import Progress, Result
from kennfeld.optimize.problem.arguments import (
    Bounds,
    Factors,
    Limits,
    ProblemArguments,
    Shift,
    Start,
    check_options,
)
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import (
    ProblemSetup,
    bound_model,
    on_model_step,
    problem_of,
    start_parameters,
    unused_names,
)
from kennfeld.optimize.problem.unit_conflicts import convert_units, unit_warnings, wanted_units
from kennfeld.optimize.problem.validation import (
    check_inputs,
    dataset_location,
    delay_findings,
    step_findings,
    weight_warnings,
)
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.search.isolated_call import isolated
from kennfeld.optimize.search.multistart import run
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.coercion import Data, to_dataset
from kennfeld.preprocessing.model_step import recorded_samples
from kennfeld.preprocessing.skipped_samples import SkippedSamples


@overload
def calibrate(model: Problem, *, options: Options | None = None, progress: Progress | None = None) -> Result: ...


@overload
def calibrate(
    model: Model | str,
    data: Data | Sequence[Data],
    start: Start,
    target: str | float | None = None,
    *,
    options: Options | None = None,
    progress: Progress | None = None,
    **arguments: Unpack[ProblemArguments],
) -> Result: ...


@isolated
def calibrate(
    model: Model | str | Problem,
    data: Data | Sequence[Data] | None = None,
    start: Start | None = None,
    target: str | float | None = None,
    *,
    node: str | None = None,
    criteria: Sequence[Criterion] = (),
    test: Data | Sequence[Data] = (),
    free: Sequence[str] = ("*",),
    free_axes: Sequence[str] = (),
    smoothness: Factors = 0.0,
    bounds: Mapping[str, Bounds] | None = None,
    limits: Limits | None = None,
    pins: Sequence[Pin] = (),
    constraints: Sequence[Shape | Equality] = (),
    channels: Mapping[str, str] | None = None,
    shift: Shift | None = None,
    rounding: RoundingMethod | None = None,
    storage: str | Path | None = None,
    step: Mapping[str, float] | None = None,
    max_shift: float = MAX_SHIFT,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Result:
    """Find the values with which the model reproduces the data.

    Args:
        model: a model, formula text, or a problem, which has all but `options` and `progress`.
        data: training data; several datasets, or columns by name (a dict, a DataFrame). A column `time`, or an index of
            dates, is the time in s; `time [ms]` in ms. A function with its own step reads inputs interpolated onto it.
        start: the current calibration: a set, a result, a parameter or several, a calibration file, or a dict of
            numbers and parameters by name. A table needs a parameter, such as a `Curve`.
        target: the channel that the model's output shall follow, or a number; or give `criteria` instead.
        node: the output that follows the target, if the model has several.
        criteria: several targets, with weights and losses.
        test: data that are scored but not fitted.
        free: glob patterns of the parameters to fit; the others keep their start.
        free_axes: patterns of axes whose breakpoints to fit (`Group`, `Table.x`), like those of `Axis(..., free=True)`.
        smoothness: factor for all tables, or by parameter and axis, as `Result.smoothness` has them; "auto" in its
            place chooses it from the data.
        bounds: lower and upper bound of all values of a parameter, in its unit, by name. None means no bound.
        limits: least and largest value of a node at every scored training sample, by name, which may be an expression
            over nodes and channels; or a list of `Limit`. None means no limit.
        pins: exact values at given coordinates.
        constraints: ranges of slope or curvature along an axis (`Shape`), and sums of values (`Equality`).
        channels: the channel of a model input, if the names differ.
        shift: by channel, value(t) = recorded(t - shift), in s, steady-state points in samples; "auto" by dataset. Or
            by dataset and channel, as `Result.shifts` has them.
        rounding: "joint" rounds the fit to what a control unit stores, all values together; "nearest" each on its own.
        storage: the A2L file with the steps, offsets and limits of labels and breakpoints.
        step: by parameter, the step of its storable values, in its unit; precedes the file. By group axis, or axis of
            a table such as `MapTorque.x`, the step of its breakpoints.
        max_shift: the largest distance of a rounded value from the fit, in steps.
        options: iterations, tolerance, continuation, starts, steps.
        progress: called after each accepted step; may raise `Stop`.

    Returns:
        The result; a fit that fails is a result too, see `Result.status`.

    Raises:
        InputError: the input cannot be used; lists all problems.

    >>> calibrate("y = a + b * x", {"x": [0.0, 1.0, 2.0], "m": [1.0, 3.0, 5.0]}, {"a": 0.0, "b": 0.0}, "m").status
    'converged'
    """
    check_options(options, progress)
    stated: ProblemArguments = {
        "node": node,
        "criteria": criteria,
        "test": test,
        "free": free,
        "free_axes": free_axes,
        "smoothness": smoothness,
        "bounds": bounds,
        "limits": limits,
        "pins": pins,
        "constraints": constraints,
        "channels": channels,
        "shift": shift,
        "rounding": rounding,
        "storage": storage,
        "step": step,
        "max_shift": max_shift,
    }
    problem = problem_of(model, data, start, target, stated, "calibrate")
    result = run(problem, options or Options(), progress)
    return replace(result, warnings=(*weight_warnings(problem), *result.warnings))


def problem(
    model: Model | str,
    data: Data | Sequence[Data],
    start: Start,
    target: str | float | None = None,
    **arguments: Unpack[ProblemArguments],
) -> Problem:
    """Return the problem that `calibrate` would solve, to be calibrated, cross-validated and analysed.

    Args:
        model: a model, or formula text.
        data: training data.
        start: the current calibration.
        target: the channel that the model's output shall follow.
        arguments: all else as in `calibrate`.

    Returns:
        The problem. `calibrate`, `cross_validate` and `residuals` take it, and so do the plots of a result.

    Raises:
        InputError: the input cannot be used; lists all problems.
        ArgumentError: an argument is of a wrong kind.

    >>> own = problem("y = a * x", {"x": [1.0, 2.0], "m": [2.0, 4.0]}, {"a": 1.0}, target="m")
    >>> own.free_size, calibrate(own).parameters["a"].value
    (1, 2.0)
    """
    return ProblemSetup(model, data, start, target, **arguments).problem()


@isolated
def simulate(model: Model | str, data: Data, parameters: Start, channels: Mapping[str, str] | None = None) -> Dataset:
    """Evaluate the named nodes of the model at the samples of the data.

    Args:
        model: a model, or formula text.
        data: a dataset, or columns by name, as `calibrate` takes them.
        parameters: the calibration, or numbers by name.
        channels: the channel of a model input, if the names differ.

    Returns:
        A channel for each named node, Float[samples]. Samples at which an input has no value are left out; a warning,
        also in the `findings` of the dataset, states which.

    Raises:
        InputError: an input or a parameter of the model is missing, or the data do not fit its step.

    >>> simulate("y = 2 * x + k", {"x": [1.0, 2.0]}, {"k": 1.0})["y"].values
    array([3., 5.])
    """
    values = start_parameters(parameters, model)
    channels = channels or {}
    function = bound_model(model, values, [data], channels)
    warn(unused_names(parameters, function))
    graph = function.graph
    inputs = {channels.get(name, name) for name in graph.inputs}
    [dataset] = convert_units([to_dataset(data, "data", graph, inputs)], wanted_units(graph, channels))
    warn(unit_warnings(graph, [dataset], values, channels))
    findings = Findings(check_inputs(graph, [dataset], values, channels))
    findings.add(*step_findings(function, [dataset], function.step, dataset_location), *delay_findings(function, 0))
    findings.finish()
    # samples that a fit would not score are simulated as well
    finer = on_model_step(function, [replace(dataset, scored=None, warmup=0.0)], inputs)[0]
    bound = bind_inputs(finer, graph, channels, function.step)
    nodes = NodeSimulator(graph, values).dataset(bound, values)
    skipped = SkippedSamples.of(bound, channels, restarts=bool(graph.states), recorded=finer.scored)
    if skipped is not None:
        nodes = replace(nodes, findings=(skipped.finding(dataset_location(dataset)),))
        warn(nodes.findings)
    # on a finer step of the model, `scored` marks the samples that were recorded
    return nodes if finer.scored is None else recorded_samples(nodes, bound.scored)
