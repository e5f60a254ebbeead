"""Inverse and weak directions of an information matrix."""

import numpy as np
import pytest

from kennfeld.optimize.trust import information_matrix
from kennfeld.optimize.trust.information_matrix import Spectrum, root


def rows_with(null, size=9, seed=0):
    """Rows in uneven units whose product does not see the given directions."""
    rng = np.random.default_rng(seed)
    units = 10.0 ** rng.uniform(-3, 3, size)
    rows = rng.normal(size=(40, size)) * units
    for direction in null:
        rows -= np.outer(rows @ direction, direction) / (direction @ direction)
    return rows


def test_a_sound_matrix_is_inverted_and_its_weakest_directions_come_first():
    rows = rows_with([])
    spectrum = Spectrum.of_matrix(rows.T @ rows)
    assert spectrum.null.shape[1] == 0
    assert spectrum.inverse.array == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-6)
    scaled = rows / spectrum.scale
    values = np.linalg.eigvalsh(scaled.T @ scaled)
    assert spectrum.weakness == pytest.approx(values, rel=1e-6)


def test_rows_and_their_product_have_the_same_spectrum():
    rows = rows_with([])
    a, b = Spectrum.of_rows(rows), Spectrum.of_matrix(rows.T @ rows)
    assert a.inverse.array == pytest.approx(b.inverse.array, rel=1e-6, abs=0)
    assert a.weakness == pytest.approx(b.weakness, rel=1e-6)


@pytest.mark.parametrize("make", [Spectrum.of_rows, lambda rows: Spectrum.of_matrix(rows.T @ rows)])
def test_undetermined_directions_are_excluded_from_the_inverse(make):
    rng = np.random.default_rng(1)
    scaled = rng.normal(size=(40, 8))
    scaled[:, 5] = scaled[:, 2]
    scaled[:, 7] = -scaled[:, 1]
    spectrum = make(scaled * 10.0 ** np.arange(8))
    assert spectrum.null.shape[1] == 2
    assert np.flatnonzero(spectrum.loose).tolist() == [1, 2, 5, 7]
    pairs = [np.flatnonzero(np.abs(d) > 0).tolist() for d in spectrum.directions[:2]]
    assert sorted(pairs) == [[1, 7], [2, 5]]
    determined = [0, 3, 4, 6]
    matrix = (scaled * 10.0 ** np.arange(8)).T @ (scaled * 10.0 ** np.arange(8))
    assert matrix @ spectrum.inverse.array @ matrix == pytest.approx(matrix, rel=1e-5)
    assert np.all(spectrum.inverse.diagonal[determined] > 0)


def test_rows_resolve_directions_that_their_product_loses():
    x = np.linspace(1, 2, 50)
    rows = np.stack([x, x + 1e-9 * np.sin(9 * x)], axis=1)
    spectrum = Spectrum.of_rows(rows)
    assert spectrum.null.shape[1] == 0
    assert spectrum.weakness[0] == pytest.approx(np.linalg.svd(rows / spectrum.scale)[1][-1] ** 2, rel=1e-3)


def test_fewer_rows_than_values_leave_undetermined_directions():
    assert Spectrum.of_rows(np.array([[1.0, 1.0, 0.5]])).null.shape == (3, 2)


def test_the_root_squares_to_the_matrix():
    rows = rows_with([], 6)
    assert root(rows.T @ rows) @ root(rows.T @ rows) == pytest.approx(rows.T @ rows, rel=1e-6)


def test_a_large_matrix_has_the_same_inverse_by_its_factor():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(700, 600))
    matrix = rows.T @ rows
    scale = np.sqrt(np.diag(matrix))
    matrix = matrix / scale / scale[:, None]
    inverse = information_matrix._inverse_by_factor(matrix)
    np.testing.assert_array_equal(inverse, inverse.T)
    np.testing.assert_allclose(inverse, information_matrix._inverse(matrix), atol=1e-12 * np.abs(inverse).max())
    with pytest.raises(np.linalg.LinAlgError):
        information_matrix._inverse_by_factor(np.ones((3, 3)))
