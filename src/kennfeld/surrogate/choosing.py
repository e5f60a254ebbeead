"""How smooth a dynamic model is, and how firmly it is held: chosen by free runs on blocks that training leaves out."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.expansion import Expansion
from kennfeld.surrogate.free_run import Settings, free_run_rmse, train_free_run
from kennfeld.surrogate.lags import Lags
from kennfeld.surrogate.one_step import one_step_expansion
from kennfeld.surrogate.recursion import Run, Runs

__all__ = ["Choice", "Fold", "choose", "folds"]

LONGEST = (5.0, 3.0, 8.0)  # length scales are cut at so many spreads
HOLDS = 10**0.5  # factor from one `hold` to the next
FIRST, POWERS = 4, (-4, 8)
BLOCKS = 6
FEW = 3  # of them are left out in turn where there are more samples than are used
SAMPLES = 3000  # used for choosing
CENTRES = 60
ITERATIONS = 6
HORIZON = 500  # samples that training runs freely while something is being chosen
SHORTEST = 20  # samples of a block beyond the lags


@dataclass(frozen=True, eq=False)
class Fold:
    """One division of the recordings."""

    training: Runs
    held_out: Runs


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen, and the RMSE of free runs on the blocks left out, in units of the output."""

    lengths: Float
    settings: Settings
    rmse: float


def folds(pieces: Sequence[Run], lags: Lags, count: int = BLOCKS, samples: int = SAMPLES) -> list[Fold]:
    """Divisions of the pieces that leave out one block each, with the inputs before it known.

    Where there are more than `samples`, blocks are left aside evenly.
    """
    blocks = list(_blocks(pieces, lags, count, samples))
    every = range(len(blocks))
    if sum(len(piece) for piece in pieces) > samples:
        every = range(0, len(blocks), max(len(blocks) // FEW, 1))
    made = []
    for left_out in every:
        training = [block for i, block in enumerate(blocks) if i != left_out]
        if training:
            made.append(Fold(Runs.of(_joined(pieces, training, lags), lags), _alone(pieces, blocks[left_out], lags)))
    return made


def _blocks(pieces: Sequence[Run], lags: Lags, count: int, samples: int) -> Iterator[tuple[int, int, int]]:
    """(piece, first, end) of each block: at least `count`, evenly over the pieces, about equally long."""
    total = sum(len(piece) for piece in pieces)
    length = max(min(total, samples) // count, lags.longest + SHORTEST)
    cut = []
    for i, piece in enumerate(pieces):
        parts = max(round(len(piece) / length), 1)
        edges = np.linspace(0, len(piece), parts + 1).astype(int).tolist()
        cut += [(i, a, b) for a, b in pairwise(edges) if b - a > lags.longest + 5]
    most = max(count, 2)
    if total > samples and len(cut) > most:
        cut = [cut[k] for k in np.unique(np.linspace(0, len(cut) - 1, most).round().astype(int))]
    yield from cut


def _joined(pieces: Sequence[Run], blocks: Sequence[tuple[int, int, int]], lags: Lags) -> list[Run]:
    """Neighbouring blocks joined, then cut into runs of about `HORIZON` samples."""
    joined: list[tuple[int, int, int]] = []
    for i, first, end in blocks:
        if joined and joined[-1][0] == i and joined[-1][2] == first:
            joined[-1] = (i, joined[-1][1], end)
        else:
            joined.append((i, first, end))
    return [pieces[i].part(*span) for i, first, end in joined for span in _short(first, end, lags)]


def _short(first: int, end: int, lags: Lags) -> Iterator[tuple[int, int]]:
    """A stretch cut into shorter ones, which run side by side, so in less time; they share the lags at their ends."""
    parts = max(round((end - first) / max(HORIZON, 5 * lags.longest)), 1)
    edges = np.linspace(first, end, parts + 1).astype(int).tolist()
    yield from ((max(a - lags.longest, first), b) for a, b in pairwise(edges))


def _alone(pieces: Sequence[Run], block: tuple[int, int, int], lags: Lags) -> Runs:
    i, first, end = block
    begin = max(first - lags.longest + max(lags.output), 0)
    return Runs.of([pieces[i].part(begin, end)], lags, None if begin else max(lags.output))


def choose(
    divisions: Sequence[Fold],
    lengths: Float,
    centres: int,
    settings: Settings,
    report: Callable[[str], None] = lambda line: None,
) -> Choice:
    """The length scales and `hold` with the least RMSE over the blocks left out.

    `lengths`, in units of spread, are those of the one-step process, cut at each of a few smoothnesses.
    """
    best: Choice | None = None
    for longest in LONGEST:
        cut = np.minimum(lengths, longest)
        starts = [one_step_expansion(f.training, cut, min(centres, CENTRES), settings.limits) for f in divisions]

        @cache
        def tried(
            power: int, cut: Float = cut, starts: Sequence[Expansion] = starts, longest: float = longest
        ) -> Choice:
            trial = replace(settings, hold=HOLDS**power, iterations=ITERATIONS, moves_centres=False)
            rmse = _held_out(divisions, starts, trial)
            report(f"length scales up to {longest:g} spreads, hold {trial.hold:g}: {rmse:.4g} on the blocks left out")
            return Choice(cut, replace(settings, hold=trial.hold), rmse)

        power = FIRST if best is None else round(np.log(best.settings.hold) / np.log(HOLDS))
        found = tried(_downhill(lambda at: tried(at).rmse, power, *POWERS))
        best = found if best is None or found.rmse < best.rmse else best
    assert best is not None
    return best


def _downhill(value: Callable[[int], float], at: int, least: int, most: int) -> int:
    """The whole number, reached by single steps from `at`, whose neighbours are no better."""
    for way in (-1, 1):
        moved = False
        while least <= at + way <= most and value(at + way) < value(at):
            at, moved = at + way, True
        if moved:
            break
    return at


def _held_out(divisions: Sequence[Fold], starts: Sequence[Expansion], settings: Settings) -> float:
    squares, count = 0.0, 0
    for fold, start in zip(divisions, starts, strict=True):
        trained = train_free_run(start, fold.training, settings)
        size = int(fold.held_out.scored.sum())
        squares += size * free_run_rmse(trained, fold.held_out, settings.limits) ** 2
        count += size
    return float(np.sqrt(squares / count))
