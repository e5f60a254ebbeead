"""The damped Gauss-Newton model of a sum of squares at one point.

Small problems are factored by QR of the Jacobian, which keeps the digits that the normal equations square away.

What the second derivatives of the residuals add to the Gauss-Newton matrix, learnt from gradients along the way.

J. Dennis, D. Gay, R. Welsch: An adaptive nonlinear least-squares algorithm, 1981. Where residuals stay large, the
Gauss-Newton matrix alone misses most of the curvature, and only heavy damping keeps its steps short enough.
"""

from typing import Protocol

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.native import Cholesky, Factor

__all__ = ["GaussNewtonModel", "Objective", "SecantCorrection"]

MEMORY = 0.5  # share of a value's scale that it keeps at least from one iteration to the next
PROBE = 0.1  # share of a step at which its curvature is measured
FLOOR = 1e-6  # of the mean curvature in its table: the least scale of a value, so that it does not run away


class SecantCorrection:
    """A symmetric matrix that follows the descent; zero at first."""

    def __init__(self, size: int) -> None:
        self.matrix = np.zeros((size, size))

    def bend(self, step: Float) -> float:
        """By how much it lowers the predicted gain of a step."""
        return float(step @ self.matrix @ step)

    def learn(self, step: Float, change: Float, explained: Float) -> None:
        """Take in how the (halved) gradient changed over a step, and how much of it the Gauss-Newton matrix explains.

        The matrix is first shrunk to the size of what is left to explain (ibid., equation 3.5), so that curvature
        learnt where the residuals were large is forgotten where they are small.
        """
        along = float(change @ step)
        left = change - explained
        if not (np.isfinite(along) and along > 0 and np.all(np.isfinite(left))):
            return
        known = self.bend(step)
        share = min(1.0, abs(float(step @ left)) / abs(known)) if known else 1.0
        missing = left - share * (self.matrix @ step)
        with np.errstate(over="ignore", invalid="ignore"):
            direction = change / along
            crossed = np.outer(missing, direction)
            matrix = share * self.matrix + crossed + crossed.T
            matrix -= float(step @ missing) * np.outer(direction, direction)
        if np.all(np.isfinite(matrix)):
            self.matrix = matrix


class Objective(Protocol):
    """A sum of squares and what the solver needs of it. Gradients are halved: J'Wr."""

    @property
    def small(self) -> bool:
        """Whether `rows` fits memory and its digits are worth a QR."""

    @property
    def bends(self) -> bool:
        """Whether `rows` changes smoothly enough to measure the curvature of the residuals."""

    @property
    def learns(self) -> bool:
        """Whether the residuals' second derivatives are worth a dense matrix of all values."""

    def cost(self, values: Float) -> float:
        """The cost; not finite where the model fails."""

    def normal(self, values: Float) -> tuple[Float, Float]:
        """Half the gradient, and the Gauss-Newton matrix. They hold until the next call."""

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Weighted residuals and their Jacobian."""

    def mean_curvature(self, diagonal: Float) -> Float:
        """For each value the mean over its table of the diagonal of the Gauss-Newton matrix; 0 for scalars."""

    def cholesky(self, size: int) -> Cholesky:
        """What factors the matrix of `size` of its values; it knows the zeros of those before."""


class GaussNewtonModel:
    """Gradient, matrix or triangular factor, and the scales of the movable values."""

    def __init__(self, objective: Objective, at: Float, movable: Int, scale: Float | None) -> None:
        self.movable = movable
        self.objective, self.at = objective, at
        if objective.small:
            residual, jacobian = objective.rows(at)
            jacobian = jacobian[:, movable]
            self.residual, self.jacobian = residual, jacobian
            self.root, self.rotated = _triangle(jacobian, residual)
            self.matrix: Float | None = None
            self.gradient = jacobian.T @ residual
            diagonal = np.einsum("ij,ij->j", jacobian, jacobian)
        else:
            gradient, matrix = objective.normal(at)
            everything = movable.size == at.size
            self.gradient = gradient if everything else gradient[movable]
            self.matrix = matrix if everything else matrix[np.ix_(movable, movable)]
            diagonal = np.diag(self.matrix)
        self.diagonal = diagonal
        full = np.zeros(at.size)
        full[movable] = diagonal
        mean = objective.mean_curvature(full)[movable]
        self.scale = np.maximum(diagonal, FLOOR * mean)
        self.scale[self.scale <= 0] = 1.0
        if scale is not None:
            self.scale = np.maximum(self.scale, MEMORY * scale)
        self.curvature = np.maximum(self.scale, mean)

    @property
    def finite(self) -> bool:
        return bool(np.all(np.isfinite(self.gradient)) and np.all(np.isfinite(self.scale)))

    @property
    def rounding(self) -> float:
        """How exactly the residuals are known: they are differences of predictions of the size |J p|."""
        return float(np.finfo(float).eps * np.linalg.norm(np.sqrt(self.diagonal) * self.at[self.movable]))

    def factor(
        self, damping: float, secant: SecantCorrection | None = None, floor: float = 0.0
    ) -> tuple[Factor, Float] | None:
        """Factor of the damped matrix and the step without limits; None where it is not positive definite.

        `floor` is the least damping, as a share of the mean curvature.
        """
        damped = np.maximum(damping * self.scale, floor * self.curvature)
        if secant is not None:
            whole = (self.root.T @ self.root if self.matrix is None else self.matrix) + secant.matrix
            curved = Cholesky(self.movable.size).factor(whole, damped)
            return None if curved is None else (curved, curved.solve(-self.gradient))
        if self.matrix is not None:
            factor = self.objective.cholesky(self.movable.size).factor(self.matrix, damped)
            return None if factor is None else (factor, factor.solve(-self.gradient))
        stacked = np.vstack([self.root, np.diag(np.sqrt(damped))])
        upper, rotated = _triangle(stacked, np.concatenate([self.rotated, np.zeros(self.scale.size)]))
        diagonal = np.abs(np.diag(upper))
        if diagonal.min(initial=1.0) <= 0:
            return None
        sign = np.where(np.diag(upper) < 0, -1.0, 1.0)
        lower = np.ascontiguousarray((sign[:, None] * upper).T)
        return Factor.of(lower), np.asarray(np.linalg.solve(upper, -rotated), dtype=np.float64)

    def bend(self, factor: Factor, step: Float) -> Float:
        """Geodesic acceleration: the correction of a step for the curvature of the residuals along it.

        M. Transtrum, J. Sethna: Improvements to the Levenberg-Marquardt algorithm, 2012. Small problems only.
        """
        trial = self.at.copy()
        trial[self.movable] += PROBE * step
        ahead, _ = self.objective.rows(trial)
        if not np.all(np.isfinite(ahead)):
            return np.full(step.size, np.inf)
        curved = (2 / PROBE) * ((ahead - self.residual) / PROBE - self.jacobian @ step)
        return factor.solve(-(self.jacobian.T @ curved))

    def explained(self, step: Float) -> Float:
        """Change of the gradient over a step that the Gauss-Newton matrix predicts."""
        return self.root.T @ (self.root @ step) if self.matrix is None else self.matrix @ step

    def gain(self, step: Float) -> float:
        """Predicted decrease of the cost."""
        bend = np.sum((self.root @ step) ** 2) if self.matrix is None else step @ (self.matrix @ step)
        return float(-2 * (self.gradient @ step) - bend)

    def length(self, step: Float) -> float:
        """Length of a step in the values' own scales."""
        with np.errstate(over="ignore"):
            return float(np.sqrt(np.sum(self.scale * step * step)))


def _triangle(jacobian: Float, residual: Float) -> tuple[Float, Float]:
    """R and Q'r of a QR factorisation; rows of zeros are added where there are fewer than columns."""
    missing = max(jacobian.shape[1] - jacobian.shape[0], 0)
    if missing:
        jacobian = np.vstack([jacobian, np.zeros((missing, jacobian.shape[1]))])
        residual = np.concatenate([residual, np.zeros(missing)])
    q, r = np.linalg.qr(jacobian)
    return r, q.T @ residual
