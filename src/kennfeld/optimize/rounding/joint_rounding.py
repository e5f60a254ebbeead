"""Rounding of all values together: nearest planes, repaired where limits require it, and improved by exchange.

Of few values, the best of all is found.
"""

from kennfeld.base.arrays import Bool, Float, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.lattice_exchange import LatticeExchange
from kennfeld.optimize.rounding.exact_search import MOST_VALUES, improve_small
from kennfeld.optimize.rounding.lattice import Lattice, matrix_of
from kennfeld.optimize.rounding.nearest_plane import nearest_planes
from kennfeld.optimize.rounding.repair import repair

SWEEPS = 30  # most passes of the exchange; a few are the rule


@dataclass(frozen=True, eq=False)
class RoundedNumbers:
    """Whole numbers that keep all limits.

    Attributes:
        lattice: the values that could be rounded.
        nearest: each value on its own, moved where limits require it, Float[size].
        joint: candidates for all values together, the best by the quadratic model first.
        moved: the values of `nearest` that limits have moved, Bool[size].
        impossible: values of the lattice given that no storable numbers let keep their limits, Bool[values].
    """

    lattice: Lattice
    nearest: Float
    joint: tuple[Float, ...]
    moved: Bool
    impossible: Bool


def round_values(lattice: Lattice, matrix: Sparse) -> RoundedNumbers:
    """Round the values of a lattice, each on its own and all together.

    Args:
        lattice: the values around the fit.
        matrix: the curvature of the cost, over all free values; sparse, shape (free, free).
    """
    pulled = lattice.pulled(lattice.in_steps(matrix))
    weights = pulled.diagonal()
    nearest, impossible = repair(lattice, lattice.nearest, weights)
    if impossible.any():
        rest = round_values(lattice.without(impossible), matrix)
        every = impossible.copy()
        every[~impossible] = rest.impossible
        return RoundedNumbers(rest.lattice, rest.nearest, rest.joint, rest.moved, every)
    targets = [nearest, *nearest_planes(pulled, lattice.centre, lattice.lower, lattice.upper)]
    starts = [nearest, *(repair(lattice, target, weights).numbers for target in targets[1:])]
    rows = matrix_of(lattice.rows, lattice.size)
    exchange = LatticeExchange(pulled, lattice.lower, lattice.upper, rows, lattice.rows.lower, lattice.rows.upper)
    ends = [exchange.improve(start, lattice.centre, SWEEPS) for start in starts]
    ends.sort(key=lambda end: exchange.cost(end - lattice.centre))
    if 0 < lattice.size <= MOST_VALUES:
        best = improve_small(lattice, pulled.toarray(), ends[0])
        # the same numbers twice would be evaluated twice over the data
        ends[:0] = [best] if best is not ends[0] else []
    return RoundedNumbers(lattice, nearest, tuple(ends), nearest != lattice.nearest, impossible)
