"""Linked evidence: the samples that inform a grid point, and the grid points that samples pass through."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from typing import Literal

import numpy as np

from kennfeld.app.session.live_model import LiveDataset, LiveModel
from kennfeld.app.session.lookup_index import LookupIndex
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.quality.lookup_coverage import Lookup, Lookups

ACTING = 1e-3  # of the largest slope of a table
FAR = 1e6  # times the values of a table: a change that only rounding errors ask for
Obstacle = Literal["", "does not act", "locked", "bounds"]
MAX_INDEXES = 16  # of a table in a dataset; one of a map takes 12 bytes a sample


@dataclass(frozen=True, eq=False)
class Informing:
    """The samples of one dataset whose lookup gives a grid point a weight.

    Attributes:
        dataset: number of the dataset.
        samples: their numbers, increasing.
        weights: the weight of each, 0 to 1; with several lookups of the table the largest.
    """

    dataset: int
    samples: Int
    weights: Float

    @cached_property
    def stretches(self) -> list[tuple[int, int]]:
        """Runs of consecutive samples, first and last, the longest ones first."""
        if not self.samples.size:
            return []
        breaks = np.flatnonzero(np.diff(self.samples) > 1)
        firsts = self.samples[np.append(0, breaks + 1)]
        lasts = self.samples[np.append(breaks, self.samples.size - 1)]
        order = np.argsort(firsts - lasts, kind="stable")
        return list(zip(firsts[order].tolist(), lasts[order].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Lookups of a table near one of its values.

    Attributes:
        samples: sample numbers, Int[lookups].
        coordinates: where they look the table up, Float[axes, lookups].
        weights: weight of the value in each, 0 to 1.
    """

    samples: Int
    coordinates: Float
    weights: Float


class Evidence:
    """The lookups of all tables at given values, over all data."""

    def __init__(self, model: LiveModel, parameters: ParameterSet) -> None:
        self._model, self._parameters = model, parameters
        self._lookups: Lookups = model.lookups(parameters)
        self._indexes: dict[tuple[object, ...], LookupIndex] = {}
        # of the value that was asked for last, as pages ask for the same one after every edit
        self._informing: tuple[tuple[str, int], list[Informing]] | None = None

    @property
    def tables(self) -> list[str]:
        """The tables on which a criterion depends."""
        return list(self._lookups.reached)

    def sample_counts(self) -> dict[str, Int]:
        """Count by table the training samples whose lookup gives each value a weight, Int of the table's shape."""
        totals = {name: np.zeros(self._parameters[name].size, dtype=np.int64) for name in self.tables}
        for recording in self._model.recordings:
            if recording.use != "training":
                continue
            for lookup in self._lookups.blocks(recording.bound):
                totals[lookup.table.name] += _touches(lookup, totals[lookup.table.name].size)
        return {name: total.reshape(self._parameters[name].values.shape) for name, total in totals.items()}

    def mean_errors(self, parameter: str, errors: Sequence[Float]) -> Float:
        """Average the errors of the training samples that inform each value of a table, weighted by their lookups.

        Args:
            parameter: name of the table.
            errors: by dataset, Float[samples]; NaN is not scored.

        Returns:
            In the shape of the values, in the unit of the errors; NaN without a scored sample.
        """
        size = self._parameters[parameter].size
        weighted, weight = np.zeros(size), np.zeros(size)
        for recording in self._model.recordings:
            if recording.use == "training":
                index = self._index(recording, parameter)
                own = errors[recording.number]
                # a held point has one error and many simulated samples
                sums = index.sums(own if recording.bound.hold is None else np.repeat(own, recording.bound.hold.samples))
                weighted, weight = weighted + sums[0], weight + sums[1]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(weight > 1e-9, weighted / weight, np.nan)
        return mean.reshape(self._parameters[parameter].values.shape)

    def places(self, parameter: str, most: int) -> Float:
        """Return where training samples look up a table, Float[axes, lookups], at most so many, evenly spread."""
        training = [recording for recording in self._model.recordings if recording.use == "training"]
        parts = [self._index(recording, parameter).places(most // max(len(training), 1)) for recording in training]
        return np.concatenate(parts, axis=1) if parts else np.zeros((len(self._parameters[parameter].index_axes), 0))

    def informing(self, parameter: str, value: int) -> list[Informing]:
        """Return by dataset the samples that look up a value of a table, given by its number in C order."""
        if self._informing is not None and self._informing[0] == (parameter, value):
            return self._informing[1]
        informing = []
        for recording in self._model.recordings:
            weight = self.informed(recording, parameter, value)
            samples = np.flatnonzero(weight > 0)
            informing.append(Informing(recording.number, samples, weight[samples]))
        self._informing = (parameter, value), informing
        return informing

    def informed(self, recording: LiveDataset, parameter: str, value: int) -> Float:
        """Return the weight that a value of a table has in each sample of a dataset, Float[samples]."""
        return self._shown(recording, self._index(recording, parameter).weights(value, recording.bound.count))

    def surroundings(self, recording: LiveDataset, parameter: str, value: int, reach: int = 2) -> "Surroundings":
        """Return where samples of a dataset look up a table near one of its values.

        Args:
            recording: the dataset.
            parameter: name of the table.
            value: number of the value in C order.
            reach: how many cells around it count as near.
        """
        return Surroundings(*self._index(recording, parameter).near(value, reach))

    def _index(self, recording: LiveDataset, parameter: str) -> LookupIndex:
        """Return the lookups of a table; they outlast edits of values that cannot move them."""
        table = self._parameters[parameter]
        # places that no value can move are kept with the model, the others with these values
        indexes = self._model.indexes if parameter in self._model.unmoved else self._indexes
        # what the places depend on besides the data; values are not among it
        key = recording.number, table.extrapolation, *(axis.breakpoints.tobytes() for axis in table.axes), parameter
        if key not in indexes:
            if len(indexes) >= MAX_INDEXES:
                indexes.pop(next(iter(indexes)))
            indexes[key] = LookupIndex(table, self._lookups.of_table(recording.bound, parameter))
        return indexes[key]

    def passed(self, recording: LiveDataset, chosen: Bool) -> Mapping[str, Float]:
        """Sum by table the weights with which chosen samples look up each of its values.

        Args:
            recording: the dataset.
            chosen: Bool[samples].
        """
        totals = {name: np.zeros(self._parameters[name].size) for name in self.tables}
        if recording.bound.hold is not None:
            chosen = np.repeat(chosen, recording.bound.hold.samples)
        for lookup in self._lookups.blocks(recording.bound):
            own = chosen[lookup.samples]
            if not own.any():
                continue
            total = totals[lookup.table.name]
            for at, share in lookup.corners:
                # an extrapolated lookup has negative weights, which would cancel others
                total += np.bincount(at[own], np.clip(share[own], 0.0, None), minlength=total.size)
        return {name: total.reshape(self._parameters[name].values.shape) for name, total in totals.items()}

    def _shown(self, recording: LiveDataset, weight: Float) -> Float:
        hold = recording.bound.hold
        return weight if hold is None else weight.reshape(-1, hold.samples).max(axis=1)


def _touches(lookup: Lookup, size: int) -> Int:
    """Count by grid point the samples in which a lookup gives it a weight above 0, Int[size]."""
    inside = reduce(np.logical_and, [(share > 0) & (share < 1) for share in lookup.shares], lookup.known)
    # within a cell all its corners have a weight: these samples are counted once, not once for each corner
    cells = np.bincount(lookup.first_corner[inside], minlength=size)
    other = np.flatnonzero(lookup.known & ~inside)
    at_edges = replace(
        lookup,
        known=lookup.known[other],
        cells=tuple(cell[other] for cell in lookup.cells),
        shares=tuple(share[other] for share in lookup.shares),
    )
    total = np.zeros(size, dtype=np.int64)
    for distance, weight in at_edges.weights():
        total[distance:] += cells[: size - distance]
        total += np.bincount((at_edges.first_corner + distance)[weight > 0], minlength=size)
    return total


@dataclass(frozen=True)
class Correction:
    """A change of one table alone that would take an error away at a sample.

    Attributes:
        parameter: name of the table.
        slope: change of the model if all values that act at the sample are raised by 1.
        change: what to add to these values, in the unit of the table; NaN if the table does not act.
        allowed: the largest part of the change that their bounds allow; 0 if one of them is locked.
        obstacle: why the change is out of reach: "does not act", "locked" or "bounds"; empty if nothing is in its way.
    """

    parameter: str
    slope: float
    change: float
    allowed: float
    obstacle: Obstacle = ""


def corrections(error: float, slopes: Mapping[str, Float], parameters: ParameterSet) -> Sequence[Correction]:
    """Compute for each table the change that would take away an error, to first order.

    All values that act at the sample are raised by the same amount. Values with less than a thousandth of the largest
    slope, such as those that a lag passed long ago, stay.

    Args:
        error: model minus measurement.
        slopes: derivative of the model by each value of a table, in the shape of its values.
        parameters: the values, with their bounds.
    """
    return [_correction(error, slope, parameters[name]) for name, slope in slopes.items()]


def _correction(error: float, slope: Float, table: Parameter) -> Correction:
    acting = np.abs(slope) > ACTING * np.abs(slope).max(initial=0.0)
    total = float(slope[acting].sum())
    # slopes that are rounding errors, or that cancel, would ask for an absurd change
    if not total or abs(error) >= FAR * abs(total) * max(float(np.abs(table.values).max()), 1.0):
        return Correction(table.name, 0.0, float("nan"), 0.0, "does not act")
    change = -error / total
    if table.locked[acting].any():
        return Correction(table.name, total, change, 0.0, "locked")
    # all acting values move together: the one that meets its bound first limits them
    ends = table.upper if change > 0 else table.lower
    room = float(np.abs(ends - table.values)[acting].min())
    if room < abs(change):
        return Correction(table.name, total, change, float(np.copysign(room, change)), "bounds")
    return Correction(table.name, total, change, change)
