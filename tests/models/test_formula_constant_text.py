"""Constants as one would write them, of exactly their value."""

import math

import pytest
from hypothesis import strategies as st

from kennfeld.models.formula import formula
from kennfeld.models.formula.constant_text import constant_text
from tests.draws import few_or_many


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1, "0.1"),
        (-2.0, "-2"),
        (1e300, "1e+300"),
        (math.inf, "inf"),
        (0.123456789012345, "0.123456789012345"),
        (1 / 3, "1 / 3"),
        (-60 / 5280, "-1 / 88"),
        (math.pi, "pi"),
        (-math.pi, "-pi"),
        (2 * math.pi, "2 * pi"),
        (math.pi / 180, "pi / 180"),
        (3 * math.pi / 4, "3 * pi / 4"),
        (60 / (2 * math.pi), "30 / pi"),
        (1 / (2 * math.pi), "1 / (2 * pi)"),
        (math.sqrt(2), "1.4142135623730951"),
    ],
)
def test_a_constant_is_written_as_a_small_fraction_or_a_multiple_of_pi_if_it_is_one(value, text):
    assert constant_text(value) == text


numbers = st.integers(-200, 200)
below = st.integers(1, 200)


@few_or_many(
    st.one_of(
        st.floats(allow_nan=False),
        st.builds(lambda a, b: a / b, numbers, below),
        st.builds(lambda a, b: a * math.pi / b, numbers, below),
        st.builds(lambda a, b: a / (b * math.pi), numbers, below),
    ),
    few=30,
    many=1000,
)
def test_what_is_written_has_the_value_to_the_last_bit(value):
    graph = formula(f"y = x + ({constant_text(value)})").graph
    expected = formula(f"y = x + ({value!r})").graph
    assert graph == expected
