"""The squared-exponential kernel with one length scale an input (automatic relevance determination)."""

import numpy as np

from kennfeld.arrays import Float

__all__ = ["bells", "bend_by_lengths", "factor"]

JITTER = 1e-8  # share of the kernel's variance
MOST_JITTER = 1e-2


def bells(x: Float, z: Float, lengths: Float) -> Float:
    """exp(-1/2 sum_d ((x_d - z_d) / lengths_d)^2) between points and centres: Float[points, centres]."""
    a, b = x / lengths, z / lengths
    exponent = a @ b.T
    exponent -= 0.5 * np.einsum("id,id->i", a, a)[:, None]
    exponent -= 0.5 * np.einsum("id,id->i", b, b)
    np.minimum(exponent, 0.0, out=exponent)
    return np.exp(exponent, out=exponent)


def bend_by_lengths(weighted: Float, x: Float, z: Float, lengths: Float) -> Float:
    """sum_ij weighted_ij ((x_id - z_jd) / lengths_d)^2 for each input d.

    With `weighted` = dF/dK times K, this is the derivative of F by the logarithms of the lengths.
    """
    a, b = x / lengths, z / lengths
    across = np.einsum("id,id->d", a, weighted @ b)
    bent: Float = weighted.sum(1) @ (a * a) + weighted.sum(0) @ (b * b) - 2 * across
    return bent


def factor(matrix: Float) -> Float:
    """Lower Cholesky factor of a kernel matrix, with just as much added to its diagonal as that takes."""
    jitter = JITTER
    while True:
        padded = matrix.copy()
        padded.flat[:: len(matrix) + 1] += jitter
        try:
            return np.asarray(np.linalg.cholesky(padded), dtype=np.float64)
        except np.linalg.LinAlgError:
            if jitter >= MOST_JITTER:
                raise
            jitter *= 10
