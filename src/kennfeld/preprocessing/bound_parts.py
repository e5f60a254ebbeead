"""Parts of a bound dataset that can be evaluated one after the other, or at the same time.

A part holds whole pieces, so that states, autocorrelations and events lie within one part; steady-state points without
memory are divided anywhere. Parts depend on the data alone, so that what is summed over them does so, too.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK, Dataset
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True, eq=False)
class BoundPart:
    """Kept samples `first` to before `last` of a bound dataset; `begin` and `end` number them among all samples.

    `piece` counts the pieces before it.
    """

    whole: BoundDataset
    first: int
    last: int
    begin: int
    end: int
    piece: int

    @cached_property
    def bound(self) -> BoundDataset:
        """The part as a dataset of its own; its arrays are views."""
        whole, kept, samples = self.whole, slice(self.first, self.last), slice(self.begin, self.end)
        if (self.first, self.last) == (0, whole.count):
            return whole
        assert whole.picked is None or whole.picked.dtype == np.bool_  # points that are held are in one part
        picked = None if whole.picked is None else whole.picked[samples]
        starts = whole.starts[slice(*np.searchsorted(whole.starts, [self.first, self.last]))] - self.first
        return BoundDataset(
            dataset=_cut(whole.dataset, samples),
            inputs={name: values[samples] for name, values in whole.inputs.items()},
            picked=None if picked is None or picked.all() else picked,
            # a part of a model without memory may begin inside a piece
            starts=starts if starts.size and starts[0] == 0 else np.concatenate([[0], starts]),
            scored=whole.scored[kept],
            clock={name: values[kept] for name, values in whole.clock.items()},
        )


def divide(bound: BoundDataset, *, anywhere: bool) -> list[BoundPart]:
    """Divide a bound dataset into parts of at least `SAMPLES_PER_BLOCK` samples.

    Args:
        bound: the dataset; points that are held until a model has settled are not divided.
        anywhere: pieces may be cut as well.
    """
    if bound.hold is not None or bound.count <= SAMPLES_PER_BLOCK:
        return [BoundPart(bound, 0, bound.count, 0, bound.dataset.samples, 0)]
    edges = np.arange(0, bound.count, SAMPLES_PER_BLOCK) if anywhere else np.array(list(_group_pieces(bound)))
    edges = np.append(edges, bound.count)
    # dropped samples belong to the part before them; the first and the last part reach to the ends of the dataset
    samples: Int = edges if bound.picked is None else np.append(np.flatnonzero(bound.picked)[edges[:-1]], 0)
    samples[[0, -1]] = 0, bound.dataset.samples
    pieces = np.searchsorted(bound.starts, edges[:-1])
    return [
        BoundPart(bound, *map(int, numbers))
        for numbers in zip(edges[:-1], edges[1:], samples[:-1], samples[1:], pieces, strict=True)
    ]


def _group_pieces(bound: BoundDataset) -> Iterator[int]:
    """Yield the first sample of each group of neighbouring pieces that are together at least a block."""
    first = 0
    yield first
    for start in bound.starts.tolist():
        if start - first >= SAMPLES_PER_BLOCK:
            first = start
            yield first


def _cut(dataset: Dataset, samples: slice) -> Dataset:
    """Return a range of samples; their pieces begin where those of the dataset do."""
    # + 1: a piece that begins with the range is the 0 below
    inside = dataset.piece_starts[slice(*np.searchsorted(dataset.piece_starts, [samples.start + 1, samples.stop]))]
    return replace(
        dataset,
        channels=tuple(replace(channel, values=channel.values[samples]) for channel in dataset.channels),
        time=None if dataset.time is None else dataset.time[samples],
        piece_starts=np.concatenate([[0], inside - samples.start]),
        scored=None if dataset.scored is None else dataset.scored[samples],
        recorded=None if dataset.recorded is None else dataset.recorded[samples],
        findings=(),
        files=None if dataset.files is None else dataset.files.cut(samples.start, samples.stop),
    )
