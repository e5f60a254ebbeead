"""Quantiles of values that lie in several places are those of numpy on all of them."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.preprocessing import quantiles as digit_counting
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


def test_quantiles_of_parts_without_values_are_none():
    assert quantiles(lambda digits: [], [0.5]).size == 0
    assert quantiles(lambda digits: [count_digits([], digits)], [0.5]).size == 0


def passes(column, probabilities):
    """Return the bits that each pass over a column counts; its quantiles are those of numpy."""
    bits = []

    def run(digits):
        bits.append(digits.bits)
        return [count_digits([part], digits) for part in np.array_split(column, 3)]

    assert np.array_equal(quantiles(run, probabilities), np.quantile(column, probabilities))
    return bits


def test_few_values_take_two_passes_and_many_four(monkeypatch):
    column = np.random.default_rng(0).normal(1.5, 1e-9, 500)
    assert passes(column, [0.1, 0.5, 0.9]) == [16, 48]
    monkeypatch.setattr(digit_counting, "FEW", 0)
    assert passes(column, [0.1, 0.5, 0.9]) == [16, 16, 16, 16]
