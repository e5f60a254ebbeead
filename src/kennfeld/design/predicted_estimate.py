"""Prediction of the uncertainty after further measurements.

It is exact for a function that is linear in its values. The slopes of others depend on values that are not known yet:
that of a time constant on the steps between the values that it leads to. The deviations are therefore also computed at
sets of values drawn from the covariance of the fit. How far these differ is how far those of a refit, whose values are
one more such set, may differ from the prediction.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float, ignore_floating_errors
from kennfeld.base.formatting import count_noun
from kennfeld.base.threads import blas_threads
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.design.value_text import ValueNames
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.information_matrix import Spectrum
from kennfeld.optimize.trust.matrices import Matrix, whole

DRAWS = 8  # sets of values; the deviation of a refit lies between the extremes of 9 in 8 cases of 10
MOST_VALUES = 1000  # whose matrices are inverted at each of them
ROUNDING = 1e-6
NOTICEABLE = 1.1  # ratio of deviations that is worth a sentence
Curvature = Callable[[Float], Float]  # Gauss-Newton matrix of further data at some values, Float[free, free]


def estimate_with(fitted: FittedFunction, added: Float, scatter: Float) -> Estimate:
    """Return the estimate of the fit with further data, whose noise is that of the present data.

    Args:
        fitted: the fit before.
        added: Gauss-Newton matrix of the further data at the fitted values, Float[free, free].
        scatter: variance of the gradient by their noise, Float[free, free].
    """
    before = fitted.estimate
    more, noise_of_more = whole(before.reduction.matrix(added)), whole(before.reduction.matrix(scatter))
    data = expand_matrix(before, before.data) + more
    smoothness = expand_matrix(before, before.smoothness)
    seen = np.diagonal(data + smoothness) > 0
    known = np.ix_(seen, seen)
    noise = None if before.noise is None else (expand_matrix(before, before.noise) + noise_of_more)[known]
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


def expand_matrix(before: Estimate, matrix: Matrix) -> Float:
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

    They contain the distance to a second minimum, as those of the trust of the fit do: whether further data tell it
    from the first one is known once these are fitted. `inf` is undetermined.
    """
    if added is None:
        known = {name: fitted.trust.deviation[name] for name in fitted.blocks if name in fitted.trust.deviation}
        # nothing is known yet of what only further data have
        open_values = split_values(fitted, np.where(fitted.unknown, np.inf, 0.0))
        return {name: np.asarray(np.maximum(own, open_values[name])) for name, own in known.items()}
    after = split_values(fitted, estimate_with(fitted, *added).deviation(error=True))
    apart = _distances(fitted)
    return {name: np.asarray(np.sqrt(own**2 + apart[name])) if name in apart else own for name, own in after.items()}


def _distances(fitted: FittedFunction) -> Mapping[str, Float]:
    """Return the mean square distance of each value to a second minimum, by parameter with one."""
    local = split_values(fitted, fitted.estimate.deviation(error=True))
    distances = dict[str, Float]()
    for name, whole_deviation in fitted.trust.deviation.items():
        if name in local:
            finite = np.isfinite(whole_deviation) & np.isfinite(local[name])
            square, own = (np.where(finite, each, 0.0) ** 2 for each in (whole_deviation, local[name]))
            if np.any(square > own * (1 + ROUNDING)):
                distances[name] = np.maximum(square - own, 0.0)
    return distances


def curvatures_at(fitted: FittedFunction, added: Curvature, seed: int = 0) -> list[Float]:
    """Return curvatures over the free values with further data, first at the fit, then at plausible values.

    Each is Float[free, free], of all data, without smoothness. Sets of values at which the function fails are left out;
    of more values than can be inverted so often, there is none.
    """
    if fitted.values.size > MOST_VALUES:
        return []
    matrices = list[Float]()
    for values in fitted.draws(seed, DRAWS):
        with ignore_floating_errors():
            own = as_array(fitted.compiled.sums.normal(fitted.compiled.full(values)).matrix)
            matrix = own + added(values)
        if np.isfinite(matrix).all():
            matrices.append(matrix)
    return matrices


def deviation_range(
    fitted: FittedFunction, after: Mapping[str, Float], added: Curvature, seed: int = 0
) -> tuple[Mapping[str, Float], Mapping[str, Float]]:
    """Return the least and the greatest deviation of each value at plausible values; nothing if there are too many.

    Args:
        fitted: the fit before.
        after: the deviations as predicted at the fit, by parameter.
        added: curvature of the further data.
        seed: of the sets of values.
    """
    before, sizes = fitted.estimate, list[Float]()
    for matrix in curvatures_at(fitted, added, seed):
        data = whole(before.reduction.matrix(matrix))
        smoothness = expand_matrix(before, before.smoothness)
        seen = np.diagonal(data + smoothness) > 0
        with blas_threads(seen.size):
            spectrum = Spectrum.of_matrix((data + smoothness)[np.ix_(seen, seen)])
        there = replace(before, seen=seen, spectrum=spectrum, noise=None)
        sizes.append(there.deviation(error=True))
    if len(sizes) < 2:
        return {}, {}
    here = sizes[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = np.array(sizes) / here
    # what is known, or undetermined, at all of them has no range
    ratios[np.isnan(ratios)] = 1.0
    ranges = (split_values(fitted, each) for each in (ratios.min(axis=0), ratios.max(axis=0)))
    apart = _distances(fitted)
    least, most = (
        {name: _scaled(after[name], own, apart.get(name, 0.0)) for name, own in each.items() if name in after}
        for each in ranges
    )
    return least, most


def _scaled(deviation: Float, ratio: Float, apart: Float | float) -> Float:
    """Return deviations times ratios; what is known or undetermined at the fit stays so, as do other minima apart."""
    open_range = np.isfinite(deviation) & (deviation > 0)
    square = np.where(open_range, deviation, 0.0) ** 2
    factor = np.where(open_range, ratio, 1.0) ** 2
    return np.where(open_range, np.sqrt(np.maximum(square - apart, 0.0) * factor + apart), deviation)


def describe_range(
    fitted: FittedFunction, after: Mapping[str, Float], least: Mapping[str, Float], most: Mapping[str, Float]
) -> list[str]:
    """Return a sentence on the predictions that depend on values that are not known yet; none if they hardly do."""
    far = list[tuple[float, int, float, float, float]]()
    for name, (first, _) in fitted.blocks.items():
        if name in least:
            rows = zip(*(each[name].ravel().tolist() for each in (after, least, most)), strict=True)
            for at, (middle, low, high) in enumerate(rows):
                if 0 < middle < np.inf and max(high / middle, middle / low) > NOTICEABLE:
                    far.append((-high / low, first + at, middle, low, high))
    if not far:
        return []
    _, at, middle, low, high = min(far)
    total = sum(np.isfinite(own).sum() for own in after.values())
    upper = f"{high:.3g}" if np.isfinite(high) else "undetermined"
    known = f"{ValueNames(fitted).name(at)}: {middle:.3g}, or from {low:.3g} to {upper}"
    return [
        f"The predictions for {len(far)} of {count_noun(int(total), 'value')} depend on values that are not known yet, "
        f"most that of {known}."
    ]
