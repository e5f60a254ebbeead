import numpy as np
import pytest

from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import model_selection
from kennfeld.surrogate.lag_screening import OUTPUT, channel_lags, screen_lags
from kennfeld.surrogate.model_selection import select_lags
from kennfeld.surrogate.narx_training import TrainingSettings
from kennfeld.surrogate.recursion import Lags, Recording


def linear(*slopes):
    return Expansion(0.0, slopes, np.empty(0), np.empty((0, len(slopes))), np.empty((0, len(slopes))))


def recording(extra, samples=300, lag=3):
    """y_k = 0.6 y_{k-1} + u_{k-1} + extra * v_{k-lag}."""
    u, y = np.random.default_rng(0).normal(size=(samples, 2)), np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.6 * y[k - 1] + u[k - 1, 0] + extra * u[max(k - lag, 0), 1]
    return Recording(u, y)


POOL = Lags((1, 2), ((0, 1, 2), (0, 1, 2, 3, 4)))


@pytest.mark.parametrize("lag", [0, 2, 4])
def test_the_lag_that_is_missing_explains_most_of_the_residual(lag):
    gains = screen_lags(linear(0.6, 1.0), Lags((1,), ((1,), ())), [recording(0.3, lag=lag)], POOL, TrainingSettings())
    assert max(gains, key=gains.get) == (1, lag)
    assert set(gains) == set(channel_lags(POOL)) - {(OUTPUT, 1), (0, 1)}


def test_the_gain_is_the_squared_residual_that_the_lag_explains():
    piece = recording(0.3)
    gains = screen_lags(linear(0.6, 1.0), Lags((1,), ((1,), ())), [piece], POOL, TrainingSettings())
    without = recording(0.0)
    explained = np.sum((piece.y - without.y)[4:] ** 2) / piece.y[4:].var()
    assert gains[1, 3] == pytest.approx(explained, rel=0.05)
    assert gains[1, 1] < 0.2 * explained


def test_a_model_that_diverges_ranks_nothing():
    assert screen_lags(linear(9.0, 1.0), Lags((1,), ((1,), ())), [recording(0.3)], POOL, TrainingSettings()) == {}


@pytest.mark.slow
def test_the_selection_trains_few_of_the_candidates(monkeypatch):
    tried = []
    error = model_selection._score
    monkeypatch.setattr(model_selection, "_score", lambda pieces, lags, s: tried.append(lags) or error(pieces, lags, s))
    lags = select_lags([recording(0.5, 120, lag=4)], 2, TrainingSettings(), longest=5, output_lags=(1,))
    assert 4 in lags.inputs[1]
    assert len(tried) < 20
