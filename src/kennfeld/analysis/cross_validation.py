"""Cross-validation: the error on data that the fit did not see, from the training data alone.

Each fold is held back once; the rest is calibrated from the project's start, everything that is chosen from data
(smoothness, shifts) anew; the result is scored on the fold. Data held back are simulated all the same, so that the
states of a model with memory are what they would be, but no target of theirs is seen.

Which samples are held back together: whole recordings, blocks in time, or steady points at random.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, InputError
from kennfeld.optimize import Options, Problem, Progress, Quality, Result, TraceLine, run
from kennfeld.optimize.api import build_problem

__all__ = ["CrossValidation", "FoldQuality", "cross_validate", "cross_validated", "folds_of"]

Kind = Literal["auto", "files", "blocks", "random"]
GAP = 0.05  # share of a block that is not fitted on either side of it

HELD = " (held back)"


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
        message = "a model with memory cannot be cross-validated on samples picked at random"
        raise InputError.of("cross-validation", message, "Use blocks.")
    available = len(pieces) if kind == "files" else sum(data.samples for data in datasets)
    if available < count:
        message = f"{count} folds of {available} {'pieces' if kind == 'files' else 'samples'}"
        raise InputError.of("cross-validation", message, "Ask for fewer folds.")
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


@dataclass(frozen=True)
class FoldQuality:
    """One criterion in one fold, in the unit of its target; `samples` is how many were held back and scored."""

    fold: int
    held: str
    criterion: str
    samples: int
    rmse_training: float
    rmse_held: float
    status: str


@dataclass(frozen=True)
class CrossValidation:
    """The quality of every fold."""

    folds: tuple[FoldQuality, ...]

    @property
    def criteria(self) -> tuple[str, ...]:
        """The criteria, in their order."""
        return tuple(dict.fromkeys(row.criterion for row in self.folds))

    def mean(self, criterion: str) -> float:
        """Mean RMSE on the data held back; NaN where no fold was scored."""
        return float(np.mean(self._held(criterion))) if self._held(criterion) else float("nan")

    def spread(self, criterion: str) -> float:
        """Standard deviation of the RMSE from fold to fold; NaN for fewer than two."""
        return float(np.std(self._held(criterion), ddof=1)) if len(self._held(criterion)) > 1 else float("nan")

    def training(self, criterion: str) -> float:
        """Mean RMSE on the data that were fitted."""
        found = [row.rmse_training for row in self.folds if row.criterion == criterion]
        return float(np.mean(found)) if found else float("nan")

    def _held(self, criterion: str) -> list[float]:
        return [row.rmse_held for row in self.folds if row.criterion == criterion and row.samples]

    def as_json(self) -> dict[str, Any]:
        """The contents of `cross_validation.json`; numbers that are not finite are None."""
        return {
            "folds": [{name: _plain(value) for name, value in vars(row).items()} for row in self.folds],
            "summary": [
                {
                    "criterion": name,
                    "rmse_training": _plain(self.training(name)),
                    "rmse_held": _plain(self.mean(name)),
                    "spread": _plain(self.spread(name)),
                }
                for name in self.criteria
            ],
        }

    def table(self) -> list[tuple[str, ...]]:
        """The folds and their mean as rows of text, the heading first."""
        head = ("fold", "held back", "criterion", "samples", "RMSE training", "RMSE held back", "status")
        rows = [
            (
                *(str(row.fold), row.held, row.criterion, str(row.samples)),
                *(f"{value:#.4g}" for value in (row.rmse_training, row.rmse_held)),
                row.status,
            )
            for row in self.folds
        ]
        return [head, *rows]

    def summary(self) -> list[str]:
        """A sentence for each criterion."""
        return [
            f"{name}: RMSE {self.mean(name):#.4g} +- {self.spread(name):#.2g} on data held back, "
            f"{self.training(name):#.4g} in training"
            for name in self.criteria
        ]

    def __str__(self) -> str:
        table = self.table()
        widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
        return "\n".join([*lines, *self.summary()])


def cross_validate(
    model: Any,
    data: Any = None,
    start: Any = None,
    target: str | float | None = None,
    *,
    folds: int = 5,
    kind: Kind = "auto",
    seed: int = 0,
    options: Options | None = None,
    progress: Progress | None = None,
    **arguments: Any,
) -> CrossValidation:
    """Cross-validate a problem, or what `calibrate` would be given.

    Args:
        model: a `Problem`, such as `Project.problem()` gives; or the model, with `data`, `start` and all else as in
            `calibrate`.
        data: training data.
        start: the current calibration, from which every fold starts.
        target: the channel that the model's output shall follow.
        folds: how many parts, each held back once.
        kind: `files` holds back whole files or pieces, `blocks` contiguous parts of each piece, `random` steady points;
            `auto` takes files where there are enough, blocks for data in time, else random.
        seed: of the random order.
        options: iterations, tolerance, continuation.
        progress: called after each accepted step; may raise `Stop`, which ends with the folds so far.
        arguments: as in `calibrate`.

    Returns:
        RMSE of each fold and criterion, with mean and spread. Raises `InputError` for unusable input.

    >>> data = {"x": [0.0, 1.0, 2.0, 3.0], "y": [1.0, 3.0, 5.0, 7.0]}
    >>> found = cross_validate("model = a + b * x", data, {"a": 0.0, "b": 0.0}, target="y", folds=2)
    >>> round(found.mean("model"), 9)
    0.0
    """
    if isinstance(model, Problem):
        if arguments or data is not None or start is not None or target is not None:
            raise ArgumentError("a problem has its data and its start; give nothing beside it but how to validate")
        problem = model
    else:
        problem = build_problem(model, data, start, target, **arguments)
    return cross_validated(problem, folds, kind, seed, options or Options(), progress)


def cross_validated(
    problem: Problem,
    folds: int,
    kind: Kind = "auto",
    seed: int = 0,
    options: Options | None = None,
    progress: Progress | None = None,
) -> CrossValidation:
    """Cross-validate a problem; see `cross_validate`."""
    training = [data for data in problem.datasets if data.use == "training" and data.weight > 0]
    memory = bool(problem.model.graph.states)
    rows: list[FoldQuality] = []
    for number, fold in enumerate(folds_of(training, folds, kind, memory=memory, seed=seed), 1):
        result = run(_held_back(problem, training, fold), options or Options(), _labelled(progress, number))
        rows += _rows(number, fold, result)
        if result.status == "stopped":
            break
    return CrossValidation(tuple(rows))


def _held_back(problem: Problem, training: Sequence[Dataset], fold: Fold) -> Problem:
    """The problem of one fold: what is held back is a test dataset."""
    datasets: list[Dataset] = []
    shifts: dict[str, Sequence[str]] = {}
    for data, held, beside in zip(training, fold.held, fold.beside, strict=True):
        scored = np.ones(data.samples, dtype=bool) if data.scored is None else data.scored
        parts = (data.name, "training", scored & ~held & ~beside), (data.name + HELD, "test", scored & held)
        for name, use, mask in parts:
            datasets.append(_masked(data, name, use, mask))
            if data.name in problem.unknown_shifts:
                shifts[name] = problem.unknown_shifts[data.name]
    return replace(problem, datasets=tuple(datasets), unknown_shifts=shifts)


def _masked(data: Dataset, name: str, use: Any, scored: Bool) -> Dataset:
    return replace(data, name=name, use=use, scored=scored)


def _labelled(progress: Progress | None, number: int) -> Progress | None:
    if progress is None:
        return None

    def labelled(line: TraceLine) -> None:
        progress(replace(line, stage=f"fold {number} {line.stage}"))

    return labelled


def _rows(number: int, fold: Fold, result: Result) -> list[FoldQuality]:
    names = dict.fromkeys(row.criterion for row in result.quality)
    return [
        FoldQuality(
            fold=number,
            held=fold.name,
            criterion=name,
            samples=sum(row.samples for row in _of(result.quality, name, "test")),
            rmse_training=_rmse(_of(result.quality, name, "training")),
            rmse_held=_rmse(_of(result.quality, name, "test")),
            status=result.status,
        )
        for name in names
    ]


def _of(quality: Sequence[Quality], criterion: str, use: str) -> list[Quality]:
    return [row for row in quality if row.criterion == criterion and row.use == use and row.samples]


def _rmse(rows: Sequence[Quality]) -> float:
    """Over the samples of several datasets."""
    samples = sum(row.samples for row in rows)
    return float(np.sqrt(sum(row.samples * row.rmse_after**2 for row in rows) / samples)) if samples else float("nan")


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
