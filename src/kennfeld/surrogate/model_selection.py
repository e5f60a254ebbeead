"""Model selection for dynamic surrogates, by the RMSE of free runs on held-out blocks.

Lags are selected one after another, each time the one that lowers the RMSE most. For each candidate a small model is
trained for free run (few centres, few steps); the selection is trained in full afterwards. Candidates are the present
sample and lags that grow by about a third, because neighbouring lags carry nearly the same information; a selected lag
may then move by a sample. The length scales and the regularisation are selected on the same blocks.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.lag_screening import OUTPUT, ChannelLag, channel_lags, screen_lags
from kennfeld.surrogate.narx_training import (
    HORIZONS,
    TrainingSettings,
    cut_recordings,
    free_run_rmse,
    horizon_ranges,
    one_step_expansion,
    train_free_run,
)
from kennfeld.surrogate.recursion import Lags, Recording, Runs
from kennfeld.surrogate.stopping import Stopped, never

LONGEST = (3.0, 5.0, 8.0)  # length scales are cut at so many spreads
MIDDLE = LONGEST[1]  # without a selection
ALIKE = 0.5  # share of a length scale from which a shorter one is not tried beside it
HOLDS = (3e3, 1e3, 300.0, 100.0, 30.0, 10.0)
BLOCKS = 6  # twice as many if there are more samples than are used
FEW = 4  # at least so many are held out in turn if there are more samples than are used
SAMPLES = 8000  # used for choosing
CENTRES = 60
ITERATIONS = 6  # at most, if there are more samples than are used
SHORTEST = 20  # samples of a block beyond the lags

LAG_CENTRES = 20
LAG_ITERATIONS = 3
LAG_BLOCKS = 4
LAG_SAMPLES = 8000
SCREENED = 5000  # samples that lags are screened on
REFINED = (3, 2, 2)  # trials that add a lag of an input, add one of the output, or move one
LENGTH = 5.0  # length scale, in spreads, while lags are chosen
HOLD = 300.0
WORTH = 0.98  # a lag stays if it lowers the RMSE to this share or less
MOST = 10
MOST_OUTPUT = 4  # longest lag of the output among the candidates


@dataclass(frozen=True, eq=False)
class HoldoutFold:
    """One division of the recordings into training and held-out runs."""

    training: Runs
    held_out: Runs
    thinned: bool = False  # whether only a part of the recordings is used


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """The selection, and the RMSE of free runs on held-out blocks, in units of the output."""

    lengths: Float
    settings: TrainingSettings
    rmse: float


def folds(
    pieces: Sequence[Recording], lags: Lags, count: int = BLOCKS, samples: int = SAMPLES, *, few: bool = False
) -> list[HoldoutFold]:
    """Return folds that hold out one block of the pieces each, with the inputs before it known.

    If there are more than `samples`, blocks are skipped evenly; then, or with `few`, about 4 blocks are held out.
    """
    blocks = held_out_blocks(pieces, lags, count, samples)
    thinned = sum(len(piece) for piece in pieces) > samples
    # each fold is a training of its own: of many samples, only every so many blocks are held out
    step = max(len(blocks) // FEW, 1) if thinned or few else 1
    result = []
    for number in range(0, len(blocks), step) if len(blocks) > 1 else ():
        i, first, end = blocks[number]
        # the run starts from the first outputs of the block itself; before it only inputs are read
        begin = max(first - lags.longest + max(lags.output), 0)
        held_out = Runs.of([pieces[i].part(begin, end)], lags, None if begin else max(lags.output))
        training = _cut_runs(pieces, [*blocks[:number], *blocks[number + 1 :]], lags)
        result.append(HoldoutFold(Runs.of(training, lags), held_out, thinned))
    return result


def held_out_blocks(
    pieces: Sequence[Recording], lags: Lags, count: int = BLOCKS, samples: int = SAMPLES
) -> list[tuple[int, int, int]]:
    """Return (piece, first, end) of each block: at least `count`, evenly over the pieces, of similar length."""
    total = sum(len(piece) for piece in pieces)
    count = 2 * count if total > samples else count
    length = max(min(total, samples) // count, lags.longest + SHORTEST)
    blocks = []
    for i, piece in enumerate(pieces):
        parts = max(round(len(piece) / length), 1)
        edges = np.linspace(0, len(piece), parts + 1).astype(int).tolist()
        blocks += [(i, a, b) for a, b in pairwise(edges) if b - a > lags.longest + 5]
    most = max(count, 2)
    if total > samples and len(blocks) > most:
        blocks = [blocks[k] for k in np.unique(np.linspace(0, len(blocks) - 1, most).round().astype(int))]
    return blocks


def _cut_runs(pieces: Sequence[Recording], blocks: Sequence[tuple[int, int, int]], lags: Lags) -> list[Recording]:
    """Join neighbouring blocks, then cut them into runs of the longest horizon."""
    joined: list[tuple[int, int, int]] = []
    for i, first, end in blocks:
        if joined and joined[-1][0] == i and joined[-1][2] == first:
            joined[-1] = (i, joined[-1][1], end)
        else:
            joined.append((i, first, end))
    return [
        pieces[i].part(*span) for i, first, end in joined for span in horizon_ranges(first, end, lags, HORIZONS[-1])
    ]


def choose_regularisation(
    divisions: Sequence[HoldoutFold],
    lengths: Float,
    centres: int,
    settings: TrainingSettings,
    report: Callable[[str], None] = lambda line: None,
    stopped: Stopped = never,
) -> ModelChoice:
    """Choose the length scales and `hold` with the least RMSE over the blocks left out.

    `lengths`, in units of spread, are those of the one-step process, cut at each of a few smoothnesses. Beside them,
    equal lengths are tried: what is likely one step ahead need not run freely, and others may be nearly as likely.
    Once `stopped` returns true, the choice is among those tried so far, and that without a selection if there are none.
    """
    # As many steps as the training itself takes where that is affordable: to end early is to hold firmly, too.
    most = ITERATIONS if divisions[0].thinned else settings.iterations
    iterations = min(settings.iterations, most)
    rows = _length_rows(lengths)
    table = np.full((len(rows), len(HOLDS)), np.inf)
    for i, (name, row) in enumerate(rows):
        if stopped():
            break
        starts = [one_step_expansion(f.training, row, min(centres, CENTRES), settings.limits) for f in divisions]
        for j, hold in enumerate(HOLDS):
            if stopped():
                break
            trial = replace(settings, hold=hold, iterations=iterations, moves_centres=False)
            table[i, j] = held_out_rmse(divisions, starts, trial)
            report(f"{name} spreads, hold {hold:g}: {table[i, j]:.4g} on the blocks left out")
    if np.isinf(table).all():
        return ModelChoice(np.minimum(lengths, MIDDLE), settings, np.nan)
    i, j = _lowest(table)
    return ModelChoice(rows[i][1], replace(settings, hold=HOLDS[j]), float(table[i, j]))


def _length_rows(lengths: Float) -> list[tuple[str, Float]]:
    """Return the length scales to try, each with its name, the smoothest last."""
    rows = [(f"length scales of {longest:g}", np.full(lengths.size, longest)) for longest in LONGEST]
    for longest in LONGEST:
        cut = np.minimum(lengths, longest)
        if cut.min() < ALIKE * longest:
            rows.append((f"length scales up to {longest:g}", cut))
    return rows


def _lowest(table: Float) -> tuple[int, int]:
    """Return the minimum of the table smoothed along its rows: a single low among high values is chance."""
    with np.errstate(divide="ignore"):
        # a diverged run is infinite; a large number instead keeps its neighbours in the mean finite
        logarithm = np.minimum(np.log(table), 1e3)
    wide = np.pad(logarithm, ((0, 0), (1, 1)), mode="edge")
    smooth = (wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]) / 4
    i, j = np.unravel_index(int(np.argmin(smooth)), smooth.shape)
    return int(i), int(j)


def held_out_rmse(divisions: Sequence[HoldoutFold], starts: Sequence[Expansion], settings: TrainingSettings) -> float:
    """Return the RMSE over held-out blocks, in units of the output, of models trained for free run."""
    squares, count = 0.0, 0
    for fold, start in zip(divisions, starts, strict=True):
        trained = train_free_run(start, fold.training, settings)
        size = int(fold.held_out.scored.sum())
        squares += size * free_run_rmse(trained, fold.held_out, settings.limits) ** 2
        count += size
    return float(np.sqrt(squares / max(count, 1)))


def candidates(longest: int) -> tuple[int, ...]:
    """Return 0, 1, 2, 3, 4, 5, 7, 10, ... up to `longest`.

    >>> candidates(20)
    (0, 1, 2, 3, 4, 5, 7, 10, 13, 18)
    """
    result, lag = {0}, 1.0
    while round(lag) <= longest:
        result.add(round(lag))
        lag = max(lag + 1, lag * 1.35)
    return tuple(sorted(result))


def select_lags(
    pieces: Sequence[Recording],
    inputs: int,
    settings: TrainingSettings,
    *,
    longest: int = 20,
    output_lags: tuple[int, ...] | None = None,
    input_lags: Sequence[tuple[int, ...]] | None = None,
    report: Callable[[str], None] = lambda line: None,
    stopped: Stopped = never,
) -> Lags:
    """Return lags of the output and of each input, up to `longest` samples; given ones are kept.

    Begins with the last output and the last sample of each input. A lag of the output is only of use if it is short:
    up to 4 are tried. Once `stopped` returns true, the lags so far are returned.
    """
    search = _LagSearch(pieces, settings, longest, stopped)
    first = [(1,)] * inputs if input_lags is None else list(input_lags)
    best = Lags(output_lags or (1,), tuple(first))
    for _ in range(MOST):
        neighbours = search.promising(
            list(_neighbours(best, search.reach, output_lags is None, input_lags is None)), best
        )
        trial = min(neighbours, key=search.score, default=best)
        if trial is best or stopped() or not search.score(trial) <= WORTH * search.score(best):
            break
        best = trial
        text = f"lags {best.output} of the output, {best.inputs} of the inputs: {search.score(best):.4g}"
        report(f"{text} on blocks left out")
    return best


class _LagSearch:
    """The free-run error of lags on held-out blocks, and a cheap forecast of which lags lower it."""

    def __init__(self, pieces: Sequence[Recording], settings: TrainingSettings, longest: int, stopped: Stopped) -> None:
        self._pieces, self._stopped = pieces, stopped
        self._settings = replace(settings, hold=HOLD, iterations=LAG_ITERATIONS, moves_centres=False)
        self.reach = min(longest, max(min(len(piece) for piece in pieces) // 4, 1))
        self._scores: dict[Lags, float] = {}

    def score(self, lags: Lags) -> float:
        """Return the RMSE on held-out blocks; infinite once the search is stopped."""
        if lags not in self._scores:
            self._scores[lags] = np.inf if self._stopped() else _score(self._pieces, lags, self._settings)
        return self._scores[lags]

    def promising(self, neighbours: Sequence[Lags], best: Lags) -> list[Lags]:
        """Return the few neighbours of `best` that bring the lags which explain most of its residual."""
        gains = self._gains(best, neighbours)
        # the run diverged and ranks nothing: all neighbours are trained, in a fixed order
        if not gains:
            return sorted(neighbours, key=repr)
        return _most_gain(neighbours, best, gains)

    def _gains(self, lags: Lags, neighbours: Sequence[Lags]) -> dict[ChannelLag, float]:
        stretches = cut_recordings(self._pieces, lags, HORIZONS[-1])
        parts = max(sum(map(len, stretches)) // SCREENED, 1)
        runs = Runs.of(stretches[::parts], lags)
        # as small as the models that are compared, so that its residual is theirs
        start = one_step_expansion(runs, np.full(lags.size, LENGTH), LAG_CENTRES, self._settings.limits)
        model = train_free_run(start, runs, self._settings, stopped=self._stopped)
        pool = _union([lags, *neighbours])
        return screen_lags(model, lags, stretches[::parts], pool, self._settings)


def _union(several: Sequence[Lags]) -> Lags:
    """Return all lags of these."""
    output = {lag for lags in several for lag in lags.output}
    inputs = [{lag for lags in several for lag in lags.inputs[j]} for j in range(len(several[0].inputs))]
    return Lags(tuple(output), tuple(map(tuple, inputs)))


def _most_gain(neighbours: Sequence[Lags], best: Lags, gains: Mapping[ChannelLag, float]) -> list[Lags]:
    """Return the neighbours that add the lags of highest gain, and those that move a lag to such a place.

    Lags of a channel that are near to each other carry nearly the same information, so only one of them is returned.
    """
    present = set(channel_lags(best))
    brought = {lags: next(iter(set(channel_lags(lags)) - present)) for lags in neighbours}
    ranked = sorted(neighbours, key=lambda lags: (-gains.get(brought[lags], 0.0), repr(lags)))
    groups = (
        [lags for lags in ranked if lags.size > best.size and brought[lags][0] != OUTPUT],
        [lags for lags in ranked if lags.size > best.size and brought[lags][0] == OUTPUT],
        [lags for lags in ranked if lags.size == best.size],
    )
    return [lags for group, count in zip(groups, REFINED, strict=True) for lags in _apart(group, brought, count)]


def _apart(ranked: Sequence[Lags], brought: Mapping[Lags, ChannelLag], count: int) -> list[Lags]:
    """Return the first `count` of these without those that bring nearly the same lag as one before."""
    picked: list[Lags] = []
    seen: list[ChannelLag] = []
    for lags in ranked:
        channel, lag = brought[lags]
        if len(picked) < count and all(other != channel or abs(lag - near) > 0.35 * near for other, near in seen):
            picked.append(lags)
            seen.append((channel, lag))
    return picked


def _neighbours(lags: Lags, reach: int, outputs: bool, inputs: bool) -> Iterator[Lags]:
    """Yield the same with one lag more, or with one lag moved; what is given is kept."""
    if outputs:
        yield from (Lags(changed, lags.inputs) for changed in _change_lags(lags.output, range(1, MOST_OUTPUT + 1)))
    for j, before in enumerate(lags.inputs) if inputs else ():
        for changed in _change_lags(before, candidates(reach)):
            yield Lags(lags.output, (*lags.inputs[:j], changed, *lags.inputs[j + 1 :]))


def _change_lags(lags: tuple[int, ...], among: Sequence[int]) -> set[tuple[int, ...]]:
    """Return one lag more; a lag one sample earlier or later; a single lag replaced."""
    more = {(*lags, lag) for lag in among if lag not in lags}
    # lags are never removed: else the first one would stay near where the search began
    if len(lags) == 1:
        more |= {(lag,) for lag in among if lag not in lags}
    for at, lag in enumerate(lags):
        beside = {lag - 1, lag + 1} - set(lags)
        more |= {(*lags[:at], near, *lags[at + 1 :]) for near in beside if min(among) <= near <= max(among)}
    return more


def lag_error(pieces: Sequence[Recording], lags: Lags, settings: TrainingSettings) -> float:
    """Return the RMSE on held-out blocks of a small model with these lags, trained for free run."""
    return _score(pieces, lags, replace(settings, hold=HOLD, iterations=LAG_ITERATIONS, moves_centres=False))


def _score(pieces: Sequence[Recording], lags: Lags, small: TrainingSettings) -> float:
    lengths = np.full(lags.size, LENGTH)
    divisions = folds(pieces, lags, LAG_BLOCKS, LAG_SAMPLES)
    starts = [one_step_expansion(fold.training, lengths, LAG_CENTRES, small.limits) for fold in divisions]
    return held_out_rmse(divisions, starts, small)
