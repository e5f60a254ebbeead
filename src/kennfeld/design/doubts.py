"""Reasons to doubt a design: a fit that did not converge, jumps, and errors that follow a channel."""

from collections.abc import Iterator

import numpy as np

from kennfeld.base.arrays import Float, ignore_floating_errors
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.strategies.jumps import jumps_of

PLACE = Location("design")
BINS = 10
MOST_EXPLAINED = 0.1  # share of the variance of the errors that a channel may explain
LEAST_INDEPENDENT = 20.0  # independent samples for each bin


def doubts(fitted: FittedFunction) -> Iterator[Finding]:
    """Yield warnings on what a design around this fit cannot know."""
    if not fitted.converged:
        message = "the fit did not converge; the design is made around values that may be far from the best"
        yield Finding(PLACE, message, "See the message of calibrate.", severity="warning")
    names = sorted({name for event in jumps_of(fitted.problem) for name in event.parameters})
    if names:
        message = f"the function jumps as {join_names(names)} change, which derivatives do not show"
        remedy = "The design says nothing about them."
        yield Finding(PLACE, message, remedy, severity="warning")
    yield from _several_weights(fitted)
    yield from _bounded_values(fitted)
    if fitted.problem.limits:
        message = "predictions leave out that limits of outputs will hold at what is measured next, too"
        yield Finding(PLACE, message, "If the outputs reach them there, deviations will differ.", severity="remark")
    yield from _missing_terms(fitted)


def _several_weights(fitted: FittedFunction) -> Iterator[Finding]:
    """Yield a remark on the weight that further data are taken to have, if those so far have several."""
    weights = sorted({data.weight for data in fitted.problem.fitted_datasets})
    if len(weights) > 1:
        message = f"the training data have weights from {weights[0]:g} to {weights[-1]:g}"
        remedy = f"What is measured next is taken to have {fitted.weight:g}, as most samples."
        yield Finding(PLACE, message, remedy, severity="remark")


def _bounded_values(fitted: FittedFunction) -> Iterator[Finding]:
    """Yield a remark on values that a bound holds instead of the data: predictions take them for known."""
    limits, values = linear_limits(fitted.problem, fitted.compiled.values), fitted.values
    at_bound = fitted.fixed & limits.movable & ((values <= limits.lower) | (values >= limits.upper))
    counts = {name: int(at_bound[first : first + size].sum()) for name, (first, size) in fitted.blocks.items()}
    texts = [f"{count_noun(count, 'value')} of {name}" for name, count in counts.items() if count]
    if texts:
        message = f"bounds hold {join_names(texts, 3)}, which predictions take for known"
        remedy = "If further data move them away from it, deviations will be larger than predicted."
        yield Finding(PLACE, message, remedy, severity="remark")


def _missing_terms(fitted: FittedFunction) -> Iterator[Finding]:
    """Yield a warning for each criterion whose errors follow a channel of the data."""
    problem = fitted.problem
    with ignore_floating_errors():
        scorer = Scorer(problem)
        pairs = [(bound, scorer.errors(bound, problem.parameters)) for bound in problem.training]
    for number, criterion in enumerate(problem.criteria):
        persistence = max(fitted.trust.persistence.get(criterion.node, 1.0), 1.0)
        best: tuple[float, str] = (MOST_EXPLAINED, "")
        shared = set.intersection(*({*bound.dataset} for bound, _ in pairs)) if pairs else set()
        for channel in sorted(shared - {criterion.target.name}):
            values = np.concatenate([bound.channel(channel) for bound, _ in pairs])
            errors = np.concatenate([each[number] for _, each in pairs])
            best = max(best, (_explained(values, errors, persistence), channel))
        if best[1]:
            message = f"{100 * best[0]:.0f} % of the variance of the errors of {criterion.node} follow {best[1]}"
            remedy = "The function may miss a term, which no data replace: run `kennfeld propose`."
            yield Finding(PLACE, message, remedy, severity="warning")


def _explained(values: Float, errors: Float, persistence: float) -> float:
    """Return the share of the variance of errors that the means over ten bins of a channel explain, less chance."""
    known = np.isfinite(values) & np.isfinite(errors)
    values, errors = values[known], errors[known]
    independent = errors.size / persistence
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)[1:-1])) if values.size else np.zeros(0)
    if independent < LEAST_INDEPENDENT * BINS or not edges.size or not errors.std() > 0:
        return 0.0
    bins = np.searchsorted(edges, values, side="right")
    counts = np.bincount(bins, minlength=edges.size + 1)
    means = np.bincount(bins, errors, edges.size + 1) / np.maximum(counts, 1)
    explained = float(counts @ (means - errors.mean()) ** 2) / float(np.sum((errors - errors.mean()) ** 2))
    # of noise, the means explain as many independent samples as there are bins
    return explained - edges.size / independent
