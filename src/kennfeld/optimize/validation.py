"""Checks of a problem before anything is compiled: limits, shared axes, bounds, time steps and memory."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.free_axes import AxisKey, FreeAxis
from kennfeld.graph.traversal import dependents
from kennfeld.models import Model
from kennfeld.optimize.limit_nodes import add_limit_nodes, channels_of, limit_sides
from kennfeld.optimize.problem import Problem

STEP_TOLERANCE = 1e-3  # relative difference of steps that time stamps may have by rounding
MAX_BYTES = 4e9  # of all delays, or of one matrix; a fit and its trust keep several of them
MAX_LISTED = 5


def check_limits(problem: Problem) -> list[Finding]:
    """Report unknown names in output limits, and conditions that depend on free parameters."""
    try:
        model = add_limit_nodes(problem.model, problem.limits)
    except InputError as error:
        return list(error.findings)
    graph = model.graph
    live = dependents(graph, lambda node: node.op == "lookup" and node.payload in problem.free_names)
    unknown = channels_of(problem.model, problem.limits)

    def remedy(name: str, data: Dataset) -> str:
        return nearest(name, [*problem.model.graph.names, *problem.parameters, *data])

    findings = [
        Finding("limit", f"unknown node or channel {name} (dataset {data.name})", remedy(name, data))
        for name in unknown
        for data in problem.datasets
        if data.use == "training" and problem.channels.get(name, name) not in data
    ]
    findings += [
        Finding(f"limit {side}", f"its condition {side.limit.where} depends on a free parameter", "Use channels only.")
        for side in limit_sides(problem.limits)
        if side.limit.where and graph.names[side.where] in live
    ]
    return findings


def check_shared_axes(axes: Mapping[AxisKey, FreeAxis], free: Collection[str]) -> list[Finding]:
    """Report tables that would change with a free axis although they are not fitted."""
    findings = []
    for key, axis in axes.items():
        others = list(dict.fromkeys(name for name, _ in axis.places if name not in free))
        if others:
            names = ", ".join(others[:MAX_LISTED]) + (", ..." if len(others) > MAX_LISTED else "")
            message = f"its breakpoints are free, but {names} on it {'is' if len(others) == 1 else 'are'} not fitted"
            remedy = "Such a table would change with the axis: fit it as well, or give it an axis of its own."
            findings.append(Finding(f"axis {key}", message, remedy))
    return findings


def unbounded(problem: Problem, place: Callable[[str], str] = "bounds of {}".format) -> list[Finding]:
    """Report free parameters without finite bounds on both sides, and free axes; locked values need no bounds."""
    findings = []
    for name in problem.free_names:
        parameter = problem.parameters[name]
        open_sides = [
            side
            for side, bound in (("lower", parameter.lower), ("upper", parameter.upper))
            if not np.all(np.isfinite(bound) | parameter.locked)
        ]
        if open_sides:
            message = f'{name} has no {" and no ".join(open_sides)} bound; method = "global" requires both'
            findings.append(Finding(place(name), message, "Write bounds = [lower, upper], as narrow as you know them."))
    for key in problem.free_axes:
        message = f'method = "global" cannot fit breakpoints, but those of {key} are free'
        findings.append(Finding(place(key.owner), message, 'Fix them, or use method = "gauss-newton".'))
    return findings


def step_findings(
    model: Model, datasets: Iterable[Dataset], step: float | None, place: Callable[[Dataset], str]
) -> Iterator[Finding]:
    """Yield errors for datasets whose time step differs from that of the model's surrogates.

    Args:
        model: the model.
        datasets: its data.
        step: the model's own step in s, or None.
        place: the location of a dataset in messages.
    """
    trained = _training_steps(model)
    for data in datasets if trained else ():
        steps = _steps(data) if step is None else np.array([step])
        if steps is None:
            message = f"{', '.join(trained)} runs in time, but dataset {data.name} has no time stamps"
            yield Finding(place(data), message, "Name the time channel `time`.")
            continue
        for name, own in trained.items():
            wrong = steps[np.abs(steps - own) > STEP_TOLERANCE * own]
            if wrong.size:
                message = f"{name} was trained at steps of {own:g} s, and dataset {data.name} has one of {wrong[0]:g} s"
                yield Finding(place(data), message, f"Write raster = {own:g}, or train it at the step of the data.")


def _training_steps(model: Model) -> dict[str, float]:
    if not model.surrogates:
        return {}
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate

    return {s.name: s.step for s in model.surrogates if isinstance(s, DynamicSurrogate)}


def _steps(data: Dataset) -> Float | None:
    """Return the time steps within pieces in s."""
    return None if data.time is None else np.delete(np.diff(data.time), data.starts[1:] - 1)


def delay_findings(model: Model, values: int) -> list[Finding]:
    """Return an error if the delays of a model do not fit into memory.

    Args:
        model: the model; each step of each delay stores a value, and its derivative for each free value.
        values: how many values are free; 0 for a simulation.
    """
    graph = model.graph
    steps = sum(state.latency for state in graph.states)
    size = 8.0 * steps * (2 + values)
    if size <= MAX_BYTES:
        return []
    longest = max(range(len(graph.states)), key=lambda i: graph.states[i].latency)
    behind = dependents(graph, lambda node: node.op == "state" and node.payload == longest)
    name = min((name for name, at in graph.names.items() if at in behind), key=graph.names.__getitem__, default="")
    message = f"a delay of {graph.states[longest].latency:.10g} steps needs {size / 1e9:.3g} GB of memory"
    return [Finding(model.places.get(name, model.source), message, "Use a shorter delay or a longer step.")]


def matrix_findings(place: str, values: int) -> list[Finding]:
    """Return an error if the matrix of a fit, with a row and a column for each free value, does not fit into memory.

    Args:
        place: location of the message.
        values: how many values are free.
    """
    size = 8.0 * values**2
    if size <= MAX_BYTES:
        return []
    message = f"{values} free values need matrices of {size / 1e9:.3g} GB"
    return [Finding(place, message, "Use fewer breakpoints, or fit fewer parameters at once.")]
