"""Values that are rounded to storage, with their errors."""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import StorageRounding
from kennfeld.optimize.quality.quality import Quality, Scorer, Scores
from kennfeld.optimize.rounding.outcome import RoundingResult, errors_by_criterion, finer_label
from kennfeld.optimize.rounding.round_fit import round_fit
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem


@dataclass(frozen=True, eq=False)
class RoundedValues:
    """The values of a fit, rounded.

    Attributes:
        values: the free values by the method that was asked for, Float[free].
        parameters: all parameters with them.
        scores: their errors.
        outcome: the errors before and after rounding by either method, and the share of each label.
        warnings: limits that storage does not let hold, and values that could not be rounded.
    """

    values: Float
    parameters: ParameterSet
    scores: Scores
    outcome: RoundingResult
    warnings: tuple[Finding, ...]


def rounded_values(
    compiled: CompiledProblem,
    rounding: StorageRounding,
    limits: LinearLimits,
    fit: Float,
    quality: Sequence[Quality],
    keeps_outputs: Callable[[Float], bool] = lambda values: True,
) -> RoundedValues:
    """Round free values, and compute their errors.

    Args:
        compiled: the problem; its parameters are those before the calibration.
        rounding: method and grids.
        limits: bounds, locks and rows of the free values.
        fit: the free values, Float[free].
        quality: their errors before rounding.
        keeps_outputs: returns whether values keep the limits of outputs.
    """
    rounded = round_fit(compiled, rounding, limits, fit, keeps_outputs)
    scorer, start = Scorer(compiled.problem), compiled.problem.parameters
    nearest, joint = (compiled.parameters(values) for values in (rounded.nearest, rounded.joint))
    scores = {"nearest": scorer.scores(start, nearest)}
    same = np.array_equal(rounded.nearest, rounded.joint)
    scores["joint"] = scores["nearest"] if same else scorer.scores(start, joint)
    applied, is_joint = scores[rounding.method], rounding.method == "joint"
    outcome = RoundingResult(
        rounding.method,
        rounding.max_shift,
        **{name: errors_by_criterion(each.quality) for name, each in scores.items()},
        unrounded=errors_by_criterion(quality),
        labels=rounded.labels,
        finer=finer_label(rounded.labels, quality, applied.quality),
        fit=compiled.parameters(fit),
    )
    values = rounded.joint if is_joint else rounded.nearest
    return RoundedValues(values, joint if is_joint else nearest, applied, outcome, rounded.warnings)
