"""Samples as a kernel reads them, kept on disk and mapped into memory."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.column_file import read_columns
from kennfeld.native.column_table import Order
from kennfeld.native.samples import Piece, Samples


class StoredSamples(NamedTuple):
    """Samples that are stored as they are visited, and the number of each before; None if that is the same."""

    samples: Samples
    order: Order | None

    def weighted(self, factors: Sequence[float]) -> "StoredSamples":
        """Return the same with the weight of each output multiplied by its factor, if there are factors."""
        return self._replace(samples=self.samples.reweighted(np.array(factors))) if factors else self


def in_visiting_order(samples: Samples) -> StoredSamples:
    """Return the same samples stored in the order in which they are visited."""
    if samples.order is None:
        return StoredSamples(samples, None)
    # one row after the other, so that only one of them is there twice
    inputs, targets = (
        [_visited(parts, samples) for parts in table.parts] for table in (samples.inputs, samples.wanted)
    )
    return StoredSamples(Samples(inputs, targets, samples.pieces), samples.order)


def sample_columns(stored: StoredSamples) -> Iterator[NDArray[Any]]:
    """Yield the columns of samples that are stored as they are visited."""
    samples, order = stored
    # order of the visits, empty if it is that of the samples; first and last sample of each piece; then all rows
    yield np.zeros(0, dtype=np.uint32) if order is None else order
    yield np.array([[piece.first, piece.last] for piece in samples.pieces], dtype=np.int64).ravel()
    for parts in (*samples.inputs.parts, *samples.wanted.parts):
        yield parts[0] if len(parts) == 1 else np.concatenate(parts)


def _visited(parts: Sequence[Float], samples: Samples) -> Float:
    whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return whole[samples.order]


def read_samples(path: Path, inputs: int, scores: Float) -> StoredSamples | None:
    """Read samples that were written as `sample_columns`; None if there are none at this path.

    Args:
        path: the file.
        inputs: number of rows of inputs.
        scores: weight of each output, Float[outputs].
    """
    stored = read_columns(path)
    if stored is None or len(stored.columns) != 2 + inputs + scores.size:
        return None
    order, edges, *rows = stored.columns
    pieces = [Piece(int(first), int(last), scores) for first, last in edges.reshape(-1, 2)]
    samples = Samples(rows[:inputs], rows[inputs:], pieces)
    return StoredSamples(samples, order if order.size else None)
