"""Directions that the data determine badly: named ones among few tables first, then whatever else there is.

A direction v is measured by the ratio v'Hv / v'Dv, where D is the diagonal of the data's curvature: what moving along
it costs, against what the values would cost if each moved alone. A change that the data see well has a ratio near 1.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.optimize.trust.estimate import Estimate
from kennfeld.optimize.trust.shapes import Shape

__all__ = ["Weak", "weak_directions"]

EXACT = 1e-9  # ratio below which the data do not see a direction at all
ROUNDING = 1e-13  # ratio below which nothing sees it
NEAR = (0.05, 0.05, 1e-3)  # ratio below which a named direction of one, two, three tables is badly determined
VAGUE = 1e-3  # the same for one without a name, of which there are many
NAMELESS = 4  # directions without a name that are worth a word
SOFT = 0.5  # ratio below which the other values of two tables may adapt to a named direction
ADAPTED = 4  # mixtures of two tables that are tried so
ALIKE = 0.7  # share of an adapted direction that must still be the named one
SIMPLER = 30.0  # times the ratio that a direction of one table less may have
NEW = 0.2  # share of a named direction that those found before must not span
MOSTLY_NEW = 0.8  # the same for one without a name
MANY = 48  # shapes from which only two are tried together


@dataclass(frozen=True)
class Weak:
    """A badly determined direction, as a change of all values.

    `weight` is what each value's change does to the data, alone. `amounts` says how much of which shape the direction
    is; empty for one without a name.
    """

    change: Float  # Float[values]
    weight: Float  # Float[values]
    ratio: float  # of data and smoothness together
    seen: float  # of the data alone
    deviation: float  # how far along the direction the cost rises by its dispersion; inf where it does not rise
    amounts: tuple[tuple[Shape, float], ...]

    @property
    def exact(self) -> bool:
        """Whether the data say nothing about it."""
        return self.seen <= EXACT


@dataclass(frozen=True)
class _Trial:
    """A direction over the estimate's values: of shapes in some amounts, or without a name."""

    change: Float
    ratio: float
    seen: float
    shapes: tuple[int, ...] = ()
    amounts: tuple[float, ...] = ()

    @property
    def score(self) -> float:
        """Least for the direction that says most with fewest tables."""
        return max(self.seen, 1e-3 * EXACT) * SIMPLER ** len(self.amounts)


def weak_directions(estimate: Estimate, shapes: Sequence[Shape], changes: Float, most: int) -> list[Weak]:
    """At most so many directions, worst first; `changes` are the shapes as rows over all values."""
    search = _Search(estimate, [shape.table for shape in shapes], estimate.narrow(changes))
    found: list[_Trial] = []
    for trial in sorted(search.named(), key=lambda trial: trial.score):
        if len(found) < most and search.news(found, trial.change) > NEW:
            found.append(trial)
    most = min(most, len(found) + NAMELESS)
    for trial in search.others(estimate.spectrum.directions):
        if len(found) < most and search.news(found, trial.change) > MOSTLY_NEW:
            found.append(trial)
    return [
        Weak(
            change=estimate.expand(trial.change),
            weight=np.abs(estimate.expand(trial.change * search.root)),
            ratio=trial.ratio,
            seen=trial.seen,
            deviation=search.deviation(trial),
            amounts=tuple((shapes[i], amount) for i, amount in zip(trial.shapes, trial.amounts, strict=True)),
        )
        for trial in sorted(found, key=lambda trial: trial.ratio)
    ]


class _Search:
    """Ratios of directions, and the shapes among which to look."""

    def __init__(self, estimate: Estimate, tables: Sequence[str], rows: Float) -> None:
        self.data, self.total = estimate.data, estimate.data + estimate.smoothness
        self.diagonal = np.maximum(np.diag(self.data), EXACT * np.diag(self.total))
        self.root = np.sqrt(self.diagonal)
        self.dispersion = estimate.dispersion
        length = np.sqrt(np.einsum("ij,j,ij->i", rows, self.diagonal, rows))
        self.numbers = np.flatnonzero(length > 0)
        self.length = length[self.numbers]
        self.rows = rows[self.numbers] / self.length[:, None]
        self.tables = [tables[i] for i in self.numbers]
        self.gram = self.rows @ self.data @ self.rows.T

    def news(self, known: Sequence[_Trial], change: Float) -> float:
        """The share of a direction that known ones do not span."""
        scaled = change * self.root
        if not known:
            return 1.0
        basis, _ = np.linalg.qr(np.stack([trial.change * self.root for trial in known], axis=1))
        rest = scaled - basis @ (basis.T @ scaled)
        return float(rest @ rest / (scaled @ scaled))

    def deviation(self, trial: _Trial) -> float:
        """How far along a direction the cost rises by its dispersion."""
        if trial.ratio <= ROUNDING:
            return float("inf")
        return float(np.sqrt(self.dispersion / (trial.change @ self.total @ trial.change)))

    def others(self, directions: Float) -> Iterator[_Trial]:
        """Weak directions without a name."""
        trials = (self._trial(change) for change in directions)
        return (trial for trial in trials if trial.ratio < VAGUE)

    def named(self) -> Iterator[_Trial]:
        """Weak directions of one shape, or of two or three shapes of different tables."""
        for count in range(1, (len(NEAR) if len(self.tables) <= MANY else 2) + 1):
            nearly: dict[tuple[str, ...], list[_Trial]] = {}
            for group, weights in self._soft(count):
                trial = self._trial(weights @ self.rows[group], group, weights)
                if trial.seen <= EXACT or trial.ratio < NEAR[count - 1]:
                    yield trial
                elif count == 2:
                    nearly.setdefault(tuple(self.tables[i] for i in group), []).append(trial)
            for names, trials in nearly.items():
                yield from self._adapted(names, trials)

    def _trial(self, change: Float, group: Sequence[int] | Int = (), weights: Sequence[float] | Float = ()) -> _Trial:
        alone = float(change @ (self.diagonal * change))
        both, data = (float(change @ matrix @ change) for matrix in (self.total, self.data))
        shapes = tuple(int(self.numbers[i]) for i in group)
        amounts = tuple(float(weight / self.length[i]) for i, weight in zip(group, weights, strict=True))
        return _Trial(change, max(both, 0.0) / alone, max(data, 0.0) / alone, shapes, amounts)

    def _soft(self, count: int) -> Iterator[tuple[Int, Float]]:
        """For each group of shapes the mixture that the data see least, where they see little of it.

        Shapes of different tables are orthogonal, so the ratios are eigenvalues.
        """
        which = combinations(range(len(self.tables)), count)
        groups = np.array([g for g in which if len({self.tables[i] for i in g}) == count], dtype=np.int64)
        groups = groups.reshape(-1, count)
        ratios, vectors = np.linalg.eigh(self.gram[groups[:, :, None], groups[:, None, :]])
        for k in np.flatnonzero(ratios[:, 0] < (SOFT if count == 2 else NEAR[count - 1])):
            yield groups[k], vectors[k][:, 0]

    def _adapted(self, names: Sequence[str], trials: Sequence[_Trial]) -> Iterator[_Trial]:
        """The mixtures that are weak once the other values of these tables have adapted."""
        where = (self.rows[[table in names for table in self.tables]] != 0).any(axis=0)
        inner = self.total[np.ix_(where, where)]
        inner = inner + 1e-12 * np.diag(np.diag(inner))
        for trial in sorted(trials, key=lambda trial: trial.seen)[:ADAPTED]:
            group = [int(np.searchsorted(self.numbers, i)) for i in trial.shapes]
            weights = np.array(trial.amounts) * self.length[group]
            change = self._cheapest(where, inner, group, weights)
            found = self._trial(change, group, weights)
            alone = float(change @ (self.diagonal * change))
            if found.ratio < NEAR[1] and float(weights @ weights) > ALIKE * alone:
                yield found

    def _cheapest(self, where: Bool, inner: Float, group: Sequence[int], weights: Float) -> Float:
        """The change w of some values that minimises w'Hw, given its amount w'D s of each shape s of a group."""
        parts = (self.rows[group] * self.diagonal)[:, where]
        reach = np.linalg.solve(inner, parts.T)
        change = np.zeros(where.size)
        change[where] = reach @ np.linalg.solve(parts @ reach, weights)
        return change
