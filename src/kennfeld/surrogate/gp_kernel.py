"""Building blocks of Gaussian processes: kernel, linear mean and selection of centres.

The kernel is the squared-exponential one or that of Matern of order 5/2, with a length scale per input (automatic
relevance determination). The mean is a plane, an offset and a slope per input, with a vague prior.
"""

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Kernel, kernel_of_square

RANK = 1e-10  # share of the largest singular value below which inputs are collinear
ROUNDS = 30  # of k-means
LEFT = 1e-7  # share of the variance below which no further centre is added
CANDIDATES = 5000  # points that greedy centres are chosen from
JITTER = 1e-8  # share of the kernel's variance
MOST_JITTER = 1e-2
LEAST_VARIANCE = 1e-24  # of f, in units of spread: the output is a plane but for rounding


@dataclass(frozen=True, eq=False)
class Plane:
    """Orthonormal basis of the planes over some points.

    Collinear inputs leave the plane undetermined in one direction; its slope is 0 there.
    """

    basis: Float  # Float[points, rank]
    back: Float  # Float[1 + inputs, rank]: from coefficients of the basis to offset and slopes

    @classmethod
    def over(cls, x: Float, weights: Float | None = None) -> "Plane":
        """Return the planes over points Float[points, inputs], each row times the root of its weight."""
        design = np.column_stack([np.ones(len(x)), x])
        if weights is not None:
            design *= np.sqrt(weights)[:, None]
        u, s, v = np.linalg.svd(design, full_matrices=False)
        keep = s > RANK * s[0]
        return cls(u[:, keep], v[keep].T / s[keep])

    @property
    def rank(self) -> int:
        """Number of directions."""
        return int(self.basis.shape[1])

    def without(self, values: Float) -> Float:
        """Remove from Float[points, ...] its projection onto the plane."""
        rest: Float = values - self.basis @ (self.basis.T @ values)
        return rest


def greedy_centres(
    x: Float, count: int, lengths: Float, seed: int, left: float = LEFT, kernel: Kernel = "gaussian"
) -> Float:
    """Return the points that `greedy` selects, of many points among some that are drawn by `seed`."""
    if len(x) > CANDIDATES:
        x = x[np.random.default_rng(seed).choice(len(x), CANDIDATES, replace=False)]
    centres: Float = x[greedy(x, count, lengths, left, kernel)]
    return centres


def greedy(x: Float, count: int, lengths: Float, left: float = LEFT, kernel: Kernel = "gaussian") -> Int:
    """Select points by index, each the one with the largest remaining variance given those before.

    `x` Float[points, inputs] in the units of `lengths`. It is the pivoted Cholesky factorisation of the kernel matrix
    (D. R. Burt, C. E. Rasmussen, M. van der Wilk: Convergence of Sparse Variational Inference in Gaussian Processes
    Regression, 2020), and ends early once the share of the variance left open is below `left` everywhere.
    """
    scaled = x / lengths
    square = 0.5 * np.einsum("id,id->i", scaled, scaled)
    variance = np.ones(len(x))
    # all variances are 1 at first: begin in the middle, whatever the order of the points
    pivot = int(np.argmin(np.sum((scaled - scaled.mean(0)) ** 2, axis=1)))
    rows = np.empty((min(count, len(x)), len(x)))
    chosen: list[int] = []
    for k in range(len(rows)):
        if variance[pivot] <= left:
            break
        near = kernel_of_square(np.maximum(2 * (square + square[pivot] - scaled @ scaled[pivot]), 0.0), kernel)[0]
        # pivoted Cholesky: row_k = (K[pivot] - sum over j < k of row_j[pivot] row_j) / sqrt(variance[pivot])
        near -= rows[:k, pivot] @ rows[:k]
        rows[k] = near / np.sqrt(variance[pivot])
        variance -= rows[k] ** 2
        # exactly, so that rounding cannot choose it twice
        variance[pivot] = 0.0
        chosen.append(pivot)
        pivot = int(np.argmax(variance))
    return np.array(chosen, dtype=np.int64)


def k_means(x: Float, count: int, seed: int) -> Float:
    """Compute `count` cluster means: Float[points, inputs] -> Float[count, inputs]; fewer if points coincide.

    Lloyd's algorithm, begun with k-means++ (D. Arthur, S. Vassilvitskii, 2007).
    """
    centres = _scatter(x, count, np.random.default_rng(seed))
    for _ in range(ROUNDS):
        # squared distances without the points' own squares
        group = np.argmin(np.einsum("id,id->i", centres, centres) - 2 * (x @ centres.T), axis=1)
        members = np.bincount(group, minlength=len(centres))
        sums = np.stack([np.bincount(group, x[:, d], len(centres)) for d in range(x.shape[1])], axis=1)
        means = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], centres)
        if np.array_equal(means, centres):
            break
        centres = means
    return centres


def _scatter(x: Float, count: int, rng: "np.random.Generator") -> Float:
    centres = [x[rng.integers(len(x))]]
    distance = np.sum((x - centres[0]) ** 2, axis=1)
    while len(centres) < count and distance.max() > 0:
        # k-means++: the next one with a probability proportional to the squared distance from those before
        centres.append(x[rng.choice(len(x), p=distance / distance.sum())])
        distance = np.minimum(distance, np.sum((x - centres[-1]) ** 2, axis=1))
    return np.array(centres)


def gaussian_kernel(x: Float, z: Float, lengths: Float) -> Float:
    """Compute exp(-1/2 sum_d ((x_d - z_d) / lengths_d)^2) of points and centres: Float[points, centres]."""
    a, b = x / lengths, z / lengths
    # |a - b|^2 = a'a - 2 a'b + b'b, one matrix product instead of an array [points, centres, inputs]
    exponent = a @ b.T
    exponent -= 0.5 * np.einsum("id,id->i", a, a)[:, None]
    exponent -= 0.5 * np.einsum("id,id->i", b, b)
    # of equal points, rounding may leave a small positive number
    np.minimum(exponent, 0.0, out=exponent)
    return np.exp(exponent, out=exponent)


def kernel_matrix(x: Float, z: Float, lengths: Float, kernel: Kernel) -> tuple[Float, Float]:
    """Compute the kernel K between points and centres, and its decline G: both Float[points, centres].

    dK_ij / d log lengths_d = G_ij ((x_id - z_jd) / lengths_d)^2; see `kernel_of_square`.
    """
    if kernel == "gaussian":
        near = gaussian_kernel(x, z, lengths)
        return near, near
    a, b = x / lengths, z / lengths
    square = -2 * (a @ b.T)
    square += np.einsum("id,id->i", a, a)[:, None]
    square += np.einsum("id,id->i", b, b)
    return kernel_of_square(np.maximum(square, 0.0, out=square), kernel)


def scaled_second_moment(weighted: Float, x: Float, z: Float, lengths: Float) -> Float:
    """Compute sum_ij weighted_ij ((x_id - z_jd) / lengths_d)^2 for each input d, Float[inputs].

    With `weighted` Float[points, centres] = dF/dK times the decline of K, this is the derivative of F by the logarithms
    of the lengths.
    """
    a, b = x / lengths, z / lengths
    # the square is expanded here, too, so that no array [points, centres, inputs] is needed
    across = np.einsum("id,id->d", a, weighted @ b)
    moment: Float = weighted.sum(1) @ (a * a) + weighted.sum(0) @ (b * b) - 2 * across
    return moment


def factor(matrix: Float) -> Float:
    """Factor a kernel matrix Float[n, n] by Cholesky, with the smallest sufficient jitter; return the lower factor."""
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
