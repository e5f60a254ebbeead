import numpy as np
import pytest

from kennfeld.optimize.solver.gauss_newton_model import SecantCorrection


def test_the_learnt_matrix_explains_the_last_change():
    random = np.random.default_rng(0)
    secant = SecantCorrection(4)
    for _ in range(6):
        step = random.standard_normal(4)
        explained = random.standard_normal(4)
        change = explained + random.standard_normal(4)
        change *= np.sign(change @ step)
        secant.learn(step, change, explained)
        np.testing.assert_allclose(secant.matrix @ step, change - explained, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(secant.matrix, secant.matrix.T)
        assert secant.curvature(step) == pytest.approx(step @ (change - explained))


def test_a_constant_curvature_is_learnt():
    random = np.random.default_rng(1)
    root = random.standard_normal((3, 3))
    curvature = root @ root.T
    secant = SecantCorrection(3)
    for _ in range(200):
        step = random.standard_normal(3)
        secant.learn(step, step + curvature @ step, step)
    np.testing.assert_allclose(secant.matrix, curvature, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("change", [[-1.0, 0.0], [0.0, 0.0], [np.nan, 1.0], [np.inf, 1.0]])
def test_a_change_without_information_on_curvature_is_ignored(change):
    secant = SecantCorrection(2)
    secant.learn(np.array([1.0, 0.0]), np.array(change), np.zeros(2))
    assert not secant.matrix.any()


def test_numbers_whose_squares_underflow_are_accepted():
    secant = SecantCorrection(2)
    tiny = np.array([1e-160, 1e-170])
    secant.learn(tiny, tiny, 0.5 * tiny)
    assert np.all(np.isfinite(secant.matrix))
