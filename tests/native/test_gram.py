"""Products of sparse rows through a factor against those of full matrices."""

import numpy as np
from hypothesis import strategies as st

from kennfeld.native import Cholesky, Factor, Gram
from tests.draws import few_or_many


def tied(size, random):
    """A positive definite matrix with the pattern of a curve, its values shuffled, and one value that ties them all."""
    pattern = np.abs(np.subtract.outer(np.arange(size), np.arange(size))) < 3
    pattern[0], pattern[:, 0] = True, True
    matrix = np.where(pattern, random.standard_normal((size, size)), 0.0)
    matrix = matrix + matrix.T + 8 * size * np.eye(size)
    shuffle = random.permutation(size)
    return matrix[np.ix_(shuffle, shuffle)]


def some_rows(count, size, random):
    """Sparse rows: columns may come twice, and coefficients be 0."""
    return random.integers(0, size, (count, 3)), random.choice([0.0, 1.0, -1.0, 2.5], (count, 3))


def full(columns, coefficients, size):
    rows = np.zeros((len(columns), size))
    np.add.at(rows, (np.arange(len(columns))[:, None], columns), coefficients)
    return rows


@few_or_many(
    st.integers(1, 60),
    st.lists(st.integers(0, 25), min_size=1, max_size=4),
    st.integers(0, 2**32 - 1),
    few=20,
    many=100,
)
def test_products_are_those_of_full_matrices_however_the_rows_come(size, counts, seed):
    random = np.random.default_rng(seed)
    matrix = tied(size, random)
    gram, rows = Gram(Cholesky(size).factor(matrix, np.zeros(size))), np.zeros((0, size))
    for count in counts:
        columns, coefficients = some_rows(count, size, random)
        gram.add(columns, coefficients)
        rows = np.vstack([rows, full(columns, coefficients, size)])
        np.testing.assert_allclose(gram.products, rows @ np.linalg.solve(matrix, rows.T), rtol=1e-9, atol=1e-12)


def test_products_are_symmetric_bit_for_bit():
    random = np.random.default_rng(1)
    gram = Gram(Cholesky(30).factor(tied(30, random), np.zeros(30)))
    gram.add(*some_rows(21, 30, random))
    gram.add(*some_rows(5, 30, random))
    assert np.array_equal(gram.products, gram.products.T)


def test_rows_without_values_have_no_products():
    gram = Gram(Factor.of(np.eye(4)))
    gram.add(np.array([[2, 0], [0, 0]]), np.array([[1.0, 0.0], [0.0, 0.0]]))
    assert gram.products.tolist() == [[1.0, 0.0], [0.0, 0.0]]
