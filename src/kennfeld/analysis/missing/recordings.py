"""Numbers of the recordings: an offset of each recording, as from a drift between days, is a curve over them."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.file_spans import short_names
from kennfeld.optimize.problem.problem import Problem

RECORDING = "\0recording"  # the channel of the numbers; no file can contain it
FEWEST, MOST = 3, 60  # recordings of which offsets are looked for


def numbered(problem: Problem) -> tuple[Problem, tuple[str, ...]]:
    """Return a problem whose data have the number of the recording as a channel, and the names of the recordings.

    The data of no recording of the training, such as test data, have the number behind the last one. With too few or
    too many recordings, or with data in partitions, the problem stays as it is and has no names.
    """
    if not can_be_numbered(problem):
        return problem, ()
    names: list[str] = []
    columns: list[Float] = []
    for data in problem.datasets:
        numbers = np.full(data.samples, np.nan)
        if data.is_fitted and data.samples:
            for name, first, last in _spans(data):
                numbers[first:last] = len(names)
                names.append(name)
        columns.append(numbers)
    filled = (Channel(RECORDING, np.nan_to_num(numbers, nan=len(names))) for numbers in columns)
    datasets = (data.with_channels(channel) for data, channel in zip(problem.datasets, filled, strict=True))
    return replace(problem, datasets=tuple(datasets)), tuple(names)


def can_be_numbered(problem: Problem) -> bool:
    """Return whether `numbered` numbers the recordings of a problem."""
    if problem.partitions is not None:
        return False
    count = sum(1 for data in problem.fitted_datasets if data.samples for _ in _spans(data))
    return FEWEST <= count <= MOST


def _spans(data: Dataset) -> Iterator[tuple[str, int, int]]:
    """Yield name, first sample and end of each recording: of each file if they are known, else of each piece."""
    if data.files is not None:
        labels = short_names(data.files.names)
        for name, start, length in zip(data.files.names, data.files.starts, data.files.lengths, strict=True):
            yield labels[name], max(int(start), 0), min(int(start + length), data.samples)
        return
    pieces = data.pieces
    for number, piece in enumerate(pieces, 1):
        yield data.name if len(pieces) == 1 else f"{data.name} piece {number}", piece.start, piece.stop


def recording_count(problem: Problem) -> int:
    """Return the number of recordings that `numbered` has numbered; 0 if it has not."""
    datasets = problem.fitted_datasets
    if not datasets or any(RECORDING not in data for data in datasets):
        return 0
    return 1 + int(max(data[RECORDING].values.max(initial=-1.0) for data in datasets))
