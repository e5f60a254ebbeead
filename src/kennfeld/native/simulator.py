"""Simulation of a compiled model: the values of chosen nodes over all samples."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.value_layout import order_values
from kennfeld.native.addresses import INT64, POINTER, address
from kennfeld.native.column_table import ColumnTable
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.kernel import input_rows
from kennfeld.native.sample_loop import compile_functions, values_code
from kennfeld.native.tape import start_code
from kennfeld.parameter_set import ParameterSet

CHUNK = 65536  # samples a native call, so that it ends within milliseconds


class Simulator:
    """Simulation of the nodes `roots` of a lowered graph."""

    def __init__(self, lowered: LoweredGraph, roots: Sequence[int], parameters: ParameterSet) -> None:
        self._line = differentiate(lowered.graph, roots, ())
        self._values = order_values(self._line, parameters, tuple(lowered.shapes), ())
        self._layout = MemoryLayout(
            input_rows(self._line.nodes),
            self._values.offsets,
            lowered.shapes,
            lowered.axes,
            tuple(state.latency for state in lowered.graph.states),
            self._values.moving,
        )
        self._axes = self._layout.breakpoints
        self._roots = tuple(roots)
        codes = [values_code(self._line, self._layout, roots)]
        if self._line.states:
            codes.append(start_code(self._line, self._layout))
        self._run, *rest = compile_functions(*codes)
        self._start = rest[0] if rest else None

    @property
    def inputs(self) -> tuple[str, ...]:
        """The rows of data that `run` expects."""
        return tuple(self._layout.inputs)

    def run(self, parameters: ParameterSet, data: Float, starts: Sequence[int] = (0,)) -> Float:
        """Compute the values of the nodes, shape (roots, samples).

        Args:
            parameters: the parameters that the graph looks up.
            data: inputs, shape (inputs, samples), in the order of `inputs`.
            starts: samples at which the states start anew.

        Raises:
            ArgumentError: the data do not match the inputs.
        """
        return self._run_rows(parameters, ColumnTable(data, data.shape[1]), starts)

    def over(
        self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int] = (0,)
    ) -> Float:
        """Compute the values of the nodes from columns of `count` samples by name, which are not copied."""
        return self._run_rows(parameters, ColumnTable([columns[name] for name in self.inputs], count), starts)

    def _run_rows(self, parameters: ParameterSet, rows: ColumnTable, starts: Sequence[int]) -> Float:
        count = rows.count
        self._check(rows, starts)
        out = np.empty((len(self._roots), count))
        values, widths = self._values.pack(parameters), np.zeros(max(len(self._layout.axes), 1))
        memory, hints = np.zeros(self._layout.memory), np.zeros(max(self._layout.hints, 1), dtype=np.int64)
        if count == 0:
            return out
        room, table = np.zeros(8), rows.headed(None)
        arrays = [address(array) for array in (values, self._axes, widths, memory)]
        model = (address(table, kind=POINTER), table.shape[1], *arrays, address(hints, kind=INT64))
        into = address(out)
        for first, last in zip(starts, [*starts[1:], count], strict=True):
            if self._start is not None:
                self._start(*model, *([address(room)] * 3), first)
            for at in range(first, last, CHUNK):
                self._run(*model, into + at * out.itemsize, count, at, min(at + CHUNK, last))
        return out

    def _check(self, rows: ColumnTable, starts: Sequence[int]) -> None:
        """Raise `ArgumentError` if the compiled code would read beyond the end of the data."""
        if len(rows.parts) != len(self.inputs):
            raise ArgumentError(f"the model has {len(self.inputs)} inputs, got {len(rows.parts)} rows of data")
        if any(not 0 <= start <= rows.count for start in starts):
            raise ArgumentError(f"starts={list(starts)} must lie within the {rows.count} samples")
