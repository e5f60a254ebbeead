"""Lags chosen one after another: each time the one that most lowers the RMSE of free runs on blocks left out.

Small models are trained for free run for each candidate (few centres, few steps); what is chosen is trained in full
afterwards. Candidates are the present sample and lags that grow by a third or so, because neighbours
say nearly the same; a lag that was chosen may then move by a sample.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.surrogate.choosing import folds, held_out_rmse
from kennfeld.surrogate.free_run import Settings
from kennfeld.surrogate.lags import Lags
from kennfeld.surrogate.one_step import one_step_expansion
from kennfeld.surrogate.recursion import Run

__all__ = ["candidates", "select_lags"]

CENTRES = 20
ITERATIONS = 3
BLOCKS = 4
SAMPLES = 2500
LENGTH = 5.0  # length scale, in spreads, while lags are chosen
HOLD = 300.0
WORTH = 0.98  # a lag stays if it lowers the RMSE to this share or less
MOST = 10
MOST_OUTPUT = 4  # longest lag of the output among the candidates


def candidates(longest: int) -> tuple[int, ...]:
    """0, 1, 2, 3, 4, 5, 7, 10, ... up to `longest`.

    >>> candidates(20)
    (0, 1, 2, 3, 4, 5, 7, 10, 13, 18)
    """
    made, lag = {0}, 1.0
    while round(lag) <= longest:
        made.add(round(lag))
        lag = max(lag + 1, lag * 1.35)
    return tuple(sorted(made))


def select_lags(
    pieces: Sequence[Run],
    inputs: int,
    settings: Settings,
    *,
    longest: int = 20,
    output_lags: tuple[int, ...] | None = None,
    input_lags: Sequence[tuple[int, ...]] | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Lags:
    """Lags of the output and of each input, up to `longest` samples; those given are kept as they are.

    Begins with the last output and the last sample of each input. A lag of the output is only of use if it is short:
    up to 4 are tried.
    """
    reach = min(longest, max(min(len(piece) for piece in pieces) // 4, 1))
    tried: dict[Lags, float] = {}

    def score(lags: Lags) -> float:
        if lags not in tried:
            tried[lags] = _score(pieces, lags, settings)
        return tried[lags]

    first = [(1,)] * inputs if input_lags is None else list(input_lags)
    best = Lags(output_lags or (1,), tuple(first))
    for _ in range(MOST):
        more = sorted(_more(best, reach, output_lags is None, input_lags is None), key=repr)
        found = min(more, key=score, default=best)
        if found is best or not score(found) <= WORTH * score(best):
            break
        best = found
        report(f"lags {best.output} of the output, {best.inputs} of the inputs: {score(best):.4g} on blocks left out")
    return best


def _more(lags: Lags, reach: int, outputs: bool, inputs: bool) -> set[Lags]:
    """The same with one lag more, or with one lag moved; what is given is kept."""
    made = set()
    if outputs:
        made |= {Lags(chosen, lags.inputs) for chosen in _changed(lags.output, range(1, MOST_OUTPUT + 1))}
    if inputs:
        for j, before in enumerate(lags.inputs):
            for chosen in _changed(before, candidates(reach)):
                made.add(Lags(lags.output, (*lags.inputs[:j], chosen, *lags.inputs[j + 1 :])))
    return made


def _changed(lags: tuple[int, ...], among: Sequence[int]) -> set[tuple[int, ...]]:
    """One lag more; a lag one sample earlier or later; a single lag replaced."""
    more = {(*lags, lag) for lag in among if lag not in lags}
    if len(lags) == 1:
        more |= {(lag,) for lag in among if lag not in lags}
    for at, lag in enumerate(lags):
        beside = {lag - 1, lag + 1} - set(lags)
        more |= {(*lags[:at], near, *lags[at + 1 :]) for near in beside if min(among) <= near <= max(among)}
    return more


def _score(pieces: Sequence[Run], lags: Lags, settings: Settings) -> float:
    lengths = np.full(lags.size, LENGTH)
    small = replace(settings, hold=HOLD, iterations=ITERATIONS, moves_centres=False)
    divisions = folds(pieces, lags, BLOCKS, SAMPLES)
    starts = [one_step_expansion(fold.training, lengths, CENTRES, settings.limits) for fold in divisions]
    return held_out_rmse(divisions, starts, small)
