"""Exact Gaussian process: every training point is a centre, and the cost grows with the cube of their number.

y = plane + f + noise, where f has variance s^2 and the kernel R, and noise the variance s^2 eta. The plane has a vague
prior and s^2 has a closed form, so the likelihood is maximised over the length scales and eta only:

    P = K^-1 - K^-1 U (U'K^-1 U)^-1 U'K^-1,  K = R + eta I,  s^2 = y'P y / (n - rank)
    -2 log L = (n - rank) log s^2 + log|K| + log|U'K^-1 U|

C. E. Rasmussen, C. K. I. Williams: Gaussian Processes for Machine Learning, 2006, equation 2.45. Leaving one out:
O. Dubrule: Cross validation of kriging in a unique neighborhood, 1983: the residual is (P y)_i / P_ii.
"""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.lazy_dataclass import dataclass
from kennfeld.surrogate.gp_kernel import Plane, bells, scaled_second_moment


@dataclass(frozen=True, eq=False)
class _KernelSystem:
    """Intermediate results of the formulas above for one set of length scales and eta."""

    root: Float  # lower Cholesky factor of K
    projected: Float  # P
    plane_root: Float  # lower Cholesky factor of U'K^-1 U
    weights: Float  # P y
    variance: float  # s^2


def _solve(kernel: Float, noise: float, y: Float, plane: Plane) -> _KernelSystem:
    from scipy.linalg import lapack

    root: Float = np.asarray(np.linalg.cholesky(kernel + noise * np.eye(len(y))), dtype=np.float64)
    lower, _ = lapack.dpotri(root, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    coupled = inverse @ plane.basis  # K^-1 U
    plane_root: Float = np.asarray(np.linalg.cholesky(plane.basis.T @ coupled), dtype=np.float64)
    half = np.linalg.solve(plane_root, coupled.T)
    inverse -= half.T @ half
    weights = inverse @ y
    variance = max(float(y @ weights) / max(len(y) - plane.rank, 1), 1e-300)
    return _KernelSystem(root, inverse, plane_root, weights, variance)


def exact_likelihood(values: Float, x: Float, y: Float, plane: Plane) -> tuple[float, Float]:
    """Return the log marginal likelihood and its gradient by the logarithms of the lengths and, last, of eta.

    `x` Float[points, inputs] and `y` Float[points] are in units of their spread. Raises `LinAlgError` if the matrix
    is not positive definite.
    """
    lengths, noise = np.exp(values[:-1]), float(np.exp(values[-1]))
    kernel = bells(x, x, lengths)
    at = _solve(kernel, noise, y, plane)
    logarithm = 2 * np.sum(np.log(np.diag(at.root))) + 2 * np.sum(np.log(np.diag(at.plane_root)))
    likelihood = -0.5 * ((len(y) - plane.rank) * np.log(at.variance) + logarithm)
    slope = np.outer(at.weights, at.weights / at.variance) - at.projected
    by_noise = 0.5 * noise * np.trace(slope)
    return float(likelihood), np.append(0.5 * scaled_second_moment(slope * kernel, x, x, lengths), by_noise)


@dataclass(frozen=True, eq=False)
class Exact:
    """An exact process at given length scales and eta, in units of spread."""

    x: Float
    y: Float
    plane: Plane
    lengths: Float
    noise: float
    system: _KernelSystem

    @classmethod
    def at(cls, x: Float, y: Float, lengths: Float, noise: float) -> "Exact":
        """Return the process through points and values."""
        plane = Plane.over(x)
        return cls(x, y, plane, lengths, noise, _solve(bells(x, x, lengths), noise, y, plane))

    def terms(self) -> tuple[float, Float, Float, Float]:
        """Return offset, slopes, weights and centres of the mean."""
        weights = self.system.weights
        rest = self.y - bells(self.x, self.x, self.lengths) @ weights - self.noise * weights
        flat = self.plane.back @ (self.plane.basis.T @ rest)
        return float(flat[0]), flat[1:], weights, self.x

    def left_out(self) -> Float:
        """Return the residual at each point of the process trained without it."""
        residual: Float = self.system.weights / np.diag(self.system.projected)
        return residual
