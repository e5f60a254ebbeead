"""The mean squared error of a fit over all criteria, as the cost counts them."""

from collections import Counter

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.native.losses import LOSS_RULES
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Scorer

HIDDEN = 5.0  # times the errors of another criterion, from which those of one hide it


@dataclass(frozen=True)
class _CriterionErrors:
    """The errors of a criterion on the data of one use: their number and the mean of their squares, or losses."""

    number: int
    samples: int
    squares: float


def mean_squares(problem: Problem, result: Result, use: str) -> tuple[float, int]:
    """Return the mean squared error over all criteria, and the number of errors.

    Each criterion counts as in the cost, by weight / scale^2, so that errors of different units and sizes are not added
    up. A loss that is not the square takes its place: outliers, and errors below a limit, count for as little as in the
    cost. Weights of samples do not count.

    Args:
        problem: as it was fitted.
        result: of the fit.
        use: "training" or "test".
    """
    criteria = problem.criteria
    rows = _of_quality(result, criteria, use) if has_squares(problem) else _of_losses(problem, result.parameters, use)
    factors = [0.0 if each.internal else each.weight / each.scale**2 for each in criteria]
    # the errors themselves if all count alike
    same = len({factor for factor in factors if factor}) == 1
    shares = [(1.0 if same else factors[row.number], row) for row in rows if factors[row.number] and row.samples]
    weights = sum(share * row.samples for share, row in shares)
    if not weights:
        return float("nan"), 0
    squares = sum(share * row.samples * row.squares for share, row in shares)
    return squares / weights, sum(row.samples for _, row in shares)


def errors_by_criterion(problem: Problem, result: Result, use: str) -> list[float]:
    """Return the RMSE of each criterion, in its unit; NaN without samples."""
    errors = []
    for number in range(len(problem.criteria)):
        own = [row for row in _of_quality(result, problem.criteria, use) if row.number == number]
        samples = sum(row.samples for row in own)
        errors.append((sum(row.samples * row.squares for row in own) / samples) ** 0.5 if samples else float("nan"))
    return errors


def unequal_criteria(problem: Problem, result: Result) -> str:
    """Return a remark if the errors of one criterion hide those of another one in the cost; "" if none does."""
    shares = {
        criterion.node: rmse * criterion.weight**0.5 / criterion.scale
        for criterion, rmse in zip(problem.criteria, errors_by_criterion(problem, result, "training"), strict=True)
        if rmse > 0 and criterion.weight and not criterion.internal
    }
    if len(shares) < 2:
        return ""
    least, most = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
    ratio = shares[most] / shares[least]
    if ratio < HIDDEN:
        return ""
    return (
        f"In the cost, the errors of {most} are {ratio:.3g} times those of {least}, whose terms they hide. "
        "Write scale = ... in each [[criterion]], about the RMSE that is expected."
    )


def has_squares(problem: Problem) -> bool:
    """Return True if the loss of all criteria is the square."""
    return all(
        criterion.loss == "square" for criterion in problem.criteria if criterion.weight and not criterion.internal
    )


def _of_quality(result: Result, criteria: tuple[Criterion, ...], use: str) -> list[_CriterionErrors]:
    # the criteria of a node have a row each in every dataset, in their order
    numbers: dict[str, list[int]] = {}
    for number, criterion in enumerate(criteria):
        numbers.setdefault(criterion.node, []).append(number)
    seen: Counter[tuple[str, str]] = Counter()
    rows = []
    for row in result.quality:
        key = row.criterion, row.dataset
        if row.use == use:
            rows.append(_CriterionErrors(numbers[row.criterion][seen[key]], row.samples, row.rmse_after**2))
        seen[key] += 1
    return rows


def _of_losses(problem: Problem, parameters: ParameterSet, use: str) -> list[_CriterionErrors]:
    return [row for part in problem.each(_losses, parameters, use, test=True) for row in part]


def _losses(problem: Problem, parameters: ParameterSet, use: str) -> list[_CriterionErrors]:
    """Return the losses of each criterion on the datasets of a use, in the squared unit of the node."""
    scorer, rows = Scorer(problem), []
    for data in problem.datasets:
        if data.use != use:
            continue
        for number, errors in enumerate(scorer.errors(problem.bind(data), parameters)):
            criterion = problem.criteria[number]
            scaled = errors[np.isfinite(errors)] / criterion.scale
            loss = LOSS_RULES[criterion.loss].value(scaled, criterion.delta)
            mean = float(loss.mean()) * criterion.scale**2 if loss.size else 0.0
            rows.append(_CriterionErrors(number, loss.size, mean))
    return rows
