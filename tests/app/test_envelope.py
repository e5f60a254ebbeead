"""Extremes by pixel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.app.session.envelope import PixelEnvelope


def reference(values: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full(edges.size - 1, np.nan), np.full(edges.size - 1, np.nan)
    for i in range(edges.size - 1):
        part = values[edges[i] : edges[i + 1]]
        part = part[np.isfinite(part)]
        if part.size:
            low[i], high[i] = part.min(), part.max()
    return low, high


@settings(max_examples=40)
@given(
    st.lists(st.floats(-10, 10) | st.just(float("nan")), min_size=1, max_size=300).map(np.array),
    st.lists(st.integers(0, 300), min_size=2, max_size=20),
)
def test_extremes_of_few_samples_are_exact(values: np.ndarray, cuts: list[int]) -> None:
    edges = np.minimum(np.sort(np.array(cuts)), values.size)
    if edges[-1] - edges[0] >= 128 * (edges.size - 1):
        return
    low, high = PixelEnvelope(values).extremes(edges)
    expected = reference(values, edges)
    np.testing.assert_array_equal(low, expected[0])
    np.testing.assert_array_equal(high, expected[1])


def test_no_peak_of_many_samples_is_lost() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=500_000)
    values[[123_456, 400_000]] = 50.0, -60.0
    edges = np.linspace(0, values.size, 801).astype(np.int64)
    low, high = PixelEnvelope(values).extremes(edges)
    assert (low.min(), high.max()) == (-60.0, 50.0)
    exact = reference(values, edges)
    assert np.mean(low <= exact[0] + 1e-12) > 0.9  # blocks of 64 reach into the next pixel


@pytest.mark.parametrize("values", [np.zeros(0), np.full(5, np.nan)])
def test_a_signal_without_values_has_no_extremes(values: np.ndarray) -> None:
    low, high = PixelEnvelope(values).extremes(np.array([0, values.size]))
    assert np.isnan(low).all()
    assert np.isnan(high).all()
