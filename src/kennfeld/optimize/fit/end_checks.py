"""Judgements of the end of a search: what makes it a failure, and sentences on what a user can do about it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.optimize.ends.doubtful_ends import describe_offsets, describe_outlier
from kennfeld.optimize.ends.end_warnings import robust_nodes, scored_nodes, targeted_nodes
from kennfeld.optimize.fit.descent_strategy import DescentSetup
from kennfeld.optimize.limits.projection import leaves_room, missed_limits, project
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Quality
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

UNDERFLOW = 1e-290  # a cost below has lost digits
REACHED = 1e-10  # share of the cost at the start below which a fit is as good as exact
UNDERFLOW_MESSAGE = "The weighted squares of the errors underflow. Use larger weights, a smaller scale or other units."


def check_derivatives(setup: DescentSetup, end: SolverResult, limits: LinearLimits) -> SolverResult:
    """Mark the end as failed if no free value has a derivative there although errors remain.

    Values that are all at bounds, or determined by the limits, may be the best ones.
    """
    if end.status != "converged" or end.cost == 0 or setup.is_global:
        return end
    sloped = setup.objective.sloped(end.values)
    within = (limits.lower < end.values) & (end.values < limits.upper)
    if sloped is None or (sloped & limits.movable).any() or not leaves_room(end.values, limits, within):
        return end
    message = (
        "All derivatives are zero: no free value changes the outputs here. Start from values in the range in which "
        'they have an effect, or search with method = "global".'
    )
    return replace(end, status="failed", message=message)


def check_underflow(problem: Problem, end: SolverResult, before: float, quality: Sequence[Quality]) -> SolverResult:
    """Mark the end as failed if errors remain whose squares underflow, so that the search did not see them."""
    targeted = targeted_nodes(problem)
    training = [row for row in quality if row.use == "training" and row.criterion in targeted]
    # a cost that has fallen far below that of the start is an exact fit, however small its squares are
    hidden = REACHED * before <= end.cost < UNDERFLOW and any(row.max_abs_after > 0 for row in training)
    if end.status != "converged" or not hidden:
        return end
    return replace(end, status="failed", message=UNDERFLOW_MESSAGE)


def with_offsets(compiled: CompiledProblem, end: SolverResult) -> SolverResult:
    """Add a sentence on inputs that vary little about a large number, which makes a descent slow."""
    if end.status != "max_iterations" or compiled.problem.partitions is not None:
        return end
    rows, parts = compiled.kernel.layout.inputs, compiled.samples.inputs.parts
    # the kernel has rows for weight channels as well
    inputs = {name: parts[row] for name, row in rows.items() if name in compiled.problem.model.graph.inputs}
    return replace(end, message=f"{end.message} {describe_offsets(inputs)}".rstrip())


def check_outliers(
    problem: Problem, objective: LeastSquaresObjective, end: SolverResult, quality: Sequence[Quality]
) -> SolverResult:
    """Mark the end as failed if a robust loss of one sample hides those of the others."""
    robust = robust_nodes(problem) & scored_nodes(problem)
    if end.status != "converged" or not robust or problem.partitions is not None:
        return end
    message = describe_outlier(np.square(objective.residual(end.values)), quality, robust)
    return replace(end, status="failed", message=message) if message else end


def with_derivative_fault(setup: DescentSetup, end: SolverResult) -> SolverResult:
    """Add a sentence on the node and the sample whose derivative made the search fail."""
    if end.status != "failed" or not np.isfinite(end.cost) or setup.objective.sloped(end.values) is not None:
        return end
    from kennfeld.optimize.quality.derivative_faults import describe_derivative_fault

    fault = describe_derivative_fault(setup.exact.problem, setup.exact.parameters(end.values))
    return replace(end, message=f"{end.message} {fault}".rstrip())


def with_rejections(setup: DescentSetup, end: SolverResult) -> SolverResult:
    """Add a sentence on the trial values that were rejected."""
    rejected = setup.exact.rejected
    if not rejected.count:
        return end
    from kennfeld.optimize.quality.rejected_steps import RejectionReasons, describe_rejections

    if np.isfinite(end.cost):
        sentence = describe_rejections(setup.exact.problem, rejected, setup.exact.parameters)
    else:
        sentence = f"At these values {RejectionReasons(setup.exact.problem).of(setup.exact.parameters(end.values))}."
    return replace(end, message=f"{end.message} {sentence}")


def within_limits(
    end: SolverResult, limits: LinearLimits, objective: LeastSquaresObjective, tolerance: float
) -> SolverResult:
    """Move the end onto the limits if it violates one; only values that keep all of them have converged."""
    violated = missed_limits(end.values, limits)
    if not violated or not np.isfinite(end.cost):
        return end
    values, _ = project(end.values, limits)
    if values is None:
        return replace(end, status="failed", message=f"{end.message} Violated limits: {violated}.")
    projected = end.moved(values, objective.cost(values))
    # a projection by rounding costs no more than the change that ends a descent
    if end.status != "converged" or projected.cost <= end.cost + tolerance * abs(end.cost):
        return projected
    message = (
        "The search ended outside its limits; the result is the nearest values that keep them, not the best ones. "
        f"Violated: {violated}."
    )
    return replace(projected, status="failed", message=message)
