"""`Kernel`: a lowered graph compiled for one set of outputs and free parameters."""

from collections.abc import Sequence

from kennfeld.base.machine_code.engine import compile_written
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.derivative import Linearization, differentiate
from kennfeld.graph.external_function import load_functions
from kennfeld.graph.lookup_lowering import Free, LoweredGraph
from kennfeld.graph.value_layout import order_values
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.jacobian_rows import entries_of
from kennfeld.native.sample_loop import Output, cost_code
from kennfeld.native.sweeps import sweeps
from kennfeld.native.tape import start_code, tape_code
from kennfeld.native.tape_layout import TapeLayout


class Kernel:
    """Native functions of a lowered graph, for given outputs and free parameters.

    Construction compiles it. A kernel holds no data and can be used by several threads at once.
    """

    def __init__(self, lowered: LoweredGraph, outputs: Sequence[Output], parameters: ParameterSet, free: Free) -> None:
        graph = lowered.graph
        self.outputs = tuple(outputs)
        self.line = differentiate(graph, [output.node for output in outputs], free)
        self.values = order_values(self.line, parameters, tuple(lowered.shapes), free)
        self.layout = MemoryLayout.of(lowered, self.line.nodes, self.values)
        self.axes = self.layout.breakpoints
        self.pattern = TapeLayout.of(self.line)
        self.entries = entries_of(self.line, self.layout, self.line.atoms)
        self.start_entries = entries_of(self.line, self.layout, self.line.start_atoms)
        self.sweeps = sweeps(self.pattern)
        load_functions(self.line.nodes)
        functions = compile_written(_kernel_code, self.line, self.layout, self.outputs)
        self.cost, self.tape, self.start = functions["cost"], functions["tape"], functions.get("start")

    @property
    def accumulates(self) -> bool:
        """True if backward and forward sweeps are cheaper than rows, with states."""
        pattern = self.pattern
        # operations per sample and column: n nnz in the sweeps, free / 2 in the symmetric product of rows; see `sweeps`
        return pattern.accumulates and pattern.carried * self.entries.room < self.values.free / 2


def _kernel_code(line: Linearization, layout: MemoryLayout, outputs: Sequence[Output]) -> list[FunctionWriter]:
    codes = [cost_code(line, layout, outputs), tape_code(line, layout, outputs)]
    return [*codes, start_code(line, layout)] if line.states else codes
