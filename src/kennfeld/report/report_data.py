"""Everything that a report tells about, computed once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis import Residuals, residuals
from kennfeld.analysis.cell_errors import tally
from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding
from kennfeld.graph.interpolation import cell_weights, interpolate, position
from kennfeld.optimize import Problem, Quality, Result
from kennfeld.optimize.lookup_coverage import BLOCK, Lookups, coordinates
from kennfeld.optimize.quality import spread
from kennfeld.optimize.tuning.shift_estimation import moved
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.project import Project
from kennfeld.project.model import coordinates_of
from kennfeld.report.stored_result import TrustSummary, view

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation

__all__ = ["ParameterChange", "ReportData", "Score", "subject"]


@dataclass(frozen=True)
class Score:
    """The errors of one criterion on one dataset, before and after; both are the same while nothing is calibrated."""

    number: int  # of the criterion
    criterion: str
    target: str
    dataset: str
    use: str
    unit: str
    samples: int
    rmse: tuple[float, float]
    r2: tuple[float, float]
    largest: tuple[float, float]


@dataclass(frozen=True, eq=False)
class ParameterChange:
    """A free parameter before and after, over the same grid points, and what is known about each of them."""

    before: Parameter
    after: Parameter
    moved: bool  # whether the breakpoints are other than before
    samples: Int | None
    informed: Bool | None
    deviation: Float | None
    by_smoothness: Bool | None

    @property
    def name(self) -> str:
        """Of the parameter."""
        return self.after.name

    @property
    def difference(self) -> Float:
        """After minus before."""
        return self.after.values - self.before.values

    @property
    def size(self) -> float:
        """Root mean square of the difference over that of the values, before or after, whichever is greater."""
        with np.errstate(over="ignore", invalid="ignore"):
            scale = max(_rms(self.before.values), _rms(self.after.values))
            return _rms(self.difference) / scale if scale > 0 else 0.0

    @property
    def bound(self) -> Int:
        """-1 at the lower bound, 1 at the upper, else 0; locked values are at none."""
        p = self.after
        held = p.locked | (p.lower == p.upper)
        at = (p.values >= p.upper).astype(np.int64) - (p.values <= p.lower).astype(np.int64)
        return np.where(held, 0, at)

    @property
    def uncovered(self) -> Bool:
        """Grid points that no training sample touches."""
        return np.zeros(self.after.values.shape, dtype=bool) if self.samples is None else self.samples == 0


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, eq=False)
class ReportData:
    """A project and a result of it; without a result, the start alone."""

    project: Project
    problem: Problem
    result: Result | None
    findings: tuple[Finding, ...]
    before: tuple[CriterionSeries, ...]
    after: tuple[CriterionSeries, ...]
    residuals: tuple[Residuals, ...]
    changes: tuple[ParameterChange, ...]
    trust: TrustSummary = field(default_factory=TrustSummary)
    written: Mapping[str, Any] | None = None  # the contents of `result.json`
    left: "tuple[Extrapolation, ...]" = ()  # where surrogates are used outside the data they were trained on
    seen: tuple[Finding, ...] = ()  # test data that are training data too

    @property
    def parameters(self) -> ParameterSet:
        """The calibrated parameters, or the start."""
        return self.problem.parameters if self.result is None else self.result.parameters

    def inputs(self, name: str) -> Sequence[str]:
        """What the function looks a table up with, an axis each; empty where that has no name."""
        return coordinates_of(self.problem.model.graph, name)

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """A row for each criterion and dataset that scores it; what stands in `result.json` is taken from there."""
        summaries = {(i, r.dataset): r for i, of in self.numbered for r in of.summaries}
        written = self._written()
        made = []
        for old, new in zip(self.before, self.after, strict=True):
            name, row = old.bound.dataset.name, written.get((old.criterion, old.bound.dataset.name))
            now = summaries[new.criterion, name]
            rmse = (_rms_known(old.error), now.rmse) if row is None else (row.rmse_before, row.rmse_after)
            r2, largest = (now.r2, now.largest) if row is None else (row.r2_after, row.max_abs_after)
            made.append(
                Score(
                    number=old.criterion,
                    criterion=self.problem.criteria[old.criterion].node,
                    target=str(self.problem.criteria[old.criterion].target),
                    dataset=name,
                    use=old.bound.dataset.use,
                    unit=old.unit,
                    samples=now.samples,
                    rmse=rmse,
                    r2=(_r2(old), r2),
                    largest=(_largest(old.error), largest),
                )
            )
        return tuple(made)

    @property
    def numbered(self) -> list[tuple[int, Residuals]]:
        """The residuals with the number of their criterion."""
        numbers = dict.fromkeys(one.criterion for one in self.after)
        return list(zip(sorted(numbers), self.residuals, strict=True))

    def _written(self) -> dict[tuple[int, str], Quality]:
        """The rows of the result's quality by criterion and dataset; a node with several targets has several rows."""
        rows: dict[tuple[int, str], Quality] = {}
        counted: dict[tuple[str, str], int] = {}
        for row in self.result.quality if self.result else ():
            key = (row.criterion, row.dataset)
            numbers = [i for i, c in enumerate(self.problem.criteria) if c.node == row.criterion]
            which = counted.get(key, 0)
            counted[key] = which + 1
            if which < len(numbers):
                rows[numbers[which], row.dataset] = row
        return rows

    @property
    def stale(self) -> bool:
        """Whether project or data have changed since the result was written: its errors cannot be reproduced."""
        for (number, name), row in self._written().items():
            found = [_rms_known(s.error) for s in self.after if (s.criterion, s.bound.dataset.name) == (number, name)]
            if row.samples and not (found and np.isclose(found[0], row.rmse_after, rtol=1e-3, equal_nan=True)):
                return True
        return False


def subject(
    project: Project,
    result: Result | None,
    findings: Sequence[Finding] = (),
    trust: TrustSummary | None = None,
    written: Mapping[str, Any] | None = None,
    left: "Sequence[Extrapolation] | None" = None,
) -> ReportData:
    """Compute what a report tells; trust and `result.json` are those of the result unless others are given.

    `left` is computed too, unless it is known.

    Raises `InputError` where the project has no problem to compute.
    """
    problem = project.problem() if result is None else moved(project.problem(), result.shifts)
    start = problem.parameters if result is None else result.start
    parameters = start if result is None else result.parameters
    small = max((data.samples for data in problem.datasets), default=0) <= BLOCK
    evaluator = Evaluator(problem, coordinates(problem) if small else {})
    before = evaluator.series(start)
    after = before if result is None else evaluator.series(parameters)
    lookups = Lookups(problem, parameters, evaluator.values if small else ())
    if trust is None:
        trust = view(None if result is None else result.trust)
    tallied = tally(lookups, parameters, after)
    left = _left(problem, parameters) if left is None else tuple(left)
    if result is not None and written is None:
        written = result.as_json() | ({"surrogates": [row.as_json() for row in left]} if left else {})
    return ReportData(
        project=project,
        problem=problem,
        result=result,
        findings=tuple(findings),
        before=before,
        after=after,
        residuals=residuals(problem, parameters, trust=trust, series=after, lookups=lookups, cells=tallied.cells),
        changes=_changes(problem, start, parameters, trust, tallied.touching),
        trust=trust,
        written=written,
        left=left,
        seen=tuple(project.seen_test_data()),
    )


def _left(problem: Problem, parameters: ParameterSet) -> "tuple[Extrapolation, ...]":
    if not problem.model.surrogates:
        return ()
    from kennfeld.analysis.extrapolation import find_extrapolation

    return find_extrapolation(problem, parameters)


def _changes(
    problem: Problem, start: ParameterSet, parameters: ParameterSet, trust: TrustSummary, counted: Mapping[str, Int]
) -> tuple[ParameterChange, ...]:
    """The free parameters, the one that changed most first."""
    made = []
    for name in problem.free_names:
        after, before = parameters[name], start[name]
        moved = not _same_grid(before, after)
        shape = after.values.shape
        made.append(
            ParameterChange(
                before=_resampled(before, after) if moved else before,
                after=after,
                moved=moved,
                samples=_shaped(trust.samples, name, shape) if name in trust.samples else counted.get(name),
                informed=_shaped(trust.informed, name, shape),
                deviation=_shaped(trust.deviation, name, shape),
                by_smoothness=_shaped(trust.by_smoothness, name, shape),
            )
        )
    return tuple(sorted(made, key=lambda change: -change.size))


def _shaped(arrays: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Any:
    """The array of a parameter where there is one of its shape."""
    found = arrays.get(name)
    return None if found is None or np.shape(found) != shape else np.asarray(found)


def _same_grid(one: Parameter, other: Parameter) -> bool:
    return one.values.shape == other.values.shape and all(
        np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(one.axes, other.axes, strict=True)
    )


def _resampled(before: Parameter, after: Parameter) -> Parameter:
    """The parameter before at the breakpoints of after."""
    points = np.meshgrid(*(axis.breakpoints for axis in after.index_axes), indexing="ij")
    sides = [
        cell_weights(position(x.ravel(), axis.breakpoints, before.extrapolation), len(axis))[0]
        for x, axis in zip(points, before.index_axes, strict=True)
    ]
    return after.with_values(interpolate(before.values, sides))


def _rms_known(error: Float) -> float:
    known = error[~np.isnan(error)]
    with np.errstate(over="ignore", invalid="ignore"):
        return _rms(known) if known.size else float("nan")


def _largest(error: Float) -> float:
    known = error[~np.isnan(error)]
    return float(np.abs(known).max()) if known.size else float("nan")


def _r2(series: CriterionSeries) -> float:
    measured, error = series.measured[series.scored], series.error[series.scored]
    with np.errstate(over="ignore", invalid="ignore"):
        variation = spread(measured)
        return 1.0 - float(np.sum(error**2)) / variation if variation > 0 else float("nan")
