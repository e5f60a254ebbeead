"""Centres that stand for many points."""

import numpy as np

from kennfeld.arrays import Float, Int

__all__ = ["greedy", "k_means"]

ROUNDS = 30
LEFT = 1e-7  # share of the variance that is not worth another centre


def greedy(x: Float, count: int, lengths: Float, left: float = LEFT) -> Int:
    """Indices of points, each the one about which those before leave most open.

    `x` Float[points, inputs] in the units of `lengths`. It is the pivoted Cholesky factorisation of the kernel matrix
    (D. R. Burt, C. E. Rasmussen, M. van der Wilk: Convergence of Sparse Variational Inference in Gaussian Processes
    Regression, 2020), and ends early once the share of the variance left open is below `left` everywhere.
    """
    scaled = x / lengths
    square = 0.5 * np.einsum("id,id->i", scaled, scaled)
    opened = np.ones(len(x))
    first = int(np.argmin(np.sum((scaled - scaled.mean(0)) ** 2, axis=1)))
    rows = np.empty((min(count, len(x)), len(x)))
    chosen: list[int] = []
    pivot = first
    for k in range(len(rows)):
        if opened[pivot] <= left:
            break
        near = np.exp(np.minimum(scaled @ scaled[pivot] - square - square[pivot], 0.0))
        near -= rows[:k, pivot] @ rows[:k]
        rows[k] = near / np.sqrt(opened[pivot])
        opened -= rows[k] ** 2
        opened[pivot] = 0.0
        chosen.append(pivot)
        pivot = int(np.argmax(opened))
    return np.array(chosen, dtype=np.int64)


def k_means(x: Float, count: int, seed: int) -> Float:
    """Means of `count` groups of points: Float[points, inputs] -> Float[count, inputs]; fewer where points are equal.

    Lloyd's algorithm, begun with k-means++ (D. Arthur, S. Vassilvitskii, 2007).
    """
    rng = np.random.default_rng(seed)
    centres = _scattered(x, count, rng)
    for _ in range(ROUNDS):
        group = np.argmin(_distances(x, centres), axis=1)
        members = np.bincount(group, minlength=len(centres))
        sums = np.stack([np.bincount(group, x[:, d], len(centres)) for d in range(x.shape[1])], axis=1)
        moved = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], centres)
        if np.array_equal(moved, centres):
            break
        centres = moved
    return centres


def _scattered(x: Float, count: int, rng: np.random.Generator) -> Float:
    centres = [x[rng.integers(len(x))]]
    distance = np.sum((x - centres[0]) ** 2, axis=1)
    while len(centres) < count and distance.max() > 0:
        centres.append(x[rng.choice(len(x), p=distance / distance.sum())])
        distance = np.minimum(distance, np.sum((x - centres[-1]) ** 2, axis=1))
    return np.array(centres)


def _distances(x: Float, centres: Float) -> Float:
    """Squared distances less the points' own squares."""
    distances: Float = np.einsum("id,id->i", centres, centres) - 2 * (x @ centres.T)
    return distances
