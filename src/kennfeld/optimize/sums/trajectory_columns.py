"""Columns of functions that keep memory, such as FMUs for co-simulation: trajectories, and their slopes by differences.

A slope is a difference of whole trajectories, simulated with one value changed, so it holds all that the value affects:
what feeds the function, its memory, and loops around it.
"""

import math
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.finite_differences import (
    NOISE_POINTS,
    NOISE_SPACING,
    difference_step,
    largest_ratio,
    noise_of,
    three_point_slope,
)
from kennfeld.base.threads import available_cores, computed_once
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.call_columns import Trajectories
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.simulator import Simulator
from kennfeld.optimize.sums.sample_rows import SampleRows

_LONG = 3e-3  # s; a trajectory that is worth a thread
_LEAST_SIZE = 1e-4  # of a value without limits: its steps are no smaller than those of this value
_OF_RANGE = 0.01  # of the range between its limits


@computed_once
def _pool() -> ThreadPoolExecutor:
    """Return threads that last, as instances of FMUs belong to threads."""
    return ThreadPoolExecutor(available_cores(), "trajectories")


class TrajectoryColumns:
    """Results of functions that keep memory, and their slopes along values of tables.

    Args:
        trajectories: the results, and the values on which they depend.
        simulator: simulates the results.
        layout: layout of the values.
        parameters: the start, with limits.
        rows: the inputs.
    """

    def __init__(
        self,
        trajectories: Trajectories,
        simulator: Simulator,
        layout: ValueLayout,
        parameters: ParameterSet,
        rows: SampleRows,
    ) -> None:
        names = [*trajectories.results, *(name for row in trajectories.slopes for name in row)]
        self.columns: Mapping[str, Float] = {name: np.zeros(rows.count) for name in names}
        self._trajectories, self._simulator = trajectories, simulator
        self._layout, self._parameters, self._rows = layout, parameters, rows
        self._places, self._lower, self._upper = self._limits()
        self._step: float | None = None
        self._latest: tuple[bytes, Float] | None = None
        self._is_long = False  # known after the first trajectory

    def refresh(self, values: Float, widths: Float, slopes: bool) -> None:
        """Compute the results for some values, Float[values]; the slopes only if they are needed, else they are 0."""
        results = self._results(values)
        sloped = self._slopes(values, results) if slopes else np.zeros((self._places.size, *results.shape))
        # the graph adds slope times value to this column, which then is the result again
        reached = results - np.einsum("p,prk->rk", values[self._places], sloped)
        for number, name in enumerate(self._trajectories.results):
            self.columns[name][:] = reached[number]
            for position, slope in enumerate(self._trajectories.slopes[number]):
                self.columns[slope][:] = sloped[position, number]

    def _slopes(self, values: Float, results: Float) -> Float:
        """Return the slopes, Float[values, results, samples]."""
        if self._step is None:
            # from the noise at the first values, for all later ones
            self._step = difference_step(self._noise(values, results))
        distances = [self._distances(values, number, self._step) for number in range(self._places.size)]
        changed = [
            self._changed(values, place, distance)
            for place, pair in zip(self._places.tolist(), distances, strict=True)
            for distance in pair
        ]
        simulated = list((_pool().map if self._is_long else map)(self._simulate, changed))
        slopes = np.empty((self._places.size, *results.shape))
        for number, (a, b) in enumerate(distances):
            first, second = simulated[2 * number : 2 * number + 2]
            slopes[number] = three_point_slope(results, first, second, a, b)
        return slopes

    def _limits(self) -> tuple[Int, Float, Float]:
        """Return the place of each value in the vector of values, and its limits."""
        places, lower, upper = [], [], []
        for value in self._trajectories.values:
            table = self._parameters[value.table]
            shape = table.values.shape
            places.append(
                self._layout.offsets[value.table] + int(np.ravel_multi_index(value.place, shape) if shape else 0)
            )
            lower.append(np.broadcast_to(table.lower, shape)[value.place])
            upper.append(np.broadcast_to(table.upper, shape)[value.place])
        return np.array(places, dtype=np.int64), np.array(lower), np.array(upper)

    def _size(self, values: Float, number: int) -> float:
        """Return the order of magnitude of a value."""
        width = float(self._upper[number] - self._lower[number])
        least = _OF_RANGE * width if math.isfinite(width) and width > 0 else _LEAST_SIZE
        return max(abs(float(values[self._places[number]])), least)

    def _distances(self, values: Float, number: int, step: float) -> tuple[float, float]:
        """Return the two distances of the points of a difference, which are within the limits of the value."""
        value, distance = float(values[self._places[number]]), step * self._size(values, number)
        # at a limit both points are on the other side, at one and two distances
        above = distance if value + distance <= self._upper[number] else -2 * distance
        below = -distance if value - distance >= self._lower[number] else 2 * distance
        # the distances that the rounded values really have
        return (value + above) - value, (value + below) - value

    def _changed(self, values: Float, place: int, distance: float) -> Float:
        changed = values.copy()
        changed[place] += distance
        return changed

    def _noise(self, values: Float, results: Float) -> float:
        """Return the noise of the trajectories, relative to the largest number of each."""
        if not self._places.size:
            return 0.0
        direction = np.zeros_like(values)
        sizes = np.array([self._size(values, number) for number in range(self._places.size)])
        # away from an upper limit, which the points of the noise must not pass
        inwards = np.where(values[self._places] + NOISE_POINTS * NOISE_SPACING * sizes <= self._upper, 1.0, -1.0)
        direction[self._places] = NOISE_SPACING * sizes * inwards
        others = [self._simulate(values + number * direction) for number in range(1, NOISE_POINTS)]
        table = np.array([results, *others])
        size = np.broadcast_to(np.max(np.abs(results), axis=1, keepdims=True, initial=0.0), results.shape)
        return largest_ratio(noise_of(table.reshape(NOISE_POINTS, -1)), size.ravel())

    def _results(self, values: Float) -> Float:
        key = values.tobytes()
        if self._latest is None or self._latest[0] != key:
            began = time.perf_counter()
            self._latest = key, self._simulate(values)
            self._is_long = time.perf_counter() - began > _LONG
        return self._latest[1]

    def _simulate(self, values: Float) -> Float:
        return self._rows.simulate(self._simulator, self._layout.unpack(values, self._parameters))
