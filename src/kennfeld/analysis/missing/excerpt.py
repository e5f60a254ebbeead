"""A problem over part of its training data, for an estimate that must not take long."""

from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.domain.dataset import Dataset, pick
from kennfeld.optimize.problem.problem import Problem


def excerpt(problem: Problem, share: float) -> Problem:
    """Return a problem over a share of the samples of each recording.

    Recordings in time keep their beginnings, as states start there; of steady-state points one in so many is kept.
    The smoothness shrinks with the data, so that it weighs the same beside them.

    Args:
        problem: without partitions or automatic smoothness.
        share: of the samples, > 0; from 1 on, the problem is returned as it is.
    """
    if share >= 1:
        return problem
    datasets = tuple(_part(data, share) if data.is_fitted else data for data in problem.datasets)
    kept = sum(data.samples for data in datasets if data.is_fitted)
    scale = kept / max(sum(data.samples for data in problem.fitted_datasets), 1)
    smoothness = {name: tuple(scale * factor for factor in problem.factors(name)) for name in problem.free_names}
    return replace(problem, datasets=datasets, smoothness={**problem.smoothness, **smoothness})


def _part(data: Dataset, share: float) -> Dataset:
    if data.samples == 0:
        return data
    return pick(data, np.concatenate([_kept(piece, share, timed=data.time is not None) for piece in data.pieces]))


def _kept(piece: slice, share: float, *, timed: bool) -> Int:
    """Return the numbers of the samples of a piece that are kept, at least one."""
    length = piece.stop - piece.start
    count = max(int(np.ceil(share * length)), 1)
    samples: Int = np.arange(count) if timed else np.arange(count) * length // count
    samples += piece.start
    return samples
