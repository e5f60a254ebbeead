"""Predictive standard deviation of a static data-driven model."""

from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Float, readonly
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.gp_kernel import Plane, factor, kernel_matrix

BLOCK = 4096
TWO_DEVIATIONS = 0.9545  # share of normal residuals within them


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The standard deviation of a new measurement, as the universal kriging of values at the centres gives it.

    deviation^2 = signal^2 (1 - k'K^-1 k + u'(U'K^-1 U)^-1 u) + noise^2,  K = R + diag(nugget),  u = U'K^-1 k - [1; x]

    where k is the kernel between the point and the centres of the model, and U the plane at the centres.
    C. E. Rasmussen, C. K. I. Williams: Gaussian Processes for Machine Learning, 2006, equation 2.42.

    Attributes:
        signal: deviation of the process about its plane, in the unit of the output.
        noise: deviation of a measurement about the function, in the unit of the output.
        nugget: variance of the value at each centre, as a share of signal^2, Float[centres].

    Raises:
        ArgumentError: a deviation is negative, or a nugget is not > 0.
    """

    signal: float
    noise: float
    nugget: Float  # Float[centres]

    def __post_init__(self) -> None:
        object.__setattr__(self, "nugget", readonly(self.nugget))
        for name in ("signal", "noise"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ArgumentError(f"{name}={getattr(self, name)} of an uncertainty must be a finite number >= 0")
        if self.nugget.ndim != 1 or not np.all(self.nugget > 0):
            raise ArgumentError("nugget of an uncertainty must be one number > 0 per centre")

    def check(self, expansion: Expansion) -> None:
        """Raise `ArgumentError` if this is not an uncertainty of that expansion."""
        if self.nugget.size != expansion.size:
            raise ArgumentError(f"nugget of an uncertainty must be one number per centre, {expansion.size}")
        if not has_equal_widths(expansion):
            raise ArgumentError("the widths of a model with an uncertainty must be the same at all centres")

    def scaled(self, factor: float) -> "Uncertainty":
        """Return the uncertainty with all deviations multiplied by a factor."""
        return Uncertainty(self.signal * factor, self.noise * factor, self.nugget)


def has_equal_widths(expansion: Expansion) -> bool:
    """Return whether the widths of an expansion are the same at all centres."""
    return not expansion.size or bool(np.all(expansion.widths == expansion.widths[0]))


@dataclass(frozen=True, eq=False)
class Deviation:
    """The predictive deviation as a function of the inputs of an expansion whose centres have equal widths.

    Raises:
        ArgumentError: the nuggets are not one per centre, or the widths differ from centre to centre.
    """

    expansion: Expansion
    uncertainty: Uncertainty
    _inverse: Float = field(init=False, repr=False)  # L^-1 of the lower Cholesky factor of K
    _plane: Plane = field(init=False, repr=False)  # at the centres
    _half: Float = field(init=False, repr=False)  # L^-1 U
    _plane_inverse: Float = field(init=False, repr=False)  # inverse of the lower Cholesky factor of U'K^-1 U

    def __post_init__(self) -> None:
        e = self.expansion
        self.uncertainty.check(e)
        if not e.size:
            return
        kernel = kernel_matrix(self._scale(e.centres), self._scale(e.centres), np.ones(e.inputs), e.kernel)[0]
        inverse = _inverse(factor(kernel + np.diag(self.uncertainty.nugget)))
        plane = Plane.over(self._scale(e.centres))
        half = inverse @ plane.basis
        plane_inverse = _inverse(np.asarray(np.linalg.cholesky(half.T @ half), dtype=np.float64))
        values = {"_inverse": inverse, "_plane": plane, "_half": half, "_plane_inverse": plane_inverse}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __call__(self, x: Float) -> Float:
        """Return the standard deviation of a new measurement at points, Float[..., inputs] -> Float[...]."""
        shape = np.shape(x)[:-1]
        points = np.asarray(x, dtype=np.float64).reshape(-1, self.expansion.inputs)
        deviation = np.full(len(points), self.uncertainty.noise)
        for first in range(0, len(points) if self.expansion.size else 0, BLOCK):
            part = slice(first, first + BLOCK)
            deviation[part] = np.hypot(self.uncertainty.noise, self.uncertainty.signal * self.open_share(points[part]))
        deviation[~np.isfinite(points).all(axis=1)] = np.nan
        return deviation.reshape(shape)

    def open_share(self, x: Float, near: Float | None = None) -> Float:
        """Compute the share of `signal` that the centres leave open at points Float[points, inputs] -> Float[points].

        `near` Float[points, centres] is the kernel between points and centres, if it is known.
        """
        e = self.expansion
        # clipped, since squares of huge inputs overflow; NaN is marked by the caller
        scaled = np.nan_to_num(np.clip(self._scale(x), -1e6, 1e6))
        if near is None:
            near = kernel_matrix(scaled, self._scale(e.centres), np.ones(e.inputs), e.kernel)[0]
        explained = near @ self._inverse.T
        basis = np.column_stack([np.ones(len(x)), scaled]) @ self._plane.back
        # u in coordinates in which U'K^-1 U is the identity
        tilted = (explained @ self._half - basis) @ self._plane_inverse.T
        squares = np.einsum("ij,ij->i", tilted, tilted) - np.einsum("ij,ij->i", explained, explained)
        share: Float = np.sqrt(np.maximum(1 + squares, 0.0))
        return share

    def _scale(self, x: Float) -> Float:
        """Return points in widths, about the mean of the centres."""
        e = self.expansion
        scaled: Float = (x - e.centres.mean(0)) / e.widths[0]
        return scaled


def _inverse(root: Float) -> Float:
    """Return the inverse of a lower triangular matrix."""
    from scipy.linalg import solve_triangular

    inverse: Float = solve_triangular(root, np.eye(len(root)), lower=True)
    return inverse


def calibrated(uncertainty: Uncertainty, expansion: Expansion, x: Float, residual: Float) -> Uncertainty:
    """Scale the uncertainty so that two deviations cover 95.45 % of left-out residuals Float[points] at x.

    V. Vovk, A. Gammerman, G. Shafer: Algorithmic Learning in a Random World, 2005 (conformal prediction).
    """
    deviation = Deviation(expansion, uncertainty)(x)
    if not np.any(residual) or not np.all(deviation > 0):
        return uncertainty
    count = len(residual)
    # the conformal quantile for a new measurement beside `count` known ones
    share = min(TWO_DEVIATIONS * (count + 1) / count, 1.0)
    return uncertainty.scaled(float(np.quantile(np.abs(residual) / deviation, share)) / 2)
