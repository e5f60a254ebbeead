import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.analysis.autocorrelation import autocorrelation
from kennfeld.optimize.trust.persistence import SAMPLES_PER_BLOCK
from tests.draws import few_or_many


def slowly(error, edges, lag):
    """The definition, pair by pair."""
    known = np.isfinite(error)
    centred = np.where(known, error - error[known].mean(), np.nan)
    pairs = [(centred[i], centred[i + lag]) for a, b in edges for i in range(a, b - lag) if known[i] and known[i + lag]]
    return np.mean([x * y for x, y in pairs]) if pairs else 0.0


@few_or_many(st.integers(0, 10_000), st.integers(8, 60), st.integers(8, 40), st.floats(0, 0.4), few=6, many=100)
def test_is_the_mean_over_all_pairs_within_a_piece(seed, first, second, missing):
    rng = np.random.default_rng(seed)
    error = rng.normal(size=first + second) + 3.0
    error[rng.random(error.size) < missing] = np.nan
    found = autocorrelation(error, [0, first])
    if found is None:
        assert np.isfinite(error).sum() < 8
        return
    edges = [(0, first), (first, error.size)]
    expected = np.array([slowly(error, edges, lag) for lag in range(found.values.size)])
    np.testing.assert_allclose(found.values, expected / expected[0], atol=1e-12)


def test_does_not_depend_on_the_size_of_the_blocks():
    rng = np.random.default_rng(0)
    error = np.convolve(rng.normal(size=2 * SAMPLES_PER_BLOCK + 4000), np.ones(20))
    found = autocorrelation(error, most=50)
    centred = error - error.mean()
    expected = [np.mean(centred[: error.size - k] * centred[k:]) for k in range(51)]
    np.testing.assert_allclose(found.values, np.array(expected) / expected[0], rtol=1e-9)


def test_errors_without_memory_are_worth_their_number():
    error = np.random.default_rng(1).normal(size=20_000)
    found = autocorrelation(error)
    assert found.independent == pytest.approx(20_000, rel=0.1)
    assert np.mean(np.abs(found.values[1:]) < found.band) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("memory", [0.5, 0.9, 0.98])
def test_independent_samples_of_a_decaying_error(memory):
    rng = np.random.default_rng(2)
    noise = rng.normal(size=200_000)
    error = np.empty_like(noise)
    error[0] = noise[0]
    for i in range(1, error.size):
        error[i] = memory * error[i - 1] + noise[i]
    found = autocorrelation(error, step=0.1)
    expected = error.size * (1 - memory) / (1 + memory)
    assert found.independent == pytest.approx(expected, rel=0.15)
    assert found.values[10] == pytest.approx(memory**10, abs=0.05)
    assert found.lags[10] == pytest.approx(1.0)
    assert found.unit == "s"


@pytest.mark.parametrize(
    "error", [np.zeros(100), np.full(100, 7.0), np.full(100, np.nan), np.ones(3), np.array([1.0, np.inf] * 50)]
)
def test_there_is_none_where_nothing_varies_or_is_known(error):
    assert autocorrelation(error) is None or np.isfinite(autocorrelation(error).values).all()


def test_lags_without_a_step_are_counted_in_samples():
    found = autocorrelation(np.random.default_rng(3).normal(size=100))
    assert found.unit == "samples"
    assert found.lags.tolist() == list(range(26))
