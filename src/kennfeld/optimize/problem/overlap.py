"""Test samples that are also training samples, on which the error does not show how the model generalises."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Int
from kennfeld.base.errors import Finding, Location
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK, Dataset
from kennfeld.optimize.problem.problem import Problem

HOLD_BACK = "Hold out other data: the error on these does not show how the function works on unseen data."

_CHANCE = 0.01  # share of the distinct test samples; coarse channels repeat themselves in some
MIXER = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: D. Knuth, The Art of Computer Programming, 6.4

Keys = NDArray[np.uint64]


def overlap_findings(problem: Problem, location: Callable[[Dataset], Location]) -> Iterator[Finding]:
    """Yield a warning for each test dataset that shares scored samples, inputs and targets, with training data.

    A single shared sample, or a share of at most 1 %, is treated as chance. Equal samples of one dataset count once: at
    standstill all are equal.
    """
    for test in problem.datasets:
        message = _describe_overlap(problem, test) if test.use == "test" else ""
        if message:
            yield Finding(location(test), message, HOLD_BACK, severity="warning")


def _describe_overlap(problem: Problem, test: Dataset) -> str:
    """Describe the overlap of a test dataset with training data, each compared over the channels of both."""
    names_by_channels: dict[tuple[str, ...], list[str]] = {}
    seen: dict[tuple[str, ...], Bool] = {}
    counts: dict[tuple[str, ...], Int] = {}
    for data in problem.fitted_datasets:
        names = shared_names(problem, test, data)
        distinct, counts[names] = np.unique(sample_keys(test, names), return_counts=True)
        shared = contained(distinct, np.sort(sample_keys(data, names)))
        if shared.sum() > 1 and shared.sum() > _CHANCE * distinct.size:
            names_by_channels.setdefault(names, []).append(data.name)
            seen[names] = seen.get(names, False) | shared
    if not names_by_channels:
        return ""
    most = max(names_by_channels, key=lambda names: counts[names][seen[names]].sum())
    shared, total = counts[most][seen[most]].sum(), counts[most].sum()
    count = f"all {total}" if shared == total else f"{shared} of {total}"
    training = ", ".join(names_by_channels[most])
    return f"{count} test samples have the same inputs and targets as samples of {training}"


def contained(keys: Keys, ordered: Keys) -> Bool:
    """Mark the keys, Bool[keys], that are among sorted ones; `numpy.isin` takes twenty times as long for millions."""
    at = np.searchsorted(ordered, keys)
    inside = at < ordered.size
    # only places within the array can be compared
    inside[inside] = ordered[at[inside]] == keys[inside]
    return inside


def shared_names(problem: Problem, test: Dataset, training: Dataset) -> tuple[str, ...]:
    """Return the channels by which samples of two datasets are compared; none if no target can be compared."""
    inputs = [problem.channels.get(name, name) for name in problem.model.graph.inputs]
    targets = [c.target.name for c in problem.criteria if problem.target_node(c) is None and c.target.kind != "number"]
    # samples of other measurements may have equal inputs
    both = [name for name in targets if name in test and name in training]
    return () if targets and not both else tuple(name for name in dict.fromkeys([*inputs, *both]) if name in test)


def sample_keys(dataset: Dataset, names: Sequence[str]) -> Keys:
    """Compute a hash, uint64[samples], for each scored sample at which all channels are finite."""
    kept = dataset.counting.copy()
    for name in names:
        kept &= np.isfinite(dataset[name].values)
    keys = np.zeros(int(kept.sum()) if names else 0, dtype=np.uint64)
    count = 0
    for first in range(0, kept.size if names else 0, SAMPLES_PER_BLOCK):
        block = slice(first, first + SAMPLES_PER_BLOCK)
        part = keys[count : count + int(kept[block].sum())]
        for name in names:
            values = dataset[name].values[block][kept[block]] + 0.0  # -0 becomes 0
            # the bits of a double, mixed after each channel so that exchanged channels differ
            part ^= values.view(np.uint64)
            for shift in (32, 29):  # mixes every bit into all others
                part ^= part >> np.uint64(shift)
                part *= MIXER
            part ^= part >> np.uint64(32)
        count += part.size
    return keys
