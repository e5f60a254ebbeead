"""Simulation of a compiled model: the values of chosen nodes over all samples."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.graph.derivative import Linearization, differentiate
from kennfeld.graph.external_function import load_functions
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.value_layout import order_values
from kennfeld.machine_code.engine import compile_written
from kennfeld.machine_code.ir import FunctionWriter
from kennfeld.native.addresses import INT64, POINTER, address
from kennfeld.native.column_table import ColumnTable
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.sample_loop import values_code
from kennfeld.native.tape import start_code
from kennfeld.parameter_set import ParameterSet

CHUNK = 65536  # samples a native call, so that it ends within milliseconds
STEPS = 4096  # samples kept while a single one is sought


class Simulator:
    """Simulation of the nodes `roots` of a lowered graph."""

    def __init__(self, lowered: LoweredGraph, roots: Sequence[int], parameters: ParameterSet) -> None:
        self._line = differentiate(lowered.graph, roots, ())
        self._values = order_values(self._line, parameters, tuple(lowered.shapes), ())
        self._layout = MemoryLayout.of(lowered, self._line.nodes, self._values)
        self._axes = self._layout.breakpoints
        self._roots = tuple(roots)
        load_functions(self._line.nodes)
        functions = compile_written(_simulator_code, self._line, self._layout, self._roots)
        self._run, self._start = functions["values"], functions.get("start")

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns that `over` reads."""
        return tuple(self._layout.inputs)

    def over(
        self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int] = (0,)
    ) -> Float:
        """Compute the values of the nodes, shape (roots, samples).

        Args:
            columns: `inputs` by name, `count` samples each, which are not copied.
            count: number of samples.
            parameters: the parameters that the graph looks up.
            starts: samples at which the states start anew.

        Raises:
            ArgumentError: a column has another length, or a start lies outside.
        """
        rows = ColumnTable([columns[name] for name in self.inputs], count)
        if any(not 0 <= start <= count for start in starts):
            raise ArgumentError(f"starts={list(starts)} must lie within the {count} samples")
        out = np.empty((len(self._roots), count))
        if count:
            run = _Run(self, rows, parameters)
            for first, last in zip(starts, [*starts[1:], count], strict=True):
                run.start(first)
                for at in range(first, last, CHUNK):
                    run.values(address(out) + at * out.itemsize, count, at, min(at + CHUNK, last))
        return out

    def last(self, columns: Mapping[str, Float], count: int, parameters: ParameterSet) -> Float:
        """Compute the values of the nodes at the last sample, shape (roots,); memory does not grow with the samples.

        Args:
            columns: `inputs` by name, `count` samples each, which are not copied.
            count: number of samples, at least 1. The states start at the first one.
            parameters: the parameters that the graph looks up.

        Raises:
            ArgumentError: a column has another length, or there are no samples.
        """
        if count < 1:
            raise ArgumentError(f"count={count} must be >= 1")
        run = _Run(self, ColumnTable([columns[name] for name in self.inputs], count), parameters)
        out = np.empty((len(self._roots), STEPS))
        run.start(0)
        for first in range(0, count, STEPS):
            run.values(address(out), STEPS, first, min(first + STEPS, count))
        return out[:, (count - 1) % STEPS].copy()


def _simulator_code(line: Linearization, layout: MemoryLayout, roots: Sequence[int]) -> list[FunctionWriter]:
    codes = [values_code(line, layout, roots)]
    return [*codes, start_code(line, layout)] if line.states else codes


class _Run:
    """The arrays of one simulation, and the native calls on them."""

    def __init__(self, simulator: Simulator, rows: ColumnTable, parameters: ParameterSet) -> None:
        layout = simulator._layout
        widths, memory = np.zeros(max(len(layout.axes), 1)), np.zeros(layout.memory)
        hints, table = np.zeros(layout.hints, dtype=np.int64), rows.headed(None)
        values, room = simulator._values.pack(parameters), np.zeros(8)
        self._simulator, self._kept = simulator, (rows, table, values, widths, memory, hints, room)
        arrays = [address(array) for array in (values, simulator._axes, widths, memory)]
        self._model = (address(table, kind=POINTER), table.shape[1], *arrays, address(hints, kind=INT64))
        self._room = address(room)

    def start(self, sample: int) -> None:
        """Set the states to their first values at a sample."""
        if self._simulator._start is not None:
            self._simulator._start(*self._model, *([self._room] * 3), sample)

    def values(self, out: int, stride: int, first: int, last: int) -> None:
        """Write the nodes over a range of samples to the address `out`, rows `stride` apart; carries the states on."""
        self._simulator._run(*self._model, out, stride, first, last)
