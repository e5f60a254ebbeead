"""Training samples that occur twice: a recording and its copy are not two measurements.

The standard deviations of values assume that the errors of samples are independent. With each sample twice, they come
out smaller by the square root of 2.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Int
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK, Dataset
from kennfeld.optimize.problem.overlap import MIXER, Keys, contained, sample_keys, shared_names
from kennfeld.optimize.problem.problem import Problem

SHARE = 0.01  # of the samples of a dataset; fewer repeat themselves by chance
FINE = 0.5  # different targets for each different sample, from which equal ones are not due to rounding
RUN = 4  # consecutive samples of a recording that are compared as one
MAX_NAMES = 5  # in a warning
Owners = NDArray[np.int32]  # places of datasets in a list
REMEDY = "Remove the copies: they add no information, and make the standard deviations of the values too small."


def repeat_findings(problem: Problem, location: Callable[[Dataset], Location]) -> Iterator[Finding]:
    """Yield a warning for each training dataset with samples that occur before, in it or in another one.

    Samples are equal if all inputs and targets are, to the last digit. Of recordings, runs of samples are compared that
    are not all equal, as at standstill. Targets with few different numbers are coarse: equal samples are then likely.
    """
    seen: dict[tuple[str, ...], _SeenKeys] = {}
    for data in problem.fitted_datasets:
        names = shared_names(problem, data, data)
        keys = _keys_of(data, names)
        if keys.size and not _is_coarse(problem, data, keys):
            before = seen.setdefault((*names, str(data.time is None)), _SeenKeys())
            # sorted: the copies of a key follow it
            repeated = np.append(False, keys[1:] == keys[:-1])
            sources = [data.name] if _is_notable(repeated) else []
            repeated |= before.contain(keys)
            if _is_notable(repeated):
                sources += before.sources_of(keys)
                message = _describe(repeated.mean(), data.name, sources)
                yield Finding(location(data), message, REMEDY, severity="warning")
            before.add(data.name, keys)


def _keys_of(data: Dataset, names: tuple[str, ...]) -> Keys:
    """Return a hash for each sample, or for each run of samples of a recording that are not all equal, in order."""
    keys = sample_keys(data, names)
    if data.time is not None and keys.size >= RUN:
        keys = _join_runs(keys)
    keys.sort()
    return keys


def _join_runs(keys: Keys) -> Keys:
    """Return a hash for each run of samples that are not all equal; it takes the place of those of the samples."""
    count, total = 0, keys.size - RUN + 1
    for first in range(0, total, SAMPLES_PER_BLOCK):
        block = keys[first : min(first + SAMPLES_PER_BLOCK, total) + RUN - 1].copy()
        runs = np.lib.stride_tricks.sliding_window_view(block, RUN)
        joined = np.zeros(len(runs), dtype=np.uint64)
        for column in runs.T:
            # a hash in which the order of the samples counts
            joined ^= column
            joined *= MIXER
            joined ^= joined >> np.uint64(29)
        # runs of one sample, as at standstill, occur everywhere
        joined = joined[(runs[:, 1:] != runs[:, :-1]).any(axis=1)]
        # behind what was read: a run takes the place of its first sample
        keys[count : count + joined.size] = joined
        count += joined.size
    return keys[:count]


def _is_coarse(problem: Problem, data: Dataset, keys: Keys) -> bool:
    """Return if equal samples may be due to the resolution of the targets."""
    if data.time is not None:
        return False
    targets = {c.target.name for c in problem.criteria if problem.target_node(c) is None and c.target.kind != "number"}
    most = max((np.unique(data[name].values[data.counting]).size for name in targets if name in data), default=0)
    return most < FINE * np.unique(keys).size


class _SeenKeys:
    """Sorted keys of datasets, and the dataset of each; thousands of datasets take little longer than one."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._merged: list[tuple[Keys, Owners]] = []  # each more than twice as long as the next one

    def add(self, name: str, keys: Keys) -> None:
        """Add the keys of a dataset."""
        owners = np.full(keys.size, len(self._names), dtype=np.int32)
        self._names.append(name)
        # merged like the digits of a counter: each key is moved a logarithmic number of times
        while self._merged and self._merged[-1][0].size <= 2 * keys.size:
            last_keys, last_owners = self._merged.pop()
            keys, owners = np.concatenate([last_keys, keys]), np.concatenate([last_owners, owners])
            order = np.argsort(keys, kind="stable")  # merges what is sorted
            keys, owners = keys[order], owners[order]
        self._merged.append((keys, owners))

    def contain(self, keys: Keys) -> Bool:
        """Mark the keys that a dataset has."""
        marked = np.zeros(keys.size, dtype=bool)
        for part, _ in self._merged:
            marked |= contained(keys, part)
        return marked

    def sources_of(self, keys: Keys) -> list[str]:
        """Return the datasets that have more of the keys than chance explains, the first one added first."""
        distinct, weights = np.unique(keys, return_counts=True)
        counts = np.zeros(len(self._names))
        for part, owners in self._merged:
            places, at = _places_of(distinct, part)
            pairs = np.unique(owners[places].astype(np.int64) * distinct.size + at)  # a dataset may have a key twice
            owner, key = np.divmod(pairs, max(distinct.size, 1))
            # each key as often as the dataset that is judged has it
            counts += np.bincount(owner, weights[key], counts.size)
        return [self._names[i] for i in np.flatnonzero(counts > _chance(keys.size))]


def _places_of(distinct: Keys, ordered: Keys) -> tuple[Int, Int]:
    """Return the places of all keys that are equal to one of the distinct ones, and the place of that one."""
    # the range of each key among the sorted ones
    first, last = (np.searchsorted(ordered, distinct, side) for side in ("left", "right"))
    at = np.repeat(np.arange(distinct.size), last - first)
    starts = np.cumsum(last - first) - (last - first)  # of each key among the places
    return np.arange(at.size) - starts[at] + first[at], at


def _is_notable(repeated: Bool) -> bool:
    """Return whether more samples repeat than chance explains."""
    return int(repeated.sum()) > _chance(repeated.size)


def _chance(size: int) -> float:
    """Return how many of so many samples chance may repeat."""
    return max(1.0, SHARE * size)


def _describe(share: float, name: str, sources: list[str]) -> str:
    samples = "all training samples" if share == 1 else f"{100 * share:.2g} % of the training samples"
    others = join_names([each for each in sources if each != name], MAX_NAMES)
    where = f"samples of {others}" if others else "others of the dataset"
    return f"{samples} of {name} have the same inputs and targets as {where}"
