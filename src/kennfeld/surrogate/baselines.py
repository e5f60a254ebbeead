"""Linear baselines of a data-driven model: a plane over the inputs, and an ARX model in free run.

A model that does not beat them has learnt nothing of the nonlinearity, or is overfitted.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.recursion import UNLIMITED, Lags, Recording, Runs, simulate

ORDERS = (1, 2, 3, 4, 6, 8)  # of an ARX model that are tried
RCOND = 1e-10  # of the largest singular value: directions below are left at 0


@dataclass(frozen=True, eq=False)
class LinearRecursion:
    """y_k = offset + slopes . [y_{k-l}, u_{j,k-l}], an expansion without bells."""

    expansion: Expansion
    lags: Lags


def plane(x: Float, y: Float) -> Expansion:
    """Fit the plane of least squares through points Float[points, inputs] and values Float[points].

    >>> flat = plane(np.array([[0.0], [1.0], [2.0]]), np.array([1.0, 3.0, 5.0]))
    >>> round(float(flat(np.array([4.0]))), 9)
    9.0
    """
    middle, spread = x.mean(0), x.std(0)
    # an input that is constant over these samples, such as those of a block, has the slope 0
    spread = np.where(spread > 0, spread, 1.0)
    # centred and scaled, so that the cut of small singular values does not depend on units
    coefficients = np.linalg.lstsq((x - middle) / spread, y - y.mean(), rcond=RCOND)[0] / spread
    return _linear(float(y.mean() - coefficients @ middle), coefficients)


def _linear(offset: float, slopes: Float) -> Expansion:
    return Expansion(offset, slopes, np.empty(0), np.empty((0, slopes.size)), np.empty((0, slopes.size)))


def arx(
    pieces: Sequence[Recording], limits: tuple[float, float] = UNLIMITED, further: Sequence[Lags] = ()
) -> LinearRecursion:
    """Return the linear autoregressive model with exogenous inputs whose free run meets the recordings best.

    Coefficients are those of least squares one step ahead (L. Ljung: System Identification, 1999, section 4.2). The
    orders 1 to 8, the same for the output and all inputs, with and without the present input, and the lags in `further`
    are tried. Samples at the limits are not used for the coefficients.

    Raises:
        ArgumentError: no piece is longer than one sample.
    """
    inputs = pieces[0].u.shape[1]
    longest = max(len(piece) for piece in pieces) - 1
    # half of the longest piece at most, so that samples are left to score
    orders = [n for n in ORDERS if 2 * n <= longest] or [1]
    # first = 0 reads the present input, 1 does not
    tried = [Lags(tuple(range(1, n + 1)), (tuple(range(first, n + 1)),) * inputs) for n in orders for first in (0, 1)]
    models = [LinearRecursion(one_step_plane(Runs.of(pieces, lags), limits), lags) for lags in (*tried, *further)]
    return min(models, key=lambda model: free_run_rmse(model, pieces, limits))


def one_step_plane(runs: Runs, limits: tuple[float, float]) -> Expansion:
    """Return the plane of least squares one step ahead, without the samples at the limits."""
    target = runs.one_step_target
    inside = (target > limits[0]) & (target < limits[1])
    return plane(runs.points[inside], target[inside])


def free_run_rmse(model: LinearRecursion, pieces: Sequence[Recording], limits: tuple[float, float]) -> float:
    """Return the RMSE of the free run from the first measured outputs on; infinite if it diverges."""
    residual = free_run_residual(model, pieces, limits)
    with np.errstate(over="ignore", invalid="ignore"):
        rmse = float(np.sqrt(np.mean(residual**2)))
    return rmse if np.isfinite(rmse) else np.inf


def free_run_residual(model: LinearRecursion, pieces: Sequence[Recording], limits: tuple[float, float]) -> Float:
    """Simulate the free run, and return its residual at the samples that count, Float[samples]."""
    runs = Runs.of(pieces, model.lags, max(model.lags.output))
    residual: Float = (simulate(model.expansion, runs, limits).y - runs.target).T[runs.scored.T]
    return residual
