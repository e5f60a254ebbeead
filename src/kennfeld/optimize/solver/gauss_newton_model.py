"""The damped Gauss-Newton model of a sum of squares at one point, and a secant correction to it.

Small problems are factored by QR of the Jacobian, which keeps the digits that the normal equations square away.
"""

from functools import cached_property
from typing import Protocol

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.native.cholesky import Cholesky, Factor
from kennfeld.native.symmetric import SymmetricMatrix, as_array, part

SCALE_MEMORY = 0.5  # share of its column scale that a value keeps at least from one iteration to the next
HOLD = 1e-12  # damping of directions without an effect, of problems that are factored by QR
NULL = 1e-13  # singular value of the scaled Jacobian that is rounding, relative to the largest
EPSILON = float(np.finfo(float).eps)
PROBE = 0.1  # share of a step at which its curvature is measured
SCALE_FLOOR = 1e-6  # of the mean curvature in its table: least column scale, so that no value runs away


class Objective(Protocol):
    """A sum of squares and what the solver needs of it. Gradients are halved: J'Wr."""

    @property
    def uses_qr(self) -> bool:
        """If `rows` fits into memory and its digits are worth a QR factorisation."""

    @property
    def supports_acceleration(self) -> bool:
        """If `residual` changes smoothly enough to measure the curvature of the residuals."""

    @property
    def supports_secant(self) -> bool:
        """If the residuals' second derivatives are worth a dense matrix of all values."""

    @property
    def target_squares(self) -> float:
        """The cost of residuals as large as the targets, whose rounding they have."""

    def cost(self, values: Float) -> float:
        """Return the cost; not finite if the model fails."""

    def normal(self, values: Float) -> tuple[Float, SymmetricMatrix]:
        """Return half the gradient, Float[values], and the Gauss-Newton matrix; valid until the next call."""

    def residual(self, values: Float) -> Float:
        """Return the weighted residuals, Float[residuals]."""

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Return the weighted residuals, Float[residuals], and their Jacobian, Float[residuals, values]."""

    def mean_curvature(self, diagonal: Float) -> Float:
        """Return for each value, Float[values], the mean over its table of the Gauss-Newton diagonal; 0 for scalars."""

    def cholesky(self, size: int) -> Cholesky:
        """Return the factorisation for the matrix of `size` values, which knows the zeros of earlier ones."""


class DampedModel:
    """The factor of H + D, the step -(H + D)^-1 g without limits, and the damping D; Float[values] each.

    Args:
        factor: of H + D, or its lower triangle, Float[values, values]: many steps need no factor.
        step: the step.
        damping: the diagonal of D.
    """

    def __init__(self, factor: Factor | Float, step: Float, damping: Float) -> None:
        self._factor, self.step, self.damping = factor, step, damping

    @property
    def factor(self) -> Factor:
        """The factor of H + D."""
        if not isinstance(self._factor, Factor):
            self._factor = Factor.of(self._factor)
        return self._factor


class GaussNewtonModel:
    """Residual r, gradient g = J'r and either R of J = QR or the matrix J'J, over the movable values."""

    def __init__(self, objective: Objective, values: Float, movable: Int, least_scale: Float | None = None) -> None:
        """Evaluate the residuals and their derivatives.

        Args:
            objective: the sum of squares.
            values: all values, Float[values].
            movable: the numbers of those that may move.
            least_scale: of the damping, in addition to that of the columns; Float[movable].
        """
        self.objective, self.values, self.movable = objective, values, movable
        if objective.uses_qr:
            residual, jacobian = objective.rows(values)
            jacobian = jacobian[:, movable]
            self.residual, self.jacobian = residual, jacobian
            self.r_factor, self.q_residual = _triangle(jacobian, residual)
            self.hessian: SymmetricMatrix | None = None
            self.gradient = jacobian.T @ residual
            diagonal = np.einsum("ij,ij->j", jacobian, jacobian)
        else:
            gradient, matrix = objective.normal(values)
            self.gradient = gradient if movable.size == values.size else gradient[movable]
            self.hessian = part(matrix, movable)
            diagonal = self.hessian.diagonal()
        self.diagonal = diagonal
        full = np.zeros(values.size)
        full[movable] = diagonal
        mean = objective.mean_curvature(full)[movable]
        # D; without the floor, a value that the data hardly see would hardly be damped
        self.column_scale = np.maximum(diagonal, SCALE_FLOOR * mean)
        self.column_scale[self.column_scale <= 0] = 1.0
        # for the least damping of limits, which tie such values to others of their table
        self.curvature = np.maximum(self.column_scale, mean)
        if least_scale is not None:
            self.column_scale = np.maximum(self.column_scale, least_scale)

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.gradient).all() and np.isfinite(self.column_scale).all())

    def remembered_scale(self, earlier: Float | None) -> Float:
        """Return the column scale, Float[movable], at least half the one remembered before."""
        scale: Float = np.maximum(self.column_scale, 0.0 if earlier is None else SCALE_MEMORY * earlier)
        return scale

    @cached_property
    def rounding(self) -> float:
        """Rounding error of the residuals, which are differences of predictions of the size |J p|."""
        sizes = np.sqrt(self.diagonal) * self.values[self.movable]
        return EPSILON * float(np.sqrt(sizes @ sizes))

    def damped_factor(
        self, damping: float, secant: "SecantCorrection | None" = None, least: float = 0.0
    ) -> DampedModel | None:
        """Return the factor of J'J + lambda D and the step without limits; None if it is not positive definite.

        Args:
            damping: lambda.
            secant: added to J'J.
            least: least damping, as a share of the mean curvature.
        """
        damped = np.maximum(damping * self.column_scale, least * self.curvature)
        if not np.isfinite(damped).all():
            return None
        if secant is not None or self.hessian is not None:
            matrix = self.r_factor.T @ self.r_factor if self.hessian is None else self.hessian
            if secant is None:
                factor = self.objective.cholesky(self.movable.size).factor(matrix, damped)
            else:
                factor = Cholesky(self.movable.size).factor(as_array(matrix) + secant.matrix, damped)
            return None if factor is None else DampedModel(factor, factor.solve(-self.gradient), damped)
        # QR of [R; sqrt(lambda D)], whose R is the factor of R'R + lambda D
        # the held directions are damped only if the damping itself is too small to hold them
        n, held = damped.size, self._held if damping < HOLD else None
        rows = 2 * n + (0 if held is None else len(held))
        stacked, rotated_residual = np.zeros((rows, n)), np.zeros(rows)
        stacked[:n] = self.r_factor
        stacked.reshape(-1)[n * n : 2 * n * n : n + 1] = np.sqrt(damped)
        if held is not None:
            stacked[2 * n :] = held
        # the damping rows have a target of 0
        rotated_residual[:n] = self.q_residual
        upper, rotated = _triangle(stacked, rotated_residual)
        diagonal = upper.diagonal()
        if np.abs(diagonal).min(initial=1.0) <= 0:
            return None
        # QR leaves the signs of rows open; a Cholesky factor has a diagonal > 0
        sign = np.where(diagonal < 0, -1.0, 1.0)
        lower = np.ascontiguousarray((sign[:, None] * upper).T)
        step = np.asarray(np.linalg.solve(upper, -rotated), dtype=np.float64)
        return DampedModel(lower, step, damped)

    @property
    def little_damping(self) -> float:
        """A damping that leaves all directions free whose effect on the residuals is not rounding."""
        return 1e-12 if self.hessian is not None else 1e-28

    @cached_property
    def _held(self) -> Float:
        """Rows that damp the directions whose effect on the residuals is rounding, by `HOLD`; Float[rows, values]."""
        units = np.sqrt(self.column_scale)
        _, singular, directions = np.linalg.svd(self.r_factor / units)
        return np.asarray(np.sqrt(HOLD) * directions[singular <= NULL * singular.max(initial=0.0)] * units)

    def geodesic_acceleration(self, factor: Factor, step: Float) -> Float:
        """Compute the correction of a step, Float[movable], for the curvature along it; for objectives that use QR.

        M. Transtrum, J. Sethna: Improvements to the Levenberg-Marquardt algorithm, 2012.
        """
        trial = self.values.copy()
        trial[self.movable] += PROBE * step
        # r'' along d from one more evaluation: r(p + h d) = r + h J d + h^2 / 2 r'', so that
        # r'' = 2 / h ((r(p + h d) - r) / h - J d)
        ahead = self.objective.residual(trial)
        if not np.isfinite(ahead).all():
            return np.full(step.size, np.inf)
        second_derivative = (2 / PROBE) * ((ahead - self.residual) / PROBE - self.jacobian @ step)
        return factor.solve(-(self.jacobian.T @ second_derivative))

    def hessian_product(self, step: Float) -> Float:
        """Compute J'J d, Float[movable], the change of the gradient that the model predicts over a step d."""
        return self.r_factor.T @ (self.r_factor @ step) if self.hessian is None else self.hessian @ step

    def predicted_reduction(self, step: Float) -> float:
        """Compute the decrease of the cost -2 g'd - d'J'J d over a step d, Float[movable]."""
        # d'J'J d as the square of R d, which keeps the digits that R'R loses
        curvature = ((self.r_factor @ step) ** 2).sum() if self.hessian is None else step @ (self.hessian @ step)
        return float(-2 * (self.gradient @ step) - curvature)

    def damped_reduction(self, step: Float, damped: DampedModel, push: float) -> float:
        """Return the same for a step d of the damped model within limits, without a product with a large J'J.

        (J'J + D) d = -g - A'm with the multipliers m of the limits makes it -g'd + d'D d + m'A d.

        Args:
            step: d.
            damped: the model that the step is of.
            push: m'A d.
        """
        if self.hessian is None:
            return self.predicted_reduction(step)
        return float(damped.damping @ np.square(step) - self.gradient @ step) + push

    def scaled_norm(self, step: Float) -> float:
        """Compute sqrt(d'D d), the length of a step d, Float[movable], in the values' own scales."""
        return float(np.sqrt((self.column_scale * step * step).sum()))


class SecantCorrection:
    """A symmetric matrix S of the residuals' second derivatives, learnt from the gradients along a descent.

    If residuals remain large, J'J misses most of the curvature and only heavy damping keeps its steps short enough.
    J. Dennis, D. Gay, R. Welsch: An adaptive nonlinear least-squares algorithm, 1981.
    """

    def __init__(self, size: int) -> None:
        self.matrix = np.zeros((size, size))

    def curvature(self, step: Float) -> float:
        """Compute d'S d, by which S lowers the predicted reduction of a step d, Float[movable]."""
        return float(step @ self.matrix @ step)

    def learn(self, step: Float, change: Float, explained: Float) -> None:
        """Update S so that S d = y - J'J d, a rank-two update of least change.

        S is first shrunk to the size of what is left to explain (ibid., equation 3.5), so that curvature learnt while
        the residuals were large is forgotten once they are small.

        Args:
            step: d.
            change: y, the change of the halved gradient over d.
            explained: J'J d.
        """
        along = float(change @ step)
        remainder = change - explained
        # y'd > 0 keeps the update bounded; steps against it teach nothing
        if not (np.isfinite(along) and along > 0 and np.isfinite(remainder).all()):
            return
        known = self.curvature(step)
        # so that d'S d is at most what is left to explain, |d'(y - J'J d)|
        share = min(1.0, abs(float(step @ remainder)) / abs(known)) if known else 1.0
        missing = remainder - share * (self.matrix @ step)
        with np.errstate(over="ignore", invalid="ignore"):
            # w = remainder - S d, v = y / y'd: S + w v' + v w' - (d'w) v v'
            direction = change / along
            outer = missing[:, None] * direction
            matrix = share * self.matrix + outer + outer.T
            matrix -= float(step @ missing) * (direction[:, None] * direction)
        if np.isfinite(matrix).all():
            self.matrix = matrix


def _triangle(jacobian: Float, residual: Float) -> tuple[Float, Float]:
    """Compute R, Float[columns, columns], and Q'r of a QR factorisation; zeros fill up rows if these are too few."""
    missing = max(jacobian.shape[1] - jacobian.shape[0], 0)
    if missing:
        jacobian = np.vstack([jacobian, np.zeros((missing, jacobian.shape[1]))])
        residual = np.concatenate([residual, np.zeros(missing)])
    q, r = np.linalg.qr(jacobian)
    return r, q.T @ residual
