"""Covariance of the fitted values from the last linearisation.

With H = H_data + S, the curvatures of data and smoothness, and M the variance of the gradient over repeated
measurements (M = phi H_data if all samples have the same noise), the fitted values scatter with the covariance

    scatter = H^-1 M H^-1

which repeated measurements would show. It does not contain the bias from smoothness: a value determined by smoothness
alone hardly scatters, but may be wrong. The error of a value is therefore stated as

    error = H^-1 (M + phi S) H^-1        (= phi H^-1 for one noise)

the covariance if the smoothness is, on average, as correct as its factor implies (G. Wahba: Bayesian confidence
intervals for the cross-validated smoothing spline, J. R. Statist. Soc. B 45, 1983; D. Nychka: Bayesian confidence
intervals for smoothing splines, J. Am. Statist. Assoc. 83, 1988). Without smoothness both are equal. The noise is
estimated from the residuals, with n - trace(H^-1 H_data) degrees of freedom.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.symmetric import SymmetricMatrix, as_array, as_sparse, zero, zeros_like
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.limit_excess import NearActiveSamples
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.sums.sums import Sums
from kennfeld.optimize.trust.active_limits import ActiveOutputLimits, find_active_output_limits, multipliers
from kennfeld.optimize.trust.information_matrix import (
    ConstraintElimination,
    Spectrum,
    nullity,
    pivots,
    root,
)
from kennfeld.optimize.trust.inverse import Inverse
from kennfeld.optimize.trust.matrices import Matrix, part, rescale, should_be_sparse, whole
from kennfeld.optimize.trust.noise import Group, rescore, variances
from kennfeld.optimize.trust.pressing_limits import TouchedLimits
from kennfeld.optimize.trust.smooth_effects import with_smooth_effects
from kennfeld.optimize.trust.variance_power import Variance

PART_TOLERANCE = 1e-4  # relative part in undetermined directions that exceeds rounding
# of the descent to the values that fit the data without output limits
DATA_ONLY = SolverSettings(max_iterations=20, tolerance=1e-4)
Judge = Callable[[Float], list[Group]]  # returns the groups of residuals at some values


@dataclass(frozen=True)
class Estimate:
    """Covariance and related quantities of the values around the end of a fit.

    Matrices are over the independent values that data or smoothness determine, and sparse if these are many. `noise` is
    M, or None if all samples have the same noise and M = phi H_data.
    """

    reduction: ConstraintElimination
    seen: Bool  # Bool[independent]: those that the matrices are over
    spectrum: Spectrum
    data: Matrix  # curvature of the data
    smoothness: Matrix  # curvature of the smoothness
    noise: Matrix | None
    dispersion: float  # phi: variance per unit of cost
    groups: tuple[Group, ...]
    variances: tuple[Variance, ...]  # of psi, for each group
    gradient: Float  # half that of the cost
    own: Float  # Float[values]: curvature of the data along each of all values
    informed: Bool  # Bool[values]: those of all values that data or smoothness inform
    pressed: ActiveOutputLimits | None = None  # where limits of outputs are met

    @property
    def distance(self) -> float:
        """Largest step of a value to the minimum of the linearised cost, in standard deviations of that value."""
        step = np.abs(self.spectrum.inverse.times(self.gradient))
        # values without a deviation of their own, held or undetermined, have no distance in units of it
        sure = np.sqrt(np.maximum(self._error_variances, 0.0))
        known = np.isfinite(sure) & (sure > 0) & ~self.spectrum.loose
        return float(np.max(step[known] / sure[known], initial=0.0))

    @property
    def _noisy(self) -> Matrix:
        """M, the variance of the gradient."""
        return self.dispersion * self.data if self.noise is None else self.noise

    @property
    def _claimed(self) -> Matrix:
        """M + phi S."""
        return self._noisy + self.dispersion * self.smoothness

    @property
    def freedom(self) -> float:
        """Degrees of freedom used by the fit, trace(H^-1 H_data)."""
        return self.spectrum.inverse.trace(self.data)

    def expand(self, changes: Float) -> Float:
        """Expand changes of the values that the matrices are over, Float[..., seen], to those of all values."""
        independent = np.zeros((*changes.shape[:-1], self.seen.size))
        independent[..., self.seen] = changes
        return self.reduction.expand(independent)

    def narrow(self, changes: Float) -> Float:
        """Select the part of changes of all values, Float[..., values], that the matrices are over."""
        return changes[..., self.reduction.independent[self.seen]]

    @cached_property
    def undetermined(self) -> Bool:
        """Mask of the values that nothing determines, alone or in combination with others, Bool[values]."""
        # from the units of the spectrum to those of the values
        basis = self.spectrum.null / self.spectrum.scale[:, None]
        loose = ~self.seen
        loose[self.seen] = self.spectrum.loose
        undetermined = np.zeros(self.reduction.size, dtype=bool)
        undetermined[self.reduction.independent] = loose
        follow = self.reduction.follow
        known = follow[:, self.seen]
        # a dependent value is undetermined if null directions move it by more than rounding of those that it follows
        moved = np.linalg.norm(known @ basis, axis=1) > PART_TOLERANCE * (np.abs(known) @ np.linalg.norm(basis, axis=1))
        undetermined[self.reduction.dependent] = moved | (follow[:, ~self.seen] != 0).any(axis=1)
        return undetermined

    def open_values(self, preference: Float) -> tuple[Int, Int]:
        """Return the numbers of values without information, and a smallest set that determines all others if fixed.

        `preference` weights the part of each value in the undetermined directions, see `pivots`.
        """
        independent = self.reduction.independent
        known = independent[self.seen]
        return independent[~self.seen], known[pivots(self.spectrum.null, preference[known])]

    @property
    def by_smoothness(self) -> int:
        """Number of directions determined by smoothness alone, among values that influence the data."""
        if not self.smoothness.diagonal().any():
            return 0
        met = np.flatnonzero(self.data.diagonal() > 0)
        # null directions of the data alone, less those that smoothness leaves open as well
        null = self.spectrum.null[met]
        undetermined = int(np.linalg.matrix_rank(null, tol=PART_TOLERANCE)) if null.size else 0
        return max(nullity(part(self.data, met)) - undetermined, 0)

    def deviation(self, *, error: bool) -> Float:
        """Compute standard deviations of the error or of the scatter, Float[values]; inf for undetermined values."""
        inverse, follow = self.spectrum.inverse, self.reduction.follow[:, self.seen]
        # a dependent value is f'q of the independent ones q: phi f'H^-1 f for one noise, else f'H^-1 (M + phi S) H^-1 f
        rows = inverse.times(follow)
        variances = np.zeros(self.reduction.size)
        if error and self.noise is None:
            dependent = self.dispersion * (rows * follow).sum(axis=1)
        else:
            dependent = (rows @ (self._claimed if error else self._noisy) * rows).sum(axis=1)
        own = self._error_variances if error else inverse.sandwich(self._noisy)
        variances[self.reduction.independent[self.seen]] = own
        variances[self.reduction.dependent] = np.where(follow.any(axis=1), dependent, 0.0)  # even if the noise is NaN
        variances[self.undetermined] = np.inf
        return np.sqrt(np.maximum(variances, 0.0))

    @cached_property
    def _error_variances(self) -> Float:
        inverse = self.spectrum.inverse
        return self.dispersion * inverse.diagonal if self.noise is None else inverse.sandwich(self._claimed)

    def covariance(self, *, scatter: bool) -> Float:
        """Compute the covariance matrix of the scatter or of the error of all values, shape (values, values)."""
        inverse = self.spectrum.inverse.array
        if scatter or self.noise is not None:
            known = inverse @ (self._noisy if scatter else self._claimed) @ inverse
        else:
            known = self.dispersion * inverse
        return self.expand(self.expand(known).T)

    def covariance_of(self, functions: Float) -> Float:
        """Compute the covariance, Float[functions, functions], of the errors of linear functions of the values.

        The functions are rows over the values of the matrices, Float[functions, seen values].
        """
        rows = self.spectrum.inverse.times(functions)
        if self.noise is None:
            return np.asarray(self.dispersion * (rows @ functions.T))
        return np.asarray(rows @ self._claimed @ rows.T)

    def leverage(self) -> Float:
        """Compute the share of each value in the degrees of freedom, Float[values]: 1 if the data alone determine it.

        It is the diagonal of R H^-1 R, where R is the symmetric root of H_data in units of its diagonal. It lies
        between 0 and 1, and its sum is trace(H^-1 H_data).
        """
        own = np.sqrt(self.data.diagonal())
        met = np.flatnonzero(own > 0)
        # a diagonal of 1 keeps digits of the root where the units of values differ by powers of ten
        half = root(whole(rescale(part(self.data, met), 1 / own[met])))
        parts = np.einsum("ij,ij->i", half @ rescale(part(self.spectrum.inverse.array, met), own[met]), half)
        leverage = np.zeros(self.reduction.size)
        leverage[self.reduction.independent[self.seen][met]] = np.clip(parts, 0.0, 1.0)
        return leverage


def estimate(
    compiled: CompiledProblem,
    limits: LinearLimits,
    values: Float,
    judge: Judge,
    touched: NearActiveSamples | None = None,
) -> Estimate | None:
    """Compute the estimate at the end of a fit; None if a derivative of the model is not finite there.

    Residuals that an active output limit causes are not noise. If `touched` has samples at which limits are reached,
    the noise is therefore taken from the end of a short descent without the limits.

    Args:
        compiled: the compiled problem.
        limits: bounds and linear limits of the free values.
        values: the free values at the end of the fit, each in its own unit; shape (values,).
        judge: returns the groups of residuals at some values.
        touched: samples at which limits of outputs are reached.
    """
    groups = judge(values)
    measured = _Measured(compiled, values, groups)
    if not measured.finite:
        return None
    outputs = np.zeros((0, values.size)) if touched is None else touched.rows
    if not np.isfinite(outputs).all():
        return None
    held, local = _within(TouchedLimits.of(limits, values, measured.curvature), measured, groups, touched)
    if touched is None or not local.seen.any():
        return local
    # a descent, as one step is too short for a curved function
    without_limits = levenberg_marquardt(measured.objective, values, limits, DATA_ONLY).values
    local = _estimate(measured, local.reduction, _with_noise_of(groups, judge(without_limits)))
    moving = local.reduction.rows(outputs)[:, local.seen]
    pressed = find_active_output_limits(touched, moving, local.spectrum.inverse, local.gradient, local.dispersion)
    # limits that are reached but determine nothing leave the residuals as they are
    if not pressed.rows.size:
        return replace(_estimate(measured, local.reduction, groups), pressed=pressed)
    tied = ConstraintElimination.of(held.fixed, np.vstack([held.all_rows, pressed.rows]))
    return replace(_estimate(measured, tied, local.groups, local.variances), pressed=pressed)


def _within(
    limits: TouchedLimits, measured: "_Measured", groups: Sequence[Group], touched: NearActiveSamples | None
) -> tuple[TouchedLimits, Estimate]:
    """Return the bounds and rows that press, and the estimate within them."""
    local = _estimate(measured, ConstraintElimination.of(limits.fixed, limits.all_rows), groups)
    if not limits.count():
        return limits, local
    gradient = measured.gradient
    # limits of outputs push as well: without their multipliers, bounds would seem to press against them
    if touched is not None and local.seen.any():
        gradient = gradient + _output_multipliers(touched, local) @ touched.rows
    # multipliers are those at the minimum of the linearised cost, which the search need not have reached exactly
    step = local.expand(-local.spectrum.inverse.times(local.reduction.vector(gradient)[local.seen]))
    gradient = gradient + measured.data @ step + measured.smoothness @ step
    pressing = limits.pressing(gradient, measured.curvature, measured.cost)
    if pressing.count() == limits.count():
        return limits, local
    return pressing, _estimate(measured, ConstraintElimination.of(pressing.fixed, pressing.all_rows), groups)


def _output_multipliers(touched: NearActiveSamples, local: Estimate) -> Float:
    """Return the multiplier of each sample at which a limit of outputs is reached, at the linearised minimum."""
    rows = local.reduction.rows(touched.rows)[:, local.seen]
    inverse = local.spectrum.inverse
    return multipliers(inverse.times(rows) @ rows.T, touched.excess - rows @ inverse.times(local.gradient))


def _with_noise_of(groups: Sequence[Group], others: Sequence[Group]) -> Sequence[Group]:
    """Return groups with the noise of others, if these are of the same samples."""
    # at other values the model may be undefined at some samples
    if [group.count for group in groups] != [group.count for group in others]:
        return groups
    pairs = zip(groups, others, strict=True)
    return [_with_residuals_of(group, other) for group, other in pairs]


def _with_residuals_of(group: Group, other: Group) -> Group:
    return replace(
        group,
        squares_by_exponent=other.squares_by_exponent,
        persistence=other.persistence,
        correlation=other.correlation,
    )


def _estimate(
    measured: "_Measured", reduction: ConstraintElimination, groups: Sequence[Group], known: Sequence[Variance] = ()
) -> Estimate:
    """Return the estimate for the independent values, with the noise of the groups or with known variances."""
    data, smoothness = reduction.matrix(measured.data), reduction.matrix(measured.smoothness)
    seen = data.diagonal() + smoothness.diagonal() > 0
    data, smoothness = part(data, seen), part(smoothness, seen)
    each = [data] if len(groups) == 1 else [part(reduction.matrix(m), seen) for m in measured.parts]
    if measured.rows is not None:
        spectrum = Spectrum.of_rows(reduction.rows(measured.rows)[:, seen])
    elif isinstance(data, np.ndarray):
        spectrum = Spectrum.of_matrix(data + smoothness)
    else:
        # absolute values, so that non-zeros of different matrices do not cancel in the pattern
        spectrum = Spectrum.of_sparse(data + smoothness, sum(map(abs, each), abs(data) + abs(smoothness)))
    used = [spectrum.inverse.trace(matrix) for matrix in each]
    groups = measured.with_smooth_effects(groups, used, (reduction, np.flatnonzero(seen), spectrum.inverse))
    by_group = known or variances(groups, used)
    shares = [noise_share(group, variance) for group, variance in zip(groups, by_group, strict=True)]
    # if limits determine all values, the noise is still known
    weights = used if sum(used) > 0 else [float(group.count) for group in groups]
    dispersion = float(np.dot(shares, weights)) / sum(weights) if sum(weights) > 0 else float("nan")
    noise = None
    # with the exponent 1, or equal weights, the variance of a group's gradient is a multiple of its curvature
    if len(groups) > 1 and any(g.varies and v.exponent < 1 for g, v in zip(groups, by_group, strict=True)):
        noise = part(reduction.matrix(measured.noise(groups, by_group)), seen)
        dispersion = spectrum.inverse.trace(noise) / sum(used) if sum(used) > 0 else dispersion
    elif len(groups) > 1:
        noise = sum(share * matrix for share, matrix in zip(shares, each, strict=True))
    return Estimate(
        reduction=reduction,
        seen=seen,
        spectrum=spectrum,
        data=data,
        smoothness=smoothness,
        noise=noise,
        dispersion=dispersion,
        groups=tuple(groups),
        variances=tuple(by_group),
        gradient=reduction.vector(measured.gradient)[seen],
        own=measured.data.diagonal(),
        informed=measured.curvature > 0,
    )


def noise_share(group: Group, variance: Variance) -> float:
    """Return the variance of the gradient per curvature, both by samples of the typical weight of a group."""
    # gradient: s w psi j, with the variance (s w)^2 v w^-g times the persistence; curvature: s w psi' j'j;
    # s score, w weight, j row of the Jacobian, v w^-g variance of psi; their ratio:
    curvature = variance.at(group.typical) * group.typical
    return float(np.divide(group.score * curvature * group.persistence, group.slope))


class _Measured:
    """Curvatures over all free values, with the slopes psi' of robust losses instead of their weights."""

    def __init__(self, compiled: CompiledProblem, values: Float, groups: Sequence[Group]) -> None:
        self._compiled, self._groups = compiled, groups
        self._full = compiled.full(values)
        self.objective = objective = LeastSquaresObjective(compiled)
        self._faint = objective.faint(values)
        self.rows: Float | None = None
        data: SymmetricMatrix
        sums = self._slope_weighted()
        if objective.uses_qr:
            residual, jacobian = sums.rows(self._full)
            # slopes that are rounding count as 0, as in the search
            jacobian[:, self._faint] = 0.0
            data, gradient = jacobian.T @ jacobian, jacobian.T @ residual
            self.rows = np.vstack([jacobian, compiled.roughness.rows(values)[1]])
        else:
            data, gradient = self._normal(sums)
        smoothness = zeros_like(data)
        compiled.roughness.add(values, gradient, smoothness)
        self._sparse = not objective.uses_qr and should_be_sparse(data, smoothness)
        self.data, self.smoothness = self._copy(data), self._copy(smoothness)
        # the weights of the slopes are those of the fit only without a robust loss
        self.cost = sum(group.score * group.squares for group in groups) + compiled.roughness.cost(values)
        robust = any(group.slope != group.weight for group in groups)
        self.gradient = objective.normal(values)[0].copy() if robust else gradient

    def _slope_weighted(self) -> Sums:
        if all(group.slope == group.weight for group in self._groups):
            return self._compiled.sums
        return self._rescored(self._groups)

    def noise(self, groups: Sequence[Group], variances: Sequence[Variance]) -> Matrix:
        """Return the variance of the gradient, sum (s w)^2 v w^-g j'j over the samples of weight w and row j."""
        factors, powers = {}, {}
        for own, group, variance in zip(self._groups, groups, variances, strict=True):
            # the sums multiply each sample by its score and by psi / r, whose mean over the group is divided out
            factors[own] = float(np.divide(group.score * variance.unit * group.persistence, group.weight))
            powers[own] = 2 - variance.exponent
        return self._copy(self._normal(self._compiled.sums_with(rescore, factors, powers))[0])

    def _rescored(self, groups: Sequence[Group]) -> Sums:
        factors = {group: float(np.divide(group.slope, group.weight)) for group in groups}
        return self._compiled.sums_with(rescore, factors)

    def with_smooth_effects(
        self, groups: Sequence[Group], used: Sequence[float], narrow: tuple[ConstraintElimination, Int, Inverse]
    ) -> list[Group]:
        """Return the groups with the persistence before the fit, see `smooth_effects`."""
        return with_smooth_effects(self._compiled, self._full, groups, used, narrow)

    @property
    def curvature(self) -> Float:
        """Curvature of the cost along each value, Float[values]."""
        return np.asarray(self.data.diagonal() + self.smoothness.diagonal())

    @property
    def finite(self) -> bool:
        """True if all derivatives of the model are finite."""
        entries = self.data.data if self._sparse else self.data
        return bool(np.isfinite(entries).all() and np.isfinite(self.gradient).all())

    def _normal(self, sums: Sums) -> tuple[SymmetricMatrix, Float]:
        """Return the curvature of some data, valid until the next call, and half the gradient."""
        normal = sums.normal(self._full)
        zero(normal.matrix, self._faint)
        return normal.matrix, np.where(self._faint, 0.0, normal.gradient)

    def _copy(self, matrix: SymmetricMatrix) -> Matrix:
        """Return a copy of a matrix, sparse if all of them are."""
        return as_sparse(matrix) if self._sparse else as_array(matrix)

    @cached_property
    def parts(self) -> list[Matrix]:
        """The curvature of the data of each group."""
        return [self._copy(self._normal(self._rescored([group]))[0]) for group in self._groups]
