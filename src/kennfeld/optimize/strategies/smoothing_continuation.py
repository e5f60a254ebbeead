"""Descents on smoothed lookups, sharpened stage by stage to the exact model.

A chain of piecewise-linear lookups is full of kinks at which gradient methods stop early. Each lookup whose coordinate
depends on a free parameter is replaced by its convolution with a Gaussian, whose width shrinks to zero (H. Mobahi,
J. Fisher: A theoretical analysis of optimization by Gaussian continuation, 2015).
"""

from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, StageReport, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem, smoothable
from kennfeld.optimize.sums.objective import LeastSquaresObjective


@dataclass(frozen=True)
class SmoothingSchedule:
    """Widths of the smoothing in mean breakpoint spacings, and what ends each stage.

    Stages at large widths end early: they only have to choose the valley. In the last ones, kinks are still passed. A
    stage begins with the damping at which the one before ended, within a range. Over the 34 problems of
    `python -m benchmarks continuation`, stages to 1e-5 take 2.7 times as long and end 2 % higher.
    """

    widths: tuple[float, ...]
    tolerances: tuple[float, ...]  # of each stage: relative change of the cost
    patience: int = 2
    damping: tuple[float, float] = (1e-8, 1e-3)  # range at the beginning of a stage


SHORT_SCHEDULE = SmoothingSchedule(tuple(1.0 / 2**i for i in range(5)), (1e-3, 1e-3, 1e-3, 1e-4, 1e-4))
LONG_SCHEDULE = SmoothingSchedule(tuple(4.0 / 2**i for i in range(7)), (1e-2, 1e-2, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4))

StageCosts = dict[float, float]  # cost of the smoothed model at the end of each stage, by width


class Continuation:
    """The smoothed form of a problem, and `exact`, its compiled form without smoothing; both over part of many samples.

    Costs are those of these samples, with the weight of all.
    """

    def __init__(self, exact: CompiledProblem) -> None:
        thinned = exact.thinned()
        self._exact, self.thinned = LeastSquaresObjective(thinned), thinned is not exact
        self._smooth = CompiledProblem(exact.problem, smooth_like=exact)
        self._objective = LeastSquaresObjective(self._smooth)

    @classmethod
    def of(cls, exact: CompiledProblem) -> "Continuation | None":
        """Return the smoothed form; None if no lookup can be smoothed."""
        return cls(exact) if smoothable(exact.problem) else None

    def with_start(self, exact: CompiledProblem) -> "Continuation":
        """Return the smoothed form of `exact`, which differs in the start of the free parameters only."""
        other = copy(self)
        other._exact = LeastSquaresObjective(exact.thinned())
        other._smooth = self._smooth.with_start(exact.problem)
        other._objective = LeastSquaresObjective(other._smooth)
        return other

    def descend(
        self,
        schedule: SmoothingSchedule,
        start: Float,
        limits: LinearLimits,
        settings: SolverSettings,
        report: StageReport,
        earlier: StageCosts | None = None,
    ) -> tuple[SolverResult, StageCosts]:
        """Descend at each width, then on the exact model.

        Args:
            schedule: widths, and when their stages end.
            start: free values that keep `limits`, Float[values].
            limits: bounds and linear rows.
            settings: of the descent on the exact model.
            report: called after each accepted step.
            earlier: costs of another schedule from the same start; ends at a width at which that was as good.

        Returns:
            The end of the last descent, and the costs on the way. If a stage was cut short, the better of its end and
            the start; if the earlier search was as good, the values there with an infinite cost.
        """
        stages: list[SolverResult] = []
        costs: StageCosts = {}
        values, damping = start, settings.damping
        for width, tolerance in zip(schedule.widths, schedule.tolerances, strict=True):
            self._smooth.set_width(width)
            stage = replace(settings, tolerance=tolerance, patience=schedule.patience, damping=damping)
            stage_report = partial(report, f"smooth {width:g}")
            stages.append(levenberg_marquardt(self._objective, values, limits, stage, stage_report))
            values, costs[width] = stages[-1].values, stages[-1].cost
            damping = float(np.clip(stages[-1].damping, *schedule.damping))
            if stages[-1].cut_short:
                return self._better(start, stages[-1]).with_effort_of(stages), costs
            # the other schedule was as good on the same smoothed cost
            if earlier and not costs[width] < earlier.get(width, np.inf):
                return replace(stages[-1], cost=np.inf).with_effort_of(stages), costs
        sharp = replace(settings, damping=damping)
        last = levenberg_marquardt(self._exact, values, limits, sharp, partial(report, "exact"))
        return last.with_effort_of([*stages, last]), costs

    def descend_directly(
        self, start: Float, limits: LinearLimits, settings: SolverSettings, report: StageReport
    ) -> SolverResult:
        """Descend on the exact model alone; arguments as for `descend`, with a start Float[values]."""
        return levenberg_marquardt(self._exact, start, limits, settings, partial(report, "plain"))

    def _better(self, start: Float, end: SolverResult) -> SolverResult:
        """Return the end with its values or the start, whichever has the lower cost on the exact model."""
        costs = np.array([self._exact.cost(v) for v in (start, end.values)])
        costs[~np.isfinite(costs)] = np.inf
        return end.moved(start if costs[0] <= costs[1] else end.values, float(costs.min()))
