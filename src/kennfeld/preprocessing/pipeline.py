"""Preparation of the datasets of a project: from the files of recordings to the samples that a calibration uses.

`prepare_dataset` holds the whole chain. The steps depend on each other: points that are held lose their time stamps, so
that shifts count samples from then on; calculated channels read shifted ones; the condition `where` may read calculated
ones; and plateaus are averaged over scored samples only.
"""

from collections.abc import Callable, Iterator
from dataclasses import field, replace

from kennfeld.base.errors import ArgumentError, Finding, Findings, Fix, InputError, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset, Settling
from kennfeld.graph import Graph
from kennfeld.preprocessing.binding import TIME_TOLERANCE
from kennfeld.preprocessing.calculated import Calculated, holds
from kennfeld.preprocessing.joined_recordings import JoinedRecordings
from kennfeld.preprocessing.model_step import refine_step
from kennfeld.preprocessing.plateaus import steady_points
from kennfeld.preprocessing.recipe import DatasetEntry, DataSettings
from kennfeld.preprocessing.recordings import (
    ChannelRequest,
    DatasetChannels,
    ReadingWatch,
    RecordingReader,
    default_name,
)
from kennfeld.preprocessing.time_shift import shift_channels
from kennfeld.preprocessing.units import Units, check_stated_units, with_stated_units


@dataclass
class LoadedData:
    """The datasets of a project.

    Attributes:
        datasets: those that could be prepared.
        locations: location of each dataset, by its name.
        offered: the channel names of files in which channels are missing.
        unknown_shifts: channels whose shift is to be estimated, by the name of the dataset.
        clocks: the columns of files that time was read from.
        complete: false if a dataset could not be prepared.
        findings: the problems of the other datasets, and remarks.
    """

    datasets: list[Dataset] = field(default_factory=list)
    locations: dict[str, Location] = field(default_factory=dict)
    offered: dict[str, None] = field(default_factory=dict)
    unknown_shifts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: set[str] = field(default_factory=set)
    complete: bool = True
    findings: list[Finding] = field(default_factory=list)


Loader = Callable[[DataSettings, ChannelRequest, Calculated], LoadedData]


def load_datasets(
    settings: DataSettings, request: ChannelRequest, calculated: Calculated, watch: ReadingWatch | None = None
) -> LoadedData:
    """Return all datasets of a project that can be prepared.

    Args:
        settings: the datasets, stated units and channel names of the project.
        request: the channels that the project reads.
        calculated: the project's calculated channels.
        watch: called after each file with the number of files of a dataset that have been read and that of all.
    """
    loaded = LoadedData()
    units = Units(settings.units, request.units)
    # channels that formulas read: the remark on their conversion names the unit that the formulas see
    formulas = {*request.in_formulas, *(name for graph in calculated.graphs.values() for name in graph.inputs)}
    used: set[str] = set()
    for entry in settings.datasets:
        channels = DatasetChannels.of(entry, request, calculated)
        formulas |= channels.in_formulas
        used |= channels.used
        reader = RecordingReader(settings, entry, channels, [*channels.findings], watch)
        dataset = None
        try:
            dataset = prepare_dataset(reader, units, request)
        except InputError as error:
            reader.findings += error.findings
        except ArgumentError as error:
            reader.findings.append(Finding(entry.location, str(error)))
        _add(loaded, reader, None if reader.failed else dataset)
    loaded.findings += units.remarks(formulas)
    if request.complete:
        loaded.findings += check_stated_units(settings, used, loaded.clocks, complete=loaded.complete)
    return loaded


def prepare_dataset(
    reader: RecordingReader, units: Units, request: ChannelRequest, *, whole: bool = True
) -> Dataset | None:
    """Return one dataset, from its files to its scored samples.

    Problems are added to the findings of the reader; if one of them is an error, the result must not be used.

    Args:
        reader: reads the files.
        units: converts the channels.
        request: the channels that the project reads.
        whole: False for a part of the files, which may have no sample that is scored, and no plateau.

    Returns:
        The dataset; None if no file could be read, or no channel for the plateaus.

    Raises:
        InputError: the settings do not fit the data, such as a warm-up of data without time stamps.
    """
    entry, channels, findings = reader.entry, reader.channels, reader.findings
    paths = reader.find_files()
    findings += _check_shifts(entry, channels)
    if not paths:
        return None
    recordings = JoinedRecordings(entry.name or default_name(paths, entry.files[0]), entry, len(paths))
    for recording in reader.read(paths, units):
        recordings.add(recording)
    dataset = recordings.dataset()
    if dataset is None:
        return None
    findings += recordings.findings
    if not entry.steady:
        # plateaus are found by time stamps, which held points give up: their averages are held at the end
        dataset = _hold_points(dataset, entry, request.step)
    _check_time(dataset, entry, channels.where)
    graphs = channels.calculated.graphs
    # shifts of calculated channels wait until these exist
    dataset = shift_channels(dataset, {name: s for name, s in entry.known_shifts.items() if name not in graphs})
    dataset = _add_calculated(dataset, entry, channels, reader.settings)
    dataset, errors = _mask_unscored(dataset, entry, channels.where)
    findings += errors if whole else []
    if not entry.steady:
        if request.step is None:
            return dataset
        # the last step: shifts and conditions are computed at the samples of the data only
        remedy = "Write raster = {:g} to resample them to an even step."
        return refine_step(dataset, request.step, request.inputs, entry.location, remedy.format)
    if reader.failed or any(condition.channel not in dataset for condition in entry.steady):
        return None
    try:
        dataset, remark = steady_points(dataset, entry)
    except InputError:
        if whole:
            raise
        return None
    findings.append(remark)
    return _hold_points(dataset, entry, request.step)


def _add(loaded: LoadedData, reader: RecordingReader, dataset: Dataset | None) -> None:
    """Add a dataset, or only what its reader has found out if it could not be prepared."""
    entry = reader.entry
    loaded.findings += reader.findings
    loaded.offered |= reader.offered
    loaded.clocks |= reader.clocks
    if dataset is None:
        loaded.complete = False
    elif dataset.name in loaded.locations:
        message = f"duplicate dataset name {dataset.name}"
        loaded.findings.append(Finding(entry.location.within("name"), message, "Give each dataset its own name."))
    else:
        loaded.datasets.append(dataset)
        if entry.unknown_shifts:
            loaded.unknown_shifts[dataset.name] = entry.unknown_shifts
        loaded.locations[dataset.name] = entry.location if entry.name else entry.location.within(f"({dataset.name})")


def _check_shifts(entry: DatasetEntry, channels: DatasetChannels) -> Iterator[Finding]:
    location = entry.location.within("shift")
    used = channels.used
    for name in entry.shift:
        if name not in used:
            remedy = nearest(name, used) or "Name a channel of the files or a calculated one."
            yield Finding(location, f"channel {name} is not used", remedy, fixes=_without(entry, "shift", name))
    for name in entry.unknown_shifts:
        # calculated channels are computed before the shift is estimated, by the channel where it was recorded
        dependent = [other for other, graph in channels.calculated.graphs.items() if name in graph.inputs]
        if dependent:
            message = f'the shift of {name} cannot be "auto" because [calculated] {dependent[0]} reads it'
            remedy = "Give a number, or shift the channels that the function reads."
            yield Finding(location, message, remedy, fixes=_without(entry, "shift", name))


def _without(entry: DatasetEntry, *keys: str) -> tuple[Fix, ...]:
    """Return the fix that removes a key of a dataset of a project file."""
    dataset = entry.location.keys
    return (Fix.remove((*dataset, *keys)),) if dataset else ()


def _hold_points(dataset: Dataset, entry: DatasetEntry, model_step: float | None) -> Dataset:
    """Return the samples as points that are held until the model has settled, if `settle` is set; without time."""
    if entry.settle is None:
        return dataset
    return replace(dataset, time=None, settling=Settling(entry.settle, entry.average, entry.step or model_step))


def _check_time(dataset: Dataset, entry: DatasetEntry, where: Graph | None) -> None:
    """Raise `InputError` if the dataset has no time stamps and a setting requires them."""
    if dataset.time is not None:
        return
    findings = Findings()
    missing = "requires time stamps, but the data have none"
    if entry.steady:
        remedy = "Name the time channel `time`; remove steady if these are steady-state points."
        fixes = _without(entry, "steady")
        findings.error(entry.location.within("steady"), f"steady {missing}", remedy, fixes=fixes)
    for key, value in (("warmup", entry.warmup), ("max_gap", entry.max_gap)):
        if value > 0:
            remedy = "Name the time channel `time`, or remove the key."
            fixes = _without(entry, key)
            findings.error(entry.location.within(key), f"{key} = {value:g} s {missing}", remedy, fixes=fixes)
    for name, shift in entry.known_shifts.items():
        if shift != round(shift):
            message = f"{shift:g} samples of {name}: data without time stamps can only be shifted by whole samples"
            fixes = (Fix.set((*entry.location.keys, "shift", name), round(shift)),)
            findings.error(entry.location.within("shift"), message, "Write a whole number.", fixes=fixes)
    if where is not None and where.clocks:
        fixes = _without(entry, "where")
        findings.error(entry.location.within("where"), f"the condition {missing}", fixes=fixes)
    findings.finish()


def _add_calculated(
    dataset: Dataset, entry: DatasetEntry, channels: DatasetChannels, settings: DataSettings
) -> Dataset:
    """Return the dataset with its calculated channels, shifted and in the units that the project states for them."""
    graphs = channels.calculated.graphs
    for name in channels.calculated.needed(channels.names):
        if graphs[name].clocks and dataset.time is None:
            message = f"{name} requires time stamps, but dataset {dataset.name} has none"
            raise InputError.of(settings.location("calculated", name), message, "Name the time channel `time`.")
    stated = {name: unit for name, unit in settings.units.items() if name in graphs}
    return with_stated_units(channels.calculated.add_to(dataset, channels.names, entry.known_shifts), stated)


def _mask_unscored(dataset: Dataset, entry: DatasetEntry, where: Graph | None) -> tuple[Dataset, list[Finding]]:
    """Return the dataset without scoring in the warm-up and where the condition is false or NaN, and the problems."""
    scored, errors = dataset.counting.copy(), []
    if where is not None and all(name in dataset for name in where.inputs):
        scored &= holds(where, dataset)
        if not scored.any():
            message = f"{entry.where} is true at no sample"
            place, fixes = entry.location.within("where"), _without(entry, "where")
            errors.append(Finding(place, message, "Check the condition.", fixes=fixes))
    if entry.warmup > 0 and dataset.time is not None:
        for piece in dataset.pieces:
            time = dataset.time[piece]
            scored[piece] &= time - time[0] > entry.warmup - TIME_TOLERANCE
        if not scored.any():
            message = f"{entry.warmup:g} s is longer than every piece"
            place, fixes = entry.location.within("warmup"), _without(entry, "warmup")
            errors.append(Finding(place, message, "Reduce it.", fixes=fixes))
    return dataset if scored.all() else replace(dataset, scored=scored), errors
