"""Channels moved in time."""

import numpy as np
from hypothesis import strategies as st

from kennfeld.domain.dataset import Dataset
from kennfeld.preprocessing.time_shift import inside_pieces, resample_channel, shift_channels, shifted_values
from tests.draws import few_or_many


def recording(time, starts=(0,), **columns):
    return Dataset.of("d", columns, time=np.asarray(time, dtype=float), piece_starts=np.asarray(starts))


def test_a_positive_shift_delays_a_channel():
    data = shift_channels(recording([0, 0.1, 0.2, 0.3], u=[1.0, 2.0, 3.0, 5.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.0, 2.0, 3.0])


def test_a_negative_shift_between_samples_interpolates():
    data = shift_channels(recording([0, 1, 2], u=[1.0, 2.5, 4.0]), {"u": -0.5})
    np.testing.assert_allclose(data["u"].values, [1.75, 3.25, np.nan])


def test_a_shift_does_not_cross_pieces():
    data = shift_channels(recording([0, 1, 0, 1], starts=[0, 2], u=[1.5, 2.5, 3.5, 4.5]), {"u": 1.0})
    np.testing.assert_allclose(data["u"].values, [np.nan, 1.5, np.nan, 3.5])


def test_a_gap_stays_as_wide_when_it_is_moved():
    data = shift_channels(recording(np.arange(5) * 0.1, u=[0.5, np.nan, 2.5, 3.5, 4.5]), {"u": 0.1})
    np.testing.assert_allclose(data["u"].values, [np.nan, 0.5, np.nan, 2.5, 3.5])


def test_a_switch_is_held_between_samples():
    values = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(resample_channel(np.arange(3.0), values, np.array([0.5, 1.5])), [0.0, 1.0])


@few_or_many(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=20), st.integers(-3, 3), few=20, many=100)
def test_shifting_there_and_back_gives_the_inner_samples_again(values, by):
    data = Dataset.of("d", {"u": values})
    back = shift_channels(shift_channels(data, {"u": float(by)}), {"u": float(-by)})
    inner = ~np.isnan(back["u"].values)
    assert inner.sum() == max(len(values) - abs(by), 0)
    np.testing.assert_array_equal(back["u"].values[inner], np.asarray(values)[inner])


recordings = st.lists(st.integers(1, 30), min_size=1, max_size=5)


@few_or_many(recordings, st.floats(-4, 4), st.booleans(), st.booleans(), st.integers(0, 2**31), few=20, many=100)
def test_a_range_of_samples_is_shifted_like_the_whole(lengths, by, timed, stepped, seed):
    random = np.random.default_rng(seed)
    total, starts = sum(lengths), np.cumsum([0, *lengths[:-1]])
    values = random.integers(0, 3, total).astype(float) if stepped else random.normal(size=total)
    values[random.random(total) < 0.1] = np.nan
    time = np.concatenate([0.3 * np.arange(length) for length in lengths])
    data = Dataset.of("d", {"u": values}, time=time if timed else None, piece_starts=starts)
    whole = shift_channels(data, {"u": by})["u"].values
    first, last = sorted(random.integers(0, total + 1, 2))
    part = shifted_values(data, {"u": by}, first, last).get("u", values[first:last])
    np.testing.assert_array_equal(part, whole[first:last])


@few_or_many(recordings, st.integers(0, 10), st.integers(0, 2**31), few=20, many=100)
def test_ends_of_pieces_are_those_of_the_whole(lengths, margin, seed):
    total, starts = sum(lengths), np.cumsum([0, *lengths[:-1]])
    data = Dataset.of("d", {"u": np.zeros(total)}, piece_starts=starts)
    whole = inside_pieces(data, margin, 0, total)
    for start, length in zip(starts, lengths, strict=True):
        excluded = min(margin, length // 4)
        assert np.flatnonzero(whole[start : start + length]).tolist() == [*range(excluded, length - excluded)]
    first, last = sorted(np.random.default_rng(seed).integers(0, total + 1, 2))
    np.testing.assert_array_equal(inside_pieces(data, margin, first, last), whole[first:last])
