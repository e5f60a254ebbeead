"""The two sides of limits of outputs: nodes of the model that shall not exceed a number.

Breakpoints as values to be fitted: which axes move, and what they keep while they do.

Search without gradients, for costs that jump: CMA-ES within bounds, started anew while that helps.

A model whose events happen earlier or later with its values (a governor triggered by the crank, a relay, quantised
code) has a cost of steps: its derivatives are exact and say nothing of them. The covariance matrix adaptation
evolution strategy (N. Hansen, A. Ostermeier, Completely Derandomized Self-Adaptation in Evolution Strategies, 2001)
compares costs and asks for nothing else. The first run begins at the start, the next ones anywhere within the bounds
with twice the population of the one before (A. Auger, N. Hansen, A Restart CMA Evolution Strategy With Increasing
Population Size, 2005). A descent from the best values ends the search.

A data-driven model in time has a step of its own: at another one it means nothing.

The memory that long delays and many free values would take: better refused by a check than during a search.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.free_axes import AxisKey, FreeAxis
from kennfeld.graph.traversal import dependent
from kennfeld.models import Model
from kennfeld.optimize.limit_nodes import add_limit_nodes, channels_of, limit_sides
from kennfeld.optimize.problem import Problem

__all__ = ["check_limits", "check_shared_axes", "delay_findings", "matrix_findings", "step_findings", "unbounded"]

SAME = 1e-3  # relative difference of steps that time stamps may have by rounding

MOST = 4e9  # bytes of all delays, or of one matrix, of which a fit and its account of trust keep several


def check_limits(problem: Problem) -> list[Finding]:
    """What is wrong with the limits of a problem."""
    try:
        model = add_limit_nodes(problem.model, problem.limits)
    except InputError as error:
        return list(error.findings)
    graph = model.graph
    live = dependent(graph, lambda node: node.op == "lookup" and node.payload in problem.free_names)
    unknown = channels_of(problem.model, problem.limits)

    def remedy(name: str, data: Dataset) -> str:
        return nearest(name, [*problem.model.graph.names, *problem.parameters, *data])

    findings = [
        Finding("limit", f"{name} is no node of the function and no channel of dataset {data.name}", remedy(name, data))
        for name in unknown
        for data in problem.datasets
        if data.use == "training" and problem.channels.get(name, name) not in data
    ]
    findings += [
        Finding(f"limit {side}", f"its condition {side.limit.where} depends on a free parameter", "Use channels alone.")
        for side in limit_sides(problem.limits)
        if side.limit.where and graph.names[side.where] in live
    ]
    return findings


def check_shared_axes(axes: Mapping[AxisKey, FreeAxis], free: Collection[str]) -> list[Finding]:
    """Tables that would change with an axis although they are not fitted."""
    findings = []
    for key, axis in axes.items():
        others = list(dict.fromkeys(name for name, _ in axis.places if name not in free))
        if others:
            names = ", ".join(others[:5]) + (", ..." if len(others) > 5 else "")
            message = f"its breakpoints are free, but {names} on it {'is' if len(others) == 1 else 'are'} not fitted"
            remedy = "Such a table would change with the axis: fit it as well, or give it an axis of its own."
            findings.append(Finding(f"axis {key}", message, remedy))
    return findings


def unbounded(problem: Problem, place: Callable[[str], str] = "bounds of {}".format) -> list[Finding]:
    """A finding for each free parameter that has no finite bounds on both sides; locked values need none."""
    found = []
    for name in problem.free_names:
        parameter = problem.parameters[name]
        open_sides = [
            side
            for side, bound in (("lower", parameter.lower), ("upper", parameter.upper))
            if not np.all(np.isfinite(bound) | parameter.locked)
        ]
        if open_sides:
            message = f"{name} has no {' and no '.join(open_sides)} bound, and a global search needs both"
            found.append(Finding(place(name), message, "Write bounds = [lower, upper], as narrow as you know them."))
    for key in problem.free_axes:
        message = f"the breakpoints of {key} are free, and a global search places none"
        found.append(Finding(place(key.owner), message, "Fix them, or use the method gauss-newton."))
    return found


def step_findings(
    model: Model, datasets: Iterable[Dataset], step: float | None, place: Callable[[Dataset], str]
) -> Iterator[Finding]:
    """Datasets whose step is not that of the model's surrogates; `step` is the model's own, where it has one."""
    wanted = _steps_of(model)
    for data in datasets if wanted else ():
        steps = _steps(data) if step is None else np.array([step])
        if steps is None:
            message = f"{', '.join(wanted)} runs in time, but dataset {data.name} has no time stamps"
            yield Finding(place(data), message, "Name the time channel `time`.")
            continue
        for name, own in wanted.items():
            wrong = steps[np.abs(steps - own) > SAME * own]
            if wrong.size:
                message = f"{name} was trained at steps of {own:g} s, and dataset {data.name} has one of {wrong[0]:g} s"
                yield Finding(place(data), message, f"Write raster = {own:g}, or train it at the step of the data.")


def _steps_of(model: Model) -> dict[str, float]:
    if not model.surrogates:
        return {}
    from kennfeld.surrogate import DynamicSurrogate

    return {s.name: s.step for s in model.surrogates if isinstance(s, DynamicSurrogate)}


def _steps(data: Dataset) -> Float | None:
    """The steps within pieces, in s."""
    return None if data.time is None else np.delete(np.diff(data.time), data.starts[1:] - 1)


def delay_findings(model: Model, values: int) -> list[Finding]:
    """Return an error if the delays of a model keep more numbers than fit into memory.

    Args:
        model: the model; each step of each delay keeps a value, and its slope with respect to each free value.
        values: how many values are free; 0 for a simulation.
    """
    graph = model.graph
    steps = sum(state.latency for state in graph.states)
    size = 8.0 * steps * (2 + values)
    if size <= MOST:
        return []
    longest = max(range(len(graph.states)), key=lambda i: graph.states[i].latency)
    behind = dependent(graph, lambda node: node.op == "state" and node.payload == longest)
    name = min((name for name, at in graph.names.items() if at in behind), key=graph.names.__getitem__, default="")
    message = f"a delay of {graph.states[longest].latency:.10g} steps needs {size / 1e9:.3g} GB of memory"
    return [
        Finding(model.places.get(name, model.source), message, "Delay by fewer steps, or give the model a longer step.")
    ]


def matrix_findings(place: str, values: int) -> list[Finding]:
    """Return an error if the matrix of a fit, with a row and a column for each free value, does not fit into memory.

    Args:
        place: where the parameters are said to be free.
        values: how many values are free.
    """
    size = 8.0 * values**2
    if size <= MOST:
        return []
    message = f"{values} values to fit need matrices of {size / 1e9:.3g} GB"
    return [Finding(place, message, "Use fewer breakpoints, or fit fewer parameters at once.")]
