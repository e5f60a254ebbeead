import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from kennfeld.base.errors import visible
from kennfeld.base.markup import decimal, element, percent, round_digits, table
from kennfeld.report.drawings import Histogram, Trace, TraceEnvelope, sample_indices

FLOATS = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=40)
@given(arrays(np.float64, array_shapes(max_dims=3, max_side=5), elements=FLOATS))
def test_rounded_numbers_are_close_and_fit_json(values):
    text = json.dumps(round_digits(values), allow_nan=False)
    back = np.array(json.loads(text), dtype=object).astype(np.float64)
    assert back.shape == values.shape
    known = np.isfinite(values) & (np.abs(values) > 1e-290) & (np.abs(values) < 1e290)
    np.testing.assert_allclose(back[known], values[known], rtol=1e-4)
    assert np.isnan(back[~np.isfinite(values)]).all()


@given(st.floats(1e-4, 9e6), st.booleans())
def test_shown_numbers_have_four_digits(value, negative):
    text = decimal(-value if negative else value)
    assert float(text) == pytest.approx(-value if negative else value, rel=6e-4)
    assert len(text.replace("-", "").replace(".", "").lstrip("0")) <= 7


@given(FLOATS)
def test_every_number_has_a_text(value):
    assert isinstance(decimal(value), str)
    assert isinstance(percent(value), str)
    assert math.isfinite(value) or decimal(value) == "–"


@settings(max_examples=40)
@given(arrays(np.float64, st.integers(0, 400), elements=FLOATS), st.integers(2, 60), st.integers(0, 400))
def test_an_envelope_keeps_extremes_within_its_size(values, most, cut):
    groups = TraceEnvelope(values.size, most)
    trace, later = Trace(), Trace()
    trace.add(groups, 0, values[:cut])
    later.add(groups, min(cut, values.size), values[cut:])
    trace.merge(later)
    points = trace.points(groups)
    assert points.size <= max(most + 2, 2)
    twice = 1 if groups.whole else 2
    firsts = [*groups.firsts(0, min(cut, values.size)), *groups.firsts(min(cut, values.size), values.size)]
    assert points.size == twice * len(firsts)
    if not np.isnan(values).all():
        assert np.nanmax(points) == np.nanmax(values)
        assert np.nanmin(points) == np.nanmin(values)
    else:
        assert np.isnan(points).all()


@given(st.integers(0, 500), st.integers(1, 50))
def test_no_sample_is_selected_twice(count, most):
    chosen = sample_indices(count, most)
    assert len(chosen) == min(most, count)
    assert (np.diff(chosen) > 0).all()


@settings(max_examples=40)
@given(arrays(np.float64, st.integers(0, 100), elements=FLOATS), st.integers(0, 100))
def test_a_histogram_loses_no_finite_number(values, cut):
    counted = Histogram.of(values[:cut], (-1.0, 1.0), 7)
    counted.merge(Histogram.of(values[cut:], (-1.0, 1.0), 7))
    assert counted.counts.sum() == np.isfinite(values).sum()
    assert counted.beyond == np.count_nonzero(np.isfinite(values) & (np.abs(values) > 1))


@given(st.text(), st.text())
def test_markup_escapes_its_content(text, title):
    import html

    created = element("p", text, title=title)
    assert created.count("<") == 2
    assert html.unescape(created) == f'<p title="{visible(title)}">{visible(text)}</p>'


def test_a_table_aligns_numbers_to_the_right():
    created = table(["name", "x"], [["a<b", "1"]])
    assert '<td>a&lt;b</td><td class="number">1</td>' in created
