"""Channels moved in time."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.dataset import Dataset
from kennfeld.preprocessing.time_shift import resample_channel, shift_channels


def made(time, starts=(0,), **columns):
    return Dataset.of("d", columns, time=np.asarray(time, dtype=float), starts=np.asarray(starts))


def test_a_positive_shift_delays_a_channel():
    data = shift_channels(made([0, 0.1, 0.2, 0.3], u=[1.0, 2.0, 3.0, 5.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.0, 2.0, 3.0])


def test_a_negative_shift_between_samples_interpolates():
    data = shift_channels(made([0, 1, 2], u=[1.0, 2.5, 4.0]), {"u": -0.5})
    np.testing.assert_allclose(data["u"].values, [1.75, 3.25, np.nan])


def test_a_shift_does_not_cross_pieces():
    data = shift_channels(made([0, 1, 0, 1], starts=[0, 2], u=[1.5, 2.5, 3.5, 4.5]), {"u": 1.0})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.5, np.nan, 3.5])


def test_a_gap_stays_as_wide_when_it_is_moved():
    data = shift_channels(made(np.arange(5) * 0.1, u=[0.5, np.nan, 2.5, 3.5, 4.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 0.5, np.nan, 2.5, 3.5])


def test_a_switch_is_held_between_samples():
    values = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(resample_channel(np.arange(3.0), values, np.array([0.5, 1.5])), [0.0, 1.0])


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=20), st.integers(-3, 3))
def test_shifting_there_and_back_gives_the_inner_samples_again(values, by):
    data = Dataset.of("d", {"u": values})
    back = shift_channels(shift_channels(data, {"u": float(by)}), {"u": float(-by)})
    inner = ~np.isnan(back["u"].values)
    assert inner.sum() == max(len(values) - abs(by), 0)
    np.testing.assert_array_equal(back["u"].values[inner], np.asarray(values)[inner])
