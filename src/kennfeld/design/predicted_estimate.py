"""Prediction of the uncertainty after further measurements."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.threads import blas_threads
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.information_matrix import Spectrum
from kennfeld.optimize.trust.matrices import Matrix, whole


def estimate_with(fitted: FittedFunction, added: Float, scatter: Float) -> Estimate:
    """Return the estimate of the fit with further data, whose noise is that of the present data.

    Args:
        fitted: the fit before.
        added: Gauss-Newton matrix of the further data at the fitted values, Float[free, free].
        scatter: variance of the gradient by their noise, Float[free, free].
    """
    before = fitted.estimate
    more, noise_of_more = whole(before.reduction.matrix(added)), whole(before.reduction.matrix(scatter))
    data = _expand(before, before.data) + more
    smoothness = _expand(before, before.smoothness)
    seen = np.diagonal(data + smoothness) > 0
    known = np.ix_(seen, seen)
    noise = None if before.noise is None else (_expand(before, before.noise) + noise_of_more)[known]
    with blas_threads(seen.size):
        spectrum = Spectrum.of_matrix((data + smoothness)[known])
    own = before.own + np.diagonal(added)
    return replace(
        before,
        seen=seen,
        spectrum=spectrum,
        data=data[known],
        smoothness=smoothness[known],
        noise=noise,
        own=own,
        informed=before.informed | (own > 0),
    )


def _expand(before: Estimate, matrix: Matrix) -> Float:
    """Return a matrix over the values of the estimate as one over all independent values."""
    known = np.flatnonzero(before.seen)
    full = np.zeros((before.seen.size,) * 2)
    full[np.ix_(known, known)] = whole(matrix)
    return full


def split_values(fitted: FittedFunction, values: Float) -> Mapping[str, Float]:
    """Return an array over the free values by parameter, in the shape of each."""
    shapes = {name: fitted.trust.deviation[name].shape for name in fitted.blocks if name in fitted.trust.deviation}
    return {
        name: values[first : first + size].reshape(shapes.get(name, (size,)))
        for name, (first, size) in fitted.blocks.items()
    }


def deviations(fitted: FittedFunction, added: tuple[Float, Float] | None = None) -> Mapping[str, Float]:
    """Return the standard deviations of all values by parameter, before or after data.

    Of these, the Gauss-Newton matrix and the variance of the gradient are needed; see `estimate_with`.

    Before, they are those of the trust of the fit, with the distance to a second minimum. `inf` is undetermined.
    """
    if added is None:
        return {name: fitted.trust.deviation[name] for name in fitted.blocks if name in fitted.trust.deviation}
    return split_values(fitted, estimate_with(fitted, *added).deviation(error=True))
