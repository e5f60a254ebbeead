"""EvaluatedCriteria of all criteria part by part, before and after a calibration."""

from dataclasses import dataclass

from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.arrays import Float
from kennfeld.dataset import SAMPLES_PER_BLOCK
from kennfeld.optimize.lookup_coverage import Lookup, Lookups, coordinates
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart


@dataclass(frozen=True, eq=False)
class EvaluatedPart:
    """The criteria over a part of a dataset before and after the calibration.

    Threads evaluate parts, so that nothing here is a cached property: until Python 3.12, its lock is that of all parts.
    """

    before: tuple[CriterionSeries, ...]
    after: tuple[CriterionSeries, ...]
    coordinates: Float  # of lookups, after the calibration


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
            return self._evaluate(part)
        if id(part.whole) not in self._kept:
            self._kept[id(part.whole)] = self._evaluate(part)
        return self._kept[id(part.whole)]

    def locate(self, part: BoundPart, evaluated: EvaluatedPart) -> list[Lookup]:
        """Return the lookups over a part after the calibration."""
        return self.lookups.over(part.bound, evaluated.coordinates)

    def _evaluate(self, part: BoundPart) -> EvaluatedPart:
        start, end = self.sets
        after = self.criteria.over(part.bound, end)
        before = after.series if start is end else self.criteria.over(part.bound, start).series
        return EvaluatedPart(before, after.series, after.extra)
