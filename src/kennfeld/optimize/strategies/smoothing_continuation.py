"""Kink continuation: descend on smoothed lookups first, sharpen them step by step, end with the exact model.

A chain of piecewise-linear lookups is full of creases at which gradient methods stop early. Each lookup whose
coordinate depends on a free parameter is replaced by its convolution with a Gaussian, whose width shrinks stage by
stage to nothing (homotopy by Gaussian smoothing; H. Mobahi and J. Fisher, A theoretical analysis of optimization by
Gaussian continuation, 2015).
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

__all__ = ["LONG_SCHEDULE", "SHORT_SCHEDULE", "Continuation"]

Report = Callable[[str, Iteration, Float], None]


@dataclass(frozen=True)
class SmoothingSchedule:
    """Widths of the smoothing in mean breakpoint spacings, and the relative change of the cost that ends a stage."""

    widths: tuple[float, ...]
    tolerance: float


SHORT_SCHEDULE = SmoothingSchedule(tuple(1.0 / 2**i for i in range(6)), 3e-5)
LONG_SCHEDULE = SmoothingSchedule(tuple(4.0 / 2**i for i in range(8)), 1e-5)


class Continuation:
    """The smoothed form of a problem, ready to be descended."""

    def __init__(self, problem: Problem, exact: CompiledProblem) -> None:
        self._exact = LeastSquaresObjective(exact)
        self._smooth = CompiledProblem(problem, smooth_like=exact)
        self._objective = LeastSquaresObjective(self._smooth)

    @classmethod
    def of(cls, problem: Problem, exact: CompiledProblem) -> "Continuation | None":
        """None where no lookup can be smoothed. `exact` is the compiled problem."""
        return cls(problem, exact) if smoothable(problem) else None

    def moved(self, exact: CompiledProblem) -> "Continuation":
        """The same for other values of the free parameters, those of the moved exact problem."""
        other = copy(self)
        other._exact = LeastSquaresObjective(exact)
        other._smooth = self._smooth.moved(exact.problem)
        other._objective = LeastSquaresObjective(other._smooth)
        return other

    def descend(
        self, ladder: SmoothingSchedule, start: Float, limits: LinearLimits, settings: SolverSettings, report: Report
    ) -> SolverResult:
        """The end of the last stage, that of the exact model; where one was cut short, the better of start and end."""
        at, iterations, evaluations = start, 0, 0
        stage_settings = replace(settings, tolerance=ladder.tolerance, patience=2)
        for width in ladder.widths:
            self._smooth.set_width(width)
            found = levenberg_marquardt(
                self._objective, at, limits, stage_settings, partial(report, f"smooth {width:g}")
            )
            iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
            at = found.values
            if found.status in ("stopped", "failed"):
                cost, at = min(((self._cost(values), values) for values in (start, at)), key=lambda end: end[0])
                return replace(found, values=at, cost=cost, iterations=iterations, evaluations=evaluations)
        last = levenberg_marquardt(self._exact, at, limits, settings, partial(report, "exact"))
        return replace(last, iterations=iterations + last.iterations, evaluations=evaluations + last.evaluations)

    def _cost(self, values: Float) -> float:
        """The cost of the exact model, infinite where it fails."""
        cost = self._exact.cost(values)
        return cost if np.isfinite(cost) else np.inf
