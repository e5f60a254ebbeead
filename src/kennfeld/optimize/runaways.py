"""Values that a search leads towards infinity, where the function no longer depends on each of them.

A bell `h*exp(-((x - m)/s)^2)` whose place m leaves the data becomes an exponential slope: the farther it goes, the
better it follows the rising side of the data. There is no optimum on that way, only a cost that falls towards a limit,
and the derivatives vanish as at one.
"""

import numpy as np

from kennfeld.arrays import Bool, Float, ignore_floating_errors
from kennfeld.errors import Finding, Location
from kennfeld.formatting import join_names
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective

GROWTH = 1e8  # ratio to the start, or to 1 if that is larger, from which a value may have run away
SAME = 1e-12  # eigenvalue of the scaled J'J of values whose effects are the same, relative to the largest
MOST = 1500  # values whose effects are compared
SHARE = 1e-4  # squared share of a value in such directions
MAX_NAMES = 5  # in a warning
REMEDY = "Set bounds, or start closer to plausible values."


def find_runaways(
    compiled: CompiledProblem, objective: LeastSquaresObjective, start: Float, end: Float
) -> list[Finding]:
    """Return a warning that names the parameters that ran away, if any did.

    They have grown by orders of magnitude, and their effect is that of other values as well. A value with an effect of
    its own is an optimum, however large it is.

    Args:
        compiled: the problem.
        objective: of it.
        start: free values, Float[values].
        end: the same at the end.
    """
    grown = np.abs(end) > GROWTH * np.maximum(np.abs(start), 1.0)
    lost = grown & _replaceable(objective, end) if grown.any() and grown.size <= MOST else grown & False
    if not lost.any():
        return []
    first = {name: compiled.values.offsets[name] for name in compiled.problem.free_names}
    sizes = {name: compiled.problem.parameters[name].size for name in first}
    ran = {n: end[a : a + sizes[n]] for n, a in first.items() if lost[a : a + sizes[n]].any()}
    listed = join_names([f"{name} to {each[np.argmax(np.abs(each))]:.3g}" for name, each in ran.items()], MAX_NAMES)
    where = "where they have no effects of their own" if len(ran) > 1 else "where it has no effect of its own"
    message = f"The search led {listed}, {where}"
    return [Finding(Location(), message, REMEDY, severity="warning")]


def _replaceable(objective: LeastSquaresObjective, values: Float) -> Bool:
    """Mark the values whose effect is that of a combination of others."""
    replaceable = np.zeros(values.size, dtype=bool)
    with ignore_floating_errors():
        matrix = as_array(objective.normal(values)[1])
        units = np.sqrt(matrix.diagonal())
        used = np.flatnonzero(np.isfinite(units) & (units > 0))
        scaled = matrix[np.ix_(used, used)] / np.outer(units[used], units[used])
    if not np.isfinite(scaled).all():
        return replaceable
    sizes, directions = np.linalg.eigh(scaled)
    same = directions[:, sizes <= SAME * sizes.max(initial=0.0)]
    replaceable[used] = np.sum(np.square(same), axis=1) > SHARE
    return replaceable
