"""The result of a calibration, its trace, and the checkpoints from which a search can resume."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.formatting import join_names, number_text
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.numeric import finite_or_none
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.quality.quality import Quality, r2_text
from kennfeld.optimize.quality.recording_quality import RecordingQuality, error_text, recordings_table
from kennfeld.optimize.rounding.outcome import RoundingResult
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.levenberg_marquardt import Status

if TYPE_CHECKING:
    from kennfeld.domain.dataset import Dataset
    from kennfeld.optimize.problem.problem import Problem
    from kennfeld.optimize.trust.assessment import TrustAssessment
    from kennfeld.optimize.trust.trust import Trust
    from kennfeld.preprocessing.coercion import Data

# in higher layers, for notebooks and scripts
_PLOTS = "kennfeld.notebook.plots"
_API = "kennfeld.optimize.api"
_SIMULATION = "kennfeld.project.simulation"
_RESIDUALS = "kennfeld.analysis.residuals"
_SHIFTS = "kennfeld.optimize.tuning.shift_estimation"
MAX_ROWS = 12  # parameters that the text of a result shows
PlotKind = Literal["convergence", "strips", "errors", "maps"]


@dataclass(frozen=True)
class TraceLine:
    """One accepted step.

    Attributes:
        iteration: number of the step within its start, from 1.
        start: number of the start, from 1.
        stage: `plain`, or `smooth WIDTH` and `exact` of a descent on smoothed lookups; in a sequence with the name of
            the step before it: `step 1: plain`.
        cost: after the step.
        rmse: of the first criterion on the training data.
        step: length of the step, in units of the scales of the values.
        damping: of the step.
        active: number of active limits.
        seconds: time since compilation began, in s.

    >>> from kennfeld import calibrate
    >>> line = calibrate("y = k * x", {"x": [1.0, 2.0], "m": [2.0, 4.0]}, {"k": 0.0}, target="m").trace[0]
    >>> line.iteration, line.stage
    (1, 'plain')
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

    def __post_init__(self) -> None:
        for name in ("smoothness", "shifts"):
            frozen = FrozenDict({key: FrozenDict(own) for key, own in getattr(self, name).items()})
            object.__setattr__(self, name, frozen)

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

        lines = [*aligned(self.table()), *aligned(values_table(self))]
        rounded = [] if self.rounding is None else [*aligned(self.rounding.table()), *self.rounding.advice()]
        warnings = [f"warning: {warning}" for warning in self.warnings]
        undetermined = undetermined_lines(self.trust, "; see result.trust", "kennfeld.design(result, direction=1)")
        return "\n".join([f"{self.status}: {self.message}", *lines, *rounded, *warnings, *undetermined])

    def __repr__(self) -> str:
        errors = [f"RMSE of {row.criterion} on {row.dataset} {row.rmse_after:.4g}" for row in self.quality]
        return f"Result({self.status!r}, {self.parameters!r}, {join_names(errors, 3)})"

    @overload
    def simulate(self, data: "Data", *, problem: "Problem | None" = None) -> "Dataset": ...

    @overload
    def simulate(self, data: None = None, *, problem: "Problem | None" = None) -> "list[Dataset]": ...

    def simulate(self, data: "Data | None" = None, *, problem: "Problem | None" = None) -> "Dataset | list[Dataset]":
        """Evaluate the function with the fitted values.

        Args:
            data: other data than those of the fit; a dataset, or columns by name.
            problem: the problem that was fitted; only required if the result was computed in another process.

        Returns:
            For `data`, a dataset with a channel for each node, Float[samples]. Without it, a list of such datasets, one
            for each of the fit, with the targets and with the shifts that the fit estimated.

        Raises:
            ArgumentError: the problem is not known.
            InputError: the data do not have the inputs of the function.

        >>> from kennfeld import calibrate
        >>> result = calibrate("y = k * x", {"x": [1.0, 2.0], "m": [2.0, 4.0]}, {"k": 0.0}, target="m")
        >>> result.simulate({"x": [3.0]})["y"].values.round(6)
        array([6.])
        """
        own = self._problem(problem)
        if data is not None:
            simulated: Dataset = import_module(_API).simulate(own.model, data, self.parameters, own.channels)
            return simulated
        datasets: list[Dataset] = import_module(_SIMULATION).simulate_problem(self._shifted(own), self.parameters)
        return datasets

    def residuals(self, *, worst: int = 20, problem: "Problem | None" = None) -> "tuple[Any, ...]":
        """Return the errors of the fit, a `Residuals` per criterion; see `kennfeld.residuals`.

        Args:
            worst: number of the largest errors to list.
            problem: the problem that was fitted; only required if the result was computed in another process.

        Raises:
            ArgumentError: the problem is not known.
        """
        own = self._shifted(self._problem(problem))
        rows: tuple[Any, ...] = import_module(_RESIDUALS).residuals(own, self.parameters, trust=self.trust, worst=worst)
        return rows

    def to_frame(self) -> Any:
        """Return the values as a DataFrame of pandas, one row per value.

        Returns:
            The columns of `ParameterSet.to_frame`, and `start`, `deviation` and `samples` of each value; NaN for those
            that were not fitted.

        Raises:
            InputError: pandas is not installed; the message has the command that installs it.
        """
        frame = self.parameters.to_frame()
        members = self.parameters.values()
        frame.insert(frame.columns.get_loc("value") + 1, "start", _by_value(members, self.start, "values"))
        for name in ("deviation", "samples"):
            frame[name] = _by_value(members, getattr(self.trust, name))
        return frame

    def _problem(self, problem: "Problem | None") -> "Problem":
        own: Problem | None = problem or getattr(self.inspection, "problem", None)
        if own is None:
            message = "the data of this result are in another process. Pass problem=project.problem()"
            raise ArgumentError(f"problem=None: {message}")
        return own

    def _shifted(self, problem: "Problem") -> "Problem":
        """Return the problem with the shifts that the fit estimated."""
        if not problem.unknown_shifts:
            return problem
        shifted: Problem = import_module(_SHIFTS).apply_shifts(problem, self.shifts)
        return shifted

    def plot(
        self,
        kind: PlotKind = "convergence",
        problem: "Problem | None" = None,
        *,
        criterion: str = "",
        dataset: str = "",
        names: Sequence[str] = (),
    ) -> Any:
        """Return a matplotlib figure of the result.

        Args:
            kind: `convergence`, the cost over the accepted steps by stage; `strips`, measurement and model over time or
                sample, with the error below; `errors`, model over measurement and the histogram of the errors, before
                and after; or `maps`, the fitted tables.
            problem: the problem that was fitted, for `strips` and `errors`; `project.problem()`. Only required if the
                result was computed in another process.
            criterion: the node of one criterion; all by default.
            dataset: the name of one dataset; all by default.
            names: the tables to plot; by default those that were fitted.

        Raises:
            InputError: matplotlib is not installed; the message has the command that installs it.
            ArgumentError: an unknown kind, name or problem, or data in partitions.
        """
        if problem is None:
            problem = getattr(self.inspection, "problem", None)  # another process returns the trust alone
        return import_module(_PLOTS).plot(self, kind, problem, criterion=criterion, dataset=dataset, names=names)


def values_table(result: Result) -> list[tuple[str, ...]]:
    """Return the fitted values with their standard deviations as rows of text with a heading; of tables, their range.

    At most `MAX_ROWS` parameters are shown.
    """
    fitted = [p for name, p in result.parameters.items() if name in result.trust.deviation]
    rows: list[tuple[str, ...]] = [("parameter", "value", "deviation", "unit")]
    for parameter in fitted[:MAX_ROWS]:
        deviation = result.trust.deviation[parameter.name]
        unit = parameter.unit or "-"
        rows.append((parameter.name, _range_text(parameter.values, 6), _range_text(deviation, 3), unit))
    if len(fitted) > MAX_ROWS:
        rows.append((f"and {len(fitted) - MAX_ROWS} more", "", "", ""))
    return rows if fitted else []


def _range_text(values: Float, digits: int) -> str:
    """Return a number to so many digits, or the least and the largest of several."""
    known = values[~np.isnan(values)]
    if not known.size:
        return "nan"
    least, largest = float(known.min()), float(known.max())
    return f"{least:.{digits}g}" if values.ndim == 0 else f"{least:.4g} .. {largest:.4g}"


def aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Return rows of text as lines with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _by_value(members: Iterable[Parameter], others: Mapping[str, Any], attribute: str = "") -> Float:
    """Return the numbers of others of the same name and shape for all values, Float[values]; NaN for those without."""

    def of(member: Parameter) -> Float:
        other = others.get(member.name)
        numbers = getattr(other, attribute) if attribute and other is not None else other
        fits = numbers is not None and numbers.shape == member.values.shape
        return np.asarray(numbers, dtype=np.float64).ravel() if fits else np.full(member.size, np.nan)

    parts = [of(member) for member in members]
    return np.concatenate(parts) if parts else np.zeros(0)


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
