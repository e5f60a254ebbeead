"""Preparation of the datasets of a project: from the files of recordings to the samples that a calibration uses.

`prepare_dataset` holds the whole chain. The steps depend on each other: points that are held lose their time stamps, so
that shifts count samples from then on; calculated channels read shifted ones; the condition `where` may read calculated
ones; and plateaus are averaged over scored samples only.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.dataset import Dataset, Settling
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.graph import Graph
from kennfeld.preprocessing.binding import TIME_TOLERANCE
from kennfeld.preprocessing.calculated import Calculated, evaluate_expression, uses_clock
from kennfeld.preprocessing.model_step import refine_step
from kennfeld.preprocessing.plateaus import steady_points
from kennfeld.preprocessing.recipe import DatasetEntry, DataSettings
from kennfeld.preprocessing.recordings import ChannelRequest, DatasetChannels, RecordingReader, join_recordings
from kennfeld.preprocessing.time_shift import shift_channels
from kennfeld.preprocessing.units import Units, check_stated_units, with_stated_units


@dataclass
class LoadedData:
    """The datasets of a project.

    Attributes:
        datasets: those that could be prepared.
        places: how messages name each dataset, by its name.
        offered: the channel names of files in which channels are missing.
        unknown_shifts: channels whose shift is to be estimated, by the name of the dataset.
        clocks: the columns of files that time was read from.
        complete: false if a dataset could not be prepared.
    """

    datasets: list[Dataset] = field(default_factory=list)
    places: dict[str, str] = field(default_factory=dict)
    offered: dict[str, None] = field(default_factory=dict)
    unknown_shifts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: set[str] = field(default_factory=set)
    complete: bool = True


def load_datasets(
    settings: DataSettings, request: ChannelRequest, calculated: Calculated, findings: list[Finding]
) -> LoadedData:
    """Return all datasets of a project that can be prepared.

    Args:
        settings: the datasets, stated units and channel names of the project.
        request: the channels that the project reads.
        calculated: the project's calculated channels.
        findings: receives the problems of the other datasets, and remarks.
    """
    loaded = LoadedData()
    units = Units(settings.units, request.units)
    formulas = {*request.in_formulas, *(name for graph in calculated.graphs.values() for name in graph.inputs)}
    used: set[str] = set()
    for entry in settings.datasets:
        problems: list[Finding] = []
        dataset = None
        try:
            channels = DatasetChannels.of(entry, request, calculated, problems)
            formulas |= channels.in_formulas
            used |= channels.used
            reader = RecordingReader(settings, entry, channels, problems, loaded.offered, loaded.clocks)
            dataset = prepare_dataset(reader, units, request)
        except InputError as error:
            problems += error.findings
        except ArgumentError as error:
            problems.append(Finding(entry.place, str(error)))
        findings += problems
        _add(loaded, entry, None if _has_errors(problems) else dataset, findings)
    findings += units.remarks(formulas)
    if request.complete:
        findings += check_stated_units(settings, used, loaded.clocks, complete=loaded.complete)
    return loaded


def prepare_dataset(reader: RecordingReader, units: Units, request: ChannelRequest) -> Dataset | None:
    """Return one dataset, from its files to its scored samples.

    Problems are added to the findings of the reader; if one of them is an error, the result must not be used.

    Returns:
        The dataset; None if no file could be read, or no channel for the plateaus.

    Raises:
        InputError: the settings do not fit the data, such as a warm-up of data without time stamps.
    """
    entry, channels, findings = reader.entry, reader.channels, reader.findings
    paths = reader.find_files()
    _check_shifts(entry, channels, findings)
    recordings = reader.read(paths, units)
    if not recordings:
        return None
    dataset = join_recordings(entry, paths, recordings, findings)
    if not entry.steady:
        dataset = _hold_points(dataset, entry, request.step)
    _check_time(dataset, entry, channels.where)
    dataset = _shift_recorded(dataset, entry, channels.calculated)
    dataset = _add_calculated(dataset, entry, channels, reader.settings)
    dataset = _mask_unscored(dataset, entry, channels.where, findings)
    if not entry.steady:
        return _refine(dataset, entry, request)
    if _has_errors(findings) or any(condition.channel not in dataset for condition in entry.steady):
        return None
    dataset = steady_points(dataset, entry, findings)
    return _hold_points(dataset, entry, request.step)


def _add(loaded: LoadedData, entry: DatasetEntry, dataset: Dataset | None, findings: list[Finding]) -> None:
    if dataset is None:
        loaded.complete = False
    elif dataset.name in loaded.places:
        message = f"duplicate dataset name {dataset.name}"
        findings.append(Finding(f"{entry.place} name", message, "Give each dataset its own name."))
    else:
        loaded.datasets.append(dataset)
        if entry.unknown_shifts:
            loaded.unknown_shifts[dataset.name] = entry.unknown_shifts
        loaded.places[dataset.name] = entry.place if entry.name else f"{entry.place} ({dataset.name})"


def _has_errors(findings: list[Finding]) -> bool:
    return any(finding.severity == "error" for finding in findings)


def _check_shifts(entry: DatasetEntry, channels: DatasetChannels, findings: list[Finding]) -> None:
    place = f"{entry.place} shift"
    used = channels.used
    for name in (*(entry.shift or {}), *entry.unknown_shifts):
        if name not in used:
            remedy = nearest(name, used) or "Name a channel of the files or a calculated one."
            findings.append(Finding(place, f"channel {name} is not used", remedy))
    for name in entry.unknown_shifts:
        dependent = [other for other, graph in channels.calculated.graphs.items() if name in graph.inputs]
        if dependent:
            message = f'the shift of {name} cannot be "auto" because [calculated] {dependent[0]} reads it'
            findings.append(Finding(place, message, "Give a number, or shift the channels that the function reads."))


def _hold_points(dataset: Dataset, entry: DatasetEntry, model_step: float | None) -> Dataset:
    """Return the samples as points that are held until the model has settled, if `settle` is set; without time."""
    if entry.settle is None:
        return dataset
    return replace(dataset, time=None, settling=Settling(entry.settle, entry.average, entry.step or model_step))


def _check_time(dataset: Dataset, entry: DatasetEntry, where: Graph | None) -> None:
    """Raise `InputError` if the dataset has no time stamps and a setting requires them."""
    if dataset.time is not None:
        return
    findings = []
    if entry.steady:
        remedy = "Name the time channel `time`; remove steady if these are steady-state points."
        findings.append(Finding(f"{entry.place} steady", "steady requires time stamps, but the data have none", remedy))
    for key, value in (("warmup", entry.warmup), ("max_gap", entry.max_gap)):
        if value > 0:
            message = f"{key} = {value:g} s requires time stamps, but the data have none"
            findings.append(
                Finding(f"{entry.place} {key}", message, "Name the time channel `time`, or remove the key.")
            )
    for name, shift in (entry.shift or {}).items():
        if shift != round(shift):
            message = f"{shift:g} samples of {name}: data without time stamps can only be shifted by whole samples"
            findings.append(Finding(f"{entry.place} shift", message, "Write a whole number."))
    if where is not None and uses_clock(where):
        message = "the condition requires time stamps, but the data have none"
        findings.append(Finding(f"{entry.place} where", message))
    if findings:
        raise InputError(findings)


def _shift_recorded(dataset: Dataset, entry: DatasetEntry, calculated: Calculated) -> Dataset:
    shifts = entry.shift or {}
    return shift_channels(dataset, {name: shift for name, shift in shifts.items() if name not in calculated.graphs})


def _add_calculated(
    dataset: Dataset, entry: DatasetEntry, channels: DatasetChannels, settings: DataSettings
) -> Dataset:
    """Return the dataset with its calculated channels, shifted and in the units that the project states for them."""
    graphs = channels.calculated.graphs
    for name in channels.calculated.needed(channels.names):
        if uses_clock(graphs[name]) and dataset.time is None:
            message = f"{name} requires time stamps, but dataset {dataset.name} has none"
            raise InputError.of(settings.place(f"[calculated] {name}"), message, "Name the time channel `time`.")
    stated: Mapping[str, str] = {name: unit for name, unit in settings.units.items() if name in graphs}
    return with_stated_units(channels.calculated.added(dataset, channels.names, entry.shift or {}), stated)


def _mask_unscored(dataset: Dataset, entry: DatasetEntry, where: Graph | None, findings: list[Finding]) -> Dataset:
    """Return the dataset without scoring during the warm-up and at samples at which `where` is false or NaN."""
    scored = dataset.counting.copy()
    if where is not None and all(name in dataset for name in where.inputs):
        values = evaluate_expression(where, dataset)
        scored &= np.isfinite(values) & (values != 0)
        if not scored.any():
            message = f"{entry.where} is true at no sample"
            findings.append(Finding(f"{entry.place} where", message, "Check the condition."))
    if entry.warmup > 0 and dataset.time is not None:
        for piece in dataset.pieces:
            time = dataset.time[piece]
            scored[piece] &= time - time[0] > entry.warmup - TIME_TOLERANCE
        if not scored.any():
            message = f"{entry.warmup:g} s is longer than every piece"
            findings.append(Finding(f"{entry.place} warmup", message, "Reduce it."))
    return dataset if scored.all() else replace(dataset, scored=scored)


def _refine(dataset: Dataset, entry: DatasetEntry, request: ChannelRequest) -> Dataset:
    if request.step is None:
        return dataset
    return refine_step(dataset, request.step, request.inputs, entry.place, _raster_remedy)


def _raster_remedy(step: float) -> str:
    return f"Write raster = {step:g} to resample them to an even step."
