"""Static Gaussian process: squared-exponential kernel with a length scale per input, linear mean, estimated noise.

For comparison, scikit-learn's `GaussianProcessRegressor` (one thread, 5 inputs) takes 0.9 s for 500 points, 9.4 s with
four more starts, and 24 s for 2000 points; this one takes 0.7 s and 5.3 s with three starts. The former has a constant
mean, no sparse approximation and no leave-one-out residuals. See `docs/surrogates.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError
from kennfeld.rbf import Expansion
from kennfeld.surrogate.exact_gp import Exact
from kennfeld.surrogate.gp_kernel import greedy
from kennfeld.surrogate.hyperparameters import exact_hyperparameters, sparse_hyperparameters
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.training_data import Scaling, check_points
from kennfeld.surrogate.validity import Validity

Method = Literal["auto", "exact", "sparse"]

MOST_EXACT = 1000
MOST_FORCED = 10_000  # the kernel matrix takes 0.8 GB there
CANDIDATES = 5000
BLOCK = 4096


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """A trained process; all its numbers are in physical units."""

    expansion: Expansion
    noise: float
    relevance: Float  # Float[inputs]
    validity: Validity
    _process: Exact | Sparse
    _scaling: Scaling

    @property
    def is_sparse(self) -> bool:
        """True if inducing inputs represent the training points."""
        return isinstance(self._process, Sparse)

    def predict(self, x: Float) -> tuple[Float, Float]:
        """Return mean and standard deviation, each Float[...], at points Float[..., inputs].

        The deviation is that of the function; a new measurement deviates by sqrt(deviation^2 + noise^2).
        """
        mean = self.expansion(x)
        points = self._scaling.inward(np.asarray(x, dtype=np.float64).reshape(-1, self.expansion.inputs))
        deviation = np.empty(len(points))
        for first in range(0, len(points), BLOCK):
            part = slice(first, first + BLOCK)
            deviation[part] = self._process.deviation(points[part])
        return mean, (self._scaling.height * deviation).reshape(mean.shape)

    def leave_one_out(self) -> Float:
        """Return the residual at each training point, Float[points], without that point, in closed form.

        Length scales and noise, and the inducing inputs of a sparse process, are those of all points.
        """
        residual: Float = self._scaling.height * self._process.left_out()
        return residual

    @property
    def leave_one_out_rmse(self) -> float:
        """RMSE of `leave_one_out`."""
        return float(np.sqrt(np.mean(self.leave_one_out() ** 2)))

    def outside(self, x: Float) -> Bool:
        """Return whether points Float[..., inputs] are too far from the training data to be trusted."""
        return self.validity.outside(x)


def gaussian_process(
    x: Float,
    y: Float,
    *,
    method: Method = "auto",
    centres: int = 300,
    starts: int = 3,
    seed: int = 0,
    names: Sequence[str] = (),
) -> GaussianProcess:
    """Train a process on points `x` Float[points, inputs] and values `y` Float[points], in physical units.

    "auto" is exact up to 1000 points and else sparse with `centres` inducing inputs, chosen greedily by variance; its
    length scales are searched on at most 3000 points, its noise on all. `starts` searches begin at places that `seed`
    draws. `names` of the inputs appear in messages.
    Raises `ArgumentError` where the points cannot be used.

    >>> x = np.linspace(0, 6, 40)[:, None]
    >>> process = gaussian_process(x, np.sin(x[:, 0]))
    >>> bool(abs(process.predict(np.array([2.05]))[0] - np.sin(2.05)) < 1e-3)
    True
    """
    points, values = check_points(x, y, names)
    if method not in ("auto", "exact", "sparse"):
        raise ArgumentError(f"method={method!r} of a Gaussian process must be auto, exact or sparse")
    if centres < 1:
        raise ArgumentError(f"centres={centres} of a Gaussian process must be at least 1")
    if method == "exact" and len(points) > MOST_FORCED:
        raise ArgumentError(f"an exact Gaussian process takes at most {MOST_FORCED} points, not {len(points)}")
    scaling = Scaling.of(points, values)
    exact = method == "exact" or (method == "auto" and len(points) <= MOST_EXACT)
    inner, target = scaling.inward(points), (values - scaling.level) / scaling.height
    process = _exact(inner, target, starts, seed) if exact else _sparse(inner, target, centres, starts, seed)
    lengths = scaling.spread * process.lengths
    return GaussianProcess(
        scaling.expansion(*process.terms(), process.lengths),
        scaling.height * float(np.sqrt(process.noise * process.variance)),
        lengths,
        Validity.around(points, lengths, seed),
        process,
        scaling,
    )


def _exact(x: Float, y: Float, starts: int, seed: int) -> Exact | Sparse:
    return Exact.at(x, y, *exact_hyperparameters(x, y, starts, seed))


def _sparse(x: Float, y: Float, centres: int, starts: int, seed: int) -> Exact | Sparse:
    lengths, noise = sparse_hyperparameters(x, y, centres, starts, seed)
    few = x
    if len(x) > CANDIDATES:
        few = x[np.random.default_rng(seed).choice(len(x), CANDIDATES, replace=False)]
    return Sparse.at(x, y, few[greedy(few, centres, lengths)], lengths, noise)
