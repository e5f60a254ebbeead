"""Shift of channels in time."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.domain.dataset import Dataset
from kennfeld.measurement.resampling import is_stepped

_SAME_INSTANT = 1e-6  # of a step
_NEIGHBOURS = 2  # samples beyond a range of time that take part in its interpolation


def shift_channels(dataset: Dataset, shift: Mapping[str, float]) -> Dataset:
    """Return the dataset with channels moved: value(t) = recorded(t - shift) within each piece, NaN outside.

    `shift` is in seconds, for steady-state data in whole samples. Channels that the dataset does not have are ignored.

    >>> data = shift_channels(Dataset.of("d", {"u": [1.0, 2.0, 3.0]}), {"u": 1.0})
    >>> data["u"].values
    array([nan,  1.,  2.])
    """
    moved = shifted_values(dataset, shift, 0, dataset.samples)
    return dataset.with_channels(*(replace(dataset[name], values=values) for name, values in moved.items()))


def shifted_values(dataset: Dataset, shift: Mapping[str, float], first: int, last: int) -> dict[str, Float]:
    """Move channels over the samples from `first` to before `last`; see `shift_channels`.

    Of samples beyond that range, only those from which values move into it are read.
    """
    edges = [*dataset.piece_starts.tolist(), dataset.samples]
    begin = int(np.searchsorted(dataset.piece_starts, first, side="right")) - 1
    end = int(np.searchsorted(dataset.piece_starts, last))
    pieces = [slice(a, b) for a, b in pairwise(edges[begin : end + 1])]
    return {
        name: np.concatenate(
            [
                _shift_piece(dataset, dataset[name].values, piece, by, max(piece.start, first), min(piece.stop, last))
                for piece in pieces
            ]
            or [np.zeros(0)]
        )
        for name, by in shift.items()
        if name in dataset and by != 0
    }


def _shift_piece(dataset: Dataset, values: Float, piece: slice, by: float, first: int, last: int) -> Float:
    """Return a channel at the samples of a piece from `first` to before `last`, moved by a time."""
    if first >= last:
        return np.zeros(0)
    count, begin, end = piece.stop - piece.start, first - piece.start, last - piece.start
    if dataset.time is None:
        at = np.arange(begin, end) - by
        low, high = int(np.floor(at[0])), int(np.ceil(at[-1]))
    else:
        own = dataset.time[piece]
        at = own[begin:end] - by
        low, high = np.searchsorted(own, at[[0, -1]]).tolist()
    # never empty: a shift beyond the piece gives NaN from its outermost sample
    low, high = min(max(low - _NEIGHBOURS, 0), count - 1), min(max(high + _NEIGHBOURS, 1), count)
    time = np.arange(low, high, dtype=np.float64) if dataset.time is None else own[low:high]
    near = values[piece.start + low : piece.start + high]
    # by the whole piece: a short range of a continuous channel may look stepped
    return resample_channel(time, near, at, stepped=is_stepped(values[piece]))


def inside_pieces(dataset: Dataset, margin: int, first: int, last: int) -> Bool:
    """Mark the samples from `first` to before `last` that are not at an end of a piece, Bool[last - first].

    `margin` samples at either end of a piece are excluded, at most half of the piece.
    """
    inside = np.zeros(last - first, dtype=bool)
    for a, b in pairwise([*dataset.piece_starts.tolist(), dataset.samples]):
        excluded = min(margin, (b - a) // 4)
        begin, end = max(a + excluded - first, 0), max(b - excluded - first, 0)
        inside[begin:end] = True
    return inside


def resample_channel(time: Float, values: Float, at: Float, *, stepped: bool | None = None) -> Float:
    """Interpolate a channel at other times: linear, or held if it is stepped; NaN next to a gap and outside.

    Args:
        time: increasing, in s or in samples; Float[samples].
        values: of the channel, Float[samples].
        at: times in the same unit, Float[n].
        stepped: states it if the values are a part of the channel only.

    Returns:
        Float[n], in the unit of the channel.
    """
    if values.size == 0:
        return np.full(at.shape, np.nan)
    after = np.clip(np.searchsorted(time, at), 0, time.size - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(time[before] - at) < np.abs(time[after] - at), before, after)
    step = float(np.median(np.diff(time))) if time.size > 1 else 1.0
    # at a sample's own instant its value counts, which a NaN next to it would hide
    exact = np.abs(time[near] - at) <= _SAME_INSTANT * step
    inside = (at >= time[0]) & (at <= time[-1])
    width = np.where(after > before, time[after] - time[before], 1.0)
    is_held = is_stepped(values) if stepped is None else stepped
    share = 0.0 if is_held else (at - time[before]) / width
    between = values[before] + share * (values[after] - values[before])
    result: Float = np.where(exact, values[near], np.where(inside, between, np.nan))
    return result
