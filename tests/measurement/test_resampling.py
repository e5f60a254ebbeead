"""Resampling: linear or held, nothing outside the samples, exact where a sample lies on the raster."""

import numpy as np
import pytest

from kennfeld.domain.dataset import SAMPLES_PER_BLOCK
from kennfeld.measurement import read
from kennfeld.measurement.resampling import even_grid, is_stepped, resample


def test_a_file_is_put_onto_an_even_raster_over_its_own_range(csv):
    data = read(csv("time,a\n1,0\n2,10\n2.55,20\n"), raster=0.5)
    np.testing.assert_allclose(data.time, [1, 1.5, 2, 2.5])
    np.testing.assert_allclose(data["a"].values, [0, 5, 10, 10 + 10 * 0.5 / 0.55])


def test_gaps_are_bridged_but_nothing_is_extrapolated():
    nan = np.nan
    got = resample(np.arange(5.0), np.array([nan, 1.5, nan, 2.5, nan]), np.arange(5.0))
    np.testing.assert_array_equal(got, [nan, 1.5, 2.0, 2.5, nan])


def test_switches_and_gears_are_held():
    time = np.arange(8.0)
    gear = np.array([1.0, 1, 2, 2, 2, 1, 1, 2])
    np.testing.assert_array_equal(resample(time, gear, np.array([1.9, 2.0, 4.99, 7.0, 7.1])), [1, 2, 2, 2, np.nan])


def test_samples_on_the_raster_come_out_bit_for_bit():
    time = np.array([float(f"{k / 100:.2f}") for k in range(2000)])
    values = np.sin(time)
    np.testing.assert_array_equal(resample(time, values, even_grid(time, 0.01)), values)


def test_a_channel_without_values_stays_without():
    assert np.isnan(resample(np.arange(3.0), np.full(3, np.nan), np.arange(3.0))).all()


def test_nothing_is_interpolated_across_a_pause_of_the_recording():
    time = np.concatenate([np.arange(10) / 10, 60 + np.arange(10) / 10])
    even = even_grid(time, 0.1)
    resampled = resample(time, np.arange(20) + 0.5, even)
    assert np.array_equal(np.isnan(resampled), (even > 0.95) & (even < 59.95))
    assert resampled[:10].tolist() == (np.arange(10) + 0.5).tolist()


def test_steps_of_a_few_times_the_usual_one_are_bridged():
    time = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1])
    assert not np.isnan(resample(time, time**2 + 0.1, even_grid(time, 0.1))).any()


def test_a_slow_channel_among_fast_ones_is_bridged():
    time = np.arange(1000) / 100
    slow = np.where(np.arange(1000) % 100 == 0, np.sin(time) + 0.1, np.nan)
    resampled = resample(time, slow, time)
    assert not np.isnan(resampled[:901]).any()


@pytest.mark.parametrize(
    ("later", "stepped"),
    [([3.0], True), ([np.nan], True), ([2.5], False), (np.arange(4.0, 18.0), False), ([-1.0] * 5, True)],
)
def test_a_long_channel_is_judged_by_all_its_values(later, stepped):
    values = np.concatenate([np.tile([1.0, 2.0, 3.0], SAMPLES_PER_BLOCK), later])
    assert is_stepped(values) is stepped
    assert is_stepped(values[::-1]) is stepped


def test_a_set_value_in_any_steps_is_held_and_a_slow_coarse_signal_is_not():
    rng = np.random.default_rng(0)
    set_value = np.repeat(rng.uniform(0, 1, 60), 20)
    temperature = np.round(20 + 5 * np.sin(np.linspace(0, 9, 3000)), 1)
    assert is_stepped(set_value)
    assert is_stepped(np.where(rng.uniform(size=1200) < 0.1, np.nan, set_value))
    assert not is_stepped(temperature)
    assert not is_stepped(rng.normal(size=500))
