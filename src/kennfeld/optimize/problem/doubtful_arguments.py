"""Warnings about arguments of functions: fitted time constants close to the step, and limits in the wrong order."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import CLOCK, Graph, Node
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.node import STEP, extract
from kennfeld.graph.traversal import ancestors
from kennfeld.optimize.problem.problem import Problem, time_constants

SHORTEST_LAG: Final = 5.0  # steps; below, T of an implicit Euler step differs from that of the lag by 10 % and more
_SAMPLES, _STEPS = 5_000, 1_000  # of each dataset, without and with memory
_ROUNDING = 1e-9
_NAMED = 4
_OF_SHORT_LAGS = (
    "Keep it if the control unit computes PT1 so, at the same step. For the time constant of a physical lag, write "
    "PT1exact, or use a finer raster."
)


class _OrderedPair(NamedTuple):
    """Two nodes of which the first must not exceed the second, and what they are."""

    low: int
    high: int
    kind: str


def find_short_lags(problem: Problem, parameters: ParameterSet) -> Iterator[Finding]:
    """Yield a warning for each fitted time constant of a PT1 below five steps.

    One implicit Euler step multiplies the distance to the input by T/(T + dt), as an exact lag does whose time constant
    is dt/log(1 + dt/T).

    Args:
        problem: the problem, with its training data.
        parameters: the fitted values.
    """
    graph = problem.graph
    for at in time_constants(graph):
        names = sorted(_looked_up(graph, [at]) & set(problem.free_names))
        if not names or not _is_implicit(graph, at):
            continue
        T, dt = _over_training(problem, at, parameters)
        short = (T > 0) & (SHORTEST_LAG * (1 - _ROUNDING) * dt > T)
        if short.any():
            message = _describe_short_lag(names, T, dt, float(short.mean()))
            yield Finding(_first_use(problem, names), message, _OF_SHORT_LAGS, severity="warning")


def _describe_short_lag(names: Sequence[str], T: Float, dt: Float, share: float) -> str:
    """Describe a time constant that is below five steps at a share of the samples."""
    worst = int(np.argmin(np.where(T > 0, T / dt, np.inf)))
    lag, step = float(T[worst]), float(dt[worst])
    where = f" at {share:.0%} of the samples, down to {lag:.3g} s at a step of {step:.3g} s"
    place = f" ({lag:.3g} s at a step of {step:.3g} s)" if share == 1 else where
    return (
        f"a time constant of PT1 that depends on {join_names(names, _NAMED)} is below {SHORTEST_LAG:g} steps{place}; "
        f"PT1 is an implicit Euler step, which then decays like a lag of {step / np.log1p(step / lag):.3g} s"
    )


def _first_use(problem: Problem, names: Sequence[str]) -> Location:
    """Return where the function first uses one of these parameters, as far as it is known."""
    locations = problem.model.locations
    return next((locations[name] for name in names if name in locations), Location())


def find_crossed(problem: Problem, parameters: ParameterSet) -> Iterator[Finding]:
    """Yield a warning for each pair of limits, or thresholds of a hysteresis, that parameters have in the wrong order.

    Limits that depend on inputs are not examined: they may cross at some samples only, as in `min(max(x, a), b)`.
    """
    graph = problem.model.graph
    for pair in dict.fromkeys(_pairs(graph)):
        names = sorted(_looked_up(graph, pair[:2]))
        if not names or not _is_fixed(graph, pair[:2]):
            continue
        part = extract(graph.nodes, (), {"low": pair.low, "high": pair.high}, {}, ())
        # limits of a rate are multiplied by the step, whose size does not change their order
        values = evaluate(part, {STEP: np.ones(1)}, parameters)
        low, high = (float(np.ravel(values[name])[0]) for name in ("low", "high"))
        if low > high:
            message = f"{pair.kind} that depend on {join_names(names, _NAMED)} are crossed: {low:.4g} > {high:.4g}"
            remedy = "Exchange them, or set bounds that keep them apart."
            yield Finding(_first_use(problem, names), message, remedy, severity="warning")


def _pairs(graph: Graph) -> Iterator[_OrderedPair]:
    """Yield the limits of `min(max(x, low), high)` and the thresholds of each hysteresis."""
    nodes = graph.nodes
    for op, args, _ in nodes:
        if op == "min" and nodes[args[0]].op == "max":
            low, high = nodes[args[0]].args[1], args[1]
            if nodes[low].op == nodes[high].op == "mul" and nodes[low].args[1] == nodes[high].args[1]:
                low, high = nodes[low].args[0], nodes[high].args[0]  # rates of a limiter, times the step
            yield _OrderedPair(low, high, "limits")
        elif op == "select" and (pair := _thresholds(nodes, args)) is not None:
            yield pair


def _thresholds(nodes: Sequence[Node], args: Sequence[int]) -> _OrderedPair | None:
    """Return off and on of `if(x >= on, 1, if(x <= off, 0, before))`, None for other selections."""
    above, one, other = (nodes[at] for at in args)
    if above.op != "ge" or one.payload != 1.0 or other.op != "select":
        return None
    below, zero, before = (nodes[at] for at in other.args)
    if below.op != "le" or zero.payload != 0.0 or before.op != "state" or below.args[0] != above.args[0]:
        return None
    return _OrderedPair(below.args[1], above.args[1], "thresholds of a hysteresis")


def _looked_up(graph: Graph, nodes: Sequence[int]) -> set[str]:
    """Return the parameters on which nodes depend within a sample."""
    return {name for at in ancestors(graph.nodes, nodes) if (name := graph.nodes[at].parameter) is not None}


def _is_fixed(graph: Graph, nodes: Sequence[int]) -> bool:
    """Return True if nodes depend on parameters and constants only."""
    return {graph.nodes[at].op for at in ancestors(graph.nodes, nodes)}.isdisjoint(("input", "state", "external"))


def _is_implicit(graph: Graph, T: int) -> bool:
    """Return True if T is the time constant of an implicit Euler step, dt / (T + dt)."""
    dt = next((at for at, node in enumerate(graph.nodes) if node == ("input", (), STEP)), None)
    # the lag is written as dt / (T + dt), in this order
    sums = {at for at, node in enumerate(graph.nodes) if node.op == "add" and node.args == (T, dt)}
    return any(node.op == "div" and node.args[0] == dt and node.args[1] in sums for node in graph.nodes)


def _over_training(problem: Problem, at: int, parameters: ParameterSet) -> tuple[Float, Float]:
    """Return a node and the step at samples of the training data; nothing if code outside of the graph computes it."""
    graph = problem.graph
    part = extract(graph.nodes, graph.states, {"T": at}, {}, ())
    values, steps = [np.empty(0)], [np.empty(0)]
    for bound in () if any(node.op == "external" for node in part.nodes) else problem.training:
        last = min(bound.count, _STEPS if part.states else bound.count)
        # with memory, the first samples one after the other; without, some from all over the data
        stride = 1 if part.states else -(-last // _SAMPLES) or 1
        here = slice(0, last, stride) if bound.picked is None else bound.kept[:last:stride]
        columns = {name: bound.inputs[name][here] for name in part.inputs}
        columns |= {name: bound.clock[name][:last:stride] for name in CLOCK if name in bound.clock}
        if last:
            starts = [int(start) for start in bound.starts if start < last] if part.states else [0]
            values.append(np.broadcast_to(evaluate(part, columns, parameters, starts)["T"], columns[STEP].shape))
            steps.append(columns[STEP])
    return np.concatenate(values), np.concatenate(steps)
