"""Channels put onto a finer step; how they are moved in time is in `optimize.shifting`."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import InputError
from kennfeld.optimize.choice.shifting import interpolated, shifted

__all__ = ["interpolated", "refined", "shifted"]


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
    scored[at] = dataset.counting
    return replace(dataset, channels=tuple(channels), time=np.concatenate(finer), starts=starts, scored=scored)
