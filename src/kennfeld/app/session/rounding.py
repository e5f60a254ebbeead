"""A set of values rounded to what a control unit stores, and what finer storage of its labels would bring."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import RoundingMethod, StorageGrid, StorageRounding
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.rounding.outcome import COARSE_BITS, LabelRounding, RoundingResult
from kennfeld.optimize.rounding.rounded_values import RoundedValues, rounded_values
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.sums.compiled import CompiledProblem

FINER = 256  # as 16 bits are to 8
NOTICED_SHARE = 0.05  # of the loss, below which finer storage of a label is not tried on its own
MAX_ALONE = 2  # labels that are stored finer one after the other, before all are


@dataclass(frozen=True)
class FinerStorage:
    """Labels that are stored in steps of 1/256, as 16 bits allow over the range of 8, and the errors then.

    Attributes:
        labels: by name their steps.
        outcome: the errors.
        size: bytes of all rounded labels; None if the bits of one are unknown.
    """

    labels: dict[str, float]
    outcome: RoundingResult
    size: int | None


@dataclass(frozen=True, eq=False)
class SetRounding:
    """A set of values, rounded.

    Attributes:
        parameters: all parameters with the rounded values.
        outcome: the errors before and after rounding, and the share of each label.
        uses: training or test, by dataset.
        size: bytes of all rounded labels; None if the bits of one are unknown.
        trials: labels whose finer storage is worth a trial, those that cost most first, and then all coarse ones.
        try_finer: rounds with finer storage of such labels.
        findings: values that could not be rounded, and limits that storage does not let hold.
        seconds: that it took.
        run: number of the run whose fit was rounded, in place of values that the run had rounded; 0 if none had.
    """

    parameters: ParameterSet
    outcome: RoundingResult
    uses: dict[str, str]
    size: int | None
    trials: tuple[tuple[str, ...], ...]
    try_finer: Callable[[Sequence[str]], FinerStorage]
    findings: tuple[Finding, ...] = ()
    seconds: float = 0.0
    run: int = 0


def round_set(problem: Problem, parameters: ParameterSet, method: RoundingMethod, run: int = 0) -> SetRounding:
    """Round a set of values to the storage of a problem.

    Args:
        problem: with its rounding.
        parameters: the values, on the axes of the problem or with others of its free axes.
        method: by which they are rounded.
        run: number of the run whose fit they are, see `SetRounding`.
    """
    began = time.perf_counter()
    assert problem.rounding is not None
    rounding = replace(problem.rounding, method=method)
    problem = replace(problem, parameters=parameters, rounding=rounding)
    compiled = CompiledProblem(problem)
    fit = compiled.start[: compiled.values.free]
    quality = Scorer(problem).scores(parameters, parameters).quality
    keeps = OutputLimits(problem).is_satisfied if problem.limits else lambda values: True
    limits = linear_limits(problem, compiled.values)

    def rounded_to(own: StorageRounding) -> RoundedValues:
        return rounded_values(compiled, own, limits, fit, quality, keeps)

    def try_finer(names: Sequence[str]) -> FinerStorage:
        grids = {name: finer_grid(rounding.grids[name]) for name in names}
        after = rounded_to(replace(rounding, grids={**rounding.grids, **grids})).outcome
        return FinerStorage({name: grid.step for name, grid in grids.items()}, after, _size(after.labels))

    rounded = rounded_to(rounding)
    return SetRounding(
        parameters=rounded.parameters,
        outcome=rounded.outcome,
        uses={row.dataset: row.use for row in quality},
        size=_size(rounded.outcome.labels),
        trials=_trials([each for each in rounded.outcome.labels if each.name in rounding.grids]),
        try_finer=try_finer,
        findings=rounded.warnings,
        seconds=time.perf_counter() - began,
        run=run,
    )


def finer_grid(grid: StorageGrid) -> StorageGrid:
    """Return the grid over the same range with 256 steps for each one.

    >>> finer_grid(StorageGrid(2.5, least=0, largest=255, bits=8)).step
    0.009765625
    """
    factor = grid.factor / FINER
    most = FINER * grid.largest + FINER - 1
    return replace(grid, factor=factor, least=FINER * grid.least, largest=most, bits=2 * grid.bits)


def _trials(labels: Sequence[LabelRounding]) -> tuple[tuple[str, ...], ...]:
    ordered = sorted((each for each in labels if each.bits <= COARSE_BITS), key=lambda each: -each.share)
    names = tuple(each.name for each in ordered)
    alone = sum(each.share >= NOTICED_SHARE for each in ordered[:MAX_ALONE])
    trials = [names[: count + 1] for count in range(alone)]
    return (*trials, names) if 0 < alone < len(names) else tuple(trials)


def _size(labels: Sequence[LabelRounding]) -> int | None:
    """Return the bytes of the values of labels; None if the bits of one are unknown."""
    if not labels or not all(each.bits for each in labels):
        return None
    return sum(each.values * each.bits for each in labels) // 8
