"""Descents on smoothed lookups, sharpened stage by stage to the exact model.

A chain of piecewise-linear lookups is full of kinks at which gradient methods stop early. Each lookup whose coordinate
depends on a free parameter is replaced by its convolution with a Gaussian, whose width shrinks to zero (H. Mobahi,
J. Fisher: A theoretical analysis of optimization by Gaussian continuation, 2015).
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.compiled import CompiledProblem, smoothable
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits

Report = Callable[[str, Iteration, Float], None]


@dataclass(frozen=True)
class SmoothingSchedule:
    """Widths of the smoothing in mean breakpoint spacings, and the relative change of the cost that ends a stage."""

    widths: tuple[float, ...]
    tolerance: float


SHORT_SCHEDULE = SmoothingSchedule(tuple(1.0 / 2**i for i in range(6)), 3e-5)
LONG_SCHEDULE = SmoothingSchedule(tuple(4.0 / 2**i for i in range(8)), 1e-5)


class Continuation:
    """The smoothed form of a problem; `exact` is its compiled form without smoothing."""

    def __init__(self, problem: Problem, exact: CompiledProblem) -> None:
        self._exact = LeastSquaresObjective(exact)
        self._smooth = CompiledProblem(problem, smooth_like=exact)
        self._objective = LeastSquaresObjective(self._smooth)

    @classmethod
    def of(cls, problem: Problem, exact: CompiledProblem) -> "Continuation | None":
        """Return the smoothed form; None if no lookup can be smoothed."""
        return cls(problem, exact) if smoothable(problem) else None

    def with_start(self, exact: CompiledProblem) -> "Continuation":
        """Return the smoothed form of `exact`, which differs in the start of the free parameters only."""
        other = copy(self)
        other._exact = LeastSquaresObjective(exact)
        other._smooth = self._smooth.with_start(exact.problem)
        other._objective = LeastSquaresObjective(other._smooth)
        return other

    def descend(
        self, schedule: SmoothingSchedule, start: Float, limits: LinearLimits, settings: SolverSettings, report: Report
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
            if stages[-1].status in ("stopped", "failed"):
                cost, values = min(((self._exact_cost(v), v) for v in (start, values)), key=lambda end: end[0])
                return replace(stages[-1], values=values, cost=cost).with_effort_of(stages)
        last = levenberg_marquardt(self._exact, values, limits, settings, partial(report, "exact"))
        return last.with_effort_of([*stages, last])

    def _exact_cost(self, values: Float) -> float:
        cost = self._exact.cost(values)
        return cost if np.isfinite(cost) else np.inf
