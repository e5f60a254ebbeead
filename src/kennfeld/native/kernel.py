"""A model compiled for one set of free parameters: cost, gradient and Gauss-Newton matrix as native functions."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float
from kennfeld.graph import Node
from kennfeld.graph.derivative import Linearization, differentiate
from kennfeld.graph.lowering import Lowered
from kennfeld.native.emitter import Layout
from kennfeld.native.entries import entries_of
from kennfeld.native.output import Output
from kennfeld.native.step import compiled, cost_code
from kennfeld.native.sweeps import Pattern, sweeps
from kennfeld.native.tape import start_code, tape_code
from kennfeld.parameters import ParameterSet

__all__ = ["Kernel", "Values", "input_rows", "order_values"]


@dataclass(frozen=True)
class Values:
    """All values of the looked-up parameters in one array: those of free parameters first, as columns of J.

    Parameters that can reach a state come before the others; `reach` counts their values.
    """

    offsets: dict[str, int]
    free: int
    reach: int
    total: int

    def pack(self, parameters: ParameterSet) -> Float:
        """The array that holds these parameters."""
        flat = np.empty(self.total)
        for name, at in self.offsets.items():
            values = parameters[name].values
            flat[at : at + values.size] = values.ravel()
        return flat

    def unpack(self, flat: Float, parameters: ParameterSet) -> ParameterSet:
        """The set with the free values replaced."""
        changed = [
            parameters[name].with_values(flat[at : at + parameters[name].size])
            for name, at in self.offsets.items()
            if at < self.free
        ]
        return parameters.with_parameters(*changed)


def order_values(line: Linearization, parameters: ParameterSet, used: Collection[str], free: Collection[str]) -> Values:
    """Offsets of the parameters in the array of values."""
    states = [*line.slopes.reach[len(line.outputs) :], *line.start_slopes.reach]
    reaching = {line.nodes[at].payload.name for row in states for at in row if at not in line.seeds}
    groups = [
        [n for n in used if n in free and n in reaching],
        [n for n in used if n in free and n not in reaching],
        [n for n in used if n not in free],
    ]
    offsets: dict[str, int] = {}
    ends, at = [], 0
    for group in groups:
        for name in group:
            offsets[name] = at
            at += parameters[name].size
        ends.append(at)
    return Values(offsets, free=ends[1], reach=ends[0], total=at)


class Kernel:
    """The native functions of a lowered graph, for given outputs and free parameters.

    Making one compiles it. A kernel holds no data and can be used by several threads at once.
    """

    def __init__(
        self, lowered: Lowered, outputs: Sequence[Output], parameters: ParameterSet, free: Collection[str]
    ) -> None:
        graph = lowered.graph
        self.outputs = tuple(outputs)
        self.line = differentiate(graph, [output.node for output in outputs], free)
        self.values = order_values(self.line, parameters, tuple(lowered.shapes), free)
        self.layout = Layout(
            input_rows(graph.nodes),
            self.values.offsets,
            lowered.shapes,
            lowered.axes,
            tuple(state.latency for state in graph.states),
        )
        self.axes = self.layout.breakpoints
        self.pattern = _pattern(self.line)
        self.entries = entries_of(self.line, self.layout, self.line.atoms)
        self.start_entries = entries_of(self.line, self.layout, self.line.start_atoms)
        self.sweeps = sweeps(self.pattern)
        codes = [cost_code(self.line, self.layout, self.outputs), tape_code(self.line, self.layout, self.outputs)]
        if self.line.states:
            codes.append(start_code(self.line, self.layout))
        self.cost, self.tape, *rest = compiled(*codes)
        self.start = rest[0] if rest else None

    @property
    def hints(self) -> int:
        """Integers that a run needs for ring buffers and searches."""
        return max(self.layout.hints, 1)

    @property
    def accumulates(self) -> bool:
        """Whether backward and forward sweeps are cheaper than rows, with states."""
        pattern = self.pattern
        return pattern.accumulates and pattern.carried * self.entries.room < self.values.free / 2


def _pattern(line: Linearization) -> Pattern:
    m, n = len(line.outputs), len(line.seeds)
    present = [frozenset(i for i, seed in enumerate(line.seeds) if seed in row) for row in line.slopes.reach]
    c, a = (
        frozenset(row * n + i for row, columns in enumerate(rows) for i in columns)
        for rows in (present[:m], present[m:])
    )
    return Pattern(m, tuple(line.states[i].latency for i in line.carried), c, a)


def input_rows(nodes: Sequence[Node]) -> dict[str, int]:
    """The row of each input in the data."""
    return {name: i for i, name in enumerate(dict.fromkeys(n.payload for n in nodes if n.op == "input"))}
