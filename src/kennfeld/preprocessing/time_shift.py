"""Shift of channels in time."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Dataset
from kennfeld.measurement.resampling import is_stepped

_SAME_INSTANT = 1e-6  # of a step


def shift_channels(dataset: Dataset, shift: Mapping[str, float]) -> Dataset:
    """Return the dataset with channels moved: value(t) = recorded(t - shift) within each piece, NaN outside.

    `shift` is in seconds, for steady-state data in whole samples. Channels that the dataset does not have are ignored.

    >>> data = shift_channels(Dataset.of("d", {"u": [1.0, 2.0, 3.0]}), {"u": 1.0})
    >>> data["u"].values
    array([nan,  1.,  2.])
    """
    shifted = []
    for name, by in shift.items():
        if name not in dataset or by == 0:
            continue
        values = dataset[name].values
        parts = []
        for piece in dataset.pieces:
            time = np.arange(piece.stop - piece.start, dtype=np.float64)
            if dataset.time is not None:
                time = dataset.time[piece]
            parts.append(resample_channel(time, values[piece], time - by))
        shifted.append(replace(dataset[name], values=np.concatenate(parts)))
    return dataset.with_channels(*shifted)


def resample_channel(time: Float, values: Float, at: Float) -> Float:
    """Return a channel at other times: linear, or held if it is stepped; NaN next to a gap and outside."""
    if values.size == 0:
        return np.full(at.shape, np.nan)
    after = np.clip(np.searchsorted(time, at), 0, time.size - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(time[before] - at) < np.abs(time[after] - at), before, after)
    step = float(np.median(np.diff(time))) if time.size > 1 else 1.0
    exact = np.abs(time[near] - at) <= _SAME_INSTANT * step
    inside = (at >= time[0]) & (at <= time[-1])
    width = np.where(after > before, time[after] - time[before], 1.0)
    share = 0.0 if is_stepped(values) else (at - time[before]) / width
    between = values[before] + share * (values[after] - values[before])
    result: Float = np.where(exact, values[near], np.where(inside, between, np.nan))
    return result
