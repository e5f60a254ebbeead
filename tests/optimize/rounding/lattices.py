"""Lattices around random fits, for tests."""

import itertools

import numpy as np
from scipy.sparse import csr_array

from kennfeld.optimize.rounding.lattice import Lattice
from kennfeld.optimize.solver.linear_constraints import LinearRows


def lattice_of(centre, rows=None, max_shift=2.0):
    """The whole numbers around a centre; rows are those of a full matrix with its sides."""
    limits = LinearRows.none() if rows is None else LinearRows.of(*rows)
    size = centre.size
    lower, upper = np.ceil(centre - max_shift), np.floor(centre + max_shift)
    return Lattice(centre.copy(), (), np.arange(size), np.ones(size), centre, lower, upper, limits)


def correlated(rng, size, samples=None):
    """A curvature in which neighbours make up for each other, as in a table."""
    root = rng.normal(size=(samples or 2 * size, size))
    root[:, 1:] += 0.8 * root[:, :-1]
    return csr_array(root.T @ root)


def least_cost(lattice, matrix):
    """The lowest cost of all whole numbers that keep bounds and rows, by trying them."""
    ranges = [np.arange(low, high + 1) for low, high in zip(lattice.lower, lattice.upper, strict=True)]
    numbers = np.array(list(itertools.product(*ranges)))
    rows = lattice.rows.matrix(np.arange(lattice.rows.count), lattice.size)
    products = numbers @ rows.T
    kept = np.all((products >= lattice.rows.lower) & (products <= lattice.rows.upper), axis=1)
    offsets = numbers[kept] - lattice.centre
    return float(np.einsum("ij,ij->i", offsets @ matrix.toarray(), offsets).min())


def cost_of(lattice, matrix, numbers):
    offset = numbers - lattice.centre
    return float(offset @ (matrix @ offset))
