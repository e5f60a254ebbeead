"""Curvatures of lookups in a map, which are sparse."""

import numpy as np


def lookups(rows, columns, count, seed=0, shared=0):
    """Random bilinear lookups in a map, as the rows of a Jacobian; all samples touch `shared` more values."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(0, rows - 1, count), random.uniform(0, columns - 1, count)
    jacobian = np.zeros((count, rows * columns + shared))
    i, j = np.minimum(x.astype(int), rows - 2), np.minimum(y.astype(int), columns - 2)
    u, v = x - i, y - j
    for a, b, weight in ((0, 0, (1 - u) * (1 - v)), (0, 1, (1 - u) * v), (1, 0, u * (1 - v)), (1, 1, u * v)):
        jacobian[np.arange(count), (i + a) * columns + j + b] = weight
    jacobian[:, rows * columns :] = random.normal(size=(count, shared))
    return jacobian


def curvature(jacobian):
    return jacobian.T @ jacobian
