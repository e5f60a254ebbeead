"""Static Gaussian process: squared-exponential kernel with a length scale per input, linear mean, estimated noise.

For comparison, scikit-learn's `GaussianProcessRegressor` (one thread, 5 inputs) takes 0.9 s for 500 points, 9.4 s with
four more starts, and 24 s for 2000 points; this one takes 0.7 s and 5.3 s with three starts. The former has a constant
mean, no sparse approximation and no leave-one-out residuals. See `docs/surrogates.md`.
"""

from collections.abc import Sequence
from typing import Literal

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.lazy_dataclass import dataclass
from kennfeld.rbf import Expansion
from kennfeld.surrogate.exact_gp import Exact
from kennfeld.surrogate.gp_kernel import greedy_centres
from kennfeld.surrogate.hyperparameters import exact_hyperparameters, sparse_hyperparameters
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.training_data import Scaling, check_points
from kennfeld.surrogate.validity import Validity

Method = Literal["auto", "exact", "sparse"]

MOST_EXACT = 1000
MOST_FORCED = 10_000  # the kernel matrix takes 0.8 GB there


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """The mean of a trained process, the range it is valid in, and its residuals; all in physical units.

    `left_out` is the residual at each training point, Float[points], without that point, in closed form. Length scales
    and noise, and the inducing inputs of a sparse process, are those of all points.
    """

    expansion: Expansion
    validity: Validity
    left_out: Float


def gaussian_process(
    x: Float,
    y: Float,
    *,
    method: Method = "auto",
    centres: int = 300,
    starts: int = 3,
    seed: int = 0,
    names: Sequence[str] = (),
    stopped: Stopped = never,
) -> GaussianProcess:
    """Train a process on points `x` Float[points, inputs] and values `y` Float[points], in physical units.

    "auto" is exact up to 1000 points and else sparse with `centres` inducing inputs, chosen greedily by variance; its
    length scales are searched on at most 3000 points, its noise on all. `starts` searches begin at places that `seed`
    draws. `names` of the inputs appear in messages. Once `stopped` returns true, the search ends at the best so far.
    Raises `ArgumentError` if the points cannot be used.

    >>> import numpy as np
    >>> x = np.linspace(0, 6, 40)[:, None]
    >>> process = gaussian_process(x, np.sin(x[:, 0]))
    >>> bool(abs(process.expansion(np.array([2.05])) - np.sin(2.05)) < 1e-3)
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
    inner, target = scaling.inward(points), (values - scaling.level) / scaling.height
    process: Exact | Sparse
    if method == "exact" or (method == "auto" and len(points) <= MOST_EXACT):
        process = Exact.at(inner, target, *exact_hyperparameters(inner, target, starts, seed, stopped=stopped))
    else:
        lengths, noise = sparse_hyperparameters(inner, target, centres, starts, seed, stopped=stopped)
        process = Sparse.at(inner, target, greedy_centres(inner, centres, lengths, seed), lengths, noise)
    return GaussianProcess(
        scaling.expansion(*process.terms(), process.lengths),
        Validity.around(points, scaling.spread * process.lengths, seed),
        scaling.height * process.left_out(),
    )
