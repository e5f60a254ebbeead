"""Covariance of the fitted values from the last linearisation.

With H = H_data + S, the curvature of the data and of the smoothness, and M the variance of the gradient over
repetitions of the measurement (M = phi H_data where all samples have one noise), the fitted values scatter with

    scatter = H^-1 M H^-1

That is what repeated measurements would show. It says nothing of what smoothness bends away: a value held by smoothness
alone hardly scatters and may be wrong all the same. So the error of a value is stated as

    error = H^-1 (M + phi S) H^-1        (= phi H^-1 for one noise)

the covariance for which the smoothness is as right on average as its factor claims (G. Wahba: Bayesian confidence
intervals for the cross-validated smoothing spline, J. R. Statist. Soc. B 45, 1983; D. Nychka: Bayesian confidence
intervals for smoothing splines, J. Am. Statist. Assoc. 83, 1988). Without smoothness the two are the same. The noise
comes from the residuals, with n - trace(H^-1 H_data) degrees of freedom.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native import Accumulator
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.output_limits import NearActiveSamples
from kennfeld.optimize.trust.active_limits import ActiveOutputLimits, find_active_output_limits
from kennfeld.optimize.trust.information_matrix import (
    ConstraintElimination,
    Spectrum,
    active_rows,
    held,
    nullity,
    pivots,
    root,
)
from kennfeld.optimize.trust.matrices import Matrix, compressed, part, scaled, whole
from kennfeld.optimize.trust.noise import Group, rescored, variances

__all__ = ["Estimate", "estimate"]

PART = 1e-4  # relative part in undetermined directions that is not rounding

ALONE = SolverSettings(
    max_iterations=20, tolerance=1e-4
)  # of the descent to where the data alone would have the values
Judge = Callable[[Float], list[Group]]  # the groups of residuals at some values


@dataclass(frozen=True)
class Estimate:
    """What is known of the values around the end of a fit.

    Matrices are over the values that can move independently and that data or smoothness inform, sparse where these are
    many. `noise` is M, None where all samples have one noise and it is phi H_data.
    """

    reduction: ConstraintElimination
    seen: Bool  # Bool[independent]: those that the matrices are over
    spectrum: Spectrum
    data: Matrix  # curvature of the data
    smoothness: Matrix  # curvature of the smoothness
    noise: Matrix | None
    dispersion: float  # phi: variance per unit of cost
    groups: tuple[Group, ...]
    variances: tuple[float, ...]  # of psi at weight 1, for each group
    gradient: Float  # half that of the cost
    own: Float  # Float[values]: curvature of the data along each of all values
    informed: Bool  # Bool[values]: those of all values that data or smoothness inform
    pressed: ActiveOutputLimits | None = None  # where limits of outputs are met

    @cached_property
    def error(self) -> Float:
        """Covariance of the values' errors, the smoothness being as wrong as its factor claims."""
        inverse = self.spectrum.inverse.array
        if self.noise is None:
            return self.dispersion * inverse
        found: Float = inverse @ self._claimed @ inverse
        return found

    @cached_property
    def scatter(self) -> Float:
        """Covariance of the values over repeated measurements."""
        inverse = self.spectrum.inverse.array
        found: Float = inverse @ self._noisy @ inverse
        return found

    @property
    def met(self) -> Bool:
        """Which of all values the data inform by themselves."""
        found: Bool = self.own > 0
        return found

    @property
    def distance(self) -> float:
        """How far the linearised cost would still move a value to its least, in standard deviations of that value."""
        step = np.abs(self.spectrum.inverse.times(self.gradient))
        sure = np.sqrt(np.maximum(self._variances(None, error=True), 0.0))
        known = np.isfinite(sure) & (sure > 0) & ~self.spectrum.loose
        return float(np.max(step[known] / sure[known], initial=0.0))

    @property
    def _noisy(self) -> Matrix:
        """The variance of the gradient, M."""
        return self.dispersion * self.data if self.noise is None else self.noise

    @property
    def _claimed(self) -> Matrix:
        """M + phi S: the same, the smoothness being as wrong as its factor claims."""
        return self._noisy + self.dispersion * self.smoothness

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the fit used up, trace(H^-1 H_data)."""
        return self.spectrum.inverse.trace(self.data)

    def expand(self, changes: Float) -> Float:
        """Changes of all values, from those the matrices are over, in the last dimension."""
        independent = np.zeros((*changes.shape[:-1], self.seen.size))
        independent[..., self.seen] = changes
        return self.reduction.expand(independent)

    def narrow(self, changes: Float) -> Float:
        """The part of changes of all values that the matrices are over."""
        found: Float = changes[..., self.reduction.independent[self.seen]]
        return found

    @cached_property
    def undetermined(self) -> Bool:
        """Which of all values nothing determines: not seen at all, or part of a direction that is not."""
        basis = self.spectrum.null / self.spectrum.scale[:, None]
        loose = ~self.seen
        loose[self.seen] = self.spectrum.loose
        found = np.zeros(self.reduction.size, dtype=bool)
        found[self.reduction.independent] = loose
        follow = self.reduction.follow
        known = follow[:, self.seen]
        moved = np.linalg.norm(known @ basis, axis=1) > PART * (np.abs(known) @ np.linalg.norm(basis, axis=1))
        found[self.reduction.dependent] = moved | (follow[:, ~self.seen] != 0).any(axis=1)
        return found

    def open_values(self, preference: Float) -> tuple[Int, Int]:
        """Return the numbers of values that nothing informs, and of a smallest set that determines all others if held.

        `preference` is a factor on the part of each of all values in what is undetermined, see `pivots`.
        """
        independent = self.reduction.independent
        known = independent[self.seen]
        return independent[~self.seen], known[pivots(self.spectrum.null, preference[known])]

    @property
    def by_smoothness(self) -> int:
        """The number of independent changes of values that samples reach which smoothness alone determines."""
        if not self.smoothness.diagonal().any():
            return 0
        met = np.flatnonzero(self.data.diagonal() > 0)
        null = self.spectrum.null[met]
        open_ones = int(np.linalg.matrix_rank(null, tol=PART)) if null.size else 0
        return max(nullity(part(self.data, met)) - open_ones, 0)

    def deviation(self, *, error: bool) -> Float:
        """Standard deviation of all values, of their error or else of their scatter; inf where undetermined."""
        follow = self.reduction.follow[:, self.seen]
        found = np.zeros(self.reduction.size)
        found[self.reduction.independent[self.seen]] = self._variances(None, error=error)
        found[self.reduction.dependent] = self._variances(follow, error=error)
        found[self.undetermined] = np.inf
        deviation: Float = np.sqrt(np.maximum(found, 0.0))
        return deviation

    def _variances(self, functions: Float | None, *, error: bool) -> Float:
        """The variance of linear functions of the values, given as rows; of the values themselves by default."""
        inverse = self.spectrum.inverse
        if error and self.noise is None:
            own = inverse.diagonal if functions is None else (inverse.times(functions) * functions).sum(axis=1)
            return np.asarray(self.dispersion * own, dtype=np.float64)
        matrix = self._claimed if error else self._noisy
        if functions is None:
            return inverse.sandwich(matrix)
        rows = inverse.times(functions)
        return np.asarray((rows @ matrix * rows).sum(axis=1), dtype=np.float64)

    def covariance(self, *, scatter: bool) -> Float:
        """Covariance of all values: of their error, or of their scatter."""
        size = self.seen.size
        independent = np.zeros((size, size))
        independent[np.ix_(self.seen, self.seen)] = self.scatter if scatter else self.error
        found: Float = self.reduction.expand(self.reduction.expand(independent).T)
        return found

    def covariance_of(self, functions: Float) -> Float:
        """Covariance of the errors of linear functions, given as rows over the values the matrices are over."""
        rows = self.spectrum.inverse.times(functions)
        found: Float = self.dispersion * (rows @ functions.T) if self.noise is None else rows @ self._claimed @ rows.T
        return found

    def leverage(self) -> Float:
        """What each of all values takes of the degrees of freedom used: 1 where data alone decide, 0 where they do not.

        The diagonal of R H^-1 R, where R is the symmetric root of H_data in units of its diagonal. It lies between 0
        and 1 and sums up to trace(H^-1 H_data).
        """
        own = np.sqrt(self.data.diagonal())
        met = np.flatnonzero(own > 0)
        half = root(whole(scaled(part(self.data, met), 1 / own[met])))
        parts = np.einsum("ij,ij->i", half @ scaled(part(self.spectrum.inverse.array, met), own[met]), half)
        found = np.zeros(self.reduction.size)
        found[self.reduction.independent[self.seen][met]] = np.clip(parts, 0.0, 1.0)
        return found


def estimate(
    compiled: CompiledProblem,
    limits: LinearLimits,
    values: Float,
    judge: Judge,
    touched: NearActiveSamples | None = None,
) -> Estimate | None:
    """The estimate at the values where a fit ended; None where a derivative of the model is not finite there.

    `touched` are the samples at which limits of outputs are met. What such a limit costs is no noise: where one
    presses, the noise is that at the values which the data alone would have, at the end of a short descent without it.
    """
    groups = judge(values)
    measured = _Measured(compiled, values, groups)
    if not measured.finite:
        return None
    rows = active_rows(limits, values)
    outputs = np.zeros((0, values.size)) if touched is None else touched.rows
    if not np.isfinite(outputs).all():
        return None
    still = held(limits, values, measured.gradient, np.vstack([rows, outputs]))
    found = _reduced(measured, ConstraintElimination.of(still, rows), groups)
    if touched is None or not found.seen.any():
        return found
    beyond = levenberg_marquardt(LeastSquaresObjective(compiled), values, limits, ALONE).values
    found = _reduced(measured, found.reduction, _noisy_as(groups, judge(beyond)))
    moving = found.reduction.rows(outputs)[:, found.seen]
    pressed = find_active_output_limits(touched, moving, found.spectrum.inverse, found.gradient, found.dispersion)
    if not pressed.rows.size:
        return replace(_reduced(measured, found.reduction, groups), pressed=pressed)
    tied = ConstraintElimination.of(still, np.vstack([rows, pressed.rows]))
    return replace(_reduced(measured, tied, found.groups, found.variances), pressed=pressed)


def _noisy_as(known: Sequence[Group], found: Sequence[Group]) -> Sequence[Group]:
    """Groups with the noise of others, where these are of the same samples."""
    if [group.count for group in known] != [group.count for group in found]:
        return known
    pairs = zip(known, found, strict=True)
    return [replace(group, squares=other.squares, persistence=other.persistence) for group, other in pairs]


def _reduced(
    measured: "_Measured", reduction: ConstraintElimination, groups: Sequence[Group], known: Sequence[float] = ()
) -> Estimate:
    """The estimate for the values that move independently, with the noise of the groups, or a known one."""
    data, smoothness = reduction.matrix(measured.data), reduction.matrix(measured.smoothness)
    seen = data.diagonal() + smoothness.diagonal() > 0
    data, smoothness = part(data, seen), part(smoothness, seen)
    each = [data] if len(groups) == 1 else [part(reduction.matrix(m), seen) for m in measured.parts]
    if measured.rows is not None:
        spectrum = Spectrum.of_rows(reduction.rows(measured.rows)[:, seen])
    elif isinstance(data, np.ndarray):
        spectrum = Spectrum.of_matrix(data + smoothness)
    else:
        spectrum = Spectrum.of_sparse(data + smoothness, sum(map(abs, each), abs(data) + abs(smoothness)))
    used = [spectrum.inverse.trace(one) for one in each]
    found = known or variances(groups, used)
    shares = [float(np.divide(g.score * v * g.persistence, g.slope)) for g, v in zip(groups, found, strict=True)]
    dispersion = float(np.dot(shares, used)) / sum(used) if sum(used) > 0 else float("nan")
    noise = None
    if len(groups) > 1:
        noise = sum(share * one for share, one in zip(shares, each, strict=True))
    return Estimate(
        reduction=reduction,
        seen=seen,
        spectrum=spectrum,
        data=data,
        smoothness=smoothness,
        noise=noise,
        dispersion=dispersion,
        groups=tuple(groups),
        variances=tuple(found),
        gradient=reduction.vector(measured.gradient)[seen],
        own=measured.data.diagonal(),
        informed=measured.data.diagonal() + measured.smoothness.diagonal() > 0,
    )


class _Measured:
    """Curvatures over all free values, with the slopes of robust losses in place of their weights."""

    def __init__(self, compiled: CompiledProblem, values: Float, groups: Sequence[Group]) -> None:
        self._compiled, self._groups = compiled, groups
        self._full = self.whole(values)
        objective = LeastSquaresObjective(compiled)
        self.gradient = objective.normal(values)[0].copy()
        self._faint = objective.faint(values)
        smoothness = np.zeros((values.size, values.size))
        compiled.roughness.add(values, np.zeros(values.size), smoothness)
        self.rows: Float | None = None
        self._sparse = False
        accumulator = self._bread()
        if objective.small:
            _, jacobian = accumulator.rows(self._full)
            jacobian[:, self._faint] = 0.0
            data = jacobian.T @ jacobian
            self.rows = np.vstack([jacobian, compiled.roughness.rows(values)[1]])
        else:
            data = self._matrix(accumulator)
            self._sparse = compressed(data, smoothness)
        self.data, self.smoothness = self._kept(data), self._kept(smoothness)

    def whole(self, values: Float) -> Float:
        """The free values and behind them the fixed ones."""
        found = self._compiled.start.copy()
        found[: values.size] = values
        return found

    def _bread(self) -> Accumulator:
        if all(group.slope == group.weight for group in self._groups):
            return self._compiled.accumulator
        return self._rescored(self._groups)

    def _rescored(self, groups: Sequence[Group]) -> Accumulator:
        factors = {group: float(np.divide(group.slope, group.weight)) for group in groups}
        return Accumulator(self._compiled.kernel, rescored(self._compiled, factors))

    @property
    def finite(self) -> bool:
        """Whether the model has derivatives there."""
        entries = self.data.data if self._sparse else self.data
        return bool(np.isfinite(entries).all() and np.isfinite(self.gradient).all())

    def _matrix(self, accumulator: Accumulator) -> Float:
        """The curvature of some data; it holds until the next call."""
        matrix = accumulator.normal(self._full).matrix
        matrix[self._faint, :] = 0.0
        matrix[:, self._faint] = 0.0
        return matrix

    def _kept(self, matrix: Float) -> Matrix:
        """The matrix in memory of its own, sparse where all of them are."""
        if not self._sparse:
            return matrix.copy()
        from scipy.sparse import csr_array

        return csr_array(matrix)

    @cached_property
    def parts(self) -> list[Matrix]:
        """The curvature of each group's data."""
        return [self._kept(self._matrix(self._rescored([group]))) for group in self._groups]
