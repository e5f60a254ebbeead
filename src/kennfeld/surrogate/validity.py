"""Validity range of a data-driven model: the neighbourhood of its training data."""

from dataclasses import field, replace

import numpy as np

from kennfeld.base.arrays import Bool, Float, readonly
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.surrogate.gp_kernel import gaussian_kernel, greedy_centres

THRESHOLD = 0.2  # share of the prior deviation
MARGIN = 1.25
NUGGET = 1e-3
CENTRES = 200
COVERED = 0.02  # share of the variance that may stay open within the data
BLOCK = 4096


@dataclass(frozen=True, eq=False)
class Validity:
    """Distance measure from the training data, with the threshold beyond which a point is outside.

    The measure is the posterior standard deviation of a Gaussian process with the lengths of the model, given the value
    at `centres`, which cover the training data, as a share of the prior one: 0 amidst the data, 1 far away. `least` and
    `most` are the minimum and maximum of the training data along each input.
    """

    centres: Float  # Float[centres, inputs]
    lengths: Float  # Float[inputs]
    threshold: float
    least: Float  # Float[inputs]
    most: Float  # Float[inputs]
    _root: Float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("centres", "lengths", "least", "most"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        if self.centres.ndim != 2 or not self.centres.size:
            raise ArgumentError(f"centres of a validity range have shape {self.centres.shape}, not [centres, inputs]")
        for name in ("lengths", "least", "most"):
            if getattr(self, name).shape != self.centres.shape[1:]:
                raise ArgumentError(f"{name} of a validity range must be one number per input, {self.centres.shape[1]}")
        if not np.all(self.lengths > 0):
            raise ArgumentError(f"lengths of a validity range must be > 0, the smallest is {self.lengths.min():g}")
        if not 0 < self.threshold <= 1:
            raise ArgumentError(f"threshold={self.threshold} of a validity range must be > 0 and <= 1")
        kernel = gaussian_kernel(self._scale(self.centres), self._scale(self.centres), np.ones(self.lengths.size))
        object.__setattr__(self, "_root", np.linalg.cholesky(kernel + NUGGET * np.eye(len(kernel))))

    @classmethod
    def around(cls, x: Float, lengths: Float, seed: int = 0) -> "Validity":
        """Measure the range of training points Float[points, inputs].

        Distances are in units of the length scales, limited to one octave below the spread times sqrt(inputs / 2): even
        a model that does not depend on an input knows nothing of values outside the data.
        """
        # Points lie apart by the root of the number of inputs: with short lengths in many inputs, each would be alone.
        reach = np.sqrt(x.shape[1] / 2) * x.std(0)
        lengths = np.clip(lengths, 0.5 * reach, reach)
        result = cls(greedy_centres(x, CENTRES, lengths, seed, COVERED), lengths, 1.0, x.min(0), x.max(0))
        # A point that is a centre itself is near to it for sure: of few points, each is measured without itself.
        distance = result.distance(x) if 2 * len(result.centres) < len(x) else result._distance_without_itself()
        threshold = min(max(THRESHOLD, MARGIN * float(np.quantile(distance, 0.999))), 1 - 1e-6)
        return replace(result, threshold=threshold)

    def distance(self, x: Float) -> Float:
        """Compute the measure at points Float[..., inputs], from 0 to 1."""
        from scipy.linalg import solve_triangular

        shape = np.shape(x)[:-1]
        points = self._scale(np.asarray(x, dtype=np.float64).reshape(-1, self.lengths.size))
        centres, ones = self._scale(self.centres), np.ones(self.lengths.size)
        measure = np.empty(len(points))
        for first in range(0, len(points), BLOCK):
            part = slice(first, first + BLOCK)
            # a missing input counts as far away
            near = gaussian_kernel(np.nan_to_num(np.clip(points[part], -1e6, 1e6), nan=1e6), centres, ones)
            explained = solve_triangular(self._root, near.T, lower=True)
            measure[part] = np.sqrt(np.maximum(1 - np.sum(explained**2, axis=0), 0.0))
        return measure.reshape(shape)

    def _distance_without_itself(self) -> Float:
        """Return the measure at each centre, by the others."""
        inverse = np.linalg.inv(self._root @ self._root.T)
        # leave-one-out variance of a Gaussian process: 1 / (K^-1)_ii (Rasmussen and Williams, equation 5.12)
        share: Float = np.sqrt(np.clip(1 / np.diag(inverse) - NUGGET, 0.0, 1.0))
        return share

    def outside(self, x: Float) -> Bool:
        """Return whether points Float[..., inputs] are too far from the training data; a missing value is."""
        beyond: Bool = self.distance(x) > self.threshold
        return beyond

    def _scale(self, x: Float) -> Float:
        scaled: Float = (x - self.least) / self.lengths
        return scaled
