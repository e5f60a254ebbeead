"""Channels moved in time and put onto a finer step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.dataset import Dataset
from kennfeld.errors import InputError
from kennfeld.project.shift import interpolated, refined, shifted


def made(time, starts=(0,), **columns):
    return Dataset.of("d", columns, time=np.asarray(time, dtype=float), starts=np.asarray(starts))


def test_a_positive_shift_delays_a_channel():
    data = shifted(made([0, 0.1, 0.2, 0.3], u=[1.0, 2.0, 3.0, 5.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.0, 2.0, 3.0])


def test_a_negative_shift_between_samples_interpolates():
    data = shifted(made([0, 1, 2], u=[1.0, 2.5, 4.0]), {"u": -0.5})
    np.testing.assert_allclose(data["u"].values, [1.75, 3.25, np.nan])


def test_a_shift_does_not_cross_pieces():
    data = shifted(made([0, 1, 0, 1], starts=[0, 2], u=[1.5, 2.5, 3.5, 4.5]), {"u": 1.0})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.5, np.nan, 3.5])


def test_a_gap_stays_as_wide_when_it_is_moved():
    data = shifted(made(np.arange(5) * 0.1, u=[0.5, np.nan, 2.5, 3.5, 4.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 0.5, np.nan, 2.5, 3.5])


def test_a_switch_is_held_between_samples():
    values = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(interpolated(np.arange(3.0), values, np.array([0.5, 1.5])), [0.0, 1.0])


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=20), st.integers(-3, 3))
def test_shifting_there_and_back_gives_the_inner_samples_again(values, by):
    data = Dataset.of("d", {"u": values})
    back = shifted(shifted(data, {"u": float(by)}), {"u": float(-by)})
    inner = ~np.isnan(back["u"].values)
    assert inner.sum() == max(len(values) - abs(by), 0)
    np.testing.assert_array_equal(back["u"].values[inner], np.asarray(values)[inner])


def test_a_finer_step_interpolates_inputs_and_scores_the_data_alone():
    data = refined(made([0, 0.2, 0.4], u=[0.5, 1.5, 2.5], y=[1.5, 2.5, 3.5]), 0.1, {"u"}, "here")
    np.testing.assert_allclose(data.time, [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(data["u"].values, [0.5, 1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(data["y"].values, [1.5, np.nan, 2.5, np.nan, 3.5])
    assert data.scored.tolist() == [True, False, True, False, True]


def test_a_finer_step_keeps_pieces_apart():
    data = refined(made([0, 1, 0, 1, 2], starts=[0, 2], u=[0.5, 1.5, 9.5, 8.5, 7.5]), 0.5, {"u"}, "here")
    assert data.starts.tolist() == [0, 3]
    np.testing.assert_allclose(data["u"].values, [0.5, 1.0, 1.5, 9.5, 9.0, 8.5, 8.0, 7.5])
    np.testing.assert_allclose(data.time, [0, 0.5, 1, 0, 0.5, 1, 1.5, 2])


def test_the_same_step_changes_nothing():
    data = made([0, 0.1, 0.2], u=[1.0, 2.0, 3.0])
    assert refined(data, 0.1, {"u"}, "here") is data


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (
            [0, 0.25, 0.5],
            "the data's step of 0.25 s is no whole multiple of the model's step, 0.1 s. Write raster = 0.2",
        ),
        (
            [0, 0.01, 0.02],
            "the data's step of 0.01 s is no whole multiple of the model's step, 0.1 s. Write raster = 0.1",
        ),
        ([0, 0.1, 0.3], "the samples are 0.1 to 0.2 s apart. Write raster = "),
    ],
)
def test_a_step_that_does_not_fit_is_a_finding(time, expected):
    with pytest.raises(InputError, match=expected):
        refined(made(time, u=[1.0, 2.0, 3.0]), 0.1, {"u"}, "here")
