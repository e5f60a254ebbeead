"""Resampling: linear or held, nothing outside the samples, exact where a sample lies on the raster."""

import numpy as np

from kennfeld.measurement import read
from kennfeld.measurement.raster import grid, resample


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
    np.testing.assert_array_equal(resample(time, values, grid(time, 0.01)), values)


def test_a_channel_without_values_stays_without():
    assert np.isnan(resample(np.arange(3.0), np.full(3, np.nan), np.arange(3.0))).all()
