"""Recordings of a dataset: find the files, read the channels that a project needs, and report those that are missing.

Optional channels, such as targets, may be missing in some files. If a file lacks a required channel, the findings name
all files without it, what needs it, and similar names that the files have.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace
from functools import cached_property, partial
from itertools import takewhile
from pathlib import Path

import numpy as np

from kennfeld.base.errors import Finding, Fix, InputError, Keys, Location
from kennfeld.base.file_errors import files_alike, nearest_file
from kennfeld.base.formatting import join_names, most_similar, nearest, quoted
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import within
from kennfeld.base.threads import map_in_order
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.file_spans import FileSpans
from kennfeld.graph import Graph
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.measurement.cache import Cache
from kennfeld.measurement.channel_groups import RASTER
from kennfeld.measurement.channel_names import CHANNEL
from kennfeld.measurement.reader import describe, list_columns, read_leniently
from kennfeld.preprocessing.calculated import Calculated, parse_expression
from kennfeld.preprocessing.recipe import DatabaseEntry, DatasetEntry, DataSettings
from kennfeld.preprocessing.units import Units, select_time_units

ReadingWatch = Callable[[int, int], None]
INPUT = "the input "  # begins the purpose of a channel that an input of the function reads

RECORDING = "recording"  # the channel of the number of the file, among all files of a project, if files have none
CACHE = Path(".kennfeld") / "cache"  # in the folder of the project file; contents of files that are slow to read


@dataclass(frozen=True)
class ChannelRequest:
    """The channels that a project reads, each with its purpose.

    Attributes:
        required: channels that every dataset must have.
        optional: channels that may be missing in some datasets, such as targets.
        inputs: the channels that the function reads.
        units: unit of each channel that the function states one for, and the owner of that unit: the input Speed.
        in_formulas: channels that the regions of criteria read.
        places: of required and optional channels, the keys of the project that name each for the function or a target.
        step: the function's own step in s.
        complete: false if the function could not be read, so that channels may be unknown.
        names_are_open: an input becomes a parameter by a section of that name, as in formula text.
    """

    required: Mapping[str, str] = field(default_factory=dict)
    optional: Mapping[str, str] = field(default_factory=dict)
    inputs: frozenset[str] = frozenset()
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    in_formulas: frozenset[str] = frozenset()
    places: Mapping[str, tuple[Keys, ...]] = field(default_factory=dict)
    step: float | None = None
    complete: bool = True
    names_are_open: bool = True


@dataclass(frozen=True)
class DatasetChannels:
    """The channels that one dataset must have or may have, each with its purpose, and its condition `where`.

    `calculated` are the calculated channels of the project, `findings` the errors in the condition, `places` those of
    the request. With `names_are_open`, an input becomes a parameter by a section of that name.
    """

    required: Mapping[str, str]
    optional: Mapping[str, str]
    calculated: Calculated
    where: Graph | None = None
    in_formulas: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()
    names_are_open: bool = True
    places: Mapping[str, tuple[Keys, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, entry: DatasetEntry, request: ChannelRequest, calculated: Calculated) -> "DatasetChannels":
        """Return the channels of a project and those that a dataset's own settings name."""
        location = entry.location.within("where")
        where, findings = parse_expression(entry.where, location) if entry.where else (None, ())
        conditions = dict.fromkeys(where.inputs if where else (), "the condition `where`")
        weights = {entry.weight_channel: "the weights of its samples"} if entry.weight_channel else {}
        steady = dict.fromkeys((condition.channel for condition in entry.steady), "the channel of `steady`")
        required = {**request.required, **conditions, **weights, **steady}
        optional = {name: purpose for name, purpose in request.optional.items() if name not in required}
        in_formulas, is_open = frozenset((*conditions, *steady)), request.names_are_open
        return cls(required, optional, calculated, where, in_formulas, findings, is_open, request.places)

    @property
    def names(self) -> list[str]:
        """Required and optional channels."""
        return [*self.required, *self.optional]

    @property
    def recorded(self) -> list[str]:
        """The channels to be read from files."""
        return self.calculated.recorded(self.names)

    @property
    def used(self) -> set[str]:
        """The channels that the project reads or calculates for this dataset."""
        return {*self.calculated.needed(self.names), *self.recorded, *self.calculated.graphs}


@dataclass
class RecordingReader:
    """Reads the recordings of one dataset; findings are added in the order of the files.

    `watch` is called after each file with the number of files that have been read and that of all. `offered` collects
    the channel names of files in which channels are missing, `clocks` the columns that time was read from. `databases`
    decode bus logs; by default they are found when the files are read.
    """

    settings: DataSettings
    entry: DatasetEntry
    channels: DatasetChannels
    findings: list[Finding] = field(default_factory=list)
    watch: ReadingWatch | None = None
    offered: dict[str, None] = field(default_factory=dict)
    clocks: set[str] = field(default_factory=set)
    databases: tuple[DatabaseFile, ...] | None = None
    _missing: dict[str, list[str]] = field(default_factory=dict)  # files without each required channel
    _candidates: dict[str, None] = field(default_factory=dict)  # channel names of these files

    @property
    def failed(self) -> bool:
        """True if one of the findings is an error."""
        return any(finding.severity == "error" for finding in self.findings)

    def find_files(self) -> list[str]:
        """Return the files in the order of the patterns, sorted within each, without duplicates."""
        files: dict[str, None] = {}
        for pattern in self.entry.files:
            matches = find_recordings(self.settings.folder, pattern)
            if not matches:
                remedy = _similar_file(self.settings.folder, pattern)
                place, fixes = self.entry.location.within("files"), self._other_files(pattern)
                self.findings.append(Finding(place, f"{pattern} matches no file", remedy, fixes=fixes))
            files |= dict.fromkeys(matches)
        return list(files)

    def _other_files(self, pattern: str) -> tuple[Fix, ...]:
        """Return the fixes of a pattern that matches no file: similar files in its place, or the dataset without it."""
        dataset, files = self.entry.location.keys, self.entry.files
        if not dataset:
            return ()
        keys: Keys = (*dataset, "files")
        others = _alike(self.settings.folder, pattern, files)
        read = (Fix.exchange(f"Read {other}", keys, files, pattern, other) for other in others[:2])
        if {*files} == {pattern}:
            return (*read, Fix.remove(dataset))
        return (*read, Fix.exchange(f"Read without {pattern}", keys, files, pattern))

    def read(self, paths: Sequence[str], units: Units) -> Iterator[Dataset]:
        """Yield the recordings that can be read, in the units of the function or of the first file that has one.

        Several files are read at the same time. The findings are complete after the last recording.
        """
        cache = self._cache() if self.entry.cache else None
        if self.databases is None:
            self.databases, findings = find_databases(self.settings.folder, self.entry)
            self.findings += findings
            if findings:
                return
        attempts = map_in_order(partial(self._attempt, cache=cache), paths)
        for number, (path, attempt) in enumerate(zip(paths, attempts, strict=True), 1):
            self._add(path, attempt)
            if self.watch is not None:
                self.watch(number, len(paths))
            if attempt.recording is not None:
                recording = units.convert(attempt.recording, Path(path).name)
                if self._is_counted and RECORDING not in recording:
                    column = np.full(recording.samples, float(self._earlier + number))
                    recording = recording.with_channels(Channel(RECORDING, column))
                yield replace(recording, files=FileSpans.joined([path], [recording.samples], [recording.start_time]))
        self._report_missing()

    @property
    def _is_counted(self) -> bool:
        """Return if the project reads the number of the recording; files alone, as of partitions, have none."""
        return RECORDING in self.channels.recorded and any(entry is self.entry for entry in self.settings.datasets)

    @cached_property
    def _earlier(self) -> int:
        return count_before(self.settings, self.entry)

    def _cache(self) -> Cache | None:
        """Return the folder of cached recordings; None if links lead elsewhere."""
        with suppress(OSError):
            return Cache(within(self.settings.folder, CACHE))
        return None

    def _add(self, path: str, attempt: "_Attempt") -> None:
        """Record what was learned about a file."""
        self.findings += [replace(each, fixes=self._placed(each.fixes)) for each in attempt.findings]
        self.offered |= dict.fromkeys(attempt.offered)
        for name in attempt.missing:
            self._missing.setdefault(name, []).append(Path(path).name)
            self._candidates |= dict.fromkeys(attempt.offered)
        if attempt.recording is not None:
            self.findings += attempt.recording.findings
            self.clocks |= {attempt.recording.clock.name} if attempt.recording.clock else set()

    def _placed(self, fixes: Sequence[Fix]) -> tuple[Fix, ...]:
        """Return the fixes of a file's reader, which knows no project, with the keys that they change in it."""
        placed: list[Fix] = []
        for fix in fixes:
            (first, *rest), value = fix.changes[0]
            if first == RASTER and self.entry.location.keys:
                placed.append(replace(fix, changes=(((*self.entry.location.keys, RASTER), value),)))
            elif first == CHANNEL:
                for keys in self.channels.places.get(str(rest[0]), ()):
                    title = f"Read {keys[1]} from" if keys[0] == "channels" else fix.title
                    placed.append(replace(fix, title=title, changes=((keys, value),)))
        return tuple(placed)

    def _attempt(self, path: str, cache: Cache | None) -> "_Attempt":
        """Read the channels of a file, without optional ones that it lacks."""
        request = self.channels.recorded or None, self.entry.raster
        try:
            # the header of a text file says without reading its rows whether a channel is missing
            columns = list_columns(path)
            if columns is not None and any(name not in columns for name in self.channels.recorded):
                attempt = self._attempt_available(path, columns, cache)
                if not attempt.findings:
                    return attempt
            names = None if cache is None else cache.load_failed(path, *request, self.databases or ())
            if names is None:
                return _Attempt(self._read(path, *request, cache))
        except InputError as error:
            try:
                tables = describe(path, self.databases or ()).tables
            except InputError:  # the file cannot be read at all
                return _Attempt(findings=error.findings)
            names = [name for t in tables for name in [*(c.name for c in t.channels), *t.left_out, *t.ambiguous]]
            # so that the next run does not read a large file again to learn that it lacks a channel
            if cache is not None:
                cache.keep_failed(path, *request, names, self.databases or ())
        return self._attempt_available(path, names, cache)

    def _read(self, path: str, channels: Sequence[str] | None, raster: float | None, cache: Cache | None) -> Dataset:
        units = select_time_units(self.settings.units)
        if cache is None:
            return read_leniently(path, channels, raster, units, self.databases or ())
        return cache.read(path, channels, raster, units=units, databases=self.databases or ())

    def _attempt_available(self, path: str, names: Sequence[str], cache: Cache | None) -> "_Attempt":
        """Read a file without the optional channels that it lacks."""
        available = [name for name in self.channels.recorded if name in names]
        required = self.channels.calculated.recorded(self.channels.required)
        missing = [name for name in required if name not in available and not (name == RECORDING and self._is_counted)]
        if missing:
            return _Attempt(offered=names, missing=missing)
        try:
            return _Attempt(self._read(path, available, self.entry.raster, cache), offered=names)
        except InputError as error:
            return _Attempt(findings=error.findings, offered=names)

    def _report_missing(self) -> None:
        for channel, files in self._missing.items():
            purpose = self.channels.required.get(channel) or self._calculated_purpose(channel)
            message = f"has no channel {channel}, {purpose}"
            fixes = self._other_channels(channel, purpose)
            remedy = self._remedy(channel, purpose)
            section = f"[parameters.{quoted(channel)}]\ninitial = 1.0" if self._may_be_scalar(channel, purpose) else ""
            self.findings.append(Finding(Location(join_names(files, 1)), message, remedy, section, fixes=fixes))

    def _remedy(self, channel: str, purpose: str) -> str:
        if channel == RECORDING:  # of a part of the data, which does not know the others
            return "Data in partitions are not numbered: record the number in a channel, or write partition = 0."
        remedy = nearest(channel, self._candidates) or f"It has {join_names(self._candidates)}."
        if self._is_unmapped_input(channel, purpose):
            key = quoted(channel)
            scalar = f"or define a scalar: [parameters.{key}] initial = 1.0."
            constant = f'or set it to a number: [calculated] {key} = "1.0".'
            alternative = scalar if self._may_be_scalar(channel, purpose) else constant
            return f'{remedy} Name its channel in [channels]: {key} = "..."; {alternative}'
        return remedy

    def _is_unmapped_input(self, channel: str, purpose: str) -> bool:
        return purpose.startswith(INPUT) and channel not in self.settings.channels.values()

    def _may_be_scalar(self, channel: str, purpose: str) -> bool:
        """Return True for an input that no file has and nobody mapped, of formula text that does not declare it."""
        return self._is_unmapped_input(channel, purpose) and self.channels.names_are_open

    def _other_channels(self, channel: str, purpose: str) -> tuple[Fix, ...]:
        """Return the fix by which an input is read from another channel of the files that lack one."""
        if not purpose.startswith(INPUT) or not self._candidates:
            return ()
        # its name, as the project may map it to the channel that is missing
        name = next((own for own, mapped in self.settings.channels.items() if mapped == channel), channel)
        keys: Keys = ("channels", name)
        return (Fix(f"Read {name} from", ((keys, ""),), tuple(sorted(self._candidates))),)

    def _calculated_purpose(self, channel: str) -> str:
        readers = (name for name, graph in self.channels.calculated.graphs.items() if channel in graph.inputs)
        name = next(readers, None)
        return "which the project needs" if name is None else f"which [calculated] {name} needs"


@dataclass(frozen=True)
class _Attempt:
    """The outcome of reading one file.

    `offered` are the names of its channels if some are missing, and `missing` the required ones among these.
    """

    recording: Dataset | None = None
    findings: Sequence[Finding] = ()
    offered: Sequence[str] = ()
    missing: Sequence[str] = ()


def find_recordings(folder: Path, pattern: str) -> list[str]:
    """Return the files that a pattern matches, sorted; a sheet behind a `#` stays with each."""
    whole, mark, sheet = pattern.rpartition("#")
    # a file may have a # in its own name, so that the sheet is split off only if nothing matches
    for part, rest in ((pattern, ""), (whole, f"#{sheet}")):
        if not part or (rest and not mark):
            continue
        if (folder / part).is_file():
            return [f"{folder / part}{rest}"]
        # a pattern such as **/*.csv must not match the contents of the cache
        files = sorted(p for p in _glob(folder, part) if p.is_file() and p.parts[-3:-1] != CACHE.parts)
        if files:
            return [f"{path}{rest}" for path in files]
    return []


def matching_recordings(folder: Path, patterns: Sequence[str]) -> list[str]:
    """Return the files that patterns match, in the order of the patterns, sorted within each, without duplicates."""
    return list(dict.fromkeys(path for pattern in patterns for path in find_recordings(folder, pattern)))


def count_before(settings: DataSettings, entry: DatasetEntry) -> int:
    """Return the number of recordings in the datasets before one, by which those of its own are numbered."""
    before = takewhile(lambda other: other is not entry, settings.datasets)
    return sum(len(matching_recordings(settings.folder, other.files)) for other in before)


def find_databases(folder: Path, entry: DatasetEntry) -> tuple[tuple[DatabaseFile, ...], list[Finding]]:
    """Return the CAN databases of a dataset, and an error for each pattern that matches no file."""
    databases: dict[DatabaseFile, None] = {}
    findings = []
    for item in entry.dbc:
        named = DatabaseEntry(item) if isinstance(item, str) else item
        if not (matches := find_recordings(folder, named.file)):
            remedy = _similar_file(folder, named.file)
            findings.append(Finding(entry.location.within("dbc"), f"{named.file} matches no file", remedy))
        databases |= {DatabaseFile(Path(path), named.bus, named.network): None for path in matches}
    return tuple(databases), findings


def default_name(paths: Sequence[str], pattern: str) -> str:
    """Return the stem of the file; for several files their pattern without its wildcards."""
    name = Path((paths[0] if len(paths) == 1 else pattern).partition("#")[0]).name
    stem = Path(name.removesuffix(".gz")).stem
    return (stem.strip("*?_- .") if len(paths) > 1 else stem) or Path(paths[0]).stem


def _glob(folder: Path, pattern: str) -> list[Path]:
    start = Path(pattern)
    try:
        if start.is_absolute():
            return list(Path(start.anchor).glob(str(start.relative_to(start.anchor))))
        return list(folder.glob(pattern))
    except (ValueError, NotImplementedError, OSError, IndexError):  # raised by pathlib for invalid patterns
        return []


def _alike(folder: Path, pattern: str, known: Sequence[str]) -> list[str]:
    """Return the files beside those of a pattern that have its ending, the most similar first."""
    if "://" in pattern:
        return []
    path = Path(pattern.partition("#")[0])
    alike = files_alike(folder / path)
    first = most_similar(path.name, alike)
    others = ((path.parent / name).as_posix() for name in sorted(alike, key=lambda name: name != first))
    return [other for other in others if other not in known]


def _similar_file(folder: Path, pattern: str) -> str:
    if "://" in pattern:
        return "Object stores are read in partitions: write partition in [cluster]."
    path = folder / pattern.partition("#")[0]
    if not path.parent.is_dir():
        return f"The folder {path.parent} does not exist."
    return nearest_file(path) or f"Paths are relative to the folder {folder.resolve()}."
