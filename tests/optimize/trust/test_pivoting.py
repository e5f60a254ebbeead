"""Bases that do not depend on how they were computed."""

import numpy as np
import pytest

from kennfeld.optimize.trust.information_matrix import Spectrum, echelon, nullity, pivots


def turned(basis, seed):
    """Another orthonormal basis of the same space."""
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(basis.shape[1],) * 2))
    return basis @ rotation


def basis_of(size, dimension, seed=0):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(size, dimension)))[0]


@pytest.mark.parametrize(("size", "dimension"), [(3, 1), (12, 5), (40, 30), (7, 7)])
def test_pivots_and_echelon_are_those_of_the_space_not_of_its_basis(size, dimension):
    basis = basis_of(size, dimension)
    chosen = pivots(basis)
    assert sorted(set(chosen.tolist())) == sorted(chosen.tolist())
    assert chosen.size == dimension
    for seed in range(5):
        other = turned(basis, seed)
        assert pivots(other).tolist() == chosen.tolist()
        assert echelon(other, chosen) == pytest.approx(echelon(basis, chosen), abs=1e-9)


def test_values_of_equal_weight_are_chosen_in_their_order():
    pairs = np.kron(np.eye(3), [[1.0], [-1.0]]) / np.sqrt(2)
    for seed in range(10):
        assert pivots(turned(pairs, seed)).tolist() == [0, 2, 4]


def test_every_change_of_the_space_moves_a_pivot():
    basis = basis_of(20, 6)
    changes = echelon(basis, pivots(basis))
    assert changes[pivots(basis)] == pytest.approx(np.eye(6))
    assert np.linalg.matrix_rank(np.hstack([basis, changes])) == 6


def test_a_space_of_no_dimension_has_no_pivots():
    assert pivots(np.zeros((4, 0))).size == 0


@pytest.mark.parametrize(("size", "rank"), [(5, 5), (30, 12), (200, 199), (3, 1)])
def test_the_nullity_of_a_product_is_size_minus_rank(size, rank):
    rows = np.random.default_rng(size).normal(size=(rank, size)) * np.logspace(-6, 6, size)
    assert nullity(rows.T @ rows) == size - rank


def test_directions_of_equal_weakness_are_reproducible():
    """Two pairs of values that are alike: an eigenvalue routine may mix them in any way."""
    values = np.array([1e-6, 1e-6, 2.0, 2.0])
    pairs = np.kron(np.eye(2), [[1.0, 1.0], [-1.0, 1.0]])[:, [0, 2, 1, 3]] / np.sqrt(2)
    rounded = []
    for seed in range(5):
        vectors = np.hstack([turned(pairs[:, :2], seed), turned(pairs[:, 2:], seed + 9)])
        directions = Spectrum(np.ones(4), np.eye(4), np.zeros((4, 0)), vectors, values).directions[:2]
        rounded.append(np.round(directions, 9).tolist())
    assert rounded == rounded[:1] * 5
    assert [np.count_nonzero(direction) for direction in rounded[0]] == [2, 2]
