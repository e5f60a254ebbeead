"""Datasets brought into the form a model reads: gaps handled, pieces cut, time steps made."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.dataset import Dataset
from kennfeld.errors import InputError
from kennfeld.graph import CLOCK, Graph

__all__ = ["Bound", "bind"]


@dataclass(frozen=True)
class Bound:
    """The samples of a dataset that a model can be run on.

    `columns` holds the model's inputs, and `dt` and `t` where it reads them. `picked` are the dataset's samples in
    order, None for all; `starts` the first sample of each piece among them; `scored` marks the ones that count.
    """

    dataset: Dataset
    columns: Mapping[str, Float]
    picked: Int | None
    starts: Int
    scored: Bool

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


def bind(dataset: Dataset, graph: Graph, channels: Mapping[str, str]) -> Bound:
    """Bind a dataset to the inputs of a graph; `channels` names the channel of an input where the names differ.

    A NaN in an input drops a steady-state point. In time data, gaps up to the dataset's `max_gap` are interpolated,
    longer ones end a piece. Raises `InputError` where a channel is missing, or time is needed and not recorded.
    """
    inputs = {name: dataset[channels.get(name, name)].values for name in graph.inputs}
    clocks = {n.payload for n in graph.nodes if n.op == "input" and n.payload in CLOCK}
    if clocks and dataset.time is None:
        raise InputError.of(
            f"dataset {dataset.name}",
            "the function needs time steps, but the data have no time stamps",
            "Name the time channel `time`, or set `raster`.",
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
    return Bound(dataset, columns, picked, starts, scored)


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
