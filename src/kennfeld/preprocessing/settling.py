"""Steady-state points for models with memory: each point held until the model has settled.

A point becomes a piece of its own, constant inputs over a few samples, which starts from the model's first values. What
counts is the last sample, or the mean over a window at the end. The mean is computed inside the graph, so that its
derivatives are exact and a robust loss judges the mean: a memory adds up `share` times the node, and starts anew where
`keep` is 0. Data that are not held have share 1 and keep 0, which leaves the node as it is.

Thousands of short pieces would cost more in calls than in samples. For the sums over samples the memories therefore
start anew inside the graph, by the age of a sample in its point, and many points run as one piece.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.dataset import Dataset, Settling
from kennfeld.errors import InputError
from kennfeld.graph import CLOCK, OPERATIONS, Graph, GraphBuilder, State
from kennfeld.graph.node import extract

__all__ = [
    "AVERAGING",
    "HoldPlan",
    "averaged",
    "averages",
    "fewer_pieces",
    "hold_of",
    "is_settled",
    "not_held",
    "restart_states",
    "sample_ages",
]

SHARE, KEEP = AVERAGING = ("\0share", "\0keep")  # inputs that no formula text can name
AGE = "\0age"  # steps since the point began; infinite in data that are not held
PIECES = 64  # that the points of a dataset are dealt into


@dataclass(frozen=True)
class HoldPlan:
    """A point as the model runs on it: `samples` of `step` seconds, of which the last `window` are averaged."""

    samples: int
    window: int
    step: float

    def columns(self, points: int) -> dict[str, Float]:
        """The clock and the averaging of so many points, one after the other."""
        number = np.arange(self.samples)
        inside = number >= self.samples - self.window
        one = {
            "dt": np.full(self.samples, self.step),
            "t": self.step * number,
            SHARE: inside / self.window,
            KEEP: (inside & (number > self.samples - self.window)).astype(np.float64),
        }
        return {name: np.tile(column, points) for name, column in one.items()}

    def mean(self, values: Float) -> Float:
        """One value a point, from those of all samples in the last axis."""
        windows = values.reshape(*values.shape[:-1], -1, self.samples)[..., self.samples - self.window :]
        mean: Float = windows.mean(axis=-1)
        return mean


def is_settled(dataset: Dataset, graph: Graph) -> bool:
    """Whether the points of a dataset are held: without memory and clock a point needs no time."""
    return dataset.settling is not None and (bool(graph.states) or _reads(graph, CLOCK))


def hold_of(dataset: Dataset, settling: Settling, model_step: float | None) -> HoldPlan:
    """How long a point is held, in whole steps; the first sample is at 0 s, the last at `settling.seconds`."""
    step = settling.step or model_step
    if step is None:
        message = f"its points are held for {settling.seconds:g} s, but neither it nor the model has a step"
        raise InputError.of(f"dataset {dataset.name}", message, "Give the step of the model in s.")
    samples = max(round(settling.seconds / step), 1) + 1
    return HoldPlan(samples, min(max(round(settling.average / step), 1), samples), step)


def averages(graph: Graph, datasets: Sequence[Dataset]) -> bool:
    """Whether a mean over a window is asked for in any of the datasets."""
    return any(is_settled(d, graph) and d.settling is not None and d.settling.average > 0 for d in datasets)


def averaged(b: GraphBuilder, node: int) -> int:
    """A node that is the mean of another one over the window, at the last sample of it."""
    share, keep = b.input(SHARE), b.input(KEEP)
    before = b.state()
    zero = b.const(0.0)
    summed = b.call("add", b.call("mul", share, node), b.call("select", keep, before, zero))
    mean = b.call("select", share, summed, zero)
    b.close(before, zero, mean)
    return mean


def not_held(graph: Graph, samples: int) -> Mapping[str, Float]:
    """The averaging of data that are not held, where the graph reads it; takes no memory."""
    return (
        {SHARE: np.broadcast_to(1.0, samples), KEEP: np.broadcast_to(0.0, samples)} if _reads(graph, AVERAGING) else {}
    )


def sample_ages(hold: HoldPlan | None, samples: int) -> dict[str, Float]:
    """The input that a restarted graph reads."""
    age = np.full(samples, np.inf) if hold is None else np.arange(samples, dtype=np.float64) % hold.samples
    return {AGE: age}


def fewer_pieces(starts: Int) -> Int:
    """The starts of at most `PIECES` pieces of neighbouring points."""
    return starts[:: -(-starts.size // PIECES)] if starts.size else starts


def restart_states(graph: Graph) -> Graph:
    """The graph whose memories start anew where a point begins, after `latency` steps of their first value.

    The same graph where a first value depends on itself; whoever runs it says so.
    """
    order = _firsts_before_reads(graph)
    if order is None:
        return graph
    b = GraphBuilder()
    b.states.extend(graph.states)
    number: dict[int, int] = {}
    for at in order:
        op, args, payload = graph.nodes[at]
        given = tuple(number[a] for a in args)
        number[at] = b.call(op, *given) if op in OPERATIONS else b.node(op, given, payload)
        if op == "state":
            state = graph.states[payload]
            number[at] = _read(b, number[at], number[state.init], state.latency)
    for i, state in enumerate(graph.states):
        b.states[i] = State(number[state.init], number[state.next], state.latency)
    names = {name: number[at] for name, at in graph.names.items()}
    return extract(b.nodes, b.states, names, graph.units, graph.outputs)


def _read(b: GraphBuilder, state: int, init: int, latency: int) -> int:
    """What a memory holds; its first value until it is as old as its latency."""
    age = b.input(AGE)
    first = init
    if latency > 1:
        held = b.state()
        first = b.call("select", b.call("lt", age, b.const(1.0)), init, held)
        b.close(held, init, first)
    return b.call("select", b.call("lt", age, b.const(float(latency))), first, state)


def _firsts_before_reads(graph: Graph) -> list[int] | None:
    """All nodes, each after those it is computed from and a memory after its first value; None if that is a loop."""
    needs = {
        at: [graph.states[node.payload].init] if node.op == "state" else list(node.args)
        for at, node in enumerate(graph.nodes)
    }
    try:
        return list(TopologicalSorter(needs).static_order())
    except CycleError:
        return None


def _reads(graph: Graph, names: Sequence[str]) -> bool:
    return any(node.op == "input" and node.payload in names for node in graph.nodes)
