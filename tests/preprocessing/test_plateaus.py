"""Plateaus of a recording, against a search that tries every stretch."""

import numpy as np
from hypothesis import strategies as st

from kennfeld.domain.dataset import Dataset
from kennfeld.preprocessing.plateaus import (
    average_plateaus,
    find_plateaus,
    first_in_band,
    least_tolerance,
    longest_stretch,
    segment_starts,
)
from tests.draws import few_or_many

ONE = np.zeros(1, dtype=np.int64)

numbers = st.lists(st.integers(-6, 6).map(float), min_size=1, max_size=40).map(np.array)


@st.composite
def recordings(draw):
    """Time stamps, values, the samples at which segments begin, a tolerance and a window."""
    values = draw(numbers)
    steps = draw(st.lists(st.sampled_from([0.5, 1.0, 3.0]), min_size=values.size, max_size=values.size))
    begins = draw(st.sets(st.integers(1, values.size), max_size=3))
    starts = np.array(sorted({0, *(b for b in begins if b < values.size)}), dtype=np.int64)
    return np.cumsum(steps), values, starts, draw(st.integers(0, 6)) / 2, draw(st.sampled_from([0.5, 2.0, 5.0]))


def within(values, starts, begin, end, tolerance):
    """Whether a stretch stays within the band and one segment."""
    return not np.any((starts > begin) & (starts <= end)) and np.ptp(values[begin : end + 1]) <= 2 * tolerance


@few_or_many(recordings(), few=20, many=100)
def test_each_sample_has_the_longest_stretch_that_ends_there(recording):
    _, values, starts, tolerance, _ = recording
    expected = [next(b for b in range(e + 1) if within(values, starts, b, e, tolerance)) for e in range(values.size)]
    assert first_in_band(values, tolerance, starts).tolist() == expected


@few_or_many(recordings(), few=20, many=100)
def test_plateaus_are_the_longest_stretches_one_after_the_other(recording):
    time, values, starts, tolerance, window = recording
    plateaus = find_plateaus(time, first_in_band(values, tolerance, starts), window)
    taken = np.zeros(values.size, dtype=bool)
    lengths = []
    while True:
        fits = [
            (time[e] - time[b], -b, e)
            for e in range(values.size)
            for b in range(e)
            if not taken[b : e + 1].any() and within(values, starts, b, e, tolerance) and time[e] - time[b] >= window
        ]
        if not fits:
            break
        length, begin, end = max(fits)
        lengths.append(length)
        taken[-begin : end + 1] = True
        assert (-begin, end) in plateaus
    assert len(plateaus) == len(lengths)
    assert plateaus == sorted(plateaus)


@few_or_many(recordings(), few=20, many=200)
def test_the_tolerance_that_is_named_gives_a_plateau_and_no_smaller_one_does(recording):
    time, values, starts, _, window = recording
    least = least_tolerance(time, values, starts, window)
    if np.isinf(least):
        assert not find_plateaus(time, first_in_band(values, 100.0, starts), window)
        return
    assert find_plateaus(time, first_in_band(values, least, starts), window)
    assert least == 0 or not find_plateaus(time, first_in_band(values, least - 0.25, starts), window)


def test_a_band_that_is_met_exactly_counts():
    values = np.array([0.1, 0.3, 0.1, 0.3])
    assert first_in_band(values, 0.1, ONE).tolist() == [0, 0, 0, 0]


def test_a_drift_is_not_a_plateau_however_slow_each_step():
    drift = np.arange(1000.0)
    assert np.max(np.arange(1000) - first_in_band(drift, 10.0, ONE)) == 20


def test_samples_that_do_not_count_end_a_segment_where_the_gap_is_too_long():
    time, counts = np.arange(8.0), np.array([1, 1, 0, 1, 0, 0, 1, 1], dtype=bool)
    assert segment_starts(time, ONE, counts, 0.0).tolist() == [0, 2, 3]
    assert segment_starts(time, ONE, counts, 2.0).tolist() == [0, 3]
    assert segment_starts(time, ONE, counts, 3.0).tolist() == [0]


def test_a_pause_and_a_new_piece_begin_a_segment():
    time = np.concatenate([np.arange(5.0), 100 + np.arange(5.0), np.arange(3.0)])
    starts = np.array([0, 10])
    every = np.ones(13, dtype=bool)
    assert segment_starts(time, starts, every, 0.0).tolist() == [0, 5, 10]
    assert segment_starts(time, starts, every, 200.0).tolist() == [0, 10]


def test_no_samples_give_no_segment_and_one_sample_gives_one():
    assert segment_starts(np.arange(3.0), ONE, np.zeros(3, dtype=bool), 0.0).tolist() == []
    assert segment_starts(np.arange(3.0), ONE, np.array([False, True, False]), 0.0).tolist() == [0]
    assert longest_stretch(np.array([5.0]), np.array([0])) == (0.0, 5.0)


def test_means_leave_out_what_is_missing_and_what_does_not_count():
    nan = np.nan
    columns = {"a": [1.0, 2, 3, 4, 9], "b": [nan, nan, 1, nan, 2], "c": [0.1] * 4 + [nan]}
    data = Dataset.of("d", columns, time=np.arange(5.0), max_gap=3.0)
    points = average_plateaus(data, np.array([True, False, True, True, True]), [(0, 1), (3, 3)])
    assert points.time is None
    assert points["a"].values.tolist() == [2.0, 9.0]
    assert points["b"].values.tolist() == [1.0, 2.0]
    assert points["c"].values[0] == 0.1
    assert np.isnan(points["c"].values[1])
