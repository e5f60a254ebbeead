"""Values that limits leave free, and how the others follow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.optimize.trust.information_matrix import ConstraintElimination


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(0, 5), st.booleans())
def test_expanded_directions_span_the_null_space_of_the_rows(seed, size, count, repeated):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, size)) * (rng.random((count, size)) < 0.6)
    if repeated and count:
        rows = np.vstack([rows, rows.sum(axis=0)])
    fixed = rng.random(size) < 0.3
    reduction = ConstraintElimination.of(fixed, rows)
    basis = reduction.expand(np.eye(reduction.independent.size))
    assert np.allclose(basis @ rows.T, 0.0, atol=1e-6 * max(1.0, np.abs(basis).max(initial=0.0)))
    assert not basis[:, fixed].any()
    moving = rows[:, ~fixed]
    rank = np.linalg.matrix_rank(moving, tol=1e-9) if moving.size else 0
    assert reduction.independent.size == np.count_nonzero(~fixed) - rank
    matrix = rng.normal(size=(size, size))
    matrix = matrix @ matrix.T
    assert reduction.matrix(matrix) == pytest.approx(
        basis @ matrix @ basis.T, abs=1e-6 * (1 + np.abs(basis).max(initial=0.0) ** 2)
    )
    assert reduction.rows(matrix) == pytest.approx(matrix @ basis.T, abs=1e-6 * (1 + np.abs(basis).max(initial=0.0)))


def test_a_value_pinned_alone_does_not_move():
    reduction = ConstraintElimination.of(np.zeros(3, dtype=bool), np.array([[0.0, 2.0, 0.0]]))
    assert reduction.fixed.tolist() == [False, True, False]
