"""Datasets brought into the form a model reads: gaps handled, pieces cut, time steps made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.dataset import Dataset
from kennfeld.errors import InputError
from kennfeld.graph import CLOCK, Graph
from kennfeld.optimize.settling import AVERAGING, Hold, hold_of, is_settled, not_held

__all__ = ["Bound", "bind"]


@dataclass(frozen=True)
class Bound:
    """The samples of a dataset that a model can be run on.

    `columns` holds the model's inputs, and `dt` and `t` where it reads them. `picked` are the dataset's samples in
    order, None for all; `starts` the first sample of each piece among them; `scored` marks the ones that count.
    Where steady-state points are held until the model has settled, each is a piece that picks the same sample again and
    again, of which the last counts; `hold` says how long.
    """

    dataset: Dataset
    columns: Mapping[str, Float]
    picked: Int | None
    starts: Int
    scored: Bool
    hold: Hold | None = None

    @property
    def count(self) -> int:
        """How many samples were kept."""
        return self.scored.size

    @property
    def kept(self) -> Int:
        """The dataset's samples that were kept, by number."""
        return np.arange(self.dataset.samples) if self.picked is None else self.picked

    def channel(self, name: str) -> Float:
        """A channel over the kept samples."""
        values = self.dataset[name].values
        return values if self.picked is None else values[self.picked]

    @property
    def shown(self) -> "Bound":
        """One sample a point where points are held, else the same."""
        if self.hold is None:
            return self
        last = slice(self.hold.samples - 1, None, self.hold.samples)
        columns = {name: column[last] for name, column in self.columns.items()}
        starts = np.zeros(min(1, self.starts.size), dtype=np.int64)
        return Bound(self.dataset, columns, self.kept[last], starts, self.scored[last])


def bind(dataset: Dataset, graph: Graph, channels: Mapping[str, str], step: float | None = None) -> Bound:
    """Bind a dataset to the inputs of a graph; `channels` names the channel of an input where the names differ.

    A NaN in an input drops a steady-state point. In time data, gaps up to the dataset's `max_gap` are interpolated,
    longer ones end a piece. `step` is the model's own, for points that are held until it has settled.
    Raises `InputError` where a channel is missing, or time is needed and not recorded.
    """
    inputs = {n: dataset[channels.get(n, n)].values for n in graph.inputs if n not in AVERAGING}
    if dataset.settling is not None and is_settled(dataset, graph):
        return _held(dataset, inputs, hold_of(dataset, dataset.settling, step))
    clocks = {n.payload for n in graph.nodes if n.op == "input" and n.payload in CLOCK}
    if clocks and dataset.time is None:
        raise InputError.of(
            f"dataset {dataset.name}",
            "the function needs time steps, but the data have no time stamps",
            "Name the time channel `time`, or set `raster`; for steady-state points, `settle`.",
        )
    if dataset.time is not None or graph.states:
        inputs, valid = _bridged(dataset, inputs)
        kept, starts = _cut(dataset, valid)
    else:
        kept = _complete(dataset, inputs)
        starts = np.zeros(min(1, kept.size), dtype=np.int64)
    scored = np.ones(kept.size, bool) if dataset.scored is None else dataset.scored[kept]
    picked = None if kept.size == dataset.samples else kept
    columns = {name: values if picked is None else values[picked] for name, values in inputs.items()}
    if clocks and dataset.time is not None:
        columns |= _clock(dataset.time[kept], starts)
    return Bound(dataset, {**columns, **not_held(graph, kept.size)}, picked, starts, scored)


def _held(dataset: Dataset, inputs: Mapping[str, Float], hold: Hold) -> Bound:
    """Each point a piece of constant inputs, of which the last sample counts."""
    points = _complete(dataset, inputs)
    picked = np.repeat(points, hold.samples)
    columns = {name: values[picked] for name, values in inputs.items()} | hold.columns(points.size)
    scored = np.zeros(picked.size, dtype=bool)
    scored[hold.samples - 1 :: hold.samples] = True if dataset.scored is None else dataset.scored[points]
    return Bound(dataset, columns, picked, hold.samples * np.arange(points.size), scored, hold)


def _complete(dataset: Dataset, inputs: Mapping[str, Float]) -> Int:
    valid = np.ones(dataset.samples, dtype=bool)
    for values in inputs.values():
        valid &= np.isfinite(values)
    return np.flatnonzero(valid)


def _bridged(dataset: Dataset, inputs: Mapping[str, Float]) -> tuple[dict[str, Float], Bool]:
    """Inputs with short gaps interpolated, and the samples at which all of them are known."""
    valid = np.ones(dataset.samples, dtype=bool)
    bridged = {}
    for name, values in inputs.items():
        known = np.isfinite(values)
        if not known.all() and dataset.max_gap > 0 and dataset.time is not None:
            values, known = _interpolated(values, known, dataset.time, dataset.pieces, dataset.max_gap)
        bridged[name] = values
        valid &= known
    return bridged, valid


def _interpolated(
    values: Float, known: Bool, time: Float, pieces: Sequence[slice], max_gap: float
) -> tuple[Float, Bool]:
    filled, good = values.copy(), known.copy()
    for piece in pieces:
        at = np.flatnonzero(known[piece]) + piece.start
        for left, right in pairwise(at):
            if right - left > 1 and time[right] - time[left] <= max_gap:
                inner = slice(left + 1, right)
                filled[inner] = np.interp(time[inner], time[[left, right]], values[[left, right]])
                good[inner] = True
    return filled, good


def _cut(dataset: Dataset, valid: Bool) -> tuple[Int, Int]:
    """The valid samples, and where among them a piece starts: at a recording's start, or after a gap."""
    fresh = np.zeros(dataset.samples, dtype=bool)
    fresh[dataset.starts] = True
    fresh[1:] |= ~valid[:-1]
    kept = np.flatnonzero(valid)
    return kept, np.flatnonzero(fresh[kept])


def _clock(time: Float, starts: Int) -> dict[str, Float]:
    """The step before each sample (the first as long as the second), and the time since the piece began."""
    if not time.size:
        return {"dt": time, "t": time}
    dt = np.diff(time, prepend=time[0])
    within = np.ones(time.size, dtype=bool)
    within[starts] = False
    alone = float(np.median(dt[within])) if within.any() else 1.0
    ends = np.append(starts[1:], time.size)
    dt[starts] = np.where(ends - starts > 1, dt[np.minimum(starts + 1, time.size - 1)], alone)
    since = time - np.repeat(time[starts], ends - starts)
    even = float(np.median(dt))
    if np.all(np.abs(dt - even) <= 1e-6 * even):
        dt = np.full(time.size, even)
    return {"dt": dt, "t": since}
