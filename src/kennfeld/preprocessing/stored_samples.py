"""Samples as a kernel reads them, kept on disk and mapped into memory."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Float
from kennfeld.column_file import read_columns
from kennfeld.native.samples import Piece, Samples


def sample_columns(samples: Samples) -> Iterator[NDArray[Any]]:
    """Yield the columns of samples, in the order in which they are visited."""
    yield np.array([[piece.first, piece.last] for piece in samples.pieces], dtype=np.int64).ravel()
    yield np.array([piece.scores for piece in samples.pieces], dtype=np.float64).ravel()
    for parts in (*samples.inputs.parts, *samples.wanted.parts):
        yield _visited(parts, samples)


def _visited(parts: Sequence[Float], samples: Samples) -> Float:
    whole = parts[0] if len(parts) == 1 else np.concatenate(parts) if parts else np.zeros(0)
    return whole if samples.order is None else whole[samples.order]


def read_samples(path: Path, inputs: int, outputs: int) -> Samples | None:
    """Return samples that were written as `sample_columns`; None if there are none at this path.

    Args:
        path: the file.
        inputs: number of rows of inputs.
        outputs: number of rows of targets.
    """
    stored = read_columns(path)
    if stored is None or len(stored.columns) != 2 + inputs + outputs:
        return None
    edges, scores, *rows = stored.columns
    pieces = [
        Piece(int(first), int(last), each)
        for (first, last), each in zip(edges.reshape(-1, 2), scores.reshape(-1, outputs), strict=True)
    ]
    return Samples(rows[:inputs], rows[inputs:], pieces)
