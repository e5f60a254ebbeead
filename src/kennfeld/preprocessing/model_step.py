"""Resampling of data to the model's own step; models with memory are defined for that step only."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding, Fix, InputError, Location
from kennfeld.domain.dataset import Dataset, pick
from kennfeld.domain.file_spans import FileSpans
from kennfeld.measurement.time_column import unit_remedy
from kennfeld.preprocessing.time_shift import resample_channel


def clock_findings(dataset: Dataset, location: Location) -> Iterator[Finding]:
    """Yield a warning if the time stamps look like milliseconds but were read as seconds."""
    if dataset.clock is not None and dataset.clock.in_milliseconds:
        name = dataset.clock.name
        message = f"the time stamps look like milliseconds: {name} has no unit and is read as s, and its steps are long"
        fixes = (Fix(f"{name} is in ms", ((("units", name), "ms"),)),) if location.keys else ()
        yield Finding(location, message, unit_remedy(name), severity="warning", fixes=fixes)


def raster_remedy(step: float) -> str:
    """Return the remedy that resamples data to an even step in s with the Python API."""
    return f"Resample the data to an even step of {step:g} s; kennfeld.read does so with raster={step:g}."


def refine_step(
    dataset: Dataset,
    step: float,
    inputs: Collection[str],
    location: Location,
    remedy: Callable[[float], str] = raster_remedy,
) -> Dataset:
    """Return the dataset at the model's own step.

    Inputs are interpolated; all other channels have values, and samples are scored, only at the samples of the data,
    which are `recorded`.

    Args:
        dataset: returned unchanged if it has no time stamps or has the model's step.
        step: the model's step in s.
        inputs: the channels that the model reads.
        location: location for error messages.
        remedy: returns the remedy that resamples data to an even step in s.

    Raises:
        InputError: the step of the data is uneven, or not a whole multiple of the model's.
    """
    if dataset.time is None or dataset.samples < 2:
        return dataset
    # without the steps from one piece to the next
    steps = np.delete(np.diff(dataset.time), dataset.piece_starts[1:] - 1)
    if not steps.size:
        return dataset
    own = float(np.median(steps))
    count = round(own / step)
    if np.any(np.abs(steps - own) > 1e-3 * own):
        message = f"the model's step is {step:g} s, but the samples are {steps.min():g} to {steps.max():g} s apart"
        raise InputError.of(location, message, remedy(max(count, 1) * step), fixes=_rasters(location, count, step))
    if count < 1 or abs(count * step - own) > 1e-6 * own:
        message = f"the data's step of {own:.6g} s is not a whole multiple of the model's step, {step:g} s"
        raise InputError.of(location, message, remedy(max(count, 1) * step), fixes=_rasters(location, count, step))
    return dataset if count == 1 else _refine(dataset, dataset.time, count, inputs)


def _rasters(location: Location, count: int, step: float) -> tuple[Fix, ...]:
    raster = float(f"{max(count, 1) * step:g}")  # as the remedy says it
    return (Fix.set((*location.keys, "raster"), raster),) if location.keys else ()


def _refine(dataset: Dataset, time: Float, count: int, inputs: Collection[str]) -> Dataset:
    sizes = [piece.stop - piece.start for piece in dataset.pieces]
    # n samples have n - 1 steps, each of which becomes `count` steps
    lengths = [(size - 1) * count + 1 for size in sizes]
    starts = np.cumsum([0, *lengths[:-1]])
    # numbers of the samples of the data among the finer ones
    own = np.concatenate([start + count * np.arange(size) for start, size in zip(starts, sizes, strict=True)])
    finer = [
        np.interp(np.arange(length) / count, np.arange(size), time[piece])
        for length, size, piece in zip(lengths, sizes, dataset.pieces, strict=True)
    ]
    channels = []
    for channel in dataset.channels:
        values = np.full(sum(lengths), np.nan)
        if channel.name in inputs:
            parts = zip(dataset.pieces, finer, strict=True)
            values = np.concatenate([resample_channel(time[p], channel.values[p], fine) for p, fine in parts])
        values[own] = channel.values
        channels.append(replace(channel, values=values))
    scored, recorded = np.zeros(sum(lengths), dtype=bool), np.zeros(sum(lengths), dtype=bool)
    scored[own], recorded[own] = dataset.counting, True
    return replace(
        dataset,
        channels=tuple(channels),
        time=np.concatenate(finer),
        piece_starts=starts,
        scored=scored,
        files=None if dataset.files is None else _refined_files(dataset.files, own, scored.size),
        recorded=recorded,
    )


def _refined_files(files: FileSpans, recorded: Int, samples: int) -> FileSpans:
    """Return whole files over the samples at a finer step, given the numbers of the recorded ones among these."""
    lengths = np.diff(np.append(recorded, samples)[files.starts], append=samples)
    return FileSpans.joined(files.names, lengths.tolist(), files.start_times)


def recorded_samples(simulated: Dataset, recorded: Bool) -> Dataset:
    """Reduce a simulation at a model's finer step to the samples of the data only.

    Args:
        simulated: channels over the model's steps.
        recorded: which of its samples the data have; Bool[samples].
    """
    return pick(replace(simulated, recorded=None), np.flatnonzero(recorded))
