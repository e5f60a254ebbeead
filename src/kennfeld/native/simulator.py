"""Simulation of a compiled model: the values of chosen nodes over all samples."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.graph.derivative import differentiate
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.value_layout import order_values
from kennfeld.machine_code.engine import compile_functions
from kennfeld.native.addresses import INT64, POINTER, address
from kennfeld.native.column_table import ColumnTable
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.sample_loop import values_code
from kennfeld.native.tape import start_code
from kennfeld.parameter_set import ParameterSet

CHUNK = 65536  # samples a native call, so that it ends within milliseconds


class Simulator:
    """Simulation of the nodes `roots` of a lowered graph."""

    def __init__(self, lowered: LoweredGraph, roots: Sequence[int], parameters: ParameterSet) -> None:
        self._line = differentiate(lowered.graph, roots, ())
        self._values = order_values(self._line, parameters, tuple(lowered.shapes), ())
        self._layout = MemoryLayout.of(lowered, self._line.nodes, self._values)
        self._axes = self._layout.breakpoints
        self._roots = tuple(roots)
        codes = [values_code(self._line, self._layout, roots)]
        if self._line.states:
            codes.append(start_code(self._line, self._layout))
        functions = compile_functions(*codes)
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
        if count == 0:
            return out
        widths, memory = np.zeros(max(len(self._layout.axes), 1)), np.zeros(self._layout.memory)
        hints, room, table = np.zeros(self._layout.hints, dtype=np.int64), np.zeros(8), rows.headed(None)
        values = self._values.pack(parameters)
        arrays = [address(array) for array in (values, self._axes, widths, memory)]
        model = (address(table, kind=POINTER), table.shape[1], *arrays, address(hints, kind=INT64))
        for first, last in zip(starts, [*starts[1:], count], strict=True):
            if self._start is not None:
                self._start(*model, *([address(room)] * 3), first)
            for at in range(first, last, CHUNK):
                self._run(*model, address(out) + at * out.itemsize, count, at, min(at + CHUNK, last))
        return out
