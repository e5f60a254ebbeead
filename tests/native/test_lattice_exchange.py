import itertools

import numpy as np
import pytest
from scipy.sparse import csr_array

from kennfeld.native.lattice_exchange import LatticeExchange


def random_exchange(seed, size=7, rows=0):
    """A random matrix with some zeros, a centre, and rows that its nearest numbers keep."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2 * size, size)) * (rng.random((2 * size, size)) < 0.5)
    matrix = root.T @ root + 0.1 * np.eye(size)
    centre = 5 * rng.normal(size=size)
    factors = rng.integers(-2, 3, size=(rows, size)).astype(float)
    product = factors @ np.rint(centre)
    least, most = product - rng.integers(0, 3, rows), product + rng.integers(0, 3, rows)
    lower, upper = np.ceil(centre - 2), np.floor(centre + 2)
    exchange = LatticeExchange(csr_array(matrix), lower, upper, csr_array(factors), least, most)
    return exchange, matrix, centre, (lower, upper), (factors, least, most)


def moves(size):
    """All moves of one value or of two by one step."""
    for i in range(size):
        for s in (1.0, -1.0):
            yield np.eye(size)[i] * s
            for j, t in itertools.product(range(i), (1.0, -1.0)):
                yield np.eye(size)[i] * s + np.eye(size)[j] * t


@pytest.mark.parametrize("rows", [0, 3])
@pytest.mark.parametrize("seed", range(12))
def test_no_allowed_move_of_one_or_two_values_is_left_that_descends(seed, rows):
    exchange, matrix, centre, (lower, upper), (factors, least, most) = random_exchange(seed, rows=rows)

    def cost(numbers):
        return (numbers - centre) @ matrix @ (numbers - centre)

    def allowed(numbers):
        product = factors @ numbers
        return np.all((numbers >= lower) & (numbers <= upper)) and np.all((product >= least) & (product <= most))

    start = np.rint(centre)
    end = exchange.improve(start, centre, 50)
    assert allowed(end)
    assert cost(end) <= cost(start)
    assert exchange.cost(end - centre) == pytest.approx(cost(end))
    neighbours = [end + move for move in moves(centre.size)]
    assert min(cost(each) for each in neighbours if allowed(each)) >= cost(end) * (1 - 1e-9)


def test_a_pair_moves_where_neither_value_may_alone():
    # z0 + z1 = 1 holds; the centre lies at (1, 0), the start at (0, 1)
    rows = csr_array(np.ones((1, 2)))
    matrix = csr_array(np.array([[1.0, 0.1], [0.1, 1.0]]))
    bounds, side = (np.full(2, -5.0), np.full(2, 5.0)), np.ones(1)
    exchange = LatticeExchange(matrix, *bounds, rows, side, side)
    end = exchange.improve(np.array([0.0, 1.0]), np.array([1.0, 0.0]), 5)
    np.testing.assert_array_equal(end, [1.0, 0.0])


def test_without_values_nothing_happens():
    empty = csr_array((0, 0))
    exchange = LatticeExchange(empty, np.zeros(0), np.zeros(0), empty, np.zeros(0), np.zeros(0))
    assert exchange.improve(np.zeros(0), np.zeros(0), 3).size == 0
