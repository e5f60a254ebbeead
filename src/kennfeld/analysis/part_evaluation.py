"""Evaluation of all criteria part by part, before and after a calibration."""

from dataclasses import dataclass

from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.dataset import SAMPLES_PER_BLOCK
from kennfeld.optimize.lookup_coverage import Lookup, Lookups, coordinates
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart


@dataclass(frozen=True, eq=False)
class EvaluatedPart:
    """The criteria over a part of a dataset, and the lookups after the calibration."""

    part: BoundPart
    before: tuple[CriterionSeries, ...]
    after: tuple[CriterionSeries, ...]
    located: list[Lookup]


class PartEvaluator:
    """Evaluates all criteria part by part, before and after a calibration; a single small part is kept."""

    def __init__(self, problem: Problem, before: ParameterSet, after: ParameterSet) -> None:
        self._problem, self._sets = problem, (before, after)
        self._evaluator = Evaluator(problem, coordinates(problem))
        for parameters in self._sets:
            self._evaluator.prepare(parameters)  # compiled before threads need it
        self.lookups, self.parameters = Lookups(problem, after), after
        self._kept: dict[int, EvaluatedPart] = {}

    def parts(self, bound: BoundDataset) -> list[BoundPart]:
        """Return the parts of a dataset."""
        return self._problem.parts(bound)

    def over(self, part: BoundPart) -> EvaluatedPart:
        """Return the criteria over a part."""
        key = id(part.whole)
        if key in self._kept:
            return self._kept[key]
        bound = part.bound
        after = self._evaluator.over(bound, self._sets[1])
        same = self._sets[0] is self._sets[1]
        before = after if same else self._evaluator.over(bound, self._sets[0])
        evaluated = EvaluatedPart(part, before.series, after.series, self.lookups.over(bound, after.extra))
        if bound is part.whole and bound.count <= SAMPLES_PER_BLOCK:
            self._kept[key] = evaluated
        return evaluated
