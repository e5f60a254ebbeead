import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.notebook.pictures import heat_map, height_colour, ink_on, line_chart, strip, ticks

numbers = st.floats(-1e9, 1e9, allow_nan=False)


@given(numbers, numbers)
def test_ticks_are_few_increasing_and_within_the_range(one, other):
    low, high = sorted((one, other))
    marks = ticks(low, high)
    assert len(marks) <= 8
    assert marks == sorted(set(marks))
    slack = 1e-6 * (high - low) + 1e-9
    assert all(low - slack <= mark <= high + slack for mark in marks)


@pytest.mark.parametrize("share", np.linspace(0, 1, 21))
def test_numbers_on_colours_can_be_read(share):
    def luminance(rgb):
        linear = [c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in rgb]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    paper = luminance(height_colour(float(share)))
    ink = 0.0 if ink_on(height_colour(float(share))) == "#000" else 1.0
    assert (max(paper, ink) + 0.05) / (min(paper, ink) + 0.05) > 3.0  # of WCAG 2 for large text


def test_a_line_ends_where_values_are_missing():
    y = np.array([1.0, 2.0, np.nan, 3.0, 4.0, np.nan, 5.0])
    picture = strip(np.arange(7.0), y, "gaps")
    assert picture.count("<polyline") == 2
    assert picture.count("<circle") == 1


def test_text_and_grid_have_the_colour_of_the_page():
    picture = line_chart(np.arange(3.0), np.arange(3.0), "x", "y")
    assert picture.count('fill="currentColor"') == picture.count("<text")
    assert picture.count('stroke="currentColor"') == picture.count("<line ")


def test_a_line_chart_has_a_line_at_each_tick_and_a_heat_map_has_none():
    x, y = np.arange(4.0), np.array([0.0, 10.0, 5.0, 20.0])
    chart = line_chart(x, y, "x", "y")
    assert chart.count("<line ") == len(ticks(0, 3)) + len(ticks(0, 20))
    coloured = heat_map(np.outer(x, y), x, np.sort(y), "x", "y", "T")
    assert "<line " not in coloured
    assert coloured.count("<rect") >= 16
