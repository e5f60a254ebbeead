"""Training for free run over longer and longer stretches.

A model that was trained one step ahead may run far off within thousands of steps, and the error there says little about
where to go: its slopes grow and fade with the length of the run. Over short stretches from measured outputs the way is
plain, and each longer stretch begins near its end. Stretches run side by side, so short ones are quick as well.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.expansion import Expansion
from kennfeld.surrogate.free_run import Settings, train_free_run
from kennfeld.surrogate.lags import Lags
from kennfeld.surrogate.recursion import Run, Runs

__all__ = ["HORIZONS", "cut", "train_over_horizons"]

HORIZONS = (30, 120, 500)  # samples


def cut(pieces: Sequence[Run], lags: Lags, horizon: int) -> list[Run]:
    """The pieces in stretches of about `horizon` samples, which share the lags at their ends."""
    return [piece.part(*span) for piece in pieces for span in spans(0, len(piece), lags, horizon)]


def spans(first: int, end: int, lags: Lags, horizon: int) -> Iterator[tuple[int, int]]:
    """First and end of each stretch."""
    parts = max(round((end - first) / max(horizon, 5 * lags.longest)), 1)
    edges = np.linspace(first, end, parts + 1).astype(int).tolist()
    yield from ((max(a - lags.longest, first), b) for a, b in pairwise(edges))


def train_over_horizons(
    start: Expansion,
    pieces: Sequence[Run],
    lags: Lags,
    settings: Settings,
    report: Callable[[int, int, float], None] = lambda horizon, step, rmse: None,
) -> Expansion:
    """The expansion that meets the output best in free runs of the longest horizon; see `train_free_run`."""
    longest = max(len(piece) for piece in pieces)
    expansion = start
    for horizon in [h for h in HORIZONS if h < longest] or [longest]:
        runs = Runs.of(cut(pieces, lags, horizon), lags)

        def heard(step: int, rmse: float, horizon: int = horizon) -> None:
            report(horizon, step, rmse)

        expansion = train_free_run(expansion, runs, settings, heard)
    return expansion
