"""Channels moved in time, and put onto a finer step."""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import InputError
from kennfeld.measurement.raster import is_stepped

__all__ = ["refined", "shifted"]

_NEAR = 1e-6  # of a step; closer than this is the same instant


def shifted(dataset: Dataset, shift: Mapping[str, float]) -> Dataset:
    """The dataset with channels moved: value(t) = recorded(t - shift), within each piece; NaN where nothing is known.

    `shift` is in seconds, for steady-state data in whole samples. A channel that is not there is passed over.

    >>> data = shifted(Dataset.of("d", {"u": [1.0, 2.0, 3.0]}), {"u": 1.0})
    >>> data["u"].values
    array([nan,  1.,  2.])
    """
    moved = []
    for name, by in shift.items():
        if name not in dataset or by == 0:
            continue
        values = dataset[name].values
        parts = [_moved(values[piece], _time(dataset, piece), by) for piece in dataset.pieces]
        moved.append(replace(dataset[name], values=np.concatenate(parts)))
    return dataset.with_channels(*moved) if moved else dataset


def _time(dataset: Dataset, piece: slice) -> Float:
    return np.arange(piece.stop - piece.start, dtype=np.float64) if dataset.time is None else dataset.time[piece]


def _moved(values: Float, time: Float, by: float) -> Float:
    return interpolated(time, values, time - by)


def interpolated(time: Float, values: Float, at: Float) -> Float:
    """A channel at other times: linear between neighbours, held where it is stepped; NaN beside a gap and outside."""
    if values.size == 0:
        return np.full(at.shape, np.nan)
    after = np.clip(np.searchsorted(time, at), 0, time.size - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(time[before] - at) < np.abs(time[after] - at), before, after)
    step = float(np.median(np.diff(time))) if time.size > 1 else 1.0
    exact = np.abs(time[near] - at) <= _NEAR * step
    inside = (at >= time[0]) & (at <= time[-1])
    width = np.where(after > before, time[after] - time[before], 1.0)
    share = (at - time[before]) / width
    between = values[before] + share * (values[after] - values[before])
    if is_stepped(values):
        between = values[before]
    result: Float = np.where(exact, values[near], np.where(inside, between, np.nan))
    return result


def refined(dataset: Dataset, step: float, inputs: Collection[str], place: str) -> Dataset:
    """The dataset on a model's own step: inputs interpolated, all else and the scoring at the data's samples alone.

    Raises `InputError` where the data's step is no whole multiple of the model's.
    """
    if dataset.time is None or dataset.samples < 2:
        return dataset
    steps = np.diff(dataset.time)
    steps = np.delete(steps, dataset.starts[1:] - 1)
    if not steps.size:
        return dataset
    own = float(np.median(steps))
    count = round(own / step)
    if np.any(np.abs(steps - own) > 1e-3 * own):
        what = f"the model's step is {step:g} s, but the samples are {steps.min():g} to {steps.max():g} s apart"
        raise InputError.of(place, what, f"Write raster = {max(count, 1) * step:g} to put them onto an even raster.")
    if count < 1 or abs(count * step - own) > 1e-6 * own:
        what = f"the data's step of {own:.6g} s is no whole multiple of the model's step, {step:g} s"
        raise InputError.of(place, what, f"Write raster = {max(count, 1) * step:g}.")
    return dataset if count == 1 else _refined(dataset, dataset.time, count, inputs)


def _refined(dataset: Dataset, time: Float, count: int, inputs: Collection[str]) -> Dataset:
    lengths = [(piece.stop - piece.start - 1) * count + 1 for piece in dataset.pieces]
    starts = np.cumsum([0, *lengths[:-1]])
    places = [
        start + count * np.arange(piece.stop - piece.start) for start, piece in zip(starts, dataset.pieces, strict=True)
    ]
    at = np.concatenate(places)
    finer = [
        np.interp(np.arange(length) / count, np.arange(p.stop - p.start), time[p])
        for length, p in zip(lengths, dataset.pieces, strict=True)
    ]
    total = int(sum(lengths))
    channels = []
    for channel in dataset.channels:
        values = np.full(total, np.nan)
        if channel.name in inputs:
            parts = zip(dataset.pieces, finer, strict=True)
            values = np.concatenate([interpolated(time[p], channel.values[p], fine) for p, fine in parts])
        values[at] = channel.values
        channels.append(Channel(channel.name, values, channel.unit, channel.description))
    scored = np.zeros(total, dtype=bool)
    scored[at] = True if dataset.scored is None else dataset.scored
    return replace(dataset, channels=tuple(channels), time=np.concatenate(finer), starts=starts, scored=scored)
