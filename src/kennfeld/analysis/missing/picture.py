"""Pictures of fitted terms: the values of a term over its channel, and the errors without it and with it."""

from dataclasses import replace

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
from kennfeld.analysis.missing.terms import MissingTerm
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.problem import Problem

BINS = 24  # of a channel, over which errors are averaged
MOST_POINTS = 1500  # samples that are drawn


@dataclass(frozen=True, eq=False)
class TermPicture:
    """A fitted term over its channel, and the errors without it and with it; empty arrays for lags and delays.

    Of data in partitions, the errors are those of the excerpt that this process holds.

    Attributes:
        deviation: standard deviation of the values of the term, Float[values]; inf if nothing determines one.
        criterion: node of the criterion whose errors the term changes most.
        unit: of the errors.
        input_unit: of the channel, the first one of a map.
        second_unit: of the second channel of a map.
        value_unit: of the values; empty for a factor.
        edges: of the bins of the channel, Float[bins + 1].
        counts: samples by bin, Int[bins].
        before: mean error by bin without the term, Float[bins]; NaN in bins without samples.
        after: with it.
        x: channel of some samples, Float[points].
        error: their errors without the term.
    """

    deviation: Float
    criterion: str
    unit: str
    input_unit: str
    second_unit: str
    value_unit: str
    edges: Float
    counts: Int
    before: Float
    after: Float
    x: Float
    error: Float


@dataclass(frozen=True, eq=False)
class DrawnProposals:
    """Proposals with their pictures, without the problem and the fits.

    Attributes:
        found: the proposals.
        pictures: of each.
        values: all parameters of the fit with each.
    """

    found: TermProposals
    pictures: tuple[TermPicture, ...] = ()
    values: tuple[ParameterSet, ...] = ()


class TermArtist:
    """Draws the proposals of one search, each once."""

    def __init__(self) -> None:
        self._pictures: dict[str, TermPicture] = {}
        self._base: tuple[Problem, _TrainingErrors] | None = None

    def drawn(self, outcome: TermProposals) -> DrawnProposals:
        """Return proposals with their pictures; those that were drawn before are not computed again."""
        values = []
        for proposal in outcome.proposals:
            assert outcome.problem is not None
            assert proposal.fit is not None
            if proposal.change not in self._pictures:
                self._pictures[proposal.change] = self._draw(outcome.problem, proposal)
            values.append(proposal.fit.parameters)
        pictures = tuple(self._pictures[proposal.change] for proposal in outcome.proposals)
        return DrawnProposals(outcome.without_fits(), pictures, tuple(values))

    def _draw(self, problem: Problem, proposal: TermProposal) -> TermPicture:
        if self._base is None or self._base[0] is not problem:
            self._base = problem, _TrainingErrors(problem)
        return draw_term(problem, proposal, self._base[1])


class _TrainingErrors:
    """The errors of all criteria on the training data, at the values of a problem, with their units by criterion.

    They are those of all samples of the datasets: a function with a term over a channel with gaps has fewer.
    """

    def __init__(self, problem: Problem) -> None:
        evaluator = Evaluator(problem)
        self._datasets = [data for data in problem.datasets if data.use == "training"]
        evaluated = [evaluator.over(problem.bind(data), problem.parameters).series for data in self._datasets]
        self.units = [series.unit for series in evaluated[0]]
        self._errors = [[_at_samples(series) for series in each] for each in evaluated]

    def of(self, criterion: int) -> Float:
        """Return the errors of a criterion, by number, Float[samples]; NaN at samples that are not scored."""
        return np.concatenate([errors[criterion] for errors in self._errors])

    def channel(self, name: str) -> Float:
        """Return a channel over the samples, Float[samples]."""
        return np.concatenate([data[name].values for data in self._datasets])


def _at_samples(series: CriterionSeries) -> Float:
    """Return the errors of a criterion at all samples of its dataset, Float[samples]; NaN where it is not scored."""
    errors = np.full(series.bound.dataset.samples, np.nan)
    errors[series.bound.kept[series.scored]] = series.error[series.scored]
    return errors


def draw_term(problem: Problem, proposal: TermProposal, without: _TrainingErrors | None = None) -> TermPicture:
    """Return the picture of a fitted proposal.

    Args:
        problem: the function as it is, at the end of its fit.
        proposal: with its fit.
        without: the errors of the function as it is; computed by default.
    """
    addition, fit = proposal.addition, proposal.fit
    assert addition is not None
    assert fit is not None
    without = without or _TrainingErrors(problem)
    extended = _TrainingErrors(replace(addition.to(problem, fit.parameters), parameters=fit.parameters))
    criterion = _most_changed(without, extended)
    name, units = proposal.term.channel, _units(problem)
    x, old, new = np.zeros(0), np.zeros(0), np.zeros(0)
    if name:
        x = without.channel(problem.channels.get(name, name))
        old, new = without.of(criterion), extended.of(criterion)
    deviation = np.zeros(0)
    if addition.parameter is not None:
        deviation = fit.trust.deviation.get(addition.parameter.name, deviation).ravel()
    return TermPicture(
        deviation,
        problem.criteria[criterion].node,
        without.units[criterion],
        units.get(name, ""),
        units.get(proposal.term.second, ""),
        value_unit(problem, proposal.term),
        *_binned(x, old, new),
    )


def _units(problem: Problem) -> dict[str, str]:
    """Return the units of channels, by the name of the input that reads them if there is one."""
    units = {channel.name: channel.unit for data in problem.datasets for channel in data.channels}
    return units | {name: units.get(channel, "") for name, channel in problem.channels.items()}


def value_unit(problem: Problem, term: MissingTerm) -> str:
    """Return the unit of the values of a term; empty for a factor."""
    if term.kind == "lag":
        return "s"
    return "" if term.kind == "multiply" else problem.model.graph.units.get(term.node, "")


def _most_changed(before: _TrainingErrors, after: _TrainingErrors) -> int:
    """Return the number of the criterion whose errors differ most, in relation to their size."""
    shares = []
    for criterion in range(len(before.units)):
        old, new = before.of(criterion), after.of(criterion)
        known = np.isfinite(old) & np.isfinite(new)
        size = float(np.sum(old[known] ** 2))
        shares.append(float(np.sum((new - old)[known] ** 2)) / size if size > 0 else 0.0)
    return int(np.argmax(shares))


def _binned(x: Float, old: Float, new: Float) -> tuple[Float, Int, Float, Float, Float, Float]:
    """Return edges of bins, samples, mean errors without and with a term, and some samples with their errors."""
    known = np.isfinite(x) & np.isfinite(old) & np.isfinite(new)
    x, old, new = x[known], old[known], new[known]
    if not x.size:
        none = np.zeros(0)
        return none, none.astype(np.int64), none, none, none, none
    low, high = float(x.min()), float(x.max())
    edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(at, minlength=BINS)
    size = np.where(counts, counts, np.nan)
    before, after = (np.bincount(at, weights=errors, minlength=BINS) / size for errors in (old, new))
    # evenly over the recordings, so that all operation is drawn
    some = np.linspace(0, x.size - 1, min(MOST_POINTS, x.size)).round().astype(int)
    return edges, counts, before, after, x[some], old[some]
