"""The data of a report, computed once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.cell_errors import tally
from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.analysis.residuals import Residuals, residuals
from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding
from kennfeld.graph.interpolation import cell_weights, interpolate, position
from kennfeld.optimize.lookup_coverage import Lookups, coordinates
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import SAMPLES_PER_BLOCK, Quality, spread
from kennfeld.optimize.result import Result
from kennfeld.optimize.tuning.shift_estimation import apply_shifts
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.project import Project
from kennfeld.project.model import coordinates_of
from kennfeld.report.stored_result import TrustSummary, summarise_trust

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation


@dataclass(frozen=True)
class Score:
    """Errors of one criterion on one dataset, before and after; both are the same before calibration."""

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
    """A free parameter before and after on the same grid, and the uncertainty of its values."""

    before: Parameter
    after: Parameter
    moved: bool  # whether the breakpoints are other than before
    samples: Int | None
    informed: Bool | None
    deviation: Float | None
    by_smoothness: Bool | None

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.after.name

    @property
    def difference(self) -> Float:
        """After minus before."""
        return self.after.values - self.before.values

    @property
    def size(self) -> float:
        """Root mean square of the difference, relative to that of the values before or after, whichever is larger."""
        with np.errstate(over="ignore", invalid="ignore"):
            scale = max(_rms(self.before.values), _rms(self.after.values))
            return _rms(self.difference) / scale if scale > 0 else 0.0

    @property
    def bound(self) -> Int:
        """-1 at the lower bound, 1 at the upper bound, else 0; locked values count as 0."""
        p = self.after
        held = p.locked | (p.lower == p.upper)
        at = (p.values >= p.upper).astype(np.int64) - (p.values <= p.lower).astype(np.int64)
        return np.where(held, 0, at)

    @property
    def uncovered(self) -> Bool:
        """True at grid points without training samples."""
        return np.zeros(self.after.values.shape, dtype=bool) if self.samples is None else self.samples == 0


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, eq=False)
class ReportData:
    """A project and its result, or its start values if there is no result."""

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
    extrapolation: "tuple[Extrapolation, ...]" = ()  # use of surrogates outside their training data
    seen: tuple[Finding, ...] = ()  # test data that are also training data

    @property
    def parameters(self) -> ParameterSet:
        """The calibrated parameters, or the start values."""
        return self.problem.parameters if self.result is None else self.result.parameters

    def inputs(self, name: str) -> Sequence[str]:
        """Return the coordinates with which the function looks a table up, one per axis; empty if unnamed."""
        return coordinates_of(self.problem.model.graph, name)

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """A score for each criterion and dataset; numbers in `result.json` take precedence."""
        summaries = {(i, r.dataset): r for i, of in self.numbered for r in of.summaries}
        written = self._written()
        scores = []
        for old, new in zip(self.before, self.after, strict=True):
            name, row = old.bound.dataset.name, written.get((old.criterion, old.bound.dataset.name))
            now = summaries[new.criterion, name]
            rmse = (_rms_known(old.error), now.rmse) if row is None else (row.rmse_before, row.rmse_after)
            r2, largest = (now.r2, now.largest) if row is None else (row.r2_after, row.max_abs_after)
            scores.append(
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
        return tuple(scores)

    @property
    def numbered(self) -> list[tuple[int, Residuals]]:
        """The residuals with the number of their criterion."""
        numbers = dict.fromkeys(series.criterion for series in self.after)
        return list(zip(sorted(numbers), self.residuals, strict=True))

    def _written(self) -> dict[tuple[int, str], Quality]:
        """Return the quality rows of the result by criterion number and dataset."""
        rows: dict[tuple[int, str], Quality] = {}
        counted: dict[tuple[str, str], int] = {}
        for row in self.result.quality if self.result else ():
            key = (row.criterion, row.dataset)
            # a node with several targets has a row for each, in the order of the criteria
            numbers = [i for i, c in enumerate(self.problem.criteria) if c.node == row.criterion]
            position = counted.get(key, 0)
            counted[key] = position + 1
            if position < len(numbers):
                rows[numbers[position], row.dataset] = row
        return rows

    @property
    def stale(self) -> bool:
        """True if the errors of the result cannot be reproduced, since the project or its data have changed."""
        for key, row in self._written().items():
            rmse = [_rms_known(s.error) for s in self.after if (s.criterion, s.bound.dataset.name) == key]
            if row.samples and not (rmse and np.isclose(rmse[0], row.rmse_after, rtol=1e-3, equal_nan=True)):
                return True
        return False


def collect_report_data(
    project: Project,
    result: Result | None,
    findings: Sequence[Finding] = (),
    trust: TrustSummary | None = None,
    written: Mapping[str, Any] | None = None,
    left: "Sequence[Extrapolation] | None" = None,
) -> ReportData:
    """Compute the data of a report.

    Args:
        project: the project.
        result: its result, if there is one.
        findings: the findings of the project check.
        trust: uncertainty of the values; by default that of the result.
        written: contents of `result.json`; by default those of the result.
        left: use of surrogates outside their training data; computed by default.

    Raises:
        InputError: the project does not define a problem that can be evaluated.
    """
    problem = project.problem() if result is None else apply_shifts(project.problem(), result.shifts)
    start = problem.parameters if result is None else result.start
    parameters = start if result is None else result.parameters
    small = max((data.samples for data in problem.datasets), default=0) <= SAMPLES_PER_BLOCK
    evaluator = Evaluator(problem, coordinates(problem) if small else {})
    before = evaluator.series(start)
    after = before if result is None else evaluator.series(parameters)
    lookups = Lookups(problem, parameters, evaluator.values if small else ())
    if trust is None:
        trust = summarise_trust(None if result is None else result.trust)
    tallied = tally(lookups, parameters, after)
    extrapolation = _extrapolation(problem, parameters) if left is None else tuple(left)
    if result is not None and written is None:
        surrogates = [row.as_json() for row in extrapolation]
        written = result.as_json() | ({"surrogates": surrogates} if surrogates else {})
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
        extrapolation=extrapolation,
        seen=tuple(project.seen_test_data()),
    )


def _extrapolation(problem: Problem, parameters: ParameterSet) -> "tuple[Extrapolation, ...]":
    if not problem.model.surrogates:
        return ()
    from kennfeld.analysis.extrapolation import find_extrapolation

    return find_extrapolation(problem, parameters)


def _changes(
    problem: Problem, start: ParameterSet, parameters: ParameterSet, trust: TrustSummary, counted: Mapping[str, Int]
) -> tuple[ParameterChange, ...]:
    """Return the free parameters, the largest change first."""
    changes = []
    for name in problem.free_names:
        after, before = parameters[name], start[name]
        moved = not _same_grid(before, after)
        shape = after.values.shape
        changes.append(
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
    return tuple(sorted(changes, key=lambda change: -change.size))


def _shaped(arrays: Mapping[str, Any], name: str, shape: tuple[int, ...]) -> Any:
    """Return the array of a parameter, None if it has another shape."""
    array = arrays.get(name)
    return None if array is None or np.shape(array) != shape else np.asarray(array)


def _same_grid(one: Parameter, other: Parameter) -> bool:
    return one.values.shape == other.values.shape and all(
        np.array_equal(a.breakpoints, b.breakpoints) for a, b in zip(one.axes, other.axes, strict=True)
    )


def _resampled(before: Parameter, after: Parameter) -> Parameter:
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
