"""Predictive deviation of a dynamic model in free run, by a linearised propagation of its errors.

The model's error of one step, w_k, is fed back with its outputs:

    e_k = sum over output lags l of df/dy_{k-l} e_{k-l} + w_k,   deviation_k^2 = var e_k + noise^2
    var w_k = process_noise^2 + (signal share_k)^2

where share_k is the share of the deviation of a Gaussian process that the centres leave open at the point of step k
(see `uncertainty`): it grows outside the training data. Beyond its limits the output is linearised statistically: a
normal error e about f has the variance and the mean slope of the limited output (A. Gelb: Applied Optimal Estimation,
1974, section 6.2).
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Float, readonly
from kennfeld.errors import ArgumentError
from kennfeld.lazy_dataclass import dataclass
from kennfeld.rbf import Expansion
from kennfeld.surrogate.gp_kernel import bells
from kennfeld.surrogate.recursion import UNLIMITED, input_slopes
from kennfeld.surrogate.uncertainty import Deviation, Uncertainty

BLOCK = 4096
MOST = 1e150  # of a variance


@dataclass(frozen=True, eq=False)
class FreeRunUncertainty:
    """The uncertainty of a dynamic model.

    Attributes:
        signal: deviation of the model far from its centres, at each step, in the unit of the output.
        noise: deviation of a measurement about the output, in the unit of the output.
        process_noise: deviation of the model at each step amidst its centres, which is fed back.
        nugget: variance of the value at each centre, as a share of signal^2, Float[centres].

    Raises:
        ArgumentError: a deviation is negative, or a nugget is not > 0.
    """

    signal: float
    noise: float
    process_noise: float
    nugget: Float  # Float[centres]

    def __post_init__(self) -> None:
        object.__setattr__(self, "nugget", readonly(self.nugget))
        if not 0 <= self.process_noise < np.inf:
            raise ArgumentError(f"process_noise={self.process_noise} of an uncertainty must be a finite number >= 0")
        Uncertainty(self.signal, self.noise, self.nugget)

    def check(self, expansion: Expansion) -> None:
        """Raise `ArgumentError` if this is not an uncertainty of that expansion."""
        Uncertainty(self.signal, self.noise, self.nugget).check(expansion)

    def scaled(self, factor: float) -> "FreeRunUncertainty":
        """Return the uncertainty with all deviations multiplied by a factor."""
        return FreeRunUncertainty(self.signal * factor, self.noise * factor, self.process_noise * factor, self.nugget)


def free_run_deviation(
    expansion: Expansion,
    uncertainty: FreeRunUncertainty,
    points: Float,
    lags: Sequence[int],
    limits: tuple[float, float],
) -> Float:
    """Return the standard deviation of a new measurement from each step of free runs side by side.

    Args:
        expansion: the model.
        uncertainty: its uncertainty.
        points: that the runs go through, from outputs that are known exactly, Float[steps, runs, inputs].
        lags: of the output, the first inputs of a point, increasing.
        limits: of the output.

    Returns:
        Float[steps, runs], infinite where the errors grow beyond all bounds.
    """
    path = RunPath.of(expansion, uncertainty.nugget, points, len(lags))
    steps = uncertainty.process_noise**2 + (uncertainty.signal * path.shares) ** 2
    return np.sqrt(path.variance(steps, lags, limits) + uncertainty.noise**2)


@dataclass(frozen=True, eq=False)
class RunPath:
    """Runs of a model: its value before the limits, its slopes by the past outputs, and its share of the prior."""

    value: Float  # Float[steps, runs]
    slopes: Float  # Float[steps, runs, output lags]
    shares: Float  # Float[steps, runs]

    @classmethod
    def of(cls, expansion: Expansion, nugget: Float, points: Float, own: int) -> "RunPath":
        shape = points.shape[:-1]
        flat = points.reshape(-1, expansion.inputs)
        slopes = np.empty((len(flat), own))
        for first in range(0, len(flat), BLOCK):
            part = flat[first : first + BLOCK]
            near = bells(part, expansion.centres, expansion.widths[0]) if expansion.size else np.empty((len(part), 0))
            slopes[first : first + BLOCK] = input_slopes(expansion, part, near, own)
        shares = np.zeros(len(flat))
        if expansion.size:
            shares = Deviation(expansion, Uncertainty(1.0, 0.0, nugget))(flat)
        return cls(expansion(flat).reshape(shape), slopes.reshape(*shape, own), shares.reshape(shape))

    def variance(self, steps: Float, lags: Sequence[int], limits: tuple[float, float]) -> Float:
        """Return the variance of the propagated error for variances `steps` of each step, Float[..., steps, runs]."""
        back = max(lags)
        at = np.array(lags) - 1
        window = np.zeros((*steps.shape[:-2], steps.shape[-1], back, back))  # covariance of e_{k-1}, ..., e_{k-back}
        result = np.empty(steps.shape)
        with np.errstate(over="ignore", invalid="ignore"):
            for k, slopes in enumerate(self.slopes):
                across = np.einsum("...ij,...j->...i", window[..., at], slopes)
                variance = np.einsum("...i,...i->...", across[..., at], slopes) + steps[..., k, :]
                variance = np.minimum(np.nan_to_num(np.maximum(variance, 0.0), nan=MOST), MOST)
                variance, gain = _limited(self.value[k], variance, limits)
                result[..., k, :] = variance
                window[..., 1:, 1:] = window[..., :-1, :-1]
                window[..., 0, 0] = variance
                window[..., 0, 1:] = window[..., 1:, 0] = np.clip(gain[..., None] * across[..., :-1], -MOST, MOST)
        result[result >= MOST] = np.inf
        return result


def _limited(value: Float, variance: Float, limits: tuple[float, float]) -> tuple[Float, Float]:
    """Return the variance of a limited output about that of `value`, and its mean slope, for a normal error."""
    if limits == UNLIMITED:
        return variance, np.ones_like(variance)
    from scipy.special import ndtr

    spread = np.sqrt(np.maximum(variance, 1e-300))
    middle = np.clip(value, *limits)
    low, high = (np.clip((limit - value) / spread, -1e10, 1e10) for limit in limits)
    inside = ndtr(high) - ndtr(low)
    density_low, density_high = (np.exp(-0.5 * end**2) / np.sqrt(2 * np.pi) for end in (low, high))
    # moments of the error within the limits, about `middle`, then those at the limits
    shift = value - middle
    first = spread * (density_low - density_high)
    second = variance * (inside + low * density_low - high * density_high)
    square = second + 2 * shift * first + shift**2 * inside
    for limit, share in ((limits[0], ndtr(low)), (limits[1], ndtr(-high))):
        if np.isfinite(limit):
            square = square + share * (limit - middle) ** 2
    return np.maximum(square, 0.0), inside
