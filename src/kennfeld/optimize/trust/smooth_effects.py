"""Persistence of the errors of a fit whose values have effects that vary slowly over time.

A fit removes from its residuals what its values can reproduce. If their effects vary slowly, that is most of what lasts
in the errors, and both their variance and their persistence look smaller than they are. The projection onto the
effects is P = J H^-1 J'; the mean of its elements k samples apart, relative to the diagonal, is estimated at a few lags
from the rows of some samples.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.trust.information_matrix import ConstraintElimination
from kennfeld.optimize.trust.inverse import Inverse
from kennfeld.optimize.trust.noise import Group
from kennfeld.optimize.trust.persistence import Correlation

MIN_PERSISTENCE = 1.1  # from which effects are looked at
MIN_LEFT = 0.25  # share of the samples that counts as left by the fit, at least
LAGS = 6  # at which they are compared
SAMPLES, MAX_ENTRIES = 300, 4_000_000  # compared at each lag; entries of the rows of all of them


def with_smooth_effects(
    compiled: CompiledProblem,
    full: Float,
    groups: Sequence[Group],
    used: Sequence[float],
    narrow: tuple[ConstraintElimination, Int, Inverse],
) -> list[Group]:
    """Raise the persistence of each group by what the fit took from its errors.

    The variance of independent errors is that of n - p, of p fitted values. If each takes as much as v independent
    errors, it is that of n - p v; the persistence is larger by the ratio of both.

    Args:
        compiled: the problem that was fitted.
        full: its values, the free followed by the fixed ones.
        groups: the groups of residuals.
        used: degrees of freedom that the fit used in each.
        narrow: reduction to independent values, the numbers of those with an effect, and the inverse over them.
    """
    lasting = [group.correlation.window for group in groups if _lasts(group)]
    if not lasting or not narrow[1].size:
        return list(groups)
    smooth = _smooth_share(compiled, full, max(int(max(lasting)) // 2, 1), narrow)
    return [_raised(g, own, smooth) if smooth > 0 and _lasts(g) else g for g, own in zip(groups, used, strict=True)]


def _lasts(group: Group) -> bool:
    return group.persistence > MIN_PERSISTENCE and group.correlation.window > 1


def _raised(group: Group, used: float, smooth: float) -> Group:
    persistence = max(group.correlation.inflation(group.count, max(used, 1.0), smooth), group.persistence)
    # v = 1 + smooth (persistence - 1): with smooth effects, each value takes the variance of that many errors
    freedom = group.count - used * (1 + smooth * (persistence - 1))
    ratio = (group.count - used) / max(freedom, MIN_LEFT * group.count)
    # without its correlation, a group is not raised again
    return replace(group, persistence=persistence * max(ratio, 1.0), correlation=Correlation())


def _smooth_share(
    compiled: CompiledProblem, full: Float, reach: int, narrow: tuple[ConstraintElimination, Int, Inverse]
) -> float:
    """Return the mean element of P up to `reach` samples from the diagonal, relative to the diagonal; from 0 to 1."""
    reduction, seen, inverse = narrow
    partitions = compiled.problem.partitions
    width = len(compiled.kernel.outputs) * compiled.values.free
    # rows are dense: samples, lags, outputs, values
    count = int(min(SAMPLES, MAX_ENTRIES // ((LAGS + 1) * width)))
    lags = np.unique(np.linspace(0, reach, LAGS + 1).astype(np.int64))
    products = np.zeros(lags.size)
    for rows, places in compiled.each(
        _lagged_rows, full, count // len(partitions.training) if partitions else count, lags
    ):
        if rows.size:
            # P between two samples is the product j H^-1 j' of their rows, summed over the outputs
            own = reduction.rows(rows.reshape(-1, rows.shape[-1]))[:, seen].reshape(*rows.shape[:2], -1)
            here = own[places[0]]
            reached = inverse.times(here.reshape(-1, here.shape[-1])).reshape(here.shape)
            products += [np.sum(reached * own[each]) for each in places]
    if not products[0] > 0:
        return 0.0
    # the mean over all lags from the products at few of them
    return float(np.clip(np.trapezoid(products / products[0], lags) / lags[-1], 0.0, 1.0))


def _lagged_rows(compiled: CompiledProblem, full: Float, count: int, lags: Int) -> tuple[Float, Int]:
    """Return the rows of J at some samples, and at each lag after them, of one partition.

    Returns:
        Float[different samples, outputs, values], and their numbers among these, Int[lags, samples].
    """
    firsts, visits = _visits(compiled, count, lags)
    if not firsts.size:
        return np.zeros((0, 0, 0)), visits
    needed = np.unique(visits)
    return compiled.sums.rows_at(full, needed), np.searchsorted(needed, visits)


def _visits(compiled: CompiledProblem, count: int, lags: Int) -> tuple[Int, Int]:
    """Return the visits of some samples, and of those at each lag after them in the same piece, Int[lags, samples]."""
    samples = compiled.samples
    total, order = samples.count, samples.order
    chosen = np.linspace(0, total - 1, min(max(count, 1), total)).astype(np.int64)
    if order is None:
        firsts = chosen
        visits = np.where(firsts + lags[:, None] < total, firsts + lags[:, None], -1)
    else:
        # neighbours in time are not neighbours in the order of visits; -1 for samples that are not visited, and for the
        # last entry, which stands for all samples beyond the end
        visit_of = np.full(int(order.max(initial=0)) + 2, -1, dtype=np.int32)
        visit_of[order] = np.arange(total, dtype=np.int32)
        firsts = np.sort(order)[chosen].astype(np.int64)
        visits = visit_of[np.minimum(firsts + lags[:, None], visit_of.size - 1)].astype(np.int64)
    begins = np.sort([piece.first for piece in samples.pieces])
    # a lag does not reach into the next piece
    piece = np.searchsorted(begins, visits, side="right")
    inside = (visits >= 0).all(axis=0) & (piece == piece[0]).all(axis=0)
    return firsts[inside], visits[:, inside]
