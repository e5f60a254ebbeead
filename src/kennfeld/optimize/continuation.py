"""Kink continuation: descend on smoothed lookups first, sharpen them step by step, end with the exact model.

A chain of piecewise-linear lookups is full of creases at which gradient methods stop early. Each lookup whose
coordinate depends on a free parameter is replaced by its convolution with a Gaussian (homotopy by Gaussian smoothing),
whose width shrinks from 4 to 1/32 mean breakpoint spacings. The plain descent runs as well, and the lower cost wins.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from kennfeld.arrays import Float
from kennfeld.optimize.gauss_newton import Descent, Iteration, Settings, gauss_newton
from kennfeld.optimize.objective import SumOfSquares
from kennfeld.optimize.problem import Compiled, Problem, smoothable
from kennfeld.optimize.quadratic import Limits

__all__ = ["STAGES", "descend_smoothed"]

STAGES = tuple(4.0 / 2**i for i in range(8))  # widths in mean breakpoint spacings
STAGE_TOLERANCE = 1e-5


def descend_smoothed(
    problem: Problem,
    exact: Compiled,
    start: Float,
    limits: Limits,
    settings: Settings,
    report: Callable[[str, Iteration, Float], None],
) -> Descent | None:
    """The end of the continuation, its cost that of the exact model; None where no lookup can be smoothed."""
    if not smoothable(problem):
        return None
    smooth = Compiled(problem, smooth_like=exact)
    at, iterations, evaluations = start, 0, 0
    stage_settings = replace(settings, tolerance=STAGE_TOLERANCE, patience=2)
    for width in STAGES:
        smooth.set_width(width)
        found = gauss_newton(SumOfSquares(smooth), at, limits, stage_settings, partial(report, f"smooth {width:g}"))
        iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
        at = found.values
        if found.status in ("stopped", "failed"):
            cost = SumOfSquares(exact).cost(at)
            return replace(found, cost=cost, iterations=iterations, evaluations=evaluations)
    last = gauss_newton(SumOfSquares(exact), at, limits, settings, partial(report, "exact"))
    return replace(last, iterations=iterations + last.iterations, evaluations=evaluations + last.evaluations)
