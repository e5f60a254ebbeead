"""Quantiles of values that lie in several places are those of numpy on all of them."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.preprocessing.quantiles import count_digits, quantiles
from tests.draws import few_or_many

values = arrays(np.float64, st.integers(1, 200), elements=st.floats(allow_nan=True, allow_infinity=False, width=64))


@few_or_many(values, st.integers(1, 5), st.integers(1, 9), few=20, many=100)
def test_quantiles_are_those_of_numpy(column, parts, count):
    known = column[np.isfinite(column)]
    probabilities = np.linspace(0, 1, count)
    pieces = np.array_split(column, parts)
    with np.errstate(over="ignore", invalid="ignore"):
        result = quantiles(lambda digits: (count_digits([piece], digits) for piece in pieces), probabilities)
        expected = np.quantile(known, probabilities) if known.size else np.zeros(0)
    assert np.array_equal(result, expected, equal_nan=True)


def test_equal_values_have_one_quantile():
    result = quantiles(lambda digits: [count_digits([np.full(10, -2.5), np.full(3, -2.5)], digits)], [0.0, 0.3, 1.0])
    assert result.tolist() == [-2.5, -2.5, -2.5]
