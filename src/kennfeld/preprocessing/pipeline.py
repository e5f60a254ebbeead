"""The datasets of a project: files found and read, channels shifted and calculated, samples chosen."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from kennfeld.dataset import Dataset, Settling, concatenate
from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest, quoted
from kennfeld.graph import Graph
from kennfeld.measurement import describe
from kennfeld.measurement.cache import Cache
from kennfeld.measurement.reader import read_leniently
from kennfeld.preprocessing.binding import NEAR
from kennfeld.preprocessing.calculated import Calculated, evaluate_expression, read_expression, uses_clock
from kennfeld.preprocessing.model_step import refine_step
from kennfeld.preprocessing.plateaus import steady_points
from kennfeld.preprocessing.recipe import DatasetEntry, DataSettings
from kennfeld.preprocessing.recordings import CACHE, default_name, matching, near
from kennfeld.preprocessing.time_shift import shift_channels
from kennfeld.preprocessing.units import Units, check_stated, compare, restated, says_nothing, times

__all__ = ["ChannelRequest", "LoadedData", "load"]


@dataclass(frozen=True)
class ChannelRequest:
    """The channels that a project reads, each with what it is for.

    Every dataset has to have the `required` ones; `optional` ones, such as targets, may be missing in some.
    `units` are those that the function has for channels, each with whose it is; `in_formulas` the channels that
    criteria weigh their samples by. Where the function could not be read, they are not `complete`.
    """

    required: Mapping[str, str] = field(default_factory=dict)
    optional: Mapping[str, str] = field(default_factory=dict)
    inputs: frozenset[str] = frozenset()
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    in_formulas: frozenset[str] = frozenset()
    step: float | None = None
    complete: bool = True


@dataclass
class LoadedData:
    """The datasets, and the names that the files offer where channels were missed."""

    datasets: list[Dataset] = field(default_factory=list)
    places: dict[str, str] = field(default_factory=dict)  # of each dataset, by its name
    offered: dict[str, None] = field(default_factory=dict)
    unknown_shifts: dict[str, tuple[str, ...]] = field(default_factory=dict)  # of each dataset that has some
    clocks: set[str] = field(default_factory=set)  # the columns of files that time was read from
    complete: bool = True


def load(file: DataSettings, wanted: ChannelRequest, calculated: Calculated, findings: list[Finding]) -> LoadedData:
    """All datasets that can be read, and what is wrong with the others."""
    loaded = LoadedData()
    units = Units(file.units, wanted.units)
    formulas = {*wanted.in_formulas, *(name for graph in calculated.graphs.values() for name in graph.inputs)}
    used: set[str] = set()
    for entry in file.datasets:
        name = entry.name
        try:
            work = _Loading(file, entry, wanted, calculated, findings, loaded, units)
            formulas |= work.in_formulas
            used |= work.used
            made = work.dataset()
        except InputError as error:
            findings += error.findings
            made = None
        except ArgumentError as error:
            findings.append(Finding(entry.place, str(error)))
            made = None
        if made is None:
            loaded.complete = False
        elif made.name in loaded.places:
            message = f"two datasets are called {made.name}"
            findings.append(Finding(f"{entry.place} name", message, "Give one of them a name of its own."))
        else:
            loaded.datasets.append(made)
            if entry.unknown_shifts:
                loaded.unknown_shifts[made.name] = entry.unknown_shifts
            loaded.places[made.name] = entry.place if name else f"{entry.place} ({made.name})"
    findings += units.remarks(formulas)
    if wanted.complete:
        findings += check_stated(file, used, loaded.clocks, complete=loaded.complete)
    return loaded


class _Loading:
    """One dataset on its way in."""

    def __init__(
        self,
        file: DataSettings,
        entry: DatasetEntry,
        wanted: ChannelRequest,
        calculated: Calculated,
        findings: list[Finding],
        loaded: LoadedData,
        units: Units,
    ) -> None:
        self.file, self.entry, self.wanted, self.calculated = file, entry, wanted, calculated
        self.findings, self.loaded, self.units = findings, loaded, units
        self.cache = Cache(file.folder / CACHE) if entry.cache else None
        self.where: Graph | None = None
        if entry.where:
            self.where = read_expression(entry.where, f"{entry.place} where", findings)
        conditions = dict.fromkeys(self.where.inputs if self.where else (), "the condition `where`")
        weights = {entry.weight_channel: "the weights of its samples"} if entry.weight_channel else {}
        steady = dict.fromkeys((one.channel for one in entry.steady), "the channel of `steady`")
        self.required = {**dict(wanted.required), **conditions, **weights, **steady}
        self.optional = {name: why for name, why in wanted.optional.items() if name not in self.required}
        self.failed = bool(entry.where) and self.where is None

    @property
    def in_formulas(self) -> set[str]:
        """The channels whose numbers the entry speaks of."""
        return {*(self.where.inputs if self.where else ()), *(one.channel for one in self.entry.steady)}

    @property
    def used(self) -> set[str]:
        """The channels that the project reads or calculates for this dataset."""
        needed = self.calculated.needed([*self.required, *self.optional])
        return {*needed, *self._channels(), *self.calculated.graphs}

    def dataset(self) -> Dataset | None:
        """The dataset, or None where a finding says why there is none."""
        paths = list(self._paths())
        self._check_shift()
        parts = list(self._parts(paths))
        if not parts:
            return None
        finished = self._finished(self._joined(paths, parts))
        return None if self.failed else finished

    def _report(self, key: str, message: str, remedy: str = "") -> None:
        self._keep([Finding(f"{self.entry.place} {key}".strip(), message, remedy)])

    def _keep(self, findings: Iterable[Finding]) -> None:
        """Keep errors; the dataset is of no use then."""
        self.findings += findings
        self.failed = True

    def _paths(self) -> Iterator[str]:
        """The files, in the order of the patterns and sorted within each; each once."""
        found: dict[str, None] = {}
        for pattern in self.entry.files:
            matches = matching(self.file.folder, pattern)
            if not matches:
                self._report("files", f"{pattern} matches no file", near(self.file.folder, pattern))
            found |= dict.fromkeys(matches)
        yield from found

    def _check_shift(self) -> None:
        used = self.used
        for name in (*(self.entry.shift or {}), *self.entry.unknown_shifts):
            if name not in used:
                remedy = nearest(name, used) or "Name a channel of the files or a calculated one."
                self._report("shift", f"nothing uses a channel {name}", remedy)
        for name in self.entry.unknown_shifts:
            after = [other for other, graph in self.calculated.graphs.items() if name in graph.inputs]
            if after:
                message = f'{name} cannot be "auto", since [calculated] {after[0]} is made of it'
                self._report("shift", message, "Give a number, or shift what the function reads.")

    def _channels(self) -> list[str]:
        return self.calculated.recorded([*self.required, *self.optional])

    def _parts(self, paths: Sequence[str]) -> Iterator[Dataset]:
        """The files, their channels in the units of the function, or else in those of the first file."""
        for path, part in self._recordings(paths):
            yield self.units.converted(part, Path(path).name)

    def _recordings(self, paths: Sequence[str]) -> Iterator[tuple[str, Dataset]]:
        """The files that can be read, as recorded."""
        missed: dict[str, list[str]] = {}
        listed: dict[str, None] = {}
        for path in paths:
            part = self._recording(path, missed, listed)
            if part is not None:
                self.findings += part.remarks
                yield path, part
        self._report_missed(missed, listed)

    def _recording(self, path: str, missed: dict[str, list[str]], listed: dict[str, None]) -> Dataset | None:
        """The file, without the optional channels that it lacks; None, and findings, where it is of no use."""
        asked = self._channels() or None, self.entry.raster
        try:
            names = None if self.cache is None else self.cache.failed(path, *asked)
            if names is None:
                return self._read(path, *asked)
        except InputError as error:
            names = self._names(path, error)
            if names is None:
                return None
            if self.cache is not None:
                self.cache.keep_failed(path, *asked, names)
        return self._lenient(path, names, missed, listed)

    def _read(self, path: str, channels: Sequence[str] | None, raster: float | None) -> Dataset:
        units = times(self.file.units)
        if self.cache is None:
            read = read_leniently(path, channels, raster, units)
        else:
            read = self.cache.read(path, channels, raster, units=units)
        self.loaded.clocks |= {read.clock.name} if read.clock is not None else set()
        return read

    def _names(self, path: str, error: InputError) -> list[str] | None:
        """All that a file has, where it cannot give what is asked for; None where it cannot be read at all."""
        try:
            tables = describe(path).tables
        except InputError:
            self._keep(error.findings)
            return None
        return [name for t in tables for name in [*(c.name for c in t.channels), *t.left_out, *t.ambiguous]]

    def _lenient(
        self, path: str, names: Sequence[str], missed: dict[str, list[str]], listed: dict[str, None]
    ) -> Dataset | None:
        """The file without the optional channels that it lacks; keeps what it misses otherwise."""
        self.loaded.offered |= dict.fromkeys(names)
        absent = [name for name in self._channels() if name not in names]
        needed = [name for name in self.calculated.recorded(self.required) if name in absent]
        for name in needed:
            missed.setdefault(name, []).append(Path(path).name)
            listed |= dict.fromkeys(names)
        if needed:
            self.failed = True
            return None
        try:
            return self._read(path, [name for name in self._channels() if name not in absent], self.entry.raster)
        except InputError as again:
            self._keep(again.findings)
            return None

    def _report_missed(self, missed: Mapping[str, Sequence[str]], listed: Mapping[str, None]) -> None:
        for channel, files in missed.items():
            place = files[0] + (f" and {len(files) - 1} more" if len(files) > 1 else "")
            why = self.required.get(channel) or self._why_calculated(channel)
            names = ", ".join(list(listed)[:8]) + (", ..." if len(listed) > 8 else "")
            remedy = nearest(channel, listed) or f"It has {names}."
            if why.startswith("the input ") and channel not in self.file.channels.values():
                key = quoted(channel)
                scalar = f"or define a scalar: [parameters.{key}] initial = 1.0."
                remedy = f'{remedy} Name its channel in [channels]: {key} = "..."; {scalar}'
            self.findings.append(Finding(place, f"has no channel {channel}, {why}", remedy))

    def _why_calculated(self, channel: str) -> str:
        for name, graph in self.calculated.graphs.items():
            if channel in graph.inputs:
                return f"which [calculated] {name} needs"
        return "which the project needs"

    def _joined(self, paths: Sequence[str], parts: Sequence[Dataset]) -> Dataset:
        """One dataset, each file a piece; a channel that some files lack is NaN there."""
        every = {channel.name: channel for part in reversed(parts) for channel in part.channels}
        self._check_units(parts)
        whole = [
            part.with_channels(
                *(replace(c, values=np.full(part.samples, np.nan)) for n, c in every.items() if n not in part)
            )
            for part in parts
        ]
        name = self.entry.name or default_name(paths, self.entry.files[0])
        joined = concatenate(name, whole) if len(whole) > 1 else whole[0]
        use, weight = self.entry.use, self.entry.weight
        sampled = self.entry.weight_channel
        joined = replace(joined, name=name, use=use, weight=weight, weight_channel=sampled)
        return replace(joined, max_gap=self.entry.max_gap, warmup=self.entry.warmup)

    def _check_units(self, parts: Sequence[Dataset]) -> None:
        units: dict[str, str] = {}
        for part in parts:
            for channel in part.channels:
                if says_nothing(channel.unit):
                    continue
                first = units.setdefault(channel.name, channel.unit)
                if channel.unit != first and compare(channel.unit, first) != "same":
                    message = f"channel {channel.name} is in {first} in one file and in {channel.unit} in another"
                    place = f"{self.entry.place} files"
                    self.findings.append(Finding(place, message, "Split the dataset.", severity="warning"))
                    units[channel.name] = channel.unit

    def _finished(self, dataset: Dataset) -> Dataset | None:
        shift = self.entry.shift or {}
        if not self.entry.steady:
            dataset = self._held(dataset)
        if not self._fits_time(dataset, shift):
            return None
        dataset = shift_channels(dataset, {n: s for n, s in shift.items() if n not in self.calculated.graphs})
        names = [*self.required, *self.optional]
        for name in self.calculated.needed(names):
            if uses_clock(self.calculated.graphs[name]) and dataset.time is None:
                message = f"{name} needs time steps, but dataset {dataset.name} has no time stamps"
                self._keep([Finding(self.file.place(f"[calculated] {name}"), message, "Name the time channel `time`.")])
                return None
        stated = {name: unit for name, unit in self.file.units.items() if name in self.calculated.graphs}
        dataset = self._chosen(restated(self.calculated.added(dataset, names, shift), stated))
        if self.entry.steady:
            return self._steady(dataset)
        if self.wanted.step is not None:
            dataset = refine_step(dataset, self.wanted.step, self.wanted.inputs, self.entry.place, _raster)
        return dataset

    def _steady(self, dataset: Dataset) -> Dataset | None:
        """The means over the plateaus, to be held where the entry asks for it too."""
        if self.failed or any(one.channel not in dataset for one in self.entry.steady):
            return None
        points = steady_points(dataset, self.entry, self.findings)
        return None if points is None else self._held(points)

    def _held(self, dataset: Dataset) -> Dataset:
        """The dataset as points to be held, whatever their time stamps, where the entry asks for it."""
        entry = self.entry
        if entry.settle is None:
            return dataset
        return replace(
            dataset, time=None, settling=Settling(entry.settle, entry.average, entry.step or self.wanted.step)
        )

    def _fits_time(self, dataset: Dataset, shift: Mapping[str, float]) -> bool:
        """Whether what the entry says fits data without time stamps, where there are none."""
        if dataset.time is not None:
            return True
        good = True
        if self.entry.steady:
            remedy = "Name the time channel `time`; leave steady out, if these are steady-state points."
            self._report("steady", "plateaus are found in time, but the data have no time stamps", remedy)
            good = False
        for key, value in (("warmup", self.entry.warmup), ("max_gap", self.entry.max_gap)):
            if value > 0:
                message = f"{key} = {value:g} s needs time, but the data have no time stamps"
                self._report(key, message, "Name the time channel `time`, or remove the key.")
                good = False
        for name, by in shift.items():
            if by != round(by):
                message = f"{by:g} samples of {name}: data without time stamps can only be shifted by whole samples"
                self._report("shift", message, "Write a whole number.")
                good = False
        if self.where is not None and uses_clock(self.where):
            self._report("where", "the condition needs time, but the data have no time stamps")
            good = False
        return good

    def _chosen(self, dataset: Dataset) -> Dataset:
        """The dataset with the samples marked that count."""
        scored = dataset.counting.copy()
        if self.where is not None and all(name in dataset for name in self.where.inputs):
            values = evaluate_expression(self.where, dataset)
            scored &= np.isfinite(values) & (values != 0)
            if not scored.any():
                self._report("where", f"{self.entry.where} holds at no sample", "Check the condition.")
        if self.entry.warmup > 0 and dataset.time is not None:
            for piece in dataset.pieces:
                time = dataset.time[piece]
                scored[piece] &= time - time[0] > self.entry.warmup - NEAR
            if not scored.any():
                self._report("warmup", f"{self.entry.warmup:g} s are longer than every piece", "Shorten it.")
        return dataset if scored.all() else replace(dataset, scored=scored)


def _raster(step: float) -> str:
    return f"Write raster = {step:g} to put them onto an even raster."
