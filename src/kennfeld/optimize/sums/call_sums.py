"""Sums of models whose calls are columns, which are computed again for the values of each evaluation."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.call_columns import BatchCall, CalledColumns
from kennfeld.graph.external_function import batch_function
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.kernel import Kernel
from kennfeld.native.samples import Samples
from kennfeld.native.simulator import Simulator
from kennfeld.optimize.sums.sample_rows import SampleRows
from kennfeld.optimize.sums.sums import NormalEquations, Sums, SumsFactory, TapeVisitor
from kennfeld.optimize.sums.trajectory_columns import TrajectoryColumns


class _Refreshed(Protocol):
    """Columns at all samples."""

    columns: Mapping[str, Float]

    def refresh(self, values: Float, widths: Float, slopes: bool) -> None:
        """Compute the columns for some values; the slopes only if they are needed, else they are 0."""


class CalledFunctions:
    """The calls of a compiled model, and the simulations of what they need.

    Args:
        called: the graph whose calls are columns.
        lowered: the lowered graph to which it belongs.
        parameters: the start.
        values: layout of the values.
    """

    def __init__(
        self, called: CalledColumns, lowered: LoweredGraph, parameters: ParameterSet, values: ValueLayout
    ) -> None:
        self.called, self.parameters, self.values = called, parameters, values
        origin = LoweredGraph(called.origin, lowered.axes, lowered.shapes)

        def simulate(names: Sequence[str]) -> Simulator:
            return Simulator(origin, [called.origin.names[name] for name in names], parameters)

        self.arguments = [simulate(call.arguments) for call in called.batches]
        self.results = simulate(called.trajectories.names) if called.trajectories is not None else None

    def sums(self, sums_of: SumsFactory, kernel: Kernel, samples: Samples) -> "CallSums":
        """Return the sums over samples, in columns of their own."""
        inputs = kernel.layout.inputs
        simulators = [*self.arguments, *([] if self.results is None else [self.results])]
        needed = {name for simulator in simulators for name in simulator.inputs}
        refreshed = self._columns(SampleRows.of(samples, inputs, needed), samples.wanted.count)
        # columns that the reduced graph does not read are left out
        own = {inputs[name]: array for each in refreshed for name, array in each.columns.items() if name in inputs}
        return CallSums(sums_of(kernel, samples.with_rows(own)), refreshed)

    def _columns(self, rows: SampleRows, count: int) -> Sequence[_Refreshed]:
        refreshed: list[_Refreshed] = [
            _BatchColumns(call, simulator, self.values, self.parameters, rows, count)
            for call, simulator in zip(self.called.batches, self.arguments, strict=True)
        ]
        if self.called.trajectories is not None and self.results is not None:
            own = TrajectoryColumns(self.called.trajectories, self.results, self.values, self.parameters, rows)
            refreshed.append(own)
        return refreshed


class _BatchColumns:
    """Columns of a function that is called for all samples at once."""

    def __init__(
        self,
        call: BatchCall,
        simulator: Simulator,
        layout: ValueLayout,
        parameters: ParameterSet,
        rows: SampleRows,
        count: int,
    ) -> None:
        names = [*call.results, *call.points, *(name for row in call.slopes for name in row)]
        self.columns: Mapping[str, Float] = {name: np.zeros(count) for name in names}
        self._call, self._simulator = call, simulator
        self._layout, self._parameters, self._rows = layout, parameters, rows
        self._latest: tuple[bytes, Float] | None = None  # arguments at the latest values

    def refresh(self, values: Float, widths: Float, slopes: bool) -> None:
        """See `_Refreshed`."""
        function, call = batch_function(self._call.function), self._call
        points, same = self._points(values, widths)
        results, derivatives = function.evaluate(points, call.moving if slopes else ())
        # the same values with slopes after a cost: results and points are in the columns already
        if not same:
            for name, argument in zip(call.points, call.moving, strict=True):
                self._write(name, points[argument])
            for name, result in zip(call.results, results, strict=True):
                self._write(name, result)
        for number, names in enumerate(call.slopes):
            for position, name in enumerate(names):
                self._write(name, derivatives[number, position] if slopes else 0.0)

    def _write(self, name: str, values: Float | float) -> None:
        self._rows.write(self.columns[name], values)

    def _points(self, values: Float, widths: Float) -> tuple[Float, bool]:
        """Return the arguments at all samples, and if they are those of the latest call."""
        key = values.tobytes() + widths.tobytes()
        if self._latest is not None and self._latest[0] == key:
            return self._latest[1], True
        parameters = self._layout.unpack(values, self._parameters)
        points = self._rows.simulate(self._simulator, parameters, widths, threads=True)
        self._latest = key, points
        return points, False


class CallSums:
    """Sums of a model whose calls are columns; see `sums.Sums`.

    Args:
        sums: the sums that read the columns.
        refreshed: the columns, in the order in which they can be computed.
    """

    def __init__(self, sums: Sums, refreshed: Sequence[_Refreshed]) -> None:
        self._sums, self._refreshed, self.widths = sums, refreshed, sums.widths
        self._last: tuple[bytes, bool] | None = None

    @property
    def stateful(self) -> bool:
        """See `Sums`."""
        return self._sums.stateful

    def prepare(self) -> None:
        """See `Sums`."""
        self._sums.prepare()

    def cost(self, values: Float) -> float:
        """See `Sums`."""
        self._refresh(values, slopes=False)
        return self._sums.cost(values)

    def normal(self, values: Float) -> NormalEquations:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        return self._sums.normal(values)

    def residual(self, values: Float) -> Float:
        """See `Sums`."""
        self._refresh(values, slopes=False)
        return self._sums.residual(values)

    def rows(self, values: Float) -> tuple[Float, Float]:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        return self._sums.rows(values)

    def rows_at(self, values: Float, visits: Int) -> Float:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        return self._sums.rows_at(values, visits)

    def squares(self, values: Float, groups: Int, count: int) -> Float:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        return self._sums.squares(values, groups, count)

    def touched(self, values: Float, owners: Int | None = None) -> Int:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        return self._sums.touched(values, owners)

    def each_tape(self, values: Float, work: TapeVisitor) -> None:
        """See `Sums`."""
        self._refresh(values, slopes=True)
        self._sums.each_tape(values, work)

    def _refresh(self, values: Float, *, slopes: bool) -> None:
        key = values.tobytes() + self.widths.tobytes()
        # columns with slopes serve a cost as well
        if self._last is not None and self._last[0] == key and self._last[1] >= slopes:
            return
        # a refresh that fails or is stopped leaves columns of two kinds of values
        self._last = None
        for each in self._refreshed:
            each.refresh(values, self.widths, slopes)
        self._last = key, slopes
