"""Warnings about a fit that ends with larger errors than it started with, and their cause."""

from bisect import bisect_left
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem

WORSE = 1.01  # ratio of the RMSE after the fit to that before, from which it counts as worse
PERFECT = 1e-9  # of the variance of the target: errors below it are rounding
SHARES = tuple(float(f"{digit}e-{power}") for power in range(1, 17) for digit in (5, 2, 1))
RIDGE = 1e-12  # of the curvature, for values that are not determined at a share
MAX_LISTED = 4  # datasets in a warning


def find_worsening(
    quality: Sequence[Quality],
    scored: Collection[str],
    *,
    outweighed: bool,
    share: float | None,
    partial_end: str = "",
) -> Iterator[Finding]:
    """Yield a warning if RMSEs are larger than at the start.

    Args:
        quality: of all criteria on all datasets.
        scored: the criteria with a weight.
        outweighed: True if the cost of the training data as a whole has risen.
        share: share of the smoothness at which it would not have; None if smoothness is not the cause.
        partial_end: the remedy if a sequence ended with a step that does not fit all values, else empty.
    """
    rows = [
        row
        for row in quality
        if row.criterion in scored and row.rmse_after > WORSE * row.rmse_before and not 1 - row.r2_after < PERFECT
    ]
    if not rows:
        return
    comparisons = [
        f"of {row.criterion} on {row.dataset}{' (test data)' if row.use == 'test' else ''} "
        f"rises from {row.rmse_before:.4g} to {row.rmse_after:.4g}"
        for row in rows[:MAX_LISTED]
    ]
    more = f", and {len(rows) - MAX_LISTED} more" if len(rows) > MAX_LISTED else ""
    cause, remedy = _cause(rows, outweighed, share, partial_end)
    yield Finding(Location(), f"{cause}: the RMSE {', '.join(comparisons)}{more}", remedy, severity="warning")


def _cause(rows: Sequence[Quality], outweighed: bool, share: float | None, partial_end: str) -> tuple[str, str]:
    if outweighed and partial_end:
        return "The last step of the sequence keeps some values, or removes breakpoints", partial_end
    if outweighed and share is not None:
        return "Smoothness outweighs the data", f"Multiply the smoothness by about {share:g}, or record more data."
    if outweighed:
        return "The fit is worse than its start", "Check bounds, pins and limits: the start may violate them."
    if all(row.use == "test" for row in rows):
        remedy = "Add training data there, increase the smoothness, or free fewer values."
        return "The fit is worse than its start on test data", remedy
    remedy = "Increase its weight: other criteria or datasets outweigh it, or a robust loss ignores its errors."
    return "The fit is partly worse than its start", remedy


def admissible_share(compiled: CompiledProblem, limits: LinearLimits, values: Float, allowed: float) -> float | None:
    """Estimate the largest share of the smoothness at which the cost of the data is at most `allowed`.

    For each share, 1, 2 or 5 times a power of ten, a Gauss-Newton step leads from the end of the fit to its minimum,
    where the cost of the data is evaluated. None if even the smallest share is too much.

    Args:
        compiled: the problem that was fitted.
        limits: of its free values.
        values: the end of the fit, Float[values].
        allowed: cost of the data.
    """
    normal = compiled.sums.normal(compiled.full(values))
    data, pull = as_array(normal.matrix), normal.gradient.copy()
    smoothness, bend = np.zeros_like(data), np.zeros_like(pull)
    compiled.roughness.add(values, bend, smoothness)
    # values at a bound stay there
    moving = limits.movable & (values > limits.lower) & (values < limits.upper)
    part = np.ix_(moving, moving)

    def is_allowed(share: float) -> bool:
        matrix = data[part] + share * smoothness[part]
        ridge = RIDGE * np.diag(np.maximum(np.diag(matrix), RIDGE))
        minimum = values.copy()
        # minimum of the quadratic model with this share of the smoothness
        minimum[moving] -= np.linalg.solve(matrix + ridge, (pull + share * bend)[moving])
        return compiled.sums.cost(compiled.full(limits.clip(minimum))) <= allowed

    first = bisect_left(SHARES, True, key=is_allowed)  # the costs rise with the share
    return SHARES[first] if first < len(SHARES) else None
