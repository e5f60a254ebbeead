"""Descents on smoothed lookups, sharpened stage by stage to the exact model.

A chain of piecewise-linear lookups is full of kinks at which gradient methods stop early. Each lookup whose coordinate
depends on a free parameter is replaced by its convolution with a Gaussian, whose width shrinks to zero (H. Mobahi,
J. Fisher: A theoretical analysis of optimization by Gaussian continuation, 2015).
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.compiled import CompiledProblem, smoothable
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, StageReport, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits


@dataclass(frozen=True)
class SmoothingSchedule:
    """Widths of the smoothing in mean breakpoint spacings, and the relative change of the cost that ends a stage."""

    widths: tuple[float, ...]
    tolerance: float


SHORT_SCHEDULE = SmoothingSchedule(tuple(1.0 / 2**i for i in range(6)), 3e-5)
LONG_SCHEDULE = SmoothingSchedule(tuple(4.0 / 2**i for i in range(8)), 1e-5)


class Continuation:
    """The smoothed form of a problem; `exact` is its compiled form without smoothing."""

    def __init__(self, exact: CompiledProblem) -> None:
        self._exact = LeastSquaresObjective(exact)
        self._smooth = CompiledProblem(exact.problem, smooth_like=exact)
        self._objective = LeastSquaresObjective(self._smooth)

    @classmethod
    def of(cls, exact: CompiledProblem) -> "Continuation | None":
        """Return the smoothed form; None if no lookup can be smoothed."""
        return cls(exact) if smoothable(exact.problem) else None

    def with_start(self, exact: CompiledProblem) -> "Continuation":
        """Return the smoothed form of `exact`, which differs in the start of the free parameters only."""
        other = copy(self)
        other._exact = LeastSquaresObjective(exact)
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
    ) -> SolverResult:
        """Descend at each width, then on the exact model.

        Returns:
            The end of the last descent; if a stage was cut short, the better of its end and the start.
        """
        stage_settings = replace(settings, tolerance=schedule.tolerance, patience=2)
        stages: list[SolverResult] = []
        values = start
        for width in schedule.widths:
            self._smooth.set_width(width)
            stage_report = partial(report, f"smooth {width:g}")
            stages.append(levenberg_marquardt(self._objective, values, limits, stage_settings, stage_report))
            values = stages[-1].values
            if stages[-1].cut_short:
                costs = np.array([self._exact.cost(v) for v in (start, values)])
                costs[~np.isfinite(costs)] = np.inf
                best = start if costs[0] <= costs[1] else values
                return replace(stages[-1], values=best, cost=float(costs.min())).with_effort_of(stages)
        last = levenberg_marquardt(self._exact, values, limits, settings, partial(report, "exact"))
        return last.with_effort_of([*stages, last])
