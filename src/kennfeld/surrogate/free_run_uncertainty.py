"""Predictive deviation of a recursion in free run, by a linearised propagation of its errors.

The model's error of one step, w_k, is fed back with its outputs (A. Gelb: Applied Optimal Estimation, 1974, chapter 4):

    e_k = sum over output lags l of df/dy_{k-l} e_{k-l} + w_k,   deviation_k^2 = var e_k + noise^2
    var w_k = process_noise^2 + (signal share_k)^2

where share_k is the share of the deviation of a Gaussian process that the centres leave open at the point of step k
(see `uncertainty`): it grows outside the training data. Limits of the output bound the error, see `recursion_code`.
"""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.gp_kernel import JITTER
from kennfeld.surrogate.recursion import basis_values, input_slopes
from kennfeld.surrogate.recursion_code import LARGEST, covariance_code
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty, has_equal_widths

BLOCK = 1024  # points whose basis functions stay in the cache


@dataclass(frozen=True)
class FreeRunUncertainty:
    """The uncertainty of a recursion; all deviations are in the unit of its output.

    Attributes:
        signal: deviation of the error that each step adds far from the training data.
        noise: deviation of a measurement about the output.
        process_noise: deviation of the error that each step adds amid the training data.
        start: deviation of outputs before the run that are not measured.

    Raises:
        ArgumentError: a deviation is negative or not finite.
    """

    signal: float
    noise: float
    process_noise: float
    start: float = 0.0

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            if not 0 <= getattr(self, name) < np.inf:
                raise ArgumentError(f"{name}={getattr(self, name)} of an uncertainty must be a finite number >= 0")

    @property
    def first(self) -> float:
        """Deviation of a measurement from the first step after measured outputs, amid the training data."""
        return float(np.hypot(self.noise, self.process_noise))

    def check(self, expansion: Expansion) -> None:
        """Raise `ArgumentError` if this is not an uncertainty of that expansion."""
        if self.signal and not has_equal_widths(expansion):
            raise ArgumentError("signal of an uncertainty must be 0 if the widths of the model differ between centres")


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """A model linearised along free runs side by side.

    Attributes:
        lags: of the output.
        limits: of the output.
        free: the output without the limits, Float[steps, runs].
        slopes: df/dy by the outputs at the lags, Float[steps, runs, lags].
        shares: of the deviation of a process that the centres leave open, Float[steps, runs].
    """

    lags: tuple[int, ...]
    limits: tuple[float, float]
    free: Float
    slopes: Float
    shares: Float

    @classmethod
    def along(
        cls, expansion: Expansion, points: Float, lags: Sequence[int], limits: tuple[float, float], *, shares: bool
    ) -> "LinearisedRun":
        """Linearise a model at the points that runs go through.

        Args:
            expansion: the model.
            points: Float[steps, runs, inputs]; the outputs at the lags are their first inputs.
            lags: of the output, increasing.
            limits: of the output.
            shares: whether the shares are needed; otherwise they are 0.
        """
        shape, own = points.shape[:-1], len(lags)
        flat = points.reshape(-1, expansion.inputs)
        free, open_shares, slopes = np.empty(len(flat)), np.zeros(len(flat)), np.empty((len(flat), own))
        process = _unit_process(expansion) if shares and expansion.size else None
        for first in range(0, len(flat), BLOCK):
            part = slice(first, first + BLOCK)
            x = flat[part]
            near = basis_values(expansion, x)
            free[part] = expansion.offset + x @ expansion.slopes + near @ expansion.weights
            slopes[part] = input_slopes(expansion, x, near, own)
            if process is not None:
                open_shares[part] = process.open_share(x, near)
        return cls(tuple(lags), limits, free.reshape(shape), slopes.reshape(*shape, own), open_shares.reshape(shape))

    def repeated(self, times: int) -> "LinearisedRun":
        """Return the runs with each step repeated so many times in a row."""
        free, slopes, shares = (np.repeat(array, times, axis=0) for array in (self.free, self.slopes, self.shares))
        return replace(self, free=free, slopes=slopes, shares=shares)

    def deviation(self, uncertainty: FreeRunUncertainty, unknown: Bool | None = None) -> Float:
        """Propagate the standard deviation of a new measurement from each step, Float[steps, runs].

        It is infinite where errors grow beyond all bounds, and NaN where the output is not a number.

        Args:
            uncertainty: that of the model.
            unknown: the outputs before the first step that are not measured, oldest first, Bool[longest lag, runs]; by
                default all are measured.
        """
        steps, runs = self.free.shape
        back = max(self.lags)
        # rows[back + k, :, j] = cov(e_k, e_{k-j}), as the code of `covariance_code` reads and writes them
        rows = np.zeros((back + steps, runs, back + 1))  # covariances with the error so many steps before
        if unknown is not None:
            for age in range(back):  # what is not measured has one common error
                rows[age:back, :, age] = uncertainty.start**2 * (unknown[age:] & unknown[: back - age])
        added = uncertainty.process_noise**2 + (uncertainty.signal * self.shares) ** 2
        numbers = [np.array(self.limits, dtype=np.float64), self.free, self.slopes, added]
        arrays = [np.ascontiguousarray(number, dtype=np.float64) for number in numbers]
        covariance_code(self.lags)(steps * runs, runs, *(array.ctypes.data for array in arrays), rows.ctypes.data)
        variance = rows[back:, :, 0]
        # the code cuts covariances off at LARGEST, which stands for infinity
        deviation = np.sqrt(np.where(variance < LARGEST, variance, np.inf) + uncertainty.noise**2)
        return np.where(np.isnan(self.free), np.nan, deviation)


def _unit_process(expansion: Expansion) -> Deviation:
    return Deviation(expansion, Uncertainty(1.0, 0.0, np.full(expansion.size, JITTER)))
