"""Groups of candidates after a few Gauss-Newton steps: what a term that moves the function far explains, and where.

The score is the gain of one step from the function as it is. It is exact for small terms. An optimum of the ignition
that is off by several degrees lies where the torque hardly depends on it: the first step is too short, and the places
beside it look better than they are.
"""

from collections.abc import Sequence
from dataclasses import replace

from kennfeld.analysis.missing.mean_errors import mean_squares
from kennfeld.analysis.missing.refit import Addition
from kennfeld.analysis.missing.score import TermScore
from kennfeld.analysis.missing.shortlist import EQUAL, CandidateGroup
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.multistart import run

STEPS = 6
LINEAR = 0.02  # by which the RMSE of a function that is nearly linear in a term differs from the predicted one
FAR = 0.8  # share of the RMSE that remains, below which a term moves the function far
RIVALS = 3  # further places that are tried


def after_few_steps(
    problem: Problem,
    group: CandidateGroup,
    others: Sequence[TermScore],
    options: Options,
    squares: float,
    weights: float,
) -> CandidateGroup:
    """Return a group whose predicted errors are those of a few steps, at the place where these are least.

    Args:
        problem: the function as it is, at the end of its fit.
        group: the candidates.
        others: further places of the same channels, the best first.
        options: of fits.
        squares: mean squared error of the function as it is.
        weights: sum of the weights.
    """
    options = replace(options, max_iterations=STEPS)

    def stepped(score: TermScore) -> TermScore:
        addition = Addition.of(problem, score)
        extended = addition.to(problem, problem.parameters)
        result = run(extended, options)
        return replace(score, predicted=mean_squares(extended, result, "training")[0] * weights)

    best = stepped(group.best)
    ratio = (max(group.best.predicted, 0.0) / best.predicted) ** 0.5 if best.predicted > 0 else 1.0
    is_far = best.predicted < FAR**2 * squares * weights
    if abs(ratio - 1) < LINEAR and not is_far:
        return replace(group, best=best)
    rivals = [score for score in others if _place(score) != _place(best)][:RIVALS]
    tried = [best, *map(stepped, rivals)]
    least = min(tried, key=lambda score: score.predicted)
    # of those that the data cannot tell apart, the one with the best score comes first
    near = [each for each in tried if not each.predicted - least.predicted > EQUAL * least.dispersion]
    untried = [score for score in group.equal if _place(score) not in map(_place, tried)]
    return CandidateGroup(near[0], (*near[1:], *(untried if best in near else [])))


def _place(score: TermScore) -> tuple[str, str]:
    return score.term.node, score.term.kind
