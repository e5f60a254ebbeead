"""Prepared recordings: the samples of one file, from reading to the scored samples, kept on disk for the next use.

A dataset of many files is prepared file by file, on any machine. What is kept is mapped into memory, so that a second
use reads only what it needs. An entry is known by the recording, the settings that prepared it and the source of the
code that did; it is safe to delete at any time.
"""

import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, Int
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.code_digest import code_digest
from kennfeld.base.column_file import ColumnFile, read_columns, write_columns
from kennfeld.base.content_digest import digest_of
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Clock, Dataset, Settling
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.preprocessing.calculated import parse_calculated
from kennfeld.preprocessing.pipeline import prepare_dataset
from kennfeld.preprocessing.recipe import DatasetEntry, DataSettings
from kennfeld.preprocessing.recording_sources import RecordingSource, local_file, version_of
from kennfeld.preprocessing.recordings import ChannelRequest, DatasetChannels, RecordingReader
from kennfeld.preprocessing.units import Units

CHECKED = 0.02  # share of the size limit that is written between two checks of the folder
_written: dict[Path, int] = {}  # bytes since the last check, by folder
ENDING = ".columns"
_MARKED = 60_000_000_000  # ns between two marks of an entry that is used
_ATTRIBUTES = ("use", "weight", "weight_channel", "max_gap", "warmup")


@dataclass(frozen=True)
class StoredSettings:
    """The settings of a project that the preparation of its recordings reads, without the project file."""

    file: str
    folder: Path
    channels: Mapping[str, str]
    calculated: Mapping[str, str]
    units: Mapping[str, str]
    datasets: tuple[DatasetEntry, ...] = ()

    @classmethod
    def of(cls, file: str, settings: DataSettings) -> "StoredSettings":
        """Return the settings of a project file of this name."""
        channels, calculated, units = (dict(each) for each in (settings.channels, settings.calculated, settings.units))
        return cls(file, settings.folder.absolute(), channels, calculated, units)

    def location(self, *keys: str | int) -> Location:
        """Return the location of a section or key."""
        first, *inner = keys
        return Location(self.file, path=" ".join([f"[{first}]", *map(str, inner)]))


@dataclass(frozen=True)
class DatasetRecipe:
    """The settings by which each file of a dataset becomes samples.

    Attributes:
        settings: those of the project.
        entry: those of the dataset, which has a name.
        request: the channels to read.
        units: the unit of channels that the function states none for, and the file it is from.
        databases: the databases that decode bus logs, with their content.
    """

    settings: StoredSettings
    entry: DatasetEntry
    request: ChannelRequest
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    databases: tuple[DatabaseFile, ...] = ()

    @cached_property
    def key(self) -> str:
        """A digest of all that the prepared samples depend on, except the file."""
        settings, request = self.settings, self.request
        texts = settings.channels, settings.calculated, settings.units
        channels = sorted(request.required), sorted(request.optional), request.inputs, request.units, request.step
        # without settings that leave the samples alone: data that are renamed or become test data are not read again
        entry = replace(self.entry, location=Location(), files=(), name="", use="training", weight=1.0)
        return digest_of(texts, channels, entry, self.units, self.databases, code_digest())

    def prepare(self, source: RecordingSource) -> "PreparedFile":
        """Read a file and prepare its samples; problems are findings of the result."""
        try:
            with local_file(source) as path:
                return self._prepare(path)
        except InputError as error:
            return PreparedFile(None, error.findings)

    def _prepare(self, path: str) -> "PreparedFile":
        calculated = parse_calculated(self.settings)
        entry = replace(self.entry, files=(path,), cache=False)
        channels = DatasetChannels.of(entry, self.request, calculated)
        reader = RecordingReader(self.settings, entry, channels, [*channels.findings], databases=self.databases)
        units = Units(self.settings.units, self.request.units, dict(self.units))
        dataset = None
        try:
            dataset = prepare_dataset(reader, units, self.request, whole=False)
        except InputError as error:
            reader.findings += error.findings
        except ArgumentError as error:
            reader.findings.append(Finding(entry.location, str(error)))
        formulas = {*self.request.in_formulas, *channels.in_formulas}
        formulas |= {name for graph in calculated.graphs.values() for name in graph.inputs}
        findings = tuple(dict.fromkeys([*reader.findings, *units.remarks(formulas)]))
        more = tuple(reader.offered), tuple(reader.clocks), tuple(channels.used)
        return PreparedFile(None if reader.failed else dataset, findings, *more, units.first)


@dataclass(frozen=True)
class PreparedFile:
    """The samples of a file, None if it has none, and what was noticed on the way.

    Attributes:
        dataset: the samples.
        findings: problems and remarks.
        offered: channel names of the file, if channels are missing.
        clocks: the columns that time was read from.
        used: the channels that the project reads or calculates.
        units: the unit of each channel that the function states none for, and the file it is from.
    """

    dataset: Dataset | None
    findings: tuple[Finding, ...] = ()
    offered: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()
    used: tuple[str, ...] = ()
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """True if one of the findings is an error."""
        return any(finding.severity == "error" for finding in self.findings)

    def of(self, entry: DatasetEntry) -> "PreparedFile":
        """Return the same with the name, the use and the weight of its dataset, which an entry on disk may not have."""
        if self.dataset is None:
            return self
        return replace(self, dataset=replace(self.dataset, name=entry.name, use=entry.scored_as, weight=entry.weight))

    def excerpt(self, most: int, *, neighbouring: bool = False) -> Dataset | None:
        """Return at most about `most` samples: the first ones of a recording, else spread over all points.

        With the extremes of every channel of steady-state points, unless the excerpt must consist of neighbours.
        """
        data = self.dataset
        if data is None or data.samples <= most:
            return data
        if data.time is not None or data.settling is not None or neighbouring:
            return cut(data, 0, most)
        even = np.linspace(0, data.samples - 1, most).astype(np.int64)
        picked = np.unique(np.concatenate([even, *(_extremes(channel.values) for channel in data.channels)]))
        return data.select(picked)


def _extremes(values: Float) -> Int:
    """Return the samples with the smallest and the largest value."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(0, dtype=np.int64)
    low, high = np.where(known, values, np.inf).argmin(), np.where(known, values, -np.inf).argmax()
    return np.array([low, high], dtype=np.int64)


def cut(data: Dataset, first: int, last: int) -> Dataset:
    """Cut out the samples from `first` to before `last`, without copying them."""
    channels = tuple(replace(channel, values=channel.values[first:last]) for channel in data.channels)
    inner = data.piece_starts[(data.piece_starts > first) & (data.piece_starts < last)] - first
    starts = np.concatenate([np.zeros(1, dtype=np.int64), inner])
    time = None if data.time is None else data.time[first:last]
    scored, recorded = (None if marks is None else marks[first:last] for marks in (data.scored, data.recorded))
    files = None if data.files is None else data.files.cut(first, last)
    return replace(
        data, channels=channels, time=time, piece_starts=starts, scored=scored, files=files, recorded=recorded
    )


@dataclass(frozen=True)
class PreparedFiles:
    """The folder of prepared recordings.

    Attributes:
        folder: on a disk of this machine, or one that several machines share.
        most: bytes; the least recently used files are removed beyond that.
    """

    folder: Path
    most: int

    def file(self, recipe: DatasetRecipe, source: RecordingSource) -> PreparedFile:
        """Return a prepared recording; it is read if it is not here yet."""
        version = version_of(source)
        path = self.path(digest_of(recipe.key, source.address, version))
        stored = read_columns(path)
        prepared = None if stored is None else _from_columns(stored)
        if prepared is None:
            prepared = recipe.prepare(source)
            same = version_of(source) == version  # nobody replaced it while it was read
            if same and not prepared.failed and self.keep(path, _columns(prepared), _notes(prepared)):
                stored = read_columns(path)
                # the mapped file takes the place of the arrays that were read, so that they can be freed
                prepared = (None if stored is None else _from_columns(stored)) or prepared
                _release_memory()
        else:
            touch(path)
        return prepared.of(recipe.entry)

    def path(self, key: str) -> Path:
        """Return the path of an entry."""
        return self.folder / f"{key}{ENDING}"

    def keep(self, path: Path, columns: Iterator[NDArray[Any]], notes: Mapping[str, Any]) -> bool:
        """Write an entry; return False if the disk does not take it."""
        try:
            write_columns(path, columns, notes)
            if not (ignored := self.folder / ".gitignore").exists():
                write_whole(ignored, "*\n")
            _written[self.folder] = _written.get(self.folder, 0) + path.stat().st_size
        except OSError:
            return False
        if _written[self.folder] > CHECKED * self.most:
            _written[self.folder] = 0
            self._limit_size(path)
        return True

    def _limit_size(self, newest: Path) -> None:
        """Remove the least recently used entries, except the newest, until the folder is within its size limit."""
        entries = []
        for path in self.folder.glob(f"*{ENDING}"):
            with suppress(OSError):  # another process may remove it
                status = path.stat()
                # `touch` sets the time of access; an entry that nobody has used again has that of its writing
                entries.append((max(status.st_atime_ns, status.st_mtime_ns), status.st_size, path))
        total = 0
        for _, size, path in sorted(entries, reverse=True):
            total += size
            if total > self.most and path != newest:
                with suppress(OSError):
                    path.unlink(missing_ok=True)


def _release_memory() -> None:
    """Return memory that the readers' library keeps for its next use."""
    if "pyarrow" in sys.modules:
        sys.modules["pyarrow"].default_memory_pool().release_unused()


def touch(path: Path) -> None:
    """Mark an entry as used now, to the minute: each mark changes the file, whose checksum is computed again then."""
    with suppress(OSError):
        stat, now = path.stat(), time.time_ns()
        if abs(now - stat.st_atime_ns) > _MARKED:
            os.utime(path, ns=(now, stat.st_mtime_ns))


def _columns(prepared: PreparedFile) -> Iterator[NDArray[Any]]:
    data = prepared.dataset
    if data is None:
        return
    yield data.piece_starts
    yield from (channel.values for channel in data.channels)
    if data.time is not None:
        yield data.time
    yield from (marks for marks in (data.scored, data.recorded) if marks is not None)


def _notes(prepared: PreparedFile) -> dict[str, Any]:
    own = {name: getattr(prepared, name) for name in ("offered", "clocks", "used", "units")}
    return own | {
        "findings": [asdict(finding) for finding in prepared.findings],
        "dataset": None if prepared.dataset is None else _attributes(prepared.dataset),
    }


def _attributes(data: Dataset) -> dict[str, Any]:
    return {name: getattr(data, name) for name in _ATTRIBUTES} | {
        "name": data.name,
        "channels": [[channel.name, channel.unit, channel.description] for channel in data.channels],
        "time": data.time is not None,
        "scored": data.scored is not None,
        "recorded": data.recorded is not None,
        "findings": [asdict(finding) for finding in data.findings],
        "settling": None if data.settling is None else asdict(data.settling),
        "clock": None if data.clock is None else asdict(data.clock),
        "start_time": None if data.start_time is None else data.start_time.isoformat(),
    }


def _from_columns(stored: ColumnFile) -> PreparedFile | None:
    """Return a stored recording; None if it was written by another version."""
    notes, columns = stored.notes, list(stored.columns)
    try:
        data = None if notes["dataset"] is None else _dataset(notes["dataset"], columns)
        offered, clocks, used = (tuple(notes[name]) for name in ("offered", "clocks", "used"))
        units = {name: (unit, file) for name, (unit, file) in notes["units"].items()}
        return PreparedFile(data, _findings(notes["findings"]), offered, clocks, used, units)
    except (KeyError, TypeError, ValueError, IndexError, ArgumentError):
        return None


def _dataset(notes: dict[str, Any], columns: list[NDArray[Any]]) -> Dataset:
    # from the end, where the columns that may be missing are: the reverse of the order in which they are written
    recorded = columns.pop() if notes["recorded"] else None
    scored = columns.pop() if notes["scored"] else None
    time = columns.pop() if notes["time"] else None
    starts, *values = columns
    channels = tuple(
        Channel(name, column, unit, description)
        for (name, unit, description), column in zip(notes["channels"], values, strict=True)
    )
    return Dataset(
        notes["name"],
        channels,
        time,
        starts,
        scored=scored,
        recorded=recorded,
        findings=_findings(notes["findings"]),
        settling=None if notes["settling"] is None else Settling(**notes["settling"]),
        clock=None if notes["clock"] is None else Clock(**notes["clock"]),
        start_time=None if notes["start_time"] is None else datetime.fromisoformat(notes["start_time"]),
        **{name: notes[name] for name in _ATTRIBUTES},
    )


def _findings(notes: list[dict[str, Any]]) -> tuple[Finding, ...]:
    return tuple(Finding(**note | {"location": Location(**note["location"])}) for note in notes)
