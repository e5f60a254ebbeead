"""The data of a report, computed once."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.extrapolation import Extrapolation, find_extrapolation
from kennfeld.analysis.missing.hints import Hints
from kennfeld.analysis.part_evaluation import PartPasses
from kennfeld.analysis.residuals import Analysis, Fit, Residuals, analyse
from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.interpolation import cell_weights, interpolate, position
from kennfeld.graph.traversal import coordinates_of
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Quality, Scorer
from kennfeld.optimize.quality.recording_quality import RecordingQuality
from kennfeld.optimize.tuning.shift_estimation import apply_shifts
from kennfeld.project import Project
from kennfeld.project.run_schema import ReportEntry
from kennfeld.report.drawings import Drawing, draw
from kennfeld.report.stored_result import TrustSummary, summarise_trust

if TYPE_CHECKING:
    from kennfeld.analysis.missing.picture import DrawnProposals
    from kennfeld.analysis.missing.proposing import SearchScope


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
            # of both: a table that begins at 0 would have changed by infinity
            scale = max(_rms(self.before.values), _rms(self.after.values))
            return _rms(self.difference) / scale if scale > 0 else 0.0

    @property
    def bound(self) -> Int:
        """-1 at the lower bound, 1 at the upper bound, else 0; see `Parameter.at_bound`."""
        return np.where(self.after.at_bound, np.where(self.after.values >= self.after.upper, 1, -1), 0)

    @property
    def uncovered(self) -> Bool:
        """True at grid points without training samples."""
        return np.zeros(self.after.values.shape, dtype=bool) if self.samples is None else self.samples == 0


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, eq=False)
class ReportedProposals:
    """Terms that a search has proposed.

    Attributes:
        drawn: the proposals with their pictures.
        scope: what took part.
        made: time of the search; "" for now.
        change: what has changed since, as the subject of a sentence, so that they are not about the result any more.
    """

    drawn: "DrawnProposals"
    scope: "SearchScope"
    made: str = ""
    change: str = ""


@dataclass(frozen=True, eq=False)
class ReportData:
    """A project and its result, or its start values if there is no result."""

    project: Project
    problem: Problem
    result: Result | None
    findings: tuple[Finding, ...]
    fits: tuple[Fit, ...]
    drawings: tuple[Drawing, ...]  # of each fit
    residuals: tuple[Residuals, ...]
    changes: tuple[ParameterChange, ...]
    trust: TrustSummary
    written: Mapping[str, Any] | None  # the contents of `result.json`
    extrapolation: tuple[Extrapolation, ...]  # use of surrogates outside their training data
    seen: tuple[Finding, ...]  # test data that are also training data
    recordings: tuple[RecordingQuality, ...]
    validation: CrossValidation | None
    heading: ReportEntry
    missing: Hints | None = None
    proposals: ReportedProposals | None = None

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
        summaries = {(i, r.dataset): r for i, of in self.numbered.items() for r in of.summaries}
        scores = []
        for fit in self.fits:
            criterion, data, old = self.problem.criteria[fit.number], fit.data.dataset, fit.counts.before.sums
            row, now = self._stored_quality.get((fit.number, data.name)), summaries[fit.number, data.name]
            rmse = (old.rmse, now.rmse) if row is None else (row.rmse_before, row.rmse_after)
            r2, largest = (now.r2, now.largest) if row is None else (row.r2_after, row.max_abs_after)
            scores.append(
                Score(
                    number=fit.number,
                    criterion=criterion.node,
                    target=str(criterion.target),
                    dataset=data.name,
                    use=data.use,
                    unit=fit.counts.unit,
                    samples=now.samples,
                    rmse=rmse,
                    r2=(_r2(fit), r2),
                    largest=(old.largest if old.count else float("nan"), largest),
                )
            )
        return tuple(scores)

    @property
    def numbered(self) -> dict[int, Residuals]:
        """The residuals by the number of their criterion."""
        # residuals are in the order of the criteria, without those that score no sample
        return dict(zip(sorted({fit.number for fit in self.fits}), self.residuals, strict=True))

    @cached_property
    def _stored_quality(self) -> dict[tuple[int, str], Quality]:
        """The quality rows of the result by criterion number and dataset."""
        by_node: dict[tuple[str, str], list[Quality]] = {}
        for row in self.result.quality if self.result else ():
            by_node.setdefault((row.criterion, row.dataset), []).append(row)
        return {
            (number, dataset): row
            for (node, dataset), rows in by_node.items()
            # a node with several targets has a row for each, in the order of the criteria
            for number, row in zip(
                [i for i, criterion in enumerate(self.problem.criteria) if criterion.node == node], rows, strict=False
            )
        }

    @property
    def stale(self) -> bool:
        """True if the errors of the result cannot be reproduced, since the project or its data have changed."""
        rmse = {(fit.number, fit.data.dataset.name): fit.counts.after.sums.rmse for fit in self.fits}
        return any(
            key not in rmse or not np.isclose(rmse[key], row.rmse_after, rtol=1e-3, equal_nan=True)
            for key, row in self._stored_quality.items()
            if row.samples
        )


def collect_report_data(
    project: Project,
    result: Result | None,
    findings: Sequence[Finding] = (),
    trust: TrustSummary | None = None,
    written: Mapping[str, Any] | None = None,
    extrapolation: Sequence[Extrapolation] | None = None,
    validation: CrossValidation | None = None,
    heading: ReportEntry | None = None,
    missing: Hints | None = None,
    proposals: ReportedProposals | None = None,
) -> ReportData:
    """Compute the data of a report.

    Args:
        project: the project.
        result: its result, if there is one.
        findings: the findings of the project check.
        trust: uncertainty of the values; by default that of the result.
        written: contents of `result.json`; by default those of the result.
        extrapolation: use of surrogates outside their training data; computed by default.
        validation: a cross-validation, if there was one.
        heading: title, author and comment; by default those of the project file.
        missing: what the function lacks; by default as `written` states it.
        proposals: the last list of proposed terms, if there is one.

    Raises:
        InputError: the project does not define a problem that can be evaluated.
    """
    # shifts that the run estimated, so that errors are those of the run
    problem = project.problem() if result is None else apply_shifts(project.problem(), result.shifts)
    start = problem.parameters if result is None else result.start
    parameters = start if result is None else result.parameters
    if trust is None:
        trust = TrustSummary() if result is None else summarise_trust(result.trust)
    passes = PartPasses(problem, start, parameters)
    analysis = analyse(problem, start, parameters, trust=trust, passes=passes)
    extrapolation = find_extrapolation(problem, parameters) if extrapolation is None else tuple(extrapolation)
    if result is not None and written is None:
        surrogates = [row.as_json() for row in extrapolation]
        written = result.as_json() | ({"surrogates": surrogates} if surrogates else {})
        written |= {} if missing is None else {"missing": missing.as_json()}
    return ReportData(
        project=project,
        problem=problem,
        result=result,
        findings=tuple(findings),
        fits=analysis.fits,
        drawings=tuple(draw(passes, analysis.fits, _worst_samples(analysis))),
        residuals=analysis.residuals,
        changes=_changes(problem, start, parameters, trust, analysis.touching),
        trust=trust,
        written=written,
        extrapolation=extrapolation,
        seen=tuple(project.seen_test_data()),
        recordings=Scorer(problem).scores(start, start).recordings if result is None else result.recordings,
        validation=validation,
        heading=heading or project.file.report,
        missing=missing or Hints.from_json((written or {}).get("missing")),
        proposals=proposals,
    )


def _changes(
    problem: Problem, start: ParameterSet, parameters: ParameterSet, trust: TrustSummary, counted: Mapping[str, Int]
) -> tuple[ParameterChange, ...]:
    """Return the free parameters, the largest change first."""
    changes = []
    for name in problem.free_names:
        after, before = parameters[name], start[name]
        moved = not before.has_grid_of(after)
        changes.append(
            ParameterChange(
                before=_resample(before, after) if moved else before,
                after=after,
                moved=moved,
                samples=_array_of(after, trust.samples) if name in trust.samples else counted.get(name),
                informed=_array_of(after, trust.informed),
                deviation=_array_of(after, trust.deviation),
                by_smoothness=_array_of(after, trust.by_smoothness),
            )
        )
    return tuple(sorted(changes, key=lambda change: -change.size))


def _array_of(table: Parameter, arrays: Mapping[str, Any]) -> Any:
    """Return the array of a parameter, None if there is none or it has another shape."""
    array = arrays.get(table.name)
    return None if array is None or np.shape(array) != table.values.shape else np.asarray(array)


def _resample(before: Parameter, after: Parameter) -> Parameter:
    points = np.meshgrid(*(axis.breakpoints for axis in after.index_axes), indexing="ij")
    # the old table at the new grid points, so that both can be subtracted
    sides = [
        cell_weights(position(x.ravel(), axis.breakpoints, before.extrapolation), len(axis))[0]
        for x, axis in zip(points, before.index_axes, strict=True)
    ]
    return after.with_values(interpolate(before.values, sides))


def _worst_samples(analysis: Analysis) -> dict[int, dict[str, list[int]]]:
    """Return the worst samples by the number of the criterion and the dataset."""
    samples: dict[int, dict[str, list[int]]] = {}
    numbers = sorted({fit.number for fit in analysis.fits})
    for number, of in zip(numbers, analysis.residuals, strict=True):
        by_dataset = samples.setdefault(number, {})
        for worst in of.worst:
            by_dataset.setdefault(worst.dataset, []).append(worst.sample)
    return samples


def _r2(fit: Fit) -> float:
    sums, variation = fit.counts.before.sums, fit.counts.target.squares
    return 1.0 - sums.squares / variation if variation > 0 and sums.count == fit.samples else float("nan")
