"""Exact Gaussian process: every training point is a centre, and the cost grows with the cube of their number.

y = plane + f + noise, where f has variance s^2 and the kernel R, and the noise of a point of weight w the variance
s^2 eta / w. The plane has a vague prior and s^2 has a closed form, so the likelihood is maximised over the length
scales and eta only:

    P = K^-1 - K^-1 U (U'K^-1 U)^-1 U'K^-1,  K = R + eta D,  D = diag(1/w),  s^2 = (y'P y + c / eta) / (N - rank)
    -2 log L = (N - rank) log s^2 + log|K| + log|U'K^-1 U| + (N - n) log eta

for n points from N rows, with the scatter c of repeated rows. C. E. Rasmussen, C. K. I. Williams: Gaussian Processes
for Machine Learning, 2006, equation 2.45. Leaving some points B out: O. Dubrule: Cross validation of kriging in a
unique neighborhood, 1983: their residuals are P_BB^-1 (P y)_B, with the covariance s^2 P_BB^-1.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Kernel
from kennfeld.surrogate.gp_kernel import LEAST_VARIANCE, Plane, kernel_matrix, scaled_second_moment
from kennfeld.surrogate.training_points import TrainingPoints


@dataclass(frozen=True, eq=False)
class _KernelSystem:
    """Intermediate results of the formulas above for one set of length scales and eta."""

    root: Float  # lower Cholesky factor of K
    projected: Float  # P
    plane_root: Float  # lower Cholesky factor of U'K^-1 U
    weights: Float  # P y
    variance: float  # s^2


def _solve(kernel: Float, noise: float, points: TrainingPoints, plane: Plane) -> _KernelSystem:
    from scipy.linalg import lapack

    padded = kernel.copy()
    padded.flat[:: len(points) + 1] += noise / points.weights
    root: Float = np.asarray(np.linalg.cholesky(padded), dtype=np.float64)
    # K^-1 from its factor; LAPACK fills the lower triangle only
    lower, _ = lapack.dpotri(root, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    coupled = inverse @ plane.basis  # K^-1 U
    plane_root: Float = np.asarray(np.linalg.cholesky(plane.basis.T @ coupled), dtype=np.float64)
    half = np.linalg.solve(plane_root, coupled.T)
    inverse -= half.T @ half
    # inverse is P from here on
    weights = inverse @ points.y
    square = float(points.y @ weights) + float(points.scatter.sum()) / noise
    variance = max(square / max(_free(points, plane), 1), LEAST_VARIANCE)
    return _KernelSystem(root, inverse, plane_root, weights, variance)


def _free(points: TrainingPoints, plane: Plane) -> float:
    """Return the degrees of freedom N - rank."""
    return len(points) + float(points.repeats.sum()) - plane.rank


def exact_likelihood(values: Float, points: TrainingPoints, plane: Plane, kernel: Kernel) -> tuple[float, Float]:
    """Compute the log marginal likelihood and its gradient by the logarithms of the lengths and, last, of eta.

    `values` and the gradient are Float[inputs + 1]. The points are in units of their spread. Raises `LinAlgError` if
    the matrix is not positive definite.
    """
    x, lengths, noise = points.x, np.exp(values[:-1]), float(np.exp(values[-1]))
    near, declines = kernel_matrix(x, x, lengths, kernel)
    at = _solve(near, noise, points, plane)
    repeats, scatter = float(points.repeats.sum()), float(points.scatter.sum()) / (noise * at.variance)
    logarithm = 2 * np.sum(np.log(np.diag(at.root))) + 2 * np.sum(np.log(np.diag(at.plane_root)))
    likelihood = -0.5 * (_free(points, plane) * np.log(at.variance) + logarithm + repeats * values[-1])
    # d log L / dK = 1/2 (P y y'P / s^2 - P)
    slope = np.outer(at.weights, at.weights / at.variance) - at.projected
    by_noise = 0.5 * (noise * float(np.sum(np.diag(slope) / points.weights)) + scatter - repeats)
    return float(likelihood), np.append(0.5 * scaled_second_moment(slope * declines, x, x, lengths), by_noise)


@dataclass(frozen=True, eq=False)
class Exact:
    """An exact process at given length scales and eta, in units of spread."""

    points: TrainingPoints
    plane: Plane
    lengths: Float
    noise: float
    kernel: Kernel
    system: _KernelSystem

    @classmethod
    def at(cls, points: TrainingPoints, lengths: Float, noise: float, kernel: Kernel = "gaussian") -> "Exact":
        """Return the process through points."""
        plane = Plane.over(points.x)
        near = kernel_matrix(points.x, points.x, lengths, kernel)[0]
        return cls(points, plane, lengths, noise, kernel, _solve(near, noise, points, plane))

    def terms(self) -> tuple[float, Float, Float, Float]:
        """Return offset, slopes, weights and centres of the mean."""
        x, weights = self.points.x, self.system.weights
        near = kernel_matrix(x, x, self.lengths, self.kernel)[0]
        # y - K P y = U beta: what the kernel and the noise leave lies in the plane
        rest = self.points.y - near @ weights - self.noise / self.points.weights * weights
        flat = self.plane.back @ (self.plane.basis.T @ rest)
        return float(flat[0]), flat[1:], weights, x

    def left_out(self, blocks: Sequence[Int] | None = None) -> Float:
        """Compute the residual at each point of the process trained without the points of its block, Float[points].

        `blocks` are the numbers of points that are left out together; by default each point is left out alone.
        """
        projected, weights = self.system.projected, self.system.weights
        # blocks of one point each: P_ii^-1 (P y)_i
        residual: Float = weights / np.diag(projected)
        for block in blocks or ():
            residual[block] = np.linalg.solve(projected[np.ix_(block, block)], weights[block])
        return residual

    @property
    def variance(self) -> float:
        """s^2, in units of spread."""
        return self.system.variance
