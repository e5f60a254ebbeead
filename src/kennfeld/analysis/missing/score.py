"""TermScore test: what each candidate would take off the cost, from one linearisation of the function.

With r the residuals, J their slopes by the free values, B those by the values of a candidate, W the weights and R the
roughness, the least cost of the linearised problem with the candidate is lower than that without it by

    gain = g' S^-1 g,    S = B'WB - B'WJ H^-1 J'WB,    g = B'Wr - B'WJ H^-1 (J'Wr + R p),    H = J'WJ + R

(C. R. Rao: Large sample tests of statistical hypotheses concerning several parameters with applications to problems of
estimation, Proc. Camb. Phil. Soc. 44, 1948). For a function that is linear in its values, this is the gain of a fit.
The free values are those that no lock, bound, pin or limit holds; H is factored once.

Without a missing term, gain / (dispersion * columns) follows an F distribution. Errors in time are correlated, and so
is the product of a column with them. The dispersion of a candidate is therefore that of the sums of these products over
blocks of the recordings (K.-Y. Liang, S. Zeger: Longitudinal data analysis using generalized linear models, Biometrika
73, 1986), and at least that of independent errors.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from kennfeld.analysis.missing.candidate_sums import BlockSums, FamilySums
from kennfeld.analysis.missing.f_distribution import detected_noncentrality, f_tail
from kennfeld.analysis.missing.families import Family
from kennfeld.analysis.missing.terms import MissingTerm
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.cholesky import Factor
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.information_matrix import ConstraintElimination
from kennfeld.optimize.trust.pressing_limits import TouchedLimits

SINGULAR = 1e-10  # of a unit diagonal: what a value must add to be no combination of the others
EXPLAINED = 1e-4  # of its own square: what the function leaves of a column that it can produce itself
FEWEST_BLOCKS = 8  # from which the dispersion follows from blocks
FEWEST_FREEDOM = 4.0  # of a dispersion; with less, almost nothing would be significant
MAX_SPECTRUM = 2000  # values up to which undetermined directions are found by eigenvalues
POWER = 0.9  # of the test of the effect that is called detectable


@dataclass(frozen=True)
class TermScore:
    """The reduction of the cost by a candidate.

    Attributes:
        term: the candidate.
        gain: reduction of the cost of the linearised problem.
        columns: independent columns of the candidate.
        dispersion: variance of a residual as it acts on this candidate.
        predicted: the cost of the data alone with the candidate.
        p: probability of a gain at least as large without a missing term.
        curvature: mean curvature of the cost by the values of a curve.
        whole: reduction of the cost by a term without a value of its own, such as a delay; the gain is that of a
            multiple of it.
        idle: numbers of the values of a map that can stay as they are, as the function can take over their effect.
    """

    term: MissingTerm
    gain: float
    columns: int
    dispersion: float
    predicted: float
    p: float
    curvature: float = 0.0
    whole: float | None = None
    idle: tuple[int, ...] = ()

    @property
    def merit(self) -> float:
        """The gain less twice what chance gains on average (H. Akaike, 1974)."""
        return (self.gain if self.whole is None else self.whole) - 2 * self.columns * self.dispersion


class Linearisation:
    """The function at its values: its free values, their curvature, and the gradient.

    Args:
        compiled: the problem with probes.
        full: free and fixed values, Float[values].
        sums: over the samples by block.
        probes: names of the probes.
    """

    def __init__(self, compiled: CompiledProblem, full: Float, sums: BlockSums, probes: Sequence[str]) -> None:
        free = compiled.values.free
        objective = LeastSquaresObjective(compiled, by_rows=False)
        gradient, matrix = objective.normal(full[:free])
        curvature = np.array(as_array(matrix))
        gradient = np.array(gradient)
        self.cost = float(sums.cost.sum())
        self.count = float(sums.counts.sum())
        self.sums = sums
        limits = linear_limits(compiled.problem, compiled.values)
        touched = TouchedLimits.of(limits, full[:free], np.diag(curvature))
        fixed = touched.fixed | ~(np.diag(curvature) > 0)
        fixed[[compiled.values.offsets[name] for name in probes]] = True
        self._reduction = ConstraintElimination.of(fixed, touched.all_rows)
        self._curvature = self._reduced_matrix(curvature)
        self._gradient = self._reduction.vector(gradient)
        self._data_gradient = self._reduction.vector(sums.jr.sum(axis=0))
        self._rough_gradient = self._gradient - self._data_gradient
        rough = np.zeros((free, free))
        compiled.roughness.add(full[:free], np.zeros(free), rough)
        self._roughness = self._reduced_matrix(rough)
        self._is_rough = bool(self._roughness.any() or self._rough_gradient.any())
        self._whitening, self.rank = _whitening(self._curvature)
        self._pull = self._whitening @ self._gradient
        self._block_pulls = self._whitening @ self._reduction.rows(sums.jr[:-1]).T if self.blocks else None

    def _reduced_matrix(self, matrix: Float) -> Float:
        return np.asarray(self._reduction.matrix(matrix))

    @property
    def blocks(self) -> int:
        """Number of blocks from which the dispersion follows; 0 if these are too few."""
        blocks = int(np.count_nonzero(self.sums.counts[:-1]))
        return blocks if blocks >= FEWEST_BLOCKS else 0

    @cached_property
    def own_gain(self) -> float:
        """The reduction of the cost by the values themselves if the search went on."""
        return float(self._pull @ self._pull)

    @cached_property
    def variance(self) -> float:
        """The variance of independent residuals."""
        return max(self.sums.spread - self.own_gain, 0.0) / max(self.count - self.rank, 1.0)

    def scores(self, family: Family, sums: FamilySums) -> Iterator[TermScore]:
        """Yield the scores of the candidates of a family; none for those that the function can produce itself."""
        white = self._whitening @ self._reduction.rows(sums.jb.T).T
        br = sums.br.sum(axis=0)
        factors = len(family.factors)
        first = 0
        for axis, hats in enumerate(family.hats):
            for at in range(factors):
                columns = first * factors + at + factors * np.arange(hats)
                score = self._score(
                    family.terms[at][axis],
                    white[:, columns],
                    br[columns],
                    sums.br[:, columns],
                    sums.squares[at][axis],
                )
                if score is not None:
                    yield score
            first += hats

    def _score(self, term: MissingTerm, white: Float, br: Float, by_block: Float, each: Float) -> TermScore | None:
        squares = each.sum(axis=0)
        own = np.diag(squares)
        if not (np.isfinite(squares).all() and own.max(initial=0.0) > 0):
            return None
        # in units of the columns, so that hats with few samples keep their digits
        unit = 1 / np.sqrt(np.where(own > 0, own, np.inf))
        left = (squares - white.T @ white) * unit * unit[:, None]
        sizes, vectors = np.linalg.eigh(0.5 * (left + left.T))
        kept = sizes > EXPLAINED
        if not kept.any():
            return None
        # directions T in which the columns are independent and of unit size: T'S T = 1
        directions = unit[:, None] * vectors[:, kept] / np.sqrt(sizes[kept])
        pull = directions.T @ (br - white.T @ self._pull)
        gain, columns = float(pull @ pull), int(kept.sum())
        scatter = None
        if self._block_pulls is not None:
            pulls = directions.T @ (by_block[:-1].T - white.T @ self._block_pulls)
            scatter = pulls, directions.T @ each[:-1] @ directions
        # the sum of all columns, in the coordinates of the directions
        constant = np.sqrt(sizes[kept]) * (vectors[:, kept].T @ np.sqrt(np.maximum(own, 0.0)))
        p, dispersion = self._significance(pull, constant / np.sqrt(squares.sum()), scatter)
        if not dispersion > 0:
            return None
        step = -directions @ pull
        predicted = self.cost - self.own_gain - gain - self._rougher(white, step)
        whole = None
        if term.kind == "delay":
            # the change of the cost by the column q times, 2 g q + S q^2, at q = 1
            size = 1 / directions[0, 0]
            whole = -float(2 * size * pull[0] + size**2)
            predicted = self.cost - self.own_gain - whole - self._rougher(white, np.ones(1))
        idle = _idle_values(left, term, columns) if term.second_breakpoints else ()
        return TermScore(term, gain, columns, dispersion, predicted, p, float(own.mean()), whole, idle)

    def _significance(self, pull: Float, constant: Float, scatter: tuple[Float, Float] | None) -> tuple[float, float]:
        """Return the probability of a gain at least as large without a missing term, and the dispersion.

        What a constant at the node explains is the same for all channels, and its errors vary as slowly as the
        function, however fast the channel: it is tested apart from the shape of the curve.

        Args:
            pull: of each direction, Float[directions].
            constant: the part of a constant that the function cannot produce itself, of the length 1 if that is all,
                Float[directions].
            scatter: the pulls by block, Float[directions, blocks], and the squares, Float[blocks, directions,
                directions]; None without blocks.
        """
        size = float(np.linalg.norm(constant))
        if len(pull) == 1 or size**2 < EXPLAINED:
            return self._tested(np.eye(len(pull)), pull, scatter)
        basis, _ = np.linalg.qr(constant[:, None] / size, mode="complete")
        shape, dispersion = self._tested(basis[:, 1:], pull, scatter)
        level, _ = self._tested(basis[:, :1], pull, scatter)
        return min(2 * min(shape, level), 1.0), dispersion

    def _tested(self, basis: Float, pull: Float, scatter: tuple[Float, Float] | None) -> tuple[float, float]:
        """Return what `_significance` returns, of a part of the directions, Float[directions, part]."""
        own, columns = basis.T @ pull, basis.shape[1]
        dispersion, freedom, alike = self.variance, max(self.count - self.rank - columns, 1.0), float(columns)
        if scatter is not None:
            pulls, squares = scatter
            spread, own_freedom, alike = self._spread(basis.T @ pulls, basis.T @ squares @ basis)
            if own_freedom < FEWEST_FREEDOM:
                return 1.0, max(spread, dispersion)
            dispersion, freedom = max(spread, dispersion), min(own_freedom, freedom)
        if not dispersion > 0:
            return 1.0, 0.0
        return f_tail(float(own @ own) / dispersion / columns, alike, freedom), dispersion

    def _spread(self, pulls: Float, squares: Float) -> tuple[float, float, float]:
        """Return the dispersion from the sums over blocks, its degrees of freedom, and those of the gain.

        Args:
            pulls: of each direction by block, Float[directions, blocks].
            squares: of the columns in these directions by block, Float[blocks, directions, directions].
        """
        used = self.sums.counts[:-1] > 0
        # what a missing term adds to a block is no noise: the part of the whole that the columns have in it
        sizes, vectors = np.linalg.eigh(squares.sum(axis=0))
        root = (vectors / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1]))) @ vectors.T
        shares = (root @ squares @ root)[used]
        rest = pulls[:, used] - (shares @ pulls.sum(axis=1)).T
        # with independent blocks of covariance dispersion * S, what is left has dispersion * (S - S S): a column that
        # few blocks have leaves little (F. E. Satterthwaite, Biometrics Bulletin 2, 1946)
        remaining = shares - shares @ shares
        expected = float(np.trace(remaining, axis1=1, axis2=2).sum())
        freedom = expected**2 / max(float((remaining**2).sum()), 1e-300)
        # directions share one dispersion, but are not independent
        freedom = freedom / 2 if len(pulls) > 1 else freedom - 1
        share = self.sums.counts[:-1].sum() / self.count
        return float((rest**2).sum()) / max(expected, 1e-300) / share, freedom, _equal_directions(rest)

    def _rougher(self, white: Float, step: Float) -> float:
        """Return by how much the roughness changes with the step of a candidate and that of the values with it."""
        if not self._is_rough:
            return 0.0
        values = self._whitening.T @ -(self._pull + white @ step)
        return float(values @ (2 * self._rough_gradient + self._roughness @ values))


def _idle_values(left: Float, term: MissingTerm, columns: int) -> tuple[int, ...]:
    """Return the numbers of the values of a map without which the others explain as much.

    A function that has a curve of the first channel can take over what the map says at one place of the second one, for
    all of the first, and so on: the middle lines of the map, or its middle value, can stay as they are.

    Args:
        left: what the function leaves of the products of the columns, in their units; Float[values, values].
        term: the map.
        columns: independent ones.
    """
    shape = len(term.breakpoints), len(term.second_breakpoints)
    numbers = np.arange(shape[0] * shape[1]).reshape(shape)
    row, column = numbers[shape[0] // 2], numbers[:, shape[1] // 2]
    for idle in (np.union1d(row, column), row, column, np.intersect1d(row, column)):
        others = np.setdiff1d(numbers, idle)
        if others.size and int((np.linalg.eigvalsh(left[np.ix_(others, others)]) > EXPLAINED).sum()) == columns:
            return tuple(idle.tolist())
    return ()


def _equal_directions(pulls: Float) -> float:
    """Return how many directions of equal dispersion scatter as these do, from 1 to their number.

    The straight part of a curve of a slow channel is slower than its bends, and a gain along it is larger by chance
    (G. E. P. Box, Annals of Mathematical Statistics 25, 1954).

    Args:
        pulls: by block, Float[directions, blocks].
    """
    directions, blocks = pulls.shape
    covariance = pulls @ pulls.T
    whole, squares = float(np.trace(covariance)), float((covariance**2).sum())
    # less what the few blocks add to the squares by chance
    squares = max((squares - whole**2 / blocks) / (1 + 1 / blocks), whole**2 / directions)
    return max(whole**2 / squares, 1.0) if squares > 0 else float(directions)


def _whitening(matrix: Float) -> tuple[Float, int]:
    """Return T with T'T = H^-1, Float[directions, values], and the number of directions that H determines."""
    if not len(matrix):
        return np.zeros((0, 0)), 0
    scale = 1 / np.sqrt(np.diag(matrix))
    units = matrix * scale * scale[:, None]
    try:
        lower = np.linalg.cholesky(units)
        sound = np.diag(lower).min() ** 2 > SINGULAR
    except np.linalg.LinAlgError:
        sound = False
    if not sound and len(matrix) <= MAX_SPECTRUM:
        sizes, vectors = np.linalg.eigh(units)
        kept = sizes > SINGULAR * sizes[-1]
        return (vectors[:, kept] / np.sqrt(sizes[kept])).T * scale, int(kept.sum())
    if not sound:
        lower = np.linalg.cholesky(units + 1e-9 * np.eye(len(units)))
    # the rows of diag(scale), solved one by one, are the columns of T
    return Factor.of(np.asarray(lower, dtype=np.float64)).solve_lower(np.diag(scale))[:, : len(matrix)].T, len(matrix)


def detected_gain(dispersion: float, columns: int, freedom: float, level: float) -> float:
    """Return the gain of a true effect that is significant at a level with the probability `POWER`."""
    return dispersion * detected_noncentrality(level, POWER, columns, freedom)
