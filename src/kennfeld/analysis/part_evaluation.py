"""EvaluatedCriteria of all criteria part by part, before and after a calibration."""

from functools import cached_property

from kennfeld.analysis.evaluation import CriterionSeries, EvaluatedCriteria, Evaluator
from kennfeld.dataset import SAMPLES_PER_BLOCK
from kennfeld.optimize.lookup_coverage import Lookup, Lookups, coordinates
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart


class EvaluatedPart:
    """The criteria over a part of a dataset, and the lookups after the calibration; each computed when first used."""

    def __init__(self, part: BoundPart, evaluator: "PartEvaluator") -> None:
        self.bound, self._evaluator = part.bound, evaluator

    @cached_property
    def before(self) -> tuple[CriterionSeries, ...]:
        """The criteria before the calibration."""
        start, end = self._evaluator.sets
        return self.after if start is end else self._evaluator.criteria.over(self.bound, start).series

    @property
    def after(self) -> tuple[CriterionSeries, ...]:
        """The criteria after the calibration."""
        return self._evaluation.series

    @cached_property
    def located(self) -> list[Lookup]:
        """The lookups after the calibration."""
        return self._evaluator.lookups.over(self.bound, self._evaluation.extra)

    @cached_property
    def _evaluation(self) -> EvaluatedCriteria:
        return self._evaluator.criteria.over(self.bound, self._evaluator.sets[1])


class PartEvaluator:
    """Evaluates all criteria part by part, before and after a calibration; a dataset that is small is kept."""

    def __init__(self, problem: Problem, before: ParameterSet, after: ParameterSet) -> None:
        self._problem, self.sets, self.parameters = problem, (before, after), after
        self.criteria = Evaluator(problem, coordinates(problem))
        for parameters in self.sets:
            self.criteria.prepare(parameters)  # compiled before threads need it
        self.lookups = Lookups(problem, after)
        self._kept: dict[int, EvaluatedPart] = {}

    def parts(self, bound: BoundDataset) -> list[BoundPart]:
        """Return the parts of a dataset."""
        return self._problem.parts(bound)

    def over(self, part: BoundPart) -> EvaluatedPart:
        """Return the criteria over a part."""
        if part.last - part.first < part.whole.count or part.whole.count > SAMPLES_PER_BLOCK:
            return EvaluatedPart(part, self)
        return self._kept.setdefault(id(part.whole), EvaluatedPart(part, self))
