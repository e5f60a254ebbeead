"""Numbers in little space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.report.coded_numbers import code_numbers, decode_numbers

NUMBERS = st.floats(-1e6, 1e6) | st.just(np.nan)


@settings(max_examples=40)
@given(arrays(float, st.integers(0, 60), elements=NUMBERS), st.sampled_from([1e-3, 0.5, 7.0]), st.sampled_from([1, 2]))
def test_numbers_are_within_half_a_step_and_gaps_stay(values, step, order):
    coded = code_numbers(values, step, order)
    decoded = decode_numbers(coded)
    np.testing.assert_array_equal(np.isnan(decoded), np.isnan(values))
    known = ~np.isnan(values)
    assert np.all(np.abs(decoded[known] - values[known]) <= coded["step"] * 0.5 * (1 + 1e-9) + 1e-9)


def test_even_time_stamps_take_little_space():
    time = 100.0 + 0.1 * np.arange(100_000)
    coded = code_numbers(time, 1e-4, order=2)
    assert len(coded["data"]) < 2000
    np.testing.assert_allclose(decode_numbers(coded), time, atol=1e-4)


@pytest.mark.parametrize("values", [[np.inf, 1.0, -np.inf], [1e307, -1e307], [5e-324, 0.0], [3.0], []])
def test_extreme_numbers_are_coded(values):
    values = np.array(values, dtype=float)
    decoded = decode_numbers(code_numbers(values, 1e-9))
    np.testing.assert_array_equal(np.isnan(decoded), ~np.isfinite(values))
    assert decoded.size == values.size


@pytest.mark.parametrize("value", [5.0, -850.0, 1e-12, 1e300, 0.0])
def test_a_constant_column_is_exact_and_small(value):
    coded = code_numbers(np.full(1000, value), 0.0)
    np.testing.assert_array_equal(decode_numbers(coded), np.full(1000, value))
    assert coded["planes"] == 1
