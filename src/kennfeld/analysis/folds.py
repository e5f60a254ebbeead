"""Which samples are held back together: whole recordings, blocks in time, or steady points at random."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, InputError

__all__ = ["Fold", "Kind", "folds_of"]

Kind = Literal["auto", "files", "blocks", "random"]
GAP = 0.05  # share of a block that is not fitted on either side of it


@dataclass(frozen=True)
class Fold:
    """For each dataset the samples held back, and those beside them that are neither fitted nor scored."""

    name: str
    held: tuple[Bool, ...]
    beside: tuple[Bool, ...]


def folds_of(
    datasets: Sequence[Dataset], count: int, kind: Kind = "auto", *, memory: bool, seed: int = 0
) -> list[Fold]:
    """`count` folds of about equal size that hold back every sample once.

    `auto` is `files`, whole pieces, where there are at least as many as folds; else `blocks`, contiguous in time, where
    data have time or the model has memory; else `random`. `blocks` go through each piece in recorded order. Raises
    `ArgumentError` for fewer than two folds, `InputError` where the data are too few.

    >>> data = Dataset.of("d", {"x": np.arange(6.0)})
    >>> [fold.held[0].nonzero()[0].tolist() for fold in folds_of([data], 3, "blocks", memory=False)]
    [[0, 1], [2, 3], [4, 5]]
    """
    if count < 2:
        raise ArgumentError(f"folds={count} must be at least 2")
    pieces = [(i, piece) for i, data in enumerate(datasets) for piece in data.pieces if piece.stop > piece.start]
    if kind == "auto":
        timed = memory or any(data.time is not None for data in datasets)
        kind = "files" if len(pieces) >= count else "blocks" if timed else "random"
    if kind == "random" and memory:
        what = "a model with memory cannot be cross-validated on samples picked at random"
        raise InputError.of("cross-validation", what, "Use blocks.")
    available = len(pieces) if kind == "files" else sum(data.samples for data in datasets)
    if available < count:
        what = f"{count} folds of {available} {'pieces' if kind == 'files' else 'samples'}"
        raise InputError.of("cross-validation", what, "Ask for fewer folds.")
    if kind == "files":
        return _whole(datasets, pieces, count)
    return _blocks(datasets, pieces, count) if kind == "blocks" else _random(datasets, count, seed)


def _masks(datasets: Sequence[Dataset]) -> list[Bool]:
    return [np.zeros(data.samples, dtype=bool) for data in datasets]


def _whole(datasets: Sequence[Dataset], pieces: Sequence[tuple[int, slice]], count: int) -> list[Fold]:
    """Whole pieces, the longest first, each to the fold that has least."""
    held = [_masks(datasets) for _ in range(count)]
    sizes, names = [0] * count, [dict[str, list[int]]() for _ in range(count)]
    numbers = [list(data.starts) for data in datasets]
    for i, piece in sorted(pieces, key=lambda entry: (entry[1].start - entry[1].stop, entry[0], entry[1].start)):
        at = int(np.argmin(sizes))
        held[at][i][piece] = True
        sizes[at] += piece.stop - piece.start
        names[at].setdefault(datasets[i].name, []).append(numbers[i].index(piece.start) + 1)
    single = {data.name: len(data.pieces) == 1 for data in datasets}
    titles = [
        ", ".join(_named(data.name, named[data.name], single[data.name]) for data in datasets if data.name in named)
        for named in names
    ]
    return [Fold(title, tuple(masks), tuple(_masks(datasets))) for title, masks in zip(titles, held, strict=True)]


def _named(dataset: str, pieces: Sequence[int], single: bool) -> str:
    return dataset if single else f"{dataset} piece{'s' * (len(pieces) > 1)} {', '.join(map(str, sorted(pieces)))}"


def _blocks(datasets: Sequence[Dataset], pieces: Sequence[tuple[int, slice]], count: int) -> list[Fold]:
    """The same part of every piece; what lies beside it is not fitted, since neighbours resemble each other."""
    folds = []
    for number in range(count):
        held, beside = _masks(datasets), _masks(datasets)
        for i, piece in pieces:
            edges = np.linspace(piece.start, piece.stop, count + 1).round().astype(int)
            first, last = int(edges[number]), int(edges[number + 1])
            gap = int(GAP * (last - first)) if datasets[i].time is not None else 0
            beside[i][max(first - gap, piece.start) : min(last + gap, piece.stop)] = True
            held[i][first:last] = True
            beside[i][first:last] = False
        folds.append(Fold(f"block {number + 1}", tuple(held), tuple(beside)))
    return folds


def _random(datasets: Sequence[Dataset], count: int, seed: int) -> list[Fold]:
    """Samples in random order, the same for the same seed, dealt out evenly."""
    edges = np.cumsum([0, *(data.samples for data in datasets)])
    order = np.random.default_rng(seed).permutation(edges[-1])
    folds = []
    for number, part in enumerate(np.array_split(order, count), 1):
        chosen = np.zeros(edges[-1], dtype=bool)
        chosen[part] = True
        folds.append(Fold(f"random {number}", tuple(np.split(chosen, edges[1:-1])), tuple(_masks(datasets))))
    return folds
