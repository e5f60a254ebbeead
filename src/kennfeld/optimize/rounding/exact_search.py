"""The best whole numbers of a small lattice, by trying all that may be better than the best ones so far.

With H = L L', the cost of whole numbers z about c is |L'(z - c)|^2, a sum with a term for each value. From the last
value to the first one, all partial sums below the cost of the best numbers so far are continued (U. Fincke, M. Pohst:
Improved methods for calculating vectors of short length in a lattice, Math. Comp. 44, 1985).
"""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.optimize.rounding.lattice import Lattice, violated_rows

MOST_VALUES = 24
MOST_PATHS = 20_000  # partial sums side by side, beyond which the search is given up
LEAST_GAIN = 1e-9  # relative, of a cost that counts as lower


def improve_small(lattice: Lattice, matrix: Float, numbers: Float) -> Float:
    """Return the best whole numbers, Float[size], if they are found and better than some, else these.

    Args:
        lattice: the values, with bounds and rows.
        matrix: positive definite, in steps; Float[size, size].
        numbers: whole numbers that keep all limits, Float[size].
    """
    order = np.argsort(matrix.diagonal(), kind="stable")
    offset = numbers - lattice.centre
    bound = (1 - LEAST_GAIN) * float(offset @ matrix @ offset)
    own = matrix[np.ix_(order, order)]
    factor = np.asarray(np.linalg.cholesky(own), dtype=np.float64)
    limits = [side[order] for side in (lattice.lower, lattice.upper)]
    paths = _paths_below(factor, lattice.centre[order], limits, bound)
    if paths is None or not len(paths):
        return numbers
    candidates = np.empty_like(paths)
    candidates[:, order] = paths
    offsets = candidates - lattice.centre
    costs = np.einsum("ki,ij,kj->k", offsets, matrix, offsets, optimize=True)
    ranked = (candidates[at] for at in np.argsort(costs, kind="stable"))
    return next((each for each in ranked if not violated_rows(lattice, each).any()), numbers)


def _paths_below(factor: Float, centre: Float, limits: list[Float], bound: float) -> Float | None:
    """Return all whole numbers with a cost below a bound, Float[paths, size]; None if there are too many."""
    size = centre.size
    paths, costs = np.zeros((1, size)), np.zeros(1)
    for i in range(size - 1, -1, -1):
        behind = (paths[:, i + 1 :] - centre[i + 1 :]) @ factor[i + 1 :, i]
        best = centre[i] - behind / factor[i, i]
        reach = np.sqrt(np.maximum(bound - costs, 0.0)) / factor[i, i]
        low = np.maximum(np.ceil(best - reach), limits[0][i])
        counts = np.maximum(np.minimum(np.floor(best + reach), limits[1][i]) - low + 1, 0).astype(np.int64)
        if counts.sum() > MOST_PATHS:
            return None
        parents = np.repeat(np.arange(len(paths)), counts)
        steps = np.arange(parents.size) - np.repeat(np.cumsum(counts) - counts, counts)
        paths = paths[parents]
        paths[:, i] = low[parents] + steps
        costs = costs[parents] + np.square((paths[:, i] - best[parents]) * factor[i, i])
    return paths
