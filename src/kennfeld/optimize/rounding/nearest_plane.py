"""Nearest plane: round one value after the other, each about the best one that the rounded ones leave.

With H = L L', the cost of a rounding d is |L'd|^2. From the last value in the order of the factor to the first one,
the best value of d[i], given those behind it, is -(sum over j > i of L[j,i] d[j]) / L[i,i]; it is rounded, and its
rounding error is what the values before it make up for (L. Babai, On Lovasz' lattice reduction and the nearest lattice
point problem, Combinatorica 6, 1986). Values with a large effect come last in the order and are rounded first, so that
weaker ones, whose rounding costs less, compensate for them.
"""

from collections.abc import Iterator

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.native.cholesky import Factor
from kennfeld.native.envelope import BLOCK, Envelope, first_blocks, places_of, sparse_orders
from kennfeld.native.symmetric import scaled

MOST_WORK = 3e6  # of an order that is not chosen for its few non-zeros: 0.2 s
MAX_PATHS = 16  # roundings that are kept side by side
CONTINUED = 3  # the cheapest of them, which exchange may lead to different ends
WORK_OF_PATHS = 8000  # values times these roundings: of many values there is one


def nearest_planes(matrix: Sparse, centre: Float, lower: Float, upper: Float) -> Iterator[Float]:
    """Yield roundings, Float[size], a few for each order of the values.

    Args:
        matrix: positive definite, in steps; sparse, shape (size, size).
        centre: the real numbers, Float[size].
        lower: least whole numbers, Float[size].
        upper: largest whole numbers, Float[size].
    """
    if not centre.size:
        return
    for envelope in _envelopes(matrix):
        factor = Factor.empty(envelope)
        blocks = scaled(matrix, np.ones(centre.size))
        if factor.load_blocks(blocks, np.zeros(centre.size)) and factor.factor():  # type: ignore[arg-type]
            yield from _substitute(factor, centre, lower, upper)


def _envelopes(matrix: Sparse) -> Iterator[Envelope]:
    """Yield the order by effect and the given one if they are affordable, else one with few non-zeros."""
    entries = matrix.tocoo()
    diagonal = matrix.diagonal()
    orders = [np.argsort(diagonal, kind="stable"), np.arange(diagonal.size)]
    envelopes = [_envelope(order, entries.row, entries.col) for order in orders]
    affordable = [envelope for envelope in envelopes if envelope.work <= MOST_WORK]
    if affordable:
        yield from affordable
        return
    sparse = [_envelope(order, entries.row, entries.col) for order in sparse_orders(matrix)]
    yield min([*envelopes, *sparse], key=lambda envelope: envelope.work)


def _envelope(order: Int, rows: Int, columns: Int) -> Envelope:
    return Envelope(order, first_blocks(places_of(order), rows, columns, BLOCK))


def _substitute(factor: Factor, centre: Float, lower: Float, upper: Float) -> Float:
    """Round by back substitution: each value near the best one, given those rounded before; Float[roundings, size].

    The cheapest few roundings of the values behind are kept, each continued by its three nearest numbers (the
    M-algorithm, J. Anderson, S. Mohan: Sequential Coding Algorithms, 1984). A single one is Babai's.
    """
    envelope, order = factor.envelope, factor.envelope.order
    start, first = envelope.start, envelope.first
    here, low, high = centre[order], lower[order], upper[order]
    most = int(np.clip(WORK_OF_PATHS // order.size, 1, MAX_PATHS))
    # one row for each rounding that is kept
    best, numbers, costs = here[None].copy(), np.empty((1, order.size)), np.zeros(1)
    for i in range(order.size - 1, -1, -1):
        block, lane = divmod(i, BLOCK)
        nearest = np.minimum(np.maximum(np.rint(best[:, i]), low[i]), high[i])
        if most > 1:
            beside = np.where(best[:, i] >= nearest, 1.0, -1.0)
            chosen = np.stack([nearest, nearest + beside, nearest - beside])
            total = costs + np.square((chosen - best[:, i]) / factor.inverse[i])
            total[(chosen < low[i]) | (chosen > high[i])] = np.inf
            # stable, so that of equal costs the nearest number comes first
            kept = np.argsort(total, axis=None, kind="stable")[: min(most, int(np.isfinite(total).sum()))]
            parents, costs, nearest = kept % costs.size, total.ravel()[kept], chosen.ravel()[kept]
            best, numbers = best[parents], numbers[parents]
        numbers[:, i] = nearest
        left = first[block] * BLOCK
        # row i of L, stored with a stride of a block: the columns from the first one of its envelope to i - 1
        row = factor.panels[start[block] + BLOCK * left + lane : start[block] + BLOCK * i + lane : BLOCK]
        best[:, left:i] -= (nearest - here[i])[:, None] * (row * factor.inverse[left:i])
    best_paths = np.argsort(costs, kind="stable")[:CONTINUED]
    results = np.empty((best_paths.size, order.size))
    results[:, order] = numbers[best_paths]
    return results
