"""`Kernel`: a lowered graph compiled for one set of outputs and free parameters."""

from collections.abc import Sequence

from kennfeld.graph import Node
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.lookup_lowering import Free, LoweredGraph
from kennfeld.graph.value_layout import order_values
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.jacobian_rows import entries_of
from kennfeld.native.sample_loop import Output, compile_functions, cost_code
from kennfeld.native.sweeps import sweeps
from kennfeld.native.tape import start_code, tape_code
from kennfeld.native.tape_layout import TapeLayout
from kennfeld.parameter_set import ParameterSet


class Kernel:
    """Native functions of a lowered graph, for given outputs and free parameters.

    Construction compiles it. A kernel holds no data and can be used by several threads at once.
    """

    def __init__(self, lowered: LoweredGraph, outputs: Sequence[Output], parameters: ParameterSet, free: Free) -> None:
        graph = lowered.graph
        self.outputs = tuple(outputs)
        self.line = differentiate(graph, [output.node for output in outputs], free)
        self.values = order_values(self.line, parameters, tuple(lowered.shapes), free)
        self.layout = MemoryLayout(
            input_rows(graph.nodes),
            self.values.offsets,
            lowered.shapes,
            lowered.axes,
            tuple(state.latency for state in graph.states),
            self.values.moving,
            self.values.free,
        )
        self.axes = self.layout.breakpoints
        self.pattern = TapeLayout.of(self.line)
        self.entries = entries_of(self.line, self.layout, self.line.atoms)
        self.start_entries = entries_of(self.line, self.layout, self.line.start_atoms)
        self.sweeps = sweeps(self.pattern)
        codes = [cost_code(self.line, self.layout, self.outputs), tape_code(self.line, self.layout, self.outputs)]
        if self.line.states:
            codes.append(start_code(self.line, self.layout))
        self.cost, self.tape, *rest = compile_functions(*codes)
        self.start = rest[0] if rest else None

    @property
    def hints(self) -> int:
        """Number of integers that a run needs for ring buffers and searches."""
        return max(self.layout.hints, 1)

    @property
    def accumulates(self) -> bool:
        """True if backward and forward sweeps are cheaper than rows, with states."""
        pattern = self.pattern
        return pattern.accumulates and pattern.carried * self.entries.room < self.values.free / 2


def input_rows(nodes: Sequence[Node]) -> dict[str, int]:
    """Return the row of each input in the data."""
    return {name: i for i, name in enumerate(dict.fromkeys(n.payload for n in nodes if n.op == "input"))}
