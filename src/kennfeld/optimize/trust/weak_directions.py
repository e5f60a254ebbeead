"""Directions that the data determine badly: named ones among few tables first, then whatever else there is.

A direction v is measured by the ratio v'Hv / v'Dv, where D is the diagonal of the data's curvature: what moving along
it costs, against what the values would cost if each moved alone. A change that the data see well has a ratio near 1.

Changes of whole tables that have a name: scaled, raised, stretched, moved along an axis, or like another table.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import Literal

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.trust.block_factor import BlockFactor
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.matrices import Matrix, part
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter

__all__ = ["TableChange", "WeakDirection", "table_changes", "weak_directions"]

Kind = Literal["scale", "offset", "stretch", "shift", "follow"]
FLAT = 1e-9  # relative spread of values from which a table counts as constant

EXACT = 1e-9  # ratio below which the data do not see a direction at all
ROUNDING = 1e-12  # ratio below which one direction is no worse than another
OPEN = 1e-3  # share of a function that undetermined directions change, above rounding
NEAR = (0.05, 0.05, 1e-3)  # ratio below which a named direction of one, two, three tables is badly determined
MOVED = 0.2  # the same for a table shifted along what another one tells: but for the breakpoints, they are one thing
VAGUE = 1e-3  # the same for one without a name, of which there are many
NAMELESS = 2  # directions without a name that are worth a word
SOFT = 0.5  # ratio below which the other values of two tables may adapt to a named direction
ADAPTED = 4  # mixtures of two tables that are tried so
ALIKE = 0.7  # share of an adapted direction that must still be the named one
SIMPLER = 30.0  # times the ratio that a direction of one table less may have
PLAINER = 4.0  # times the ratio that a direction may have that shifts one table less, or lets one less follow another
NEW = 0.2  # share of a named direction that those found before must not span
MOSTLY_NEW = 0.8  # the same for one without a name
RIDGE = 1e-12  # of the diagonal, so that adapted values exist where nothing determines them
MANY = 48  # shapes from which only two are tried together


@dataclass(frozen=True)
class TableChange:
    """A named change of one table, per unit of its amount.

    `scale`: the values themselves; `offset`: ones; `stretch`: the distances from `about`, a value that is held;
    `shift`: what moving the table along axis `axis` by one unit does; `follow`: the values of the table `other`, which
    is looked up at the same place. `fed` are the tables from which the coordinate on a shifted axis comes.
    """

    kind: Kind
    table: str
    change: Float  # of the table's shape
    axis: int = 0
    about: float = 0.0
    other: str = ""
    fed: frozenset[str] = frozenset()


def table_changes(graph: Graph, parameters: ParameterSet, held: Mapping[str, Bool]) -> list[TableChange]:
    """The named changes of the tables in `held`, which marks values that cannot change; those that differ."""
    places = _places(graph)
    found = []
    fed = _fed(graph)
    tables = [name for name in held if parameters[name].kind != "rbf"]  # an expansion is no table
    for name in tables:
        found += _own(parameters[name], held[name], fed.get(name, []))
        for other in tables:
            if other != name and places.get(name) and places.get(name) == places.get(other):
                change = _resampled(parameters[other], parameters[name].index_axes)
                if np.ptp(change) > FLAT * np.abs(change).max():
                    found.append(TableChange("follow", name, change, other=other))
    return found


def _places(graph: Graph) -> Mapping[str, set[tuple[int, ...]]]:
    """The coordinates that each table is looked up with."""
    found: dict[str, set[tuple[int, ...]]] = {}
    for node in graph.nodes:
        if node.op == "lookup" and node.args:
            found.setdefault(node.payload, set()).add(node.args)
    return found


def _fed(graph: Graph) -> Mapping[str, list[frozenset[str]]]:
    """For each axis of each table, the tables that its coordinate depends on within a step."""
    above: list[frozenset[str]] = []
    found: dict[str, list[frozenset[str]]] = {}
    for node in graph.nodes:
        reached = frozenset[str]().union(*(above[at] for at in node.args))
        if node.op == "lookup":
            axes = found.setdefault(node.payload, [frozenset()] * len(node.args))
            found[node.payload] = [a | above[at] for a, at in zip(axes, node.args, strict=True)]
            reached |= {node.payload}
        above.append(reached)
    return found


def _own(table: Parameter, held: Bool, fed: Sequence[frozenset[str]]) -> list[TableChange]:
    values = np.nan_to_num(table.values)
    largest = float(np.abs(values).max())
    found = [TableChange("scale", table.name, values)] if largest > 0 else []
    if not found or float(np.ptp(values)) > FLAT * largest:
        found.append(TableChange("offset", table.name, np.ones(values.shape)))
    about = values[held]
    if about.size and about[0] != 0 and float(np.ptp(about)) <= FLAT * largest:
        found.append(TableChange("stretch", table.name, values - about[0], about=float(about[0])))
    for i, axis in enumerate(table.index_axes):
        if len(axis) > 1:
            slope = np.gradient(values, axis.breakpoints, axis=i)
            if float(np.ptp(slope)) > FLAT * max(float(np.abs(slope).max()), 1e-300):
                found.append(TableChange("shift", table.name, -slope, axis=i, fed=fed[i] if fed else frozenset()))
    return found


def _resampled(table: Parameter, axes: Sequence[Axis]) -> Float:
    """A table's values at the grid points of other axes."""
    values = np.nan_to_num(table.values)
    for i, (own, wanted) in enumerate(zip(table.index_axes, axes, strict=True)):
        weights, _ = cell_weights(position(wanted.breakpoints, own.breakpoints, table.extrapolation), len(own))
        values = np.moveaxis(np.tensordot(weights, values, axes=(1, i)), 0, i)
    return values


@dataclass(frozen=True)
class WeakDirection:
    """A badly determined direction, as a change of all values.

    `weight` is what each value's change does to the data, alone. `amounts` says how much of which shape the direction
    is; empty for one without a name.
    """

    change: Float  # Float[values]
    weight: Float  # Float[values]
    ratio: float  # of data and smoothness together
    seen: float  # of the data alone
    deviation: float  # standard deviation of how far along it the values are, the worse ones given; inf where open
    amounts: tuple[tuple[TableChange, float], ...]

    @property
    def exact(self) -> bool:
        """Whether the data say nothing about it."""
        return self.seen <= EXACT


@dataclass(frozen=True)
class _TrialDirection:
    """A direction over the estimate's values: of shapes in some amounts, or without a name."""

    change: Float
    ratio: float
    seen: float
    shapes: tuple[int, ...] = ()
    amounts: tuple[float, ...] = ()
    score: float = 0.0  # least for the direction that says most with fewest words


def weak_directions(
    estimate: Estimate, shapes: Sequence[TableChange], changes: Float, most: int
) -> list[WeakDirection]:
    """At most so many directions, worst first; `changes` are the shapes as rows over all values."""
    search = _DirectionSearch(estimate, shapes, estimate.narrow(changes))
    found: list[_TrialDirection] = []
    for trial in sorted(search.named(), key=lambda trial: trial.score):
        if len(found) < most and search.news(found, trial.change) > NEW:
            found.append(trial)
    most = min(most, len(found) + NAMELESS)
    for trial in search.others(estimate.spectrum.directions):
        if len(found) == most:
            break
        if search.news(found, trial.change) > MOSTLY_NEW:
            found.append(trial)
    found.sort(key=lambda trial: (_rounded(max(trial.ratio, ROUNDING)), not trial.shapes))
    return [
        WeakDirection(
            change=estimate.expand(trial.change),
            weight=np.abs(estimate.expand(trial.change * search.root)),
            ratio=trial.ratio,
            seen=trial.seen,
            deviation=deviation,
            amounts=tuple((shapes[i], amount) for i, amount in zip(trial.shapes, trial.amounts, strict=True)),
        )
        for trial, deviation in zip(found, search.deviations(found), strict=True)
    ]


def _rounded(ratio: float) -> float:
    """A ratio in so few digits that rounding errors decide no order."""
    return float(f"{ratio:.5e}")


class _DirectionSearch:
    """Ratios of directions, and the shapes among which to look."""

    def __init__(self, estimate: Estimate, shapes: Sequence[TableChange], rows: Float) -> None:
        self.data, self.total = estimate.data, estimate.data + estimate.smoothness
        self.diagonal = np.maximum(self.data.diagonal(), EXACT * self.total.diagonal())
        self.root = np.sqrt(self.diagonal)
        self.covariance = estimate.covariance_of
        self.null, self.scale = estimate.spectrum.null, estimate.spectrum.scale
        length = np.sqrt(np.einsum("ij,j,ij->i", rows, self.diagonal, rows))
        self.numbers: list[int] = np.flatnonzero(length > 0).tolist()
        self.length = length[self.numbers]
        self.rows = rows[self.numbers] / self.length[:, None]
        self.tables = [shapes[i].table for i in self.numbers]
        self.kinds = [shapes[i].kind for i in self.numbers]
        self.fed = [shapes[i].fed for i in self.numbers]
        self.gram, self.whole_gram = (self.rows @ matrix @ self.rows.T for matrix in (self.data, self.total))

    def news(self, known: Sequence[_TrialDirection], change: Float) -> float:
        """The share of a direction that known ones do not span."""
        scaled = change * self.root
        if not known:
            return 1.0
        basis, _ = np.linalg.qr(np.stack([trial.change * self.root for trial in known], axis=1))
        rest = scaled - basis @ (basis.T @ scaled)
        return float(rest @ rest / (scaled @ scaled))

    def deviations(self, trials: Sequence[_TrialDirection]) -> list[float]:
        """Standard deviations of how far along each direction the values are, those before it given.

        How far that is, v'D p / v'D v, is a linear function of the values; what the functions before it tell of its
        variance is taken off by the Cholesky factor of their covariance.
        """
        if not trials:
            return []
        functions = np.stack([trial.change * self.diagonal for trial in trials])
        functions /= np.einsum("ij,ij->i", functions, [trial.change for trial in trials])[:, None]
        open_ones = self._settle(functions)
        covariance = self.covariance(functions)
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        scaled = covariance / np.outer(size, size) + 1e-10 * np.eye(len(trials))
        if not np.isfinite(scaled).all():
            return [float("nan")] * len(trials)
        given: Float = np.where(open_ones, np.inf, np.diag(np.linalg.cholesky(scaled)) * size)
        return [float(deviation) for deviation in given]

    def _settle(self, functions: Float) -> Bool:
        """Which functions are not determined at all; they are taken off those that follow, so that these are, in place.

        The functions that are not become 0.
        """
        basis = self.null / self.scale[:, None]
        found = np.zeros(len(functions), dtype=bool)
        for i, function in enumerate(functions):
            moved = function @ basis
            if np.linalg.norm(moved) > OPEN * np.linalg.norm(function / self.scale):
                found[i] = True
                shares = functions[i + 1 :] @ (basis @ moved) / (moved @ moved)
                functions[i + 1 :] -= np.outer(shares, function)
                functions[i] = 0.0
        return found

    def others(self, directions: Float) -> Iterator[_TrialDirection]:
        """Weak directions without a name."""
        trials = (self._measured(change) for change in directions)
        return (trial for trial in trials if trial.ratio < VAGUE)

    def named(self) -> Iterator[_TrialDirection]:
        """Weak directions of one shape, or of two or three shapes of different tables."""
        for count in range(1, (len(NEAR) if len(self.tables) <= MANY else 2) + 1):
            nearly: dict[tuple[str, ...], list[_TrialDirection]] = {}
            for group, weights in self._soft(count):
                trial = self._mixed(group, weights)
                if trial.seen <= EXACT or trial.ratio < self._near(group):
                    yield trial
                elif count == 2:
                    nearly.setdefault(tuple(self.tables[i] for i in group), []).append(trial)
            for names, trials in nearly.items():
                yield from self._adapted(names, trials)

    def _mixed(self, group: Int, weights: Float) -> _TrialDirection:
        """A mixture of shapes as they are."""
        part = np.ix_(group, group)
        both, data = (float(weights @ gram[part] @ weights) for gram in (self.whole_gram, self.gram))
        return self._trial(weights @ self.rows[group], both, data, group, weights)

    def _measured(
        self, change: Float, group: Sequence[int] | Int = (), weights: Float | None = None
    ) -> _TrialDirection:
        """Any change, perhaps one that began as a mixture of shapes."""
        alone = float(change @ (self.diagonal * change))
        both, data = (float(change @ matrix @ change) / alone for matrix in (self.total, self.data))
        return self._trial(change, both, data, group, np.zeros(0) if weights is None else weights)

    def _trial(
        self, change: Float, ratio: float, seen: float, group: Sequence[int] | Int, weights: Float
    ) -> _TrialDirection:
        shapes = tuple(self.numbers[i] for i in group)
        amounts = tuple(float(weight / self.length[i]) for i, weight in zip(group, weights, strict=True))
        words = SIMPLER ** len(shapes) * PLAINER ** sum(self.kinds[i] in ("follow", "shift") for i in group)
        plain = _rounded(seen) if seen > EXACT else 1e-3 * EXACT
        return _TrialDirection(change, max(ratio, 0.0), max(seen, 0.0), shapes, amounts, plain * words)

    def _near(self, group: Sequence[int] | Int) -> float:
        """The ratio below which a mixture of shapes is worth naming."""
        pairs = permutations(group, 2) if len(group) == 2 else ()
        moved = any(self.kinds[i] == "shift" and self.tables[j] in self.fed[i] and self._raised(j) for i, j in pairs)
        return MOVED if moved else NEAR[len(group) - 1]

    def _raised(self, shape: int) -> bool:
        """Whether a shape changes all values of its table by the same."""
        return self.kinds[shape] == "offset" or np.count_nonzero(self.rows[shape]) == 1

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

    def _adapted(self, names: Sequence[str], trials: Sequence[_TrialDirection]) -> Iterator[_TrialDirection]:
        """The mixtures that are weak once the other values of these tables have adapted.

        That is the change w that minimises w'Hw among those with the same amount w'D s of each shape s of the mixture.
        """
        best = sorted(trials, key=lambda trial: trial.score)[:ADAPTED]
        groups = [np.searchsorted(self.numbers, trial.shapes) for trial in best]
        used = np.unique(np.concatenate(groups))
        where = (self.rows[[table in names for table in self.tables]] != 0).any(axis=0)
        parts = (self.rows[used] * self.diagonal)[:, where]
        reach = _adapted(part(self.total, where), parts.T)
        for trial, group in zip(best, groups, strict=True):
            at = np.searchsorted(used, group)
            weights = np.array(trial.amounts) * self.length[group]
            change = np.zeros(where.size)
            change[where] = reach[:, at] @ np.linalg.solve(parts[at] @ reach[:, at], weights)
            found = self._measured(change, group, weights)
            alike = float(weights @ weights) / float(change @ (self.diagonal * change))
            if found.ratio < self._near(group) and alike > ALIKE:
                yield found


def _adapted(matrix: Matrix, right: Float) -> Float:
    """Solve with a matrix that may be singular."""
    ridge = RIDGE * matrix.diagonal()
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.solve(matrix + np.diag(ridge), right), dtype=np.float64)
    from scipy.sparse import csr_array, diags_array

    return BlockFactor(csr_array(matrix + diags_array(ridge))).solve(right)
