"""Directions that the data determine poorly: combinations of simple table changes first, then any others.

A direction v is rated by v'Hv / v'Dv, where D is the diagonal of the curvature of the data: the cost of moving along
it, relative to the cost if each value moved alone. A well-determined direction has a ratio near 1. The simple changes
of a table are scaling, an offset, stretching, a shift along an axis, and a multiple of another table.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, permutations

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.selected_inverse import SparseFactor
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.matrices import Matrix, part
from kennfeld.optimize.trust.table_changes import EXACT, TableChange, WeakDirection

ROUNDING = 1e-12  # ratio below which differences are rounding
OPEN = 1e-3  # share of a function that undetermined directions change, above rounding
MAX_RATIOS = (0.05, 0.05, 1e-3)  # of poorly determined combinations of one, two, three table changes
MAX_SHIFT_RATIO = 0.2  # the same for a table shifted along the output of another one, almost the same change
MAX_OTHER_RATIO = 1e-3  # the same for directions that are no combination of table changes
MAX_OTHERS = 2  # such directions in a result
MAX_ADAPTABLE_RATIO = 0.5  # below which the other values of two tables may adapt to a combination
MAX_ADAPTED = 4  # combinations of two tables that are tried so
MIN_SIMILARITY = 0.7  # share of an adapted direction that must still be the combination
SIMPLER = 30.0  # times the ratio that a direction of one table less may have
PLAINER = 4.0  # times the ratio that a direction may have that shifts one table less, or lets one less follow another
MIN_NEW_SHARE = 0.2  # of a combination, outside the span of the directions before it
MIN_NEW_SHARE_OTHERS = 0.8  # the same for other directions
RIDGE = 1e-9  # of the diagonal: undetermined values adapt as little as possible, far above rounding errors
MANY = 48  # table changes from which only two are combined


@dataclass(frozen=True)
class _TrialDirection:
    """A direction over the values of the estimate: a combination of table changes, or another direction."""

    change: Float
    ratio: float
    seen: float
    shapes: tuple[int, ...] = ()
    amounts: tuple[float, ...] = ()
    score: float = 0.0  # lower for poorly determined directions with a short description


def weak_directions(
    estimate: Estimate, shapes: Sequence[TableChange], changes: Float, most: int
) -> list[WeakDirection]:
    """Find at most `most` poorly determined directions, worst first.

    Args:
        estimate: curvatures and covariance around the end of a fit.
        shapes: simple table changes.
        changes: the same as rows over all values; shape (table changes, values).
        most: maximum number of directions.
    """
    search = _DirectionSearch(estimate, shapes, estimate.narrow(changes))
    trials: list[_TrialDirection] = []

    def take(candidates: Iterable[_TrialDirection], least: float, count: int) -> None:
        for trial in candidates:
            if count and len(trials) < most and search.new_share(trials, trial.change) > least:
                trials.append(trial)
                count -= 1

    named = sorted(search.named(), key=lambda trial: trial.score)
    # what the data do not see at all comes first, as later directions are rated by what they add
    exact = [trial for trial in named if trial.seen <= EXACT]
    directions = estimate.spectrum.directions
    undetermined = min(estimate.spectrum.null.shape[1], len(directions))
    take(exact, MIN_NEW_SHARE, most)
    # a combination that is merely near an undetermined direction would not say what has no effect
    take(map(search.rate, directions[:undetermined]), MIN_NEW_SHARE_OTHERS, MAX_OTHERS)
    take([trial for trial in named if trial.seen > EXACT], MIN_NEW_SHARE, most)
    take(search.others(directions[undetermined:]), MIN_NEW_SHARE_OTHERS, MAX_OTHERS)
    smoothed = bool(estimate.smoothness.diagonal().any())
    # of equal ratios, one that consists of table changes comes first
    trials.sort(key=lambda trial: (_rounded(max(trial.ratio, ROUNDING)), not trial.shapes))
    return [
        WeakDirection(
            change=estimate.expand(trial.change),
            weight=np.abs(estimate.expand(trial.change * search.root)),
            ratio=trial.ratio,
            seen=trial.seen,
            deviation=deviation,
            amounts=tuple((shapes[i], amount) for i, amount in zip(trial.shapes, trial.amounts, strict=True)),
            smoothed=smoothed,
        )
        for trial, deviation in zip(trials, search.deviations(trials), strict=True)
    ]


def _rounded(ratio: float) -> float:
    """Round a ratio to so few digits that rounding errors decide no order."""
    return float(f"{ratio:.5e}")


class _DirectionSearch:
    """Search for directions of low ratio among combinations of table changes."""

    def __init__(self, estimate: Estimate, shapes: Sequence[TableChange], rows: Float) -> None:
        self.data, self.total = estimate.data, estimate.data + estimate.smoothness
        # values without data still count a little, so that a change of them has a length
        self.diagonal = np.maximum(self.data.diagonal(), EXACT * self.total.diagonal())
        self.root = np.sqrt(self.diagonal)
        self.covariance = estimate.covariance_of
        self.null, self.scale = estimate.spectrum.null, estimate.spectrum.scale
        # sqrt(v'D v), by which changes are scaled: their ratio is then v'H v, the diagonal of `whole_gram`
        length = np.sqrt(np.einsum("ij,j,ij->i", rows, self.diagonal, rows))
        self.numbers: list[int] = np.flatnonzero(length > 0).tolist()
        self.length = length[self.numbers]
        self.rows = rows[self.numbers] / self.length[:, None]
        self.tables = [shapes[i].table for i in self.numbers]
        self.kinds = [shapes[i].kind for i in self.numbers]
        self.fed = [shapes[i].fed for i in self.numbers]
        single = np.count_nonzero(self.rows, axis=1) == 1
        # changes that are the same for all values of a table
        self.raised = [kind == "offset" or bool(lone) for kind, lone in zip(self.kinds, single, strict=True)]
        self.gram, self.whole_gram = (self.rows @ matrix @ self.rows.T for matrix in (self.data, self.total))

    def new_share(self, known: Sequence[_TrialDirection], change: Float) -> float:
        """Return the share of a direction outside the span of known ones."""
        scaled = change * self.root
        if not known:
            return 1.0
        basis, _ = np.linalg.qr(np.stack([trial.change * self.root for trial in known], axis=1))
        rest = scaled - basis @ (basis.T @ scaled)
        return float(rest @ rest / (scaled @ scaled))

    def deviations(self, trials: Sequence[_TrialDirection]) -> list[float]:
        """Return the standard deviation along each direction, conditional on those before it.

        The amount of a direction, v'D p / v'D v, is a linear function of the values. The diagonal of the Cholesky
        factor of the covariance of these functions is their conditional standard deviation.
        """
        if not trials:
            return []
        # as rows v'D / v'D v
        functions = np.stack([trial.change * self.diagonal for trial in trials])
        functions /= np.einsum("ij,ij->i", functions, [trial.change for trial in trials])[:, None]
        undetermined = self._settle(functions)
        covariance = self.covariance(functions)
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        # a correlation matrix, as deviations differ by powers of ten; the ridge gives equal functions a factor
        scaled = covariance / np.outer(size, size) + 1e-10 * np.eye(len(trials))
        if not np.isfinite(scaled).all():
            return [float("nan")] * len(trials)
        deviations: list[float] = np.where(undetermined, np.inf, np.diag(np.linalg.cholesky(scaled)) * size).tolist()
        return deviations

    def _settle(self, functions: Float) -> Bool:
        """Mark undetermined functions, set them to 0, and subtract them from those that follow, in place."""
        basis = self.null / self.scale[:, None]
        undetermined = np.zeros(len(functions), dtype=bool)
        for i, function in enumerate(functions):
            moved = function @ basis
            if np.linalg.norm(moved) > OPEN * np.linalg.norm(function / self.scale):
                undetermined[i] = True
                # conditional on it: what follows must not move along the null direction of this function
                shares = functions[i + 1 :] @ (basis @ moved) / (moved @ moved)
                functions[i + 1 :] -= np.outer(shares, function)
                functions[i] = 0.0
        return undetermined

    def others(self, directions: Float) -> Iterator[_TrialDirection]:
        """Return poorly determined directions that are no combination of table changes."""
        return (trial for trial in map(self.rate, directions) if trial.ratio < MAX_OTHER_RATIO)

    def named(self) -> Iterator[_TrialDirection]:
        """Return poorly determined combinations of one to three changes of different tables."""
        for count in range(1, (len(MAX_RATIOS) if len(self.tables) <= MANY else 2) + 1):
            nearly: dict[tuple[str, ...], list[_TrialDirection]] = {}
            for group, weights in self._soft_combinations(count):
                own = np.ix_(group, group)
                both, data = (float(weights @ gram[own] @ weights) for gram in (self.whole_gram, self.gram))
                trial = self._trial(weights @ self.rows[group], both, data, group, weights)
                if trial.seen <= EXACT or trial.ratio < self._max_ratio(group):
                    yield trial
                elif count == 2:
                    nearly.setdefault(tuple(self.tables[i] for i in group), []).append(trial)
            # two tables may be poorly determined only once their other values adapt
            for names, trials in nearly.items():
                yield from self._adapt(names, trials)

    def rate(self, change: Float, group: Sequence[int] | Int = (), weights: Float | None = None) -> _TrialDirection:
        """Rate any change, perhaps one adapted from a combination of table changes."""
        alone = float(change @ (self.diagonal * change))
        both, data = (float(change @ matrix @ change) / alone for matrix in (self.total, self.data))
        return self._trial(change, both, data, group, np.zeros(0) if weights is None else weights)

    def _trial(
        self, change: Float, ratio: float, seen: float, group: Sequence[int] | Int, weights: Float
    ) -> _TrialDirection:
        shapes = tuple(self.numbers[i] for i in group)
        amounts = tuple(float(weight / self.length[i]) for i, weight in zip(group, weights, strict=True))
        # the ratio times a penalty for each table, and for the kinds that are harder to grasp; below EXACT, the ratio
        # is rounding and only the penalty counts
        words = SIMPLER ** len(shapes) * PLAINER ** sum(self.kinds[i] in ("follow", "shift") for i in group)
        plain = _rounded(seen) if seen > EXACT else 1e-3 * EXACT
        return _TrialDirection(change, max(ratio, 0.0), max(seen, 0.0), shapes, amounts, plain * words)

    def _max_ratio(self, group: Sequence[int] | Int) -> float:
        """Return the ratio below which a combination counts as poorly determined."""
        pairs = permutations(group, 2) if len(group) == 2 else ()
        # raising the table from which another one gets its coordinate, and shifting that one by as much
        moved = any(self.kinds[i] == "shift" and self.tables[j] in self.fed[i] and self.raised[j] for i, j in pairs)
        return MAX_SHIFT_RATIO if moved else MAX_RATIOS[len(group) - 1]

    def _soft_combinations(self, count: int) -> Iterator[tuple[Int, Float]]:
        """Return for each group of table changes the combination of lowest ratio, if that is low.

        Changes of different tables are orthogonal, so the ratios are eigenvalues.
        """
        groups = self._groups(count)
        ratios, vectors = np.linalg.eigh(self.gram[groups[:, :, None], groups[:, None, :]])
        for k in np.flatnonzero(ratios[:, 0] < (MAX_ADAPTABLE_RATIO if count == 2 else MAX_RATIOS[count - 1])):
            yield groups[k], vectors[k][:, 0]

    def _groups(self, count: int) -> Int:
        """Return groups of table changes of different tables; pairs only if they act on the same data."""
        if count == 2:
            number = np.unique(self.tables, return_inverse=True)[1]
            apart = number[:, None] != number
            return np.argwhere(np.triu(apart & (np.abs(self.gram) > ROUNDING), 1))
        which = combinations(range(len(self.tables)), count)
        groups = [g for g in which if len({self.tables[i] for i in g}) == count]
        return np.array(groups, dtype=np.int64).reshape(-1, count)

    def _adapt(self, names: Sequence[str], trials: Sequence[_TrialDirection]) -> Iterator[_TrialDirection]:
        """Return the combinations that are poorly determined once the other values of these tables adapt.

        The adapted change w minimises w'Hw for the same amount w'D s of each table change s of the combination.
        """
        best = sorted(trials, key=lambda trial: trial.score)[:MAX_ADAPTED]
        groups = [np.searchsorted(self.numbers, trial.shapes) for trial in best]
        used = np.unique(np.concatenate(groups))
        where = (self.rows[[table in names for table in self.tables]] != 0).any(axis=0)
        parts = (self.rows[used] * self.diagonal)[:, where]
        # w = H^-1 P' (P H^-1 P')^-1 a minimises w'Hw with P w = a, for the rows P = s'D and the amounts a
        reach = solve_singular(part(self.total, where), parts.T)
        for trial, group in zip(best, groups, strict=True):
            at = np.searchsorted(used, group)
            weights = np.array(trial.amounts) * self.length[group]
            change = np.zeros(where.size)
            change[where] = reach[:, at] @ np.linalg.solve(parts[at] @ reach[:, at], weights)
            adapted = self.rate(change, group, weights)
            # squares of the lengths by D, in which the combination consists of orthonormal rows
            similarity = float(weights @ weights) / float(change @ (self.diagonal * change))
            if adapted.ratio < self._max_ratio(group) and similarity > MIN_SIMILARITY:
                yield adapted


def solve_singular(matrix: Matrix, right: Float) -> Float:
    """Solve M x = right, [values, values] and Float[values, ...], with a matrix that may be singular."""
    ridge = RIDGE * matrix.diagonal()
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.solve(matrix + np.diag(ridge), right), dtype=np.float64)
    from scipy.sparse import csr_array, diags_array

    return SparseFactor(csr_array(matrix + diags_array(ridge))).solve(right)
