"""Cross-validation: the error on unseen data, estimated from the training data.

Each fold is held out once; the rest is calibrated from the start of the problem, including everything that is chosen
from data (smoothness, shifts), and the result is scored on the fold. Held-out samples are simulated, so that the states
of a model are correct, but their targets are not used. A fold is made of whole recordings, blocks in time, or steady
points at random.
"""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Unpack, get_args, overload

import numpy as np

from kennfeld.analysis.validation_result import CrossValidation, FoldQuality, Kind
from kennfeld.base.arrays import Bool
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.task_runner import TaskRunner, message_line
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_spans import short_names
from kennfeld.models import Model
from kennfeld.optimize.fit.result import Progress, Result, TraceLine
from kennfeld.optimize.problem.arguments import ProblemArguments, Start, check_options
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.partitions import Partition
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import problem_of
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.solver.levenberg_marquardt import Stop
from kennfeld.preprocessing.coercion import Data

GAP = 0.05  # share of a block that is not fitted on each side of it

MAX_NAMES = 3  # files of a fold that are named
HELD_OUT = " (held out)"
PLACE = Location("cross-validation")


@dataclass(frozen=True)
class Fold:
    """For each dataset the samples held out, and their neighbours that are neither fitted nor scored."""

    name: str
    held: tuple[Bool, ...]
    excluded: tuple[Bool, ...]


@dataclass(frozen=True)
class PartitionFold:
    """Partitions that are held out."""

    name: str
    held: tuple[Partition, ...]


def folds_of_partitions(partitions: Sequence[Partition], count: int, kind: Kind, seed: int = 0) -> list[PartitionFold]:
    """Split partitions at random into folds of about equal size that hold out each once.

    Raises:
        ArgumentError: fewer than two folds.
        InputError: fewer partitions than folds, or a kind of folds that divides files.
    """
    if count < 2:
        raise ArgumentError(f"folds must be >= 2, got {count}")
    if kind not in ("auto", "files"):
        raise InputError.of(PLACE, f"data in partitions cannot be held out by {kind}", "Use files.")
    if len(partitions) < count:
        message = f"cannot make {count} folds of {len(partitions)} partitions"
        raise InputError.of(PLACE, message, "Use fewer folds, or smaller partitions.")
    order = np.random.default_rng(seed).permutation(len(partitions))
    groups = [[partitions[at] for at in sorted(order[number::count])] for number in range(count)]
    return [PartitionFold(name_partitions(group), tuple(group)) for group in groups]


def name_partitions(partitions: Sequence[Partition]) -> str:
    """Return the files of partitions, the first one and how many more there are."""
    files = list(dict.fromkeys(part.source.name for partition in partitions for part in partition.parts))
    return join_names(files, 1)


def folds_of(
    datasets: Sequence[Dataset], count: int, kind: Kind = "auto", *, memory: bool, seed: int = 0
) -> list[Fold]:
    """Split data into folds of about equal size that hold out every sample once.

    Args:
        datasets: the training data.
        count: number of folds.
        kind: `files` are whole pieces, `blocks` contiguous parts of each piece, `random` single samples; `auto` is
            `files` if there are enough pieces, else `blocks` if data have time or the model has states, else `random`.
        memory: True if the model has states.
        seed: of the random order.

    Raises:
        ArgumentError: fewer than two folds.
        InputError: not enough data, or random samples for a model with states.

    >>> data = Dataset.of("d", {"x": np.arange(6.0)})
    >>> [fold.held[0].nonzero()[0].tolist() for fold in folds_of([data], 3, "blocks", memory=False)]
    [[0, 1], [2, 3], [4, 5]]
    """
    if count < 2:
        raise ArgumentError(f"folds must be >= 2, got {count}")
    pieces = _pieces(datasets)
    if kind == "auto":
        kind = suitable_kind(datasets, count, memory=memory)
    if kind == "random" and memory:
        message = "a model with states cannot be cross-validated on random samples"
        raise InputError.of(PLACE, message, 'Use kind = "blocks".')
    available = len(pieces) if kind == "files" else sum(data.samples for data in datasets)
    if available < count:
        message = f"cannot make {count} folds of {available} {'pieces' if kind == 'files' else 'samples'}"
        raise InputError.of(PLACE, message, "Use fewer folds.")
    if kind == "random":
        return _hold_out_random_samples(datasets, count, seed)
    hold_out = _hold_out_pieces if kind == "files" else _hold_out_blocks
    return hold_out(datasets, pieces, count)


def suitable_kind(datasets: Sequence[Dataset], count: int, *, memory: bool, whole: bool = True) -> Kind:
    """Return the kind of folds that `auto` stands for; see `folds_of`. Without `whole`, pieces are divided."""
    timed = memory or any(data.time is not None for data in datasets)
    return "files" if whole and len(_pieces(datasets)) >= count else "blocks" if timed else "random"


def _pieces(datasets: Sequence[Dataset]) -> list[tuple[int, slice]]:
    return [(i, piece) for i, data in enumerate(datasets) for piece in data.pieces if piece.stop > piece.start]


def _masks(datasets: Sequence[Dataset]) -> tuple[Bool, ...]:
    return tuple(np.zeros(data.samples, dtype=bool) for data in datasets)


def _hold_out_pieces(datasets: Sequence[Dataset], pieces: Sequence[tuple[int, slice]], count: int) -> list[Fold]:
    """Assign whole pieces, the longest first, each to the smallest fold."""
    held_out = [_masks(datasets) for _ in range(count)]
    sizes, members = [0] * count, [dict[int, list[int]]() for _ in range(count)]
    # R. L. Graham: Bounds on Multiprocessing Timing Anomalies, 1969: short pieces even out what long ones leave
    for i, piece in sorted(pieces, key=lambda entry: (entry[1].start - entry[1].stop, entry[0], entry[1].start)):
        at = int(np.argmin(sizes))
        held_out[at][i][piece] = True
        sizes[at] += piece.stop - piece.start
        members[at].setdefault(i, []).append(list(datasets[i].piece_starts).index(piece.start) + 1)
    titles = [", ".join(_describe_pieces(datasets[i], own[i]) for i in sorted(own)) for own in members]
    return [Fold(title, masks, _masks(datasets)) for title, masks in zip(titles, held_out, strict=True)]


def _describe_pieces(data: Dataset, numbers: Sequence[int]) -> str:
    if data.files is not None and np.array_equal(data.files.starts, data.piece_starts):  # each file is a piece
        names = list(short_names(data.files.names).values())
        return join_names([names[number - 1] for number in sorted(numbers)], MAX_NAMES)
    if len(data.pieces) == 1:
        return data.name
    return f"{data.name} piece{'s' * (len(numbers) > 1)} {', '.join(map(str, sorted(numbers)))}"


def _hold_out_blocks(datasets: Sequence[Dataset], pieces: Sequence[tuple[int, slice]], count: int) -> list[Fold]:
    """Hold out the same part of every piece; its neighbours are not fitted, because they are correlated with it."""
    folds = []
    for number in range(count):
        held_out, excluded = _masks(datasets), _masks(datasets)
        for i, piece in pieces:
            edges = np.linspace(piece.start, piece.stop, count + 1).round().astype(int)
            first, last = int(edges[number]), int(edges[number + 1])
            # steady-state points are independent of their neighbours
            gap = int(GAP * (last - first)) if datasets[i].time is not None else 0
            excluded[i][max(first - gap, piece.start) : min(last + gap, piece.stop)] = True
            held_out[i][first:last] = True
            excluded[i][first:last] = False
        folds.append(Fold(f"block {number + 1}", held_out, excluded))
    return folds


def _hold_out_random_samples(datasets: Sequence[Dataset], count: int, seed: int) -> list[Fold]:
    edges = np.cumsum([0, *(data.samples for data in datasets)])
    order = np.random.default_rng(seed).permutation(edges[-1])
    folds = []
    for number, part in enumerate(np.array_split(order, count), 1):
        chosen = np.zeros(edges[-1], dtype=bool)
        chosen[part] = True
        folds.append(Fold(f"random {number}", tuple(np.split(chosen, edges[1:-1])), _masks(datasets)))
    return folds


@overload
def cross_validate(
    model: Problem,
    *,
    folds: int = 5,
    kind: Kind = "auto",
    seed: int = 0,
    options: Options | None = None,
    progress: Progress | None = None,
) -> CrossValidation: ...


@overload
def cross_validate(
    model: Model | str,
    data: Data | Sequence[Data],
    start: Start,
    target: str | float | None = None,
    *,
    folds: int = 5,
    kind: Kind = "auto",
    seed: int = 0,
    options: Options | None = None,
    progress: Progress | None = None,
    **arguments: Unpack[ProblemArguments],
) -> CrossValidation: ...


def cross_validate(
    model: Model | str | Problem,
    data: Data | Sequence[Data] | None = None,
    start: Start | None = None,
    target: str | float | None = None,
    *,
    folds: int = 5,
    kind: Kind = "auto",
    seed: int = 0,
    options: Options | None = None,
    progress: Progress | None = None,
    **arguments: Unpack[ProblemArguments],
) -> CrossValidation:
    """Cross-validate a problem, or a model with the arguments of `calibrate`.

    Args:
        model: a `Problem`, such as `Project.problem()` gives; or the model, with `data`, `start` and all else as in
            `calibrate`.
        data: training data.
        start: the current calibration, from which every fold starts.
        target: the channel that the model's output shall follow.
        folds: number of parts, each held out once.
        kind: `files` holds out whole files or pieces, `blocks` contiguous parts of each piece, `random` steady points;
            `auto` takes files if there are enough, blocks for data in time, else random.
        seed: of the random order.
        options: iterations, tolerance, continuation.
        progress: called after each accepted step; may raise `Stop`, which returns the folds so far.
        arguments: as in `calibrate`.

    Returns:
        RMSE of each fold and criterion, with mean and spread.

    Raises:
        InputError: the input cannot be used.

    >>> data = {"x": [0.0, 1.0, 2.0, 3.0], "y": [1.0, 3.0, 5.0, 7.0]}
    >>> result = cross_validate("model = a + b * x", data, {"a": 0.0, "b": 0.0}, target="y", folds=2)
    >>> round(result.mean("model"), 9)
    0.0
    """
    check_options(options, progress)
    check_folds(folds, kind, seed)
    problem = problem_of(model, data, start, target, arguments, "cross_validate")
    options = options or Options()
    held: Sequence[Fold | PartitionFold]
    if problem.partitions is not None:
        held = folds_of_partitions(problem.partitions.training, folds, kind, seed)
    else:
        held = folds_of(problem.fitted_datasets, folds, kind, memory=bool(problem.model.graph.states), seed=seed)
        if options.cluster is not None:
            return CrossValidation(tuple(_folds_on_cluster(options.cluster, problem, options, held, progress)))
    rows: list[FoldQuality] = []
    for number, fold in enumerate[Fold | PartitionFold](held, 1):
        result = run(fold_problem(problem, fold), options, _name_fold(progress, number))
        rows += _fold_quality(number, fold, result)
        if result.status == "stopped":
            break
    return CrossValidation(tuple(rows))


def check_folds(folds: object, kind: object, seed: object) -> None:
    """Raise `ArgumentError` for folds that cannot be made."""
    for name, value, least in (("folds", folds, 2), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ArgumentError(f"{name} must be an integer >= {least}, got {value!r}")
    if kind not in get_args(Kind):
        raise ArgumentError(f"kind must be {', '.join(get_args(Kind))}, got {kind!r}")


def _folds_on_cluster(
    runner: TaskRunner,
    problem: Problem,
    options: Options,
    folds: Sequence[Fold | PartitionFold],
    progress: Progress | None,
) -> Iterator[FoldQuality]:
    """Yield the rows of all folds, which run as tasks of a cluster."""

    def receive(message: bytes) -> bool:
        # `Stop` is raised in this process; the answer passes it on to the workers
        line: TraceLine = pickle.loads(message)
        try:
            if progress is not None:
                progress(line)
        except Stop:
            return True
        return False

    # a copy, without what the problem has cached; a worker runs its fold alone
    shared = pickle_content((replace(problem), replace(options, cluster=None, workers=1)))
    items = [pickle_content((number, fold)) for number, fold in enumerate(folds, 1)]
    for rows in runner.map_with_messages(run_fold, shared, items, receive):
        yield from rows


def run_fold(shared: bytes, item: bytes, arguments: bytes) -> list[FoldQuality]:
    """Run one fold on a worker; none of its rows count if it was asked to stop before."""
    problem, options = pickle.loads(shared)
    number, fold = pickle.loads(item)
    line = message_line()

    def report(entry: TraceLine) -> None:
        line.send(pickle_content(entry))
        if line.is_stopping():
            raise Stop

    if line.is_stopping():
        return []
    result = run(fold_problem(problem, fold), options, _name_fold(report, number))
    return list(_fold_quality(number, fold, result))


def fold_problem(problem: Problem, fold: Fold | PartitionFold) -> Problem:
    """Return the problem of one fold, with the held-out samples as test datasets."""
    if isinstance(fold, PartitionFold):
        return _without_partitions(problem, fold)
    training = problem.fitted_datasets
    datasets: list[Dataset] = []
    shifts: dict[str, Sequence[str]] = {}
    for data, held_out, excluded in zip(training, fold.held, fold.excluded, strict=True):
        scored = np.ones(data.samples, dtype=bool) if data.scored is None else data.scored
        parts = [
            # all samples remain in both: states run through held-out samples, too
            replace(data, scored=scored & ~held_out & ~excluded),
            replace(data, name=data.name + HELD_OUT, use="test", scored=scored & held_out),
        ]
        datasets += parts
        if data.name in problem.unknown_shifts:
            shifts |= {part.name: problem.unknown_shifts[data.name] for part in parts}
    return replace(problem, datasets=tuple(datasets), unknown_shifts=shifts)


def _without_partitions(problem: Problem, fold: PartitionFold) -> Problem:
    """Return the problem with the held-out partitions as test data, under names of their own."""
    whole = problem.partitions
    assert whole is not None
    recipes, count = whole.recordings.recipes, len(whole.recordings.recipes)
    copies = tuple(replace(r, entry=replace(r.entry, name=r.entry.name + HELD_OUT, use="test")) for r in recipes)
    held = tuple(
        # the copies of the datasets follow the originals, in the same order
        Partition(tuple(replace(part, dataset=part.dataset + count) for part in partition.parts))
        for partition in fold.held
    )
    training = problem.fitted_datasets
    further = (replace(data, name=data.name + HELD_OUT, use="test") for data in training)
    partitions = replace(
        whole,
        recordings=replace(whole.recordings, recipes=recipes + copies),
        training=tuple(partition for partition in whole.training if partition not in fold.held),
        test=held,
    )
    sought = problem.unknown_shifts
    shifts = {**sought, **{data.name + HELD_OUT: sought[data.name] for data in training if data.name in sought}}
    return replace(problem, datasets=(*training, *further), partitions=partitions, unknown_shifts=shifts)


def _name_fold(progress: Progress | None, number: int) -> Progress | None:
    """Return the same progress, but stages name their fold."""
    if progress is None:
        return None
    return lambda line: progress(replace(line, stage=f"fold {number} {line.stage}"))


def _fold_quality(number: int, fold: Fold | PartitionFold, result: Result) -> Iterator[FoldQuality]:
    for name in dict.fromkeys(row.criterion for row in result.quality):
        _, training = _pool(result.quality, name, "training")
        samples, held_out = _pool(result.quality, name, "test")
        yield FoldQuality(number, fold.name, name, samples, training, held_out, result.status)


def _pool(quality: Sequence[Quality], criterion: str, use: str) -> tuple[int, float]:
    """Return the number of samples and the RMSE over all datasets of one use."""
    rows = [row for row in quality if row.criterion == criterion and row.use == use and row.samples]
    samples = sum(row.samples for row in rows)
    # RMSEs are pooled by their squares
    total = sum(row.samples * row.rmse_after**2 for row in rows)
    return samples, float(np.sqrt(total / samples)) if samples else float("nan")
