"""Test samples that are training samples too: the error on them says nothing about data that the fit has not seen."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding
from kennfeld.optimize.problem import Problem

__all__ = ["HOLD_BACK", "Overlap", "overlap_findings", "overlaps"]

HOLD_BACK = "Hold other data back: the error on these does not tell how the function works on unseen data."

_CHANCE = 0.01  # share of the distinct test samples; coarse channels repeat themselves in some
_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: D. Knuth, The Art of Computer Programming, 6.4

Keys = NDArray[np.uint64]


@dataclass(frozen=True)
class Overlap:
    """How many of the samples of a test dataset, and of which training datasets they are samples too."""

    dataset: Dataset
    training: tuple[str, ...]
    samples: int
    of: int

    def __str__(self) -> str:
        count = f"all {self.of}" if self.samples == self.of else f"{self.samples} of {self.of}"
        return f"{count} test samples have the same inputs and targets as samples of {', '.join(self.training)}"


def overlaps(problem: Problem) -> Iterator[Overlap]:
    """Yield the test datasets that share scored samples with training data: equal inputs and equal targets.

    A single shared sample, or a share of at most 1 %, is taken for chance. Equal samples of one dataset count once in
    that: at standstill all are the same.
    """
    training = [data for data in problem.datasets if data.use == "training" and data.weight > 0]
    for test in (data for data in problem.datasets if data.use == "test"):
        names = [_shared_names(problem, test, data) for data in training]
        own = {tuple(chosen): _keys(test, chosen) for chosen in names}
        seen = [np.isin(own[tuple(chosen)], _keys(data, chosen)) for chosen, data in zip(names, training, strict=True)]
        found = [
            data.name
            for chosen, data, mask in zip(names, training, seen, strict=True)
            if _is_more_than_chance(own[tuple(chosen)], mask)
        ]
        if found:
            whole = max(keys.size for keys in own.values())
            same = [mask for mask in seen if mask.size == whole]
            samples = int(np.any(same, axis=0).sum()) if same else max(int(mask.sum()) for mask in seen)
            yield Overlap(test, tuple(found), samples, whole)


def overlap_findings(problem: Problem, place: Callable[[Dataset], str]) -> Iterator[Finding]:
    """Yield a warning for each test dataset that shares samples with training data."""
    for overlap in overlaps(problem):
        yield Finding(place(overlap.dataset), str(overlap), HOLD_BACK, severity="warning")


def _shared_names(problem: Problem, test: Dataset, training: Dataset) -> list[str]:
    """The channels that tell whether samples of two datasets are the same; none if no target can be compared."""
    inputs = [problem.channels.get(name, name) for name in problem.model.graph.inputs]
    targets = [c.target.name for c in problem.criteria if problem.target_node(c) is None and c.target.kind != "number"]
    both = [name for name in targets if name in test and name in training]
    return [] if targets and not both else [name for name in dict.fromkeys([*inputs, *both]) if name in test]


def _keys(dataset: Dataset, names: Sequence[str]) -> Keys:
    """A number for each scored sample at which all channels are known: equal for equal samples, else hardly ever."""
    kept = dataset.counting.copy()
    for name in names:
        kept &= np.isfinite(dataset[name].values)
    keys = np.zeros(int(kept.sum()) if names else 0, dtype=np.uint64)
    for name in names:
        values = dataset[name].values[kept] + 0.0  # -0 becomes 0
        keys = _mixed(keys ^ values.view(np.uint64))
    return keys


def _mixed(keys: Keys) -> Keys:
    """Spread every bit over all others."""
    keys = (keys ^ (keys >> np.uint64(32))) * _FACTOR
    keys = (keys ^ (keys >> np.uint64(29))) * _FACTOR
    return np.asarray(keys ^ (keys >> np.uint64(32)))


def _is_more_than_chance(keys: Keys, seen: NDArray[np.bool_]) -> bool:
    shared = np.unique(keys[seen]).size
    return shared > 1 and shared > _CHANCE * np.unique(keys).size
