"""Values at a kink of the function, such as a at 0 in `abs(a)*x`: the cost rises to both sides of them.

Their derivative is that of one side. It asks for a step on which the cost rises, and the shorter steps that remain
hold all other values as well. A descent goes on if these values are held instead.
"""

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

BESIDE = (1e-8, 1e-6), (1e-6, 1e-4), (1e-4, 1e-2)  # distances that are compared, relative to the size of a value
SLOPED = 1e-3  # cosine between residuals and a column of J from which a value should have moved
CURVED = 1e3  # ratio of rises at both distances: 100 at a kink, 10 000 at a smooth minimum
MOST = 64  # values that are looked at
MAX_NAMES = 5  # in a warning


def values_at_kinks(objective: LeastSquaresObjective, values: Float, start: Float, limits: LinearLimits) -> Bool:
    """Mark the values with a slope beside which the cost rises to both sides in proportion to the distance.

    Args:
        objective: a small problem, whose Jacobian is at hand.
        values: the end of a descent, Float[values].
        start: of it; gives sizes to values at 0.
        limits: only values that may move are looked at.
    """
    marks = np.zeros(values.size, dtype=bool)
    cost = objective.cost(values)
    residual, jacobian = objective.rows(values)
    with np.errstate(all="ignore"):
        cosines = np.abs(jacobian.T @ residual) / np.sqrt(np.sum(np.square(jacobian), axis=0) * cost)
    sloped = np.flatnonzero(limits.movable & (cosines > SLOPED))
    for place in sloped[np.argsort(-cosines[sloped], kind="stable")][:MOST].tolist():
        # a value at 0 has the size of its start
        size = max(abs(values[place]), abs(start[place]) or 1.0)
        sides = np.array([-size, size])
        marks[place] = any(_rises(objective, values, cost, place, np.outer(pair, sides)) for pair in BESIDE)
    return marks


def _rises(objective: LeastSquaresObjective, values: Float, cost: float, place: int, steps: Float) -> bool:
    """Return if the cost rises with steps of a value, Float[distances, sides], as it does beside a kink."""

    def rise(step: float) -> float:
        trial = values.copy()
        trial[place] += step
        return float(objective.cost(trial) - cost)

    for near, far in steps.T.tolist():  # a cost may be a pass over all partitions, so the first that falls is enough
        beside = rise(near)
        # a side where the model fails holds the value as a rise does
        if np.isfinite(beside) and not (beside > 0 and rise(far) < CURVED * beside):
            return False
    return True


def find_kinks(compiled: CompiledProblem, marks: Bool) -> list[Finding]:
    """Return a warning that names the parameters with values at kinks, if there are any."""
    problem, offsets = compiled.problem, compiled.values.offsets
    names = [n for n in problem.free_names if marks[offsets[n] :][: problem.parameters[n].size].any()]
    if not names:
        return []
    message = (
        f"{join_names(names, MAX_NAMES)} ended at a kink of the function, such as that of abs or max: the cost rises "
        "to both sides, and the deviation is that of one of them"
    )
    remedy = "Set a bound there, or write the function without the kink."
    return [Finding(Location.of_file(problem.model.source), message, remedy, severity="warning")]
