import numpy as np
import pytest
import scipy

from kennfeld.surrogate.student_noise import FREEDOM, student_gain, student_scale


def test_the_scale_is_the_one_of_highest_likelihood():
    residual = np.random.default_rng(0).standard_t(3, size=200)
    likelihood = lambda scale: -scipy.stats.t.logpdf(residual, FREEDOM, scale=scale).sum()  # noqa: E731
    best = scipy.optimize.minimize_scalar(likelihood, bounds=(0.1, 10), method="bounded", options={"xatol": 1e-8})
    assert student_scale(residual) == pytest.approx(best.x, rel=1e-5)


def test_the_gain_is_that_of_the_densities_of_scipy():
    residual = np.random.default_rng(0).standard_t(3, size=200)
    wide = scipy.stats.t.logpdf(residual, FREEDOM, scale=student_scale(residual))
    normal = scipy.stats.norm.logpdf(residual, scale=np.sqrt(np.mean(residual**2)))
    assert student_gain(residual, residual) == pytest.approx(scipy.stats.trim_mean(wide - normal, 0.1))


def test_few_rows_do_not_decide():
    residual = np.random.default_rng(0).normal(size=300)
    wild = np.where(np.arange(300) < 20, 30.0, residual)
    assert student_gain(residual, residual) < 0.05
    assert student_gain(wild, wild) > 1


def test_residuals_of_0_gain_nothing():
    assert (student_scale(np.zeros(5)), student_gain(np.zeros(5), np.zeros(5))) == (0.0, 0.0)
