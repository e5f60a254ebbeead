"""Kinds of measurements: not all criteria are measured everywhere, such as drag at motored points only."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset


@dataclass(frozen=True, eq=False)
class MeasuredKind:
    """The criteria that are measured together, those with a target in some of the training data.

    Attributes:
        name: the dataset that such measurements are like.
        criteria: those that are measured.
        example: a dataset whose inputs and settings measurements of this kind have.
    """

    name: str
    criteria: tuple[Criterion, ...]
    example: Dataset


def measured_kinds(fitted: FittedFunction, *, timed: bool = False) -> list[MeasuredKind]:
    """Return the kinds of measurements among the training data, or among those over time, that of most samples first.

    If no training data are over time, they are those of all.
    """
    problem, kinds = fitted.problem, dict[tuple[int, ...], list[Dataset]]()
    over_time = [data for data in problem.fitted_datasets if data.time is not None]
    for data in over_time if timed and over_time else problem.fitted_datasets:
        bound = problem.bind(data)
        own = tuple(
            number
            for number, criterion in enumerate(problem.criteria)
            if np.isfinite(problem.target(criterion, bound)).any()
        )
        kinds.setdefault(own, []).append(data)
    ordered = sorted(kinds.items(), key=lambda item: -sum(data.samples for data in item[1]))
    return [MeasuredKind(own[0].name, tuple(problem.criteria[i] for i in at), own[0]) for at, own in ordered if at]


def kind_of(kinds: Sequence[MeasuredKind], candidates: Sequence[Dataset]) -> MeasuredKind:
    """Return the kind of candidates: that with most targets among their channels, else the first."""

    def targets(kind: MeasuredKind) -> int:
        return sum(all(c.target.name in data for data in candidates) for c in kind.criteria) if candidates else 0

    return max(kinds, key=targets)
