"""Steady-state points for models with memory: each point is held until the model has settled.

A point becomes a piece of constant inputs over several samples, which starts from the model's initial states. Its last
sample is scored, or the mean over a window at the end. The mean is computed inside the graph, so that its derivatives
are exact and a robust loss sees the mean: with share = 1 / window inside the window and 0 before it,

    m_k = share_k node_k + (m_{k-1} if keep_k else 0)

Data that are not held have share 1 and keep 0, so that m is the node itself.

Thousands of short pieces would cost more in calls than in samples. For the sums over samples the states are therefore
restarted inside the graph, by the age of a sample in its point, and many points run as one piece.
"""

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset, Settling
from kennfeld.graph import Graph, GraphBuilder, State
from kennfeld.graph.node import STEPS, TIME, extract

SHARE, KEEP = AVERAGING = ("\0share", "\0keep")  # inputs that no formula text can name
AGE = "\0age"  # steps since the point began; infinite in data that are not held
MAX_PIECES = 64  # into which the points of a dataset are grouped


@dataclass(frozen=True)
class HoldPlan:
    """Simulation of a held point: `samples` of `step` seconds, of which the last `window` are averaged."""

    samples: int
    window: int
    step: float

    def columns(self, points: int) -> dict[str, Float]:
        """Return the clock and averaging inputs of a number of points, one after the other: Float[points * samples]."""
        # keep is 0 at the first sample of the window, at which the sum begins
        number = np.arange(self.samples)
        inside = number >= self.samples - self.window
        point = {
            **dict.fromkeys(STEPS, np.full(self.samples, self.step)),
            TIME: self.step * number,
            SHARE: inside / self.window,
            KEEP: (inside & (number > self.samples - self.window)).astype(np.float64),
        }
        return {name: np.tile(column, points) for name, column in point.items()}

    def mean(self, values: Float) -> Float:
        """Average each point over its window: Float[..., points * samples] -> Float[..., points]."""
        windows = values.reshape(*values.shape[:-1], -1, self.samples)[..., self.samples - self.window :]
        mean: Float = windows.mean(axis=-1)
        return mean


def is_settled(dataset: Dataset, graph: Graph) -> bool:
    """Return whether the points of a dataset are held: a model without memory and clock needs no time."""
    return dataset.settling is not None and graph.is_timed


def plan_hold(dataset: Dataset, settling: Settling, model_step: float | None) -> HoldPlan:
    """Return how a point is held, in whole steps; its first sample is at 0 s, its last at `settling.seconds`."""
    step = settling.step or model_step
    if step is None:
        message = f"settle = {settling.seconds:g} s requires a step, but neither the dataset nor the model defines one"
        raise InputError.of(Location(f"dataset {dataset.name}"), message, "Set the step of the model in s.")
    samples = max(round(settling.seconds / step), 1) + 1
    return HoldPlan(samples, min(max(round(settling.average / step), 1), samples), step)


def needs_average(graph: Graph, datasets: Sequence[Dataset]) -> bool:
    """Return whether any of the datasets requires a mean over a window."""
    return any(is_settled(d, graph) and d.settling is not None and d.settling.average > 0 for d in datasets)


def average_window(b: GraphBuilder, node: int) -> int:
    """Return a node that is the mean of another one over the window, at its last sample."""
    share, keep = b.input(SHARE), b.input(KEEP)
    before = b.state()
    zero = b.const(0.0)
    summed = b.call("add", b.call("mul", share, node), b.call("select", keep, before, zero))
    mean = b.call("select", share, summed, zero)
    b.close(before, zero, mean)
    return mean


def unheld_inputs(graph: Graph, samples: int) -> Mapping[str, Float]:
    """Return the averaging inputs of data that are not held, if the graph reads them; views of single numbers."""
    if set(AVERAGING).isdisjoint(graph.inputs):
        return {}
    return {SHARE: np.broadcast_to(1.0, samples), KEEP: np.broadcast_to(0.0, samples)}


def sample_ages(hold: HoldPlan | None, samples: int) -> dict[str, Float]:
    """Return the input that a graph from `restart_states` reads: steps since the point began, Float[samples]."""
    age = np.full(samples, np.inf) if hold is None else np.arange(samples, dtype=np.float64) % hold.samples
    return {AGE: age}


def group_points(starts: Int) -> Int:
    """Group neighbouring points, given by their starts Int[points], into at most `MAX_PIECES` pieces; return theirs."""
    # every nth start, n rounded up
    return starts[:: -(-starts.size // MAX_PIECES)] if starts.size else starts


def restart_states(graph: Graph) -> Graph:
    """Return the graph with states that restart when a point begins, after `latency` steps of their initial value.

    The graph is returned unchanged if an initial value depends on itself, which is reported when it runs.
    """
    # states come after their initial values
    needs = {
        at: [graph.states[node.payload].init] if node.op == "state" else list(node.args)
        for at, node in enumerate(graph.nodes)
    }
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError:
        return graph
    b = GraphBuilder()
    b.states.extend(graph.states)
    number: dict[int, int] = {}
    for at in order:
        node = graph.nodes[at]
        number[at] = b.rebuild(node, tuple(number[a] for a in node.args))
        if node.op == "state":
            state = graph.states[node.payload]
            number[at] = _restart(b, number[at], number[state.init], state.latency)
    for i, state in enumerate(graph.states):
        b.states[i] = State(number[state.init], number[state.next], state.latency)
    names = {name: number[at] for name, at in graph.names.items()}
    return extract(b.nodes, b.states, names, graph.units, graph.outputs)


def _restart(b: GraphBuilder, state: int, init: int, latency: int) -> int:
    """Return the value of a state; its initial value until it is as old as its latency."""
    age = b.input(AGE)
    first = init
    if latency > 1:
        delayed = b.state()
        # the initial value of the point's first step, kept by a state: the node itself may change in later steps
        first = b.call("select", b.call("lt", age, b.const(1.0)), init, delayed)
        b.close(delayed, init, first)
    return b.call("select", b.call("lt", age, b.const(float(latency))), first, state)
