"""The F distribution is that of scipy."""

import numpy as np
import pytest
from scipy.special import fdtrc, fdtri, ncfdtr

from kennfeld.analysis.missing.f_distribution import detected_noncentrality, f_quantile, f_tail


@pytest.mark.parametrize(("m", "n"), [(1, 1), (1, 10), (5, 39), (6, 97.5), (30, 12), (3, 1e6), (1, 0.5)])
def test_tail_and_quantile_are_those_of_scipy(m, n):
    for x in np.geomspace(1e-6, 1e6, 40):
        assert f_tail(x, m, n) == pytest.approx(fdtrc(m, n, x), rel=1e-8, abs=1e-300)
    for p in (0.5, 1e-2, 1e-5, 1e-8):
        assert f_quantile(p, m, n) == pytest.approx(fdtri(m, n, 1 - p), rel=1e-6)


def test_ends_of_the_range_have_their_probabilities():
    assert (f_tail(0.0, 3, 4), f_tail(-1.0, 3, 4), f_tail(np.inf, 3, 4)) == (1.0, 1.0, 0.0)


@pytest.mark.parametrize("power", [0.5, 0.9])
@pytest.mark.parametrize(("m", "n"), [(1, 30), (5, 39), (5, 1e5)])
def test_an_effect_is_detected_as_often_as_stated(m, n, power):
    for level in (1e-2, 1e-5):
        noncentrality = detected_noncentrality(level, power, m, n)
        assert 1 - ncfdtr(m, n, noncentrality, f_quantile(level, m, n)) == pytest.approx(power, abs=0.02)
