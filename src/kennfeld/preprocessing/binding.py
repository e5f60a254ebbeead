"""Binding of datasets to the inputs of a model: gaps are bridged, pieces are split, time steps are computed."""

from collections.abc import Mapping
from itertools import pairwise
from typing import TypeVar

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import median
from kennfeld.domain.dataset import PAUSE, Dataset, longest_usual_step, time_steps
from kennfeld.graph import Graph
from kennfeld.graph.node import NEXT_STEP, STEP, TIME
from kennfeld.preprocessing.settling import AVERAGING, HoldPlan, is_settled, plan_hold, unheld_inputs

_Column = TypeVar("_Column", Float, Bool)  # Python 3.11

TIME_TOLERANCE = 1e-6  # s; time stamps are no closer
EVEN = 1e-6  # relative difference of steps that count as equal


@dataclass(frozen=True)
class BoundDataset:
    """The samples of a dataset that a model can be run on.

    `inputs` holds the model's inputs at all samples of the dataset, Float[samples]. `picked` marks the kept samples,
    Bool[samples], None if all are kept; `starts` are the first samples of pieces among them, Int[pieces]; `scored`
    marks those that are scored, Bool[kept samples]; `clock` holds steps and time of the kept samples in s, Float[kept
    samples], if the model reads them, and other inputs that are not channels. If steady-state points are held until the
    model has settled (`hold`), `picked` repeats the number of each point, Int[points * hold.samples], each point is a
    piece, and the last sample of each is scored.
    """

    dataset: Dataset
    inputs: Mapping[str, Float]
    picked: Bool | Int | None
    starts: Int
    scored: Bool
    clock: Mapping[str, Float]
    hold: HoldPlan | None = None

    @property
    def count(self) -> int:
        """Number of kept samples."""
        return self.scored.size

    @property
    def kept(self) -> Int:
        """The dataset's samples that were kept, by number."""
        if self.picked is None:
            return np.arange(self.dataset.samples)
        return np.flatnonzero(self.picked) if self.hold is None else np.asarray(self.picked, dtype=np.int64)

    @property
    def columns(self) -> dict[str, Float]:
        """All columns that the model reads, over the kept samples; the dataset's own arrays if all are kept."""
        return {name: self.at_kept(values) for name, values in self.inputs.items()} | dict(self.clock)

    def part(self, first: int, last: int) -> dict[str, Float]:
        """Return all columns that the model reads over the kept samples from `first` to before `last`."""
        here: slice | Int = slice(first, last) if self.picked is None else self.kept[first:last]
        return {n: v[here] for n, v in self.inputs.items()} | {n: v[first:last] for n, v in self.clock.items()}

    def start_of(self, sample: int) -> int:
        """Return the first kept sample of the piece that a kept sample is in."""
        return int(self.starts[np.searchsorted(self.starts, sample, side="right") - 1])

    @property
    def whole(self) -> "BoundDataset":
        """The same with all samples of the dataset kept, for models without memory; the others are not scored."""
        if self.picked is None or self.hold is not None:
            return self
        scored, start = np.zeros(self.dataset.samples, dtype=bool), np.zeros(1, dtype=np.int64)
        scored[self.picked] = self.scored
        # dropped samples have no step and no time; what the model returns there is never scored
        clock = {name: np.full(scored.size, np.nan) for name in self.clock}
        for name, values in self.clock.items():
            clock[name][self.picked] = values
        return BoundDataset(self.dataset, self.inputs, None, start, scored, clock)

    def channel(self, name: str) -> Float:
        """Return a channel over the kept samples, Float[kept samples], in its own unit."""
        return self.at_kept(self.dataset[name].values)

    def at_kept(self, values: _Column) -> _Column:
        """Return values of all samples of the dataset, at the kept ones."""
        return values if self.picked is None else values[self.picked]

    @property
    def shown(self) -> "BoundDataset":
        """The same with one sample per point if points are held."""
        if self.hold is None:
            return self
        last = slice(self.hold.samples - 1, None, self.hold.samples)
        starts = np.zeros(min(1, self.starts.size), dtype=np.int64)
        picked = np.zeros(self.dataset.samples, dtype=bool)
        picked[self.kept[last]] = True
        clock = {name: column[last] for name, column in self.clock.items()}
        return BoundDataset(self.dataset, self.inputs, picked, starts, self.scored[last], clock)


def bind_inputs(dataset: Dataset, graph: Graph, channels: Mapping[str, str], step: float | None = None) -> BoundDataset:
    """Bind a dataset to the inputs of a graph.

    A NaN in an input drops a steady-state point. In time data, gaps up to the dataset's `max_gap` are interpolated,
    longer ones end a piece.

    Args:
        dataset: must have a channel for each input.
        graph: the model.
        channels: the channel of each input that has another name.
        step: the model's own step in s, for points that are held until it has settled.

    Raises:
        InputError: the model reads the time or the step, but the dataset has no time stamps.
    """
    inputs = {n: dataset[channels.get(n, n)].values for n in graph.inputs if n not in AVERAGING}
    # ahead of the check for time stamps: held points take their clock from the plan
    if dataset.settling is not None and is_settled(dataset, graph):
        return _hold_points(dataset, inputs, plan_hold(dataset, dataset.settling, step))
    if graph.clocks and dataset.time is None:
        raise InputError.of(
            Location(f"dataset {dataset.name}"),
            "the function requires time stamps, but the data have none",
            "Name the time channel `time`, or set `raster`; for steady-state points, `settle`.",
        )
    # states carry over from sample to sample without time stamps, too, so that a missing input ends a piece
    if dataset.time is not None or graph.states:
        inputs = {name: _bridge_gaps(dataset, values) for name, values in inputs.items()}
        valid = _complete(dataset, inputs)
        starts = _find_starts(dataset, valid)
    else:
        valid = _complete(dataset, inputs)
        starts = np.zeros(int(valid.any()), dtype=np.int64)
    picked = None if valid.all() else valid
    kept = slice(None) if picked is None else picked
    # a view of one number unless samples are masked
    scored = (np.broadcast_to(np.True_, dataset.samples) if dataset.scored is None else dataset.scored)[kept]
    clock = {}
    if dataset.time is not None:
        time = dataset.time[kept]
        functions = {STEP: _steps, NEXT_STEP: _next_steps, TIME: _time_in_piece}
        clock = {name: functions[name](time, starts) for name in graph.clocks}
        if dataset.warmup > 0:
            scored = scored & _is_warm(time, starts, dataset.warmup)
    return BoundDataset(dataset, inputs, picked, starts, scored, {**clock, **unheld_inputs(graph, scored.size)})


def _hold_points(dataset: Dataset, inputs: Mapping[str, Float], hold: HoldPlan) -> BoundDataset:
    """Bind each point as a piece of constant inputs, of which the last sample is scored."""
    points = np.flatnonzero(_complete(dataset, inputs))
    picked = np.repeat(points, hold.samples)
    scored = np.zeros(picked.size, dtype=bool)
    scored[hold.samples - 1 :: hold.samples] = dataset.counting[points]
    starts = hold.samples * np.arange(points.size)
    return BoundDataset(dataset, inputs, picked, starts, scored, hold.columns(points.size), hold)


def _complete(dataset: Dataset, inputs: Mapping[str, Float]) -> Bool:
    valid = np.ones(dataset.samples, dtype=bool)
    for values in inputs.values():
        valid &= np.isfinite(values)
    return valid


def _bridge_gaps(dataset: Dataset, values: Float) -> Float:
    """Return an input with gaps up to `max_gap` interpolated."""
    known = np.isfinite(values)
    if known.all() or dataset.max_gap <= 0 or dataset.time is None:
        return values
    time, bridged = dataset.time, values.copy()
    for piece in dataset.pieces:
        for left, right in pairwise(np.flatnonzero(known[piece]) + piece.start):
            if right - left > 1 and time[right] - time[left] <= dataset.max_gap:
                inner = slice(left + 1, right)
                bridged[inner] = np.interp(time[inner], time[[left, right]], values[[left, right]])
    return bridged


def _find_starts(dataset: Dataset, valid: Bool) -> Int:
    """Return the first samples of pieces among the valid ones: after a recording's start, a gap or a pause."""
    fresh = np.zeros(dataset.samples, dtype=bool)
    fresh[dataset.piece_starts] = True
    # this marks samples inside a gap as well, but only valid ones are returned
    fresh[1:] |= ~valid[:-1]
    if (
        dataset.time is not None
        and (longest := _longest_step(dataset.time, dataset.piece_starts, dataset.max_gap)) < np.inf
    ):
        for first, steps in time_steps(dataset.time, dataset.piece_starts):
            fresh[first : first + steps.size] |= steps > longest
    return np.flatnonzero(fresh[valid])


def _longest_step(time: Float, starts: Int, max_gap: float) -> float:
    """Return the longest step in s that is not a pause of the recording; infinite if there is no pause."""
    # fmin and fmax ignore the NaN that stands for the step from one piece to the next
    ends = [(np.fmin.reduce(steps), np.fmax.reduce(steps)) for _, steps in time_steps(time, starts)]
    low, high = (np.nan, np.nan) if not ends else (np.fmin.reduce(ends)[0], np.fmax.reduce(ends)[1])
    if not high > PAUSE * low:  # checked first: a quantile is slow
        return np.inf
    steps = np.concatenate([steps[~np.isnan(steps)] for _, steps in time_steps(time, starts)])
    return max(longest_usual_step(steps), max_gap)


def _steps(time: Float, starts: Int) -> Float:
    """Return the step before each sample in s; the first one of a piece equals the second.

    A piece of a single sample has the median step of all pieces, 1 s if none has two samples.
    """
    if not time.size:
        return time
    dt = np.empty(time.size)
    # the difference at the start of a piece is from another recording; it is replaced below
    np.subtract(time[1:], time[:-1], out=dt[1:])
    lengths = np.diff(starts, append=time.size)
    alone = median(np.delete(dt, starts)) if lengths.min() == 1 and dt.size > starts.size else 1.0
    dt[starts] = np.where(lengths > 1, dt[np.minimum(starts + 1, time.size - 1)], alone)
    low, high = float(dt.min()), float(dt.max())
    # the median may reorder dt if the range says already that one number replaces it
    even = median(dt, overwrite=high - low <= EVEN * low)
    if max(high - even, even - low) <= EVEN * even:
        return np.broadcast_to(even, time.size)
    return dt


def _next_steps(time: Float, starts: Int) -> Float:
    """Return the step after each sample in s; the last one of a piece equals the one before."""
    dt = _steps(time, starts)
    if not time.size or dt.strides == (0,):  # even
        return dt
    following = np.append(dt[1:], dt[-1])
    lasts = np.append(starts[1:], time.size) - 1
    following[lasts] = dt[lasts]
    return following


def _is_warm(time: Float, starts: Int, warmup: float) -> Bool:
    """Mark the samples after the warm-up of their piece."""
    warm = np.empty(time.size, dtype=bool)
    for first, last in pairwise([*starts.tolist(), time.size]):
        # a sample at exactly `warmup` counts, however its time stamp was rounded
        warm[first:last] = time[first:last] - time[first] > warmup - TIME_TOLERANCE
    return warm


def _time_in_piece(time: Float, starts: Int) -> Float:
    return time - np.repeat(time[starts], np.diff(starts, append=time.size))
