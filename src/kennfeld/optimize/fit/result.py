"""The result of a calibration, its trace, and the checkpoints from which a search can resume."""

from collections.abc import Callable, Mapping
from dataclasses import field
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.base.formatting import number_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.numeric import finite_or_none
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.quality.quality import Quality, r2_text
from kennfeld.optimize.quality.recording_quality import RecordingQuality, error_text, recordings_table
from kennfeld.optimize.rounding.outcome import RoundingResult
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.levenberg_marquardt import Status

if TYPE_CHECKING:
    from kennfeld.optimize.problem.problem import Problem
    from kennfeld.optimize.trust.assessment import TrustAssessment
    from kennfeld.optimize.trust.trust import Trust

_PLOTS = "kennfeld.notebook.plots"  # in a higher layer, for notebooks and scripts
PlotKind = Literal["convergence", "strips", "errors", "maps"]


@dataclass(frozen=True)
class TraceLine:
    """One accepted step.

    `stage` is `plain`, or `smooth WIDTH` and `exact` of a descent on smoothed lookups; in a sequence with the name of
    the step before it: `step 1: plain`. `seconds` counts from the begin of the compilation.
    """

    iteration: int
    start: int
    stage: str
    cost: float
    rmse: float
    step: float
    damping: float
    active: int
    seconds: float


@dataclass(frozen=True)
class Seconds:
    """Elapsed time in s."""

    total: float = 0.0
    read: float = 0.0
    compile: float = 0.0
    optimize: float = 0.0


@dataclass(frozen=True)
class StartResult:
    """The end of one start; `distance` is to the values of the best start, relative to the size of each parameter."""

    start: int
    status: Status
    message: str
    cost_before: float
    cost_after: float
    iterations: int
    evaluations: int
    distance: float = float("nan")

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "starts" in `result.json`."""
        return {"start": self.start, **_outcome_json(self), "distance": finite_or_none(self.distance)}


@dataclass(frozen=True)
class Result(NotebookDisplay):
    """The result of a calibration. A fit that fails is a result too, with the reason in `status` and `message`.

    Attributes:
        status: `converged`, or why the search ended otherwise.
        message: the status as a sentence, with the remedy.
        parameters: the calibrated values.
        start: the values before.
        quality: errors by criterion and dataset.
        trace: accepted steps.
        iterations: number of accepted steps.
        evaluations: number of evaluations of the cost.
        cost_before: cost at the start.
        cost_after: cost at the end.
        free_values: number of values that the search may change.
        fixed_values: number of values that it may not.
        seconds: time of each part of the work, in s.
        inspection: what `trust` is computed from.
        starts: a row for each start, if there are several.
        resumed: the checkpoints from which the search resumed.
        smoothness: factors of each table with an automatic one, by axis x, y, z or w.
        shifts: estimated shifts by dataset and channel, in s, or in samples for steady-state data.
        warnings: criteria whose errors are larger than at the start, signs that the end is not the optimum, slopes that
            do not describe how the cost changes, sample weights that are missing, fitted time constants close to the
            step, limits that are crossed, and shifts that are ambiguous or at the edge of the search window.
        recordings: errors by criterion, dataset and file, with the worst stretch of each file.
        certificate: how far the values are from a minimum within the limits, in numbers without units; None if that
            cannot be computed. Of a rounded result, that of the fit before.
        rounding: errors before and after rounding to storable values; None if nothing was rounded.

    >>> from kennfeld import calibrate
    >>> result = calibrate("y = k * x", {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}, {"k": 0.0}, target="m")
    >>> result.status, round(result.parameters["k"].value, 6)
    ('converged', 2.0)
    """

    status: Status
    message: str
    parameters: ParameterSet
    start: ParameterSet
    quality: tuple[Quality, ...]
    trace: tuple[TraceLine, ...]
    iterations: int
    evaluations: int
    cost_before: float
    cost_after: float
    free_values: int
    fixed_values: int
    seconds: Seconds = field(default_factory=Seconds)
    inspection: "TrustAssessment | None" = field(default=None, repr=False, compare=False)
    starts: tuple[StartResult, ...] = ()
    resumed: tuple[str, ...] = ()
    smoothness: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    shifts: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    warnings: tuple[Finding, ...] = ()
    recordings: tuple[RecordingQuality, ...] = field(default=(), repr=False)
    certificate: Certificate | None = None
    rounding: RoundingResult | None = None

    @property
    def moved(self) -> dict[str, tuple[Float, Float]]:
        """Breakpoints that were moved, before and after: `AxisSpeed` for a group axis, else `MapTorque.x`."""
        moved = {}
        for key, free in free_axes(self.start).items():
            # all tables on a group axis have the same breakpoints
            table, which = free.places[0]
            before, after = free.axis.breakpoints, self.parameters[table].axes[which].breakpoints
            if not np.array_equal(before, after):
                moved[str(key)] = before, after
        return moved

    @cached_property
    def trust(self) -> "Trust":
        """Uncertainty of the free values, and what determines them; computed on first use."""
        from kennfeld.optimize.trust.trust import Trust

        if self.inspection is not None:
            return self.inspection.trust
        ended = self.status in ("infeasible", "failed")
        remark = f"The search ended with status {self.status}: the uncertainty of its values is unknown."
        return Trust(remark=remark if ended else "")

    @property
    def converged(self) -> bool:
        """True if the search ended at a minimum."""
        return self.status == "converged"

    def as_json(self) -> dict[str, Any]:
        """Return the contents of `result.json`; numbers that are not finite are None."""
        moved = {name: {"before": old.tolist(), "after": new.tolist()} for name, (old, new) in self.moved.items()}
        return {
            **_outcome_json(self),
            "seconds": {name: round(value, 6) for name, value in vars(self.seconds).items()},
            "values": {"free": self.free_values, "fixed": self.fixed_values},
            "certificate": self.certificate and self.certificate.as_json(),
            "quality": [{name: finite_or_none(value) for name, value in vars(row).items()} for row in self.quality],
            "recordings": [row.as_json() for row in self.recordings],
            "starts": [row.as_json() for row in self.starts],
            "resumed": list(self.resumed),
            "trust": self.trust.as_json(),
            "smoothness": {
                name: {axis: finite_or_none(factor) for axis, factor in factors.items()}
                for name, factors in self.smoothness.items()
            },
            "shifts": {name: dict(channels) for name, channels in self.shifts.items()},
            "warnings": [{"sentence": f"{warning.message}.", "remedy": warning.remedy} for warning in self.warnings],
            **({} if self.rounding is None else {"rounding": self.rounding.as_json()}),
        } | ({"breakpoints": moved} if moved else {})

    def table(self) -> list[tuple[str, ...]]:
        """Return the quality as rows of text with a heading; rows without samples only if there are no others."""
        scored = [q for q in self.quality if q.samples] or self.quality
        head = ("criterion", "dataset", "use", "samples", "RMSE before", "RMSE after", "R2", "max |error|")
        rows = []
        for q in scored:
            errors = [error_text(x) for x in (q.rmse_before, q.rmse_after, q.max_abs_after)]
            errors.insert(2, r2_text(q.r2_after, q.samples, q.rmse_after))
            rows.append((q.criterion, q.dataset, q.use, str(q.samples), *errors))
        return [head, *rows]

    def recordings_table(self) -> list[tuple[str, ...]]:
        """Return the errors by recording as rows of text with a heading, the worst of each criterion first."""
        return recordings_table(self.recordings)

    def starts_table(self) -> list[tuple[str, ...]]:
        """Return the starts as rows of text with a heading."""
        head = ("start", "status", "cost before", "cost after", "iterations", "distance")
        rows = []
        for row in self.starts:
            costs = number_text(row.cost_before), number_text(row.cost_after)  # empty if it was stopped before it began
            rows.append((str(row.start), row.status, *costs, str(row.iterations), f"{row.distance:.3g}"))
        return [head, *rows]

    def __str__(self) -> str:
        from kennfeld.optimize.trust.undetermined import undetermined_lines

        lines = _aligned(self.table())
        rounded = [] if self.rounding is None else [*_aligned(self.rounding.table()), *self.rounding.advice()]
        warnings = [f"warning: {warning}" for warning in self.warnings]
        undetermined = undetermined_lines(self.trust, "; see result.trust")
        return "\n".join([f"{self.status}: {self.message}", *lines, *rounded, *warnings, *undetermined])

    def plot(self, kind: PlotKind = "convergence", problem: "Problem | None" = None, **selection: Any) -> Any:
        """Return a matplotlib figure of the result.

        Args:
            kind: `convergence`, the cost over the accepted steps by stage; `strips`, measurement and model over time or
                sample, with the error below; `errors`, model over measurement and the histogram of the errors, before
                and after; or `maps`, the fitted tables.
            problem: the problem that was fitted, for `strips` and `errors`; `project.problem()`. Only required if the
                result was computed in another process.
            selection: `criterion` and `dataset` select one of each by name; `names` are the tables to plot.

        Raises:
            InputError: matplotlib is not installed; the message has the command that installs it.
            ArgumentError: an unknown kind, name or problem, or data in partitions.
        """
        if problem is None:
            problem = getattr(self.inspection, "problem", None)  # another process returns the trust alone
        return import_module(_PLOTS).plot(self, kind, problem, **selection)


def _aligned(table: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]


def _outcome_json(outcome: StartResult | Result) -> dict[str, Any]:
    return {
        "status": outcome.status,
        "message": outcome.message,
        "iterations": outcome.iterations,
        "evaluations": outcome.evaluations,
        "cost": {"before": finite_or_none(outcome.cost_before), "after": finite_or_none(outcome.cost_after)},
    }


Progress = Callable[[TraceLine], None]


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """An accepted parameter set of one start.

    Attributes:
        start: number of the start.
        step: number of the step of the sequence, from 1.
        iteration: accepted steps of the start over all stages and steps.
        stage: see `TraceLine`.
        cost: of the exact model of this step, so that sets of one step can be compared.
        values: the parameters that the search may change, on their full grids.
        ended: the result of the start once it has ended.
        problem: the digest of the problem, see `problem_digest`; empty if it is unknown.
    """

    start: int
    step: int
    iteration: int
    stage: str
    cost: float
    values: Mapping[str, Float] = field(repr=False)
    ended: StartResult | None = None
    name: str = ""
    problem: str = ""


CheckpointSink = Callable[[Checkpoint], None]


def single_start(result: Result) -> StartResult:
    """Return the row of a result with a single start."""
    costs, effort = (result.cost_before, result.cost_after), (result.iterations, result.evaluations)
    return StartResult(1, result.status, result.message, *costs, *effort, distance=0.0)
