"""Simulation of a compiled model: the values of chosen nodes over all samples."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.machine_code.engine import compile_written
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.base.threads import available_cores, map_in_order
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.call_columns import BatchCall, read_batches
from kennfeld.graph.derivative import Linearization, differentiate
from kennfeld.graph.external_function import batch_function, load_functions
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.node import Graph, extract
from kennfeld.graph.value_layout import order_values
from kennfeld.native.addresses import INT64, POINTER, address
from kennfeld.native.column_table import ColumnTable, Row
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.sample_loop import values_code
from kennfeld.native.tape import start_code
from kennfeld.native.trajectory_gate import TrajectoryGate

CHUNK = 65536  # samples a native call, so that it ends within milliseconds
SHARE = 32768  # samples that are worth a thread
STEPS = 4096  # samples kept while a single one is sought


class Simulator:
    """Simulation of the nodes `roots` of a lowered graph."""

    def __init__(self, lowered: LoweredGraph, roots: Sequence[int], parameters: ParameterSet) -> None:
        self._calls: Sequence[_BatchResults] = ()
        if any(node.op == "external" and node.payload.function.batched for node in lowered.graph.nodes):
            lowered, roots = self._read_batches(lowered, roots, parameters)
        self._line = differentiate(lowered.graph, roots, ())
        self._values = order_values(self._line, parameters, tuple(lowered.shapes), ())
        self._layout = MemoryLayout.of(lowered, self._line.nodes, self._values)
        self._axes = self._layout.breakpoints
        self._roots = tuple(roots)
        load_functions(self._line.nodes)
        self._gate = TrajectoryGate(self._line.nodes)
        functions = compile_written(_simulator_code, self._line, self._layout, self._roots)
        self._run, self._start = functions["values"], functions.get("start")

    def _read_batches(
        self, lowered: LoweredGraph, roots: Sequence[int], parameters: ParameterSet
    ) -> tuple[LoweredGraph, Sequence[int]]:
        """Return graph and nodes with the results of calls as columns, and keep the calls."""
        # names that no function can have
        wanted = {f"\0root{number}": at for number, at in enumerate(roots)}
        called = read_batches(_reduced(lowered.graph, wanted))
        self._calls = [_BatchResults(call, replace(lowered, graph=called.graph), parameters) for call in called.batches]
        graph = _reduced(called.graph, {name: called.graph.names[name] for name in wanted})
        return replace(lowered, graph=graph), [graph.names[name] for name in wanted]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns that `over` reads."""
        own = {name for call in self._calls for name in call.names}
        needed = dict.fromkeys(name for call in self._calls for name in call.inputs) | dict.fromkeys(
            self._layout.inputs
        )
        return tuple(name for name in needed if name not in own)

    def over(
        self,
        columns: Mapping[str, Row],
        count: int,
        parameters: ParameterSet,
        starts: Sequence[int] = (0,),
        widths: Float | None = None,
        *,
        threads: bool = False,
    ) -> Float:
        """Compute the values of the nodes, shape (roots, samples).

        Args:
            columns: `inputs` by name, `count` samples each, which are not copied.
            count: number of samples.
            parameters: the parameters that the graph looks up.
            starts: samples at which the states start anew.
            widths: standard deviations of the smoothing, one per axis of the lowered graph; by default there is none.
            threads: True to divide the pieces, or without states the samples, among threads.

        Raises:
            ArgumentError: a column has another length, or a start lies outside.
        """
        rows = self._rows(columns, count, parameters, starts, widths)
        if any(not 0 <= start <= count for start in starts):
            raise ArgumentError(f"starts={list(starts)} must lie within the {count} samples")
        out = np.empty((len(self._roots), count))
        if count:
            pieces = list(zip(starts, [*starts[1:], count], strict=True))
            shares = self._shares(pieces, count) if threads else [pieces]
            for _ in map_in_order(
                lambda share: self._run_over(share, _Run(self, rows, parameters, widths), out), shares
            ):
                pass
        return out

    def _shares(self, pieces: Sequence[tuple[int, int]], count: int) -> list[Sequence[tuple[int, int]]]:
        """Divide pieces among threads."""
        # without states, samples do not depend on each other and may be cut anywhere
        if self._start is None:
            length = max(-(-count // available_cores()), SHARE)
            pieces = [(first, min(first + length, count)) for first in range(0, count, length)]
        number = min(len(pieces), available_cores())
        return [pieces[share::number] for share in range(number)]

    def _run_over(self, pieces: Sequence[tuple[int, int]], run: "_Run", out: Float) -> None:
        count = out.shape[1]
        with self._gate.room():
            for first, last in pieces:
                run.start(first)
                for at in range(first, last, CHUNK):
                    run.values(address(out) + at * out.itemsize, count, at, min(at + CHUNK, last))

    def steps(self, columns: Mapping[str, Row], count: int, parameters: ParameterSet) -> "SimulatedSteps":
        """Return a simulation that goes on where it stopped; see `over` for the arguments.

        The function must call no others, whose own memory knows one simulation at a time.
        """
        return SimulatedSteps(_Run(self, self._rows(columns, count, parameters), parameters), len(self._roots))

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
        run = _Run(self, self._rows(columns, count, parameters), parameters)
        out = np.empty((len(self._roots), STEPS))
        with self._gate.room():
            run.start(0)
            for first in range(0, count, STEPS):
                # each call overwrites the one before; only the last one is read
                run.values(address(out), STEPS, first, min(first + STEPS, count))
        return out[:, (count - 1) % STEPS].copy()

    def _rows(
        self,
        columns: Mapping[str, Row],
        count: int,
        parameters: ParameterSet,
        starts: Sequence[int] = (0,),
        widths: Float | None = None,
    ) -> ColumnTable:
        """Return the columns that the machine code reads; those of calls are computed first."""
        known = dict(columns)
        for call in self._calls:
            # in their order: the arguments of a call may be results of an earlier one
            known |= call.over(known, count, parameters, starts, widths)
        return ColumnTable([known[name] for name in self._layout.inputs], count)


def _reduced(graph: Graph, names: Mapping[str, int]) -> Graph:
    """Return the part of a graph that computes some nodes."""
    return extract(graph.nodes, graph.states, names, {}, ())


class _BatchResults:
    """The results of a function that is called for all samples at once, and the simulation of its arguments."""

    def __init__(self, call: BatchCall, lowered: LoweredGraph, parameters: ParameterSet) -> None:
        self.names, self._function = call.results, call.function
        graph = _reduced(lowered.graph, {name: lowered.graph.names[name] for name in call.arguments})
        roots = [graph.names[name] for name in call.arguments]
        self._arguments = Simulator(replace(lowered, graph=graph), roots, parameters)
        self.inputs = self._arguments.inputs

    def over(
        self,
        columns: Mapping[str, Row],
        count: int,
        parameters: ParameterSet,
        starts: Sequence[int],
        widths: Float | None,
    ) -> Mapping[str, Float]:
        """Return the columns of the results."""
        points = self._arguments.over(columns, count, parameters, starts, widths)
        results, _ = batch_function(self._function).evaluate(points, ())
        return dict(zip(self.names, results, strict=True))


def _simulator_code(line: Linearization, layout: MemoryLayout, roots: Sequence[int]) -> list[FunctionWriter]:
    codes = [values_code(line, layout, roots)]
    return [*codes, start_code(line, layout)] if line.states else codes


class _Run:
    """The arrays of one simulation, and the native calls on them."""

    def __init__(
        self, simulator: Simulator, rows: ColumnTable, parameters: ParameterSet, widths: Float | None = None
    ) -> None:
        layout = simulator._layout
        widths = np.zeros(max(len(layout.axes), 1)) if widths is None else np.array(widths)
        memory = np.zeros(layout.memory)
        hints, table = np.zeros(layout.hints, dtype=np.int64), rows.headed(None)
        # `start` writes slopes too: with nothing free, no more than the number of their entries, 0
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


class SimulatedSteps:
    """The values of the nodes over one range of samples after the other."""

    def __init__(self, run: _Run, roots: int) -> None:
        self._run, self._roots = run, roots

    def start(self, sample: int) -> None:
        """Set the states to their first values at a sample."""
        self._run.start(sample)

    def over(self, first: int, last: int) -> Float:
        """Compute the nodes from the sample at which the last range ended, or the start; Float[roots, samples]."""
        out = np.empty((self._roots, last - first))
        self._run.values(address(out), last - first, first, last)
        return out
