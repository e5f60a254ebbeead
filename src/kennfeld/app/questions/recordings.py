"""The recordings of the project: their files, channels, and what the function reads of them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from kennfeld.app.answer import finite
from kennfeld.app.session.proposal import Range
from kennfeld.app.session.session import Session
from kennfeld.app.wire import ABSENT, Absent
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.bus_databases import DatabaseFile, to_databases
from kennfeld.measurement.reader import describe
from kennfeld.preprocessing.recording_sources import find_addresses, is_remote, recording_files
from kennfeld.preprocessing.recordings import find_recordings

MAX_CHANNELS = 2000  # of a file that the files of a project are listed with
MAX_SIGNALS = 20_000  # of a file that can be searched
MAX_DESCRIBED = 10  # files of a dataset that are read to describe their channels, if the data are in partitions
MAX_FILES = 200  # of them that are listed


@dataclass(frozen=True)
class ChannelRow:
    """A channel of a file with the range of its values; `group` names the table if there are several."""

    name: str
    group: str
    unit: str
    least: float | None
    greatest: float | None


@dataclass(frozen=True)
class ChannelGroup:
    """A group of channels with time stamps of its own; `step` is the usual time between them in s."""

    name: str
    step: float


@dataclass(frozen=True)
class RecordingFile:
    """A file of a dataset, as far as it can be read.

    Attributes:
        size: of the file in bytes.
        samples: number of samples of the longest table.
        step: between samples in s; of several groups of channels, the shortest.
        groups: of channels with time stamps, if there are several.
        length: duration in s.
        missing: share of missing values in the channel that has most of them.
        sparsest: that channel.
        error: why it cannot be read.
        note: why it is not described.
    """

    name: str
    channels: Sequence[ChannelRow]
    size: int | Absent = ABSENT
    samples: int | Absent = ABSENT
    step: float | Absent | None = ABSENT
    groups: Sequence[ChannelGroup] = ()
    length: float | Absent | None = ABSENT
    missing: float | Absent = ABSENT
    sparsest: str | Absent = ABSENT
    error: str | Absent = ABSENT
    note: str | Absent = ABSENT


@dataclass(frozen=True)
class DatasetFiles:
    """A dataset of the project file, numbered from 1 on, with its files."""

    number: int
    name: str
    use: str
    files: Sequence[RecordingFile]


@dataclass(frozen=True)
class MappedInput:
    """An input of the function, or the target of the criterion `number`, with its channel."""

    name: str
    role: Literal["input", "target"]
    unit: str
    channel: str
    number: int | Absent = ABSENT


@dataclass(frozen=True)
class DataFiles:
    """The files of all datasets, and the channels that the project needs."""

    datasets: Sequence[DatasetFiles]
    inputs: Sequence[MappedInput]


def files(session: Session) -> DataFiles:
    """Return the files of each dataset with their channels, and the inputs and targets of the function.

    The project may be incomplete: what its file says counts.
    """
    entries = _entries(session)
    rows = [
        DatasetFiles(
            number=number,
            name=str(entry.get("name", "")),
            use=str(entry.get("use", "training")),
            files=[*map(_listed, _described_files(session, entry)), *_other_files(session, entry)],
        )
        for number, entry in enumerate(entries, 1)
    ]
    return DataFiles(rows, _inputs(session))


def _listed(file: RecordingFile) -> RecordingFile:
    return replace(file, channels=file.channels[:MAX_CHANNELS])


def _described_files(session: Session, entry: Mapping[str, Any]) -> list[RecordingFile]:
    """Return the files of a dataset with their channels; some of them if the data are in partitions."""
    folder = session.path.parent
    paths = _paths(folder, entry)
    if session.reads_partitions:
        paths = [path for path in paths[:MAX_DESCRIBED] if not is_remote(path)]
    databases = _databases(folder, entry)
    return [_file(folder, path, databases) for path in paths]


def _databases(folder: Path, entry: Mapping[str, Any]) -> tuple[DatabaseFile, ...]:
    """Return the CAN databases of a dataset with their content, as far as its entry is right."""
    items = entry.get("dbc", [])
    databases: list[DatabaseFile] = []
    for item in items if isinstance(items, list) else [items]:
        named = item if isinstance(item, dict) else {"file": item}
        with suppress(ArgumentError, InputError):  # reported by the check of the project
            for path in find_recordings(folder, str(named.get("file", ""))):
                databases += (database.loaded() for database in to_databases({**named, "file": path}))
    return tuple(databases)


def _other_files(session: Session, entry: Mapping[str, Any]) -> Iterator[RecordingFile]:
    """Yield the further files of a dataset in partitions, which are not read here."""
    if not session.reads_partitions:
        return
    paths = _paths(session.path.parent, entry)
    others = [path for number, path in enumerate(paths) if number >= MAX_DESCRIBED or is_remote(path)]
    for path in others[:MAX_FILES]:
        yield RecordingFile(path if is_remote(path) else Path(path).name, [], note="read in partitions")
    if more := others[MAX_FILES:]:
        yield RecordingFile(count_noun(len(more), "more file"), [], note="read in partitions")


def _entries(session: Session) -> list[Mapping[str, Any]]:
    entries = session.settings.get("dataset", [])
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def used_entries(session: Session) -> dict[int, Mapping[str, Any]]:
    """Return the datasets in the project file that are not off, in order, by their numbers from 1 on."""
    return {number: entry for number, entry in enumerate(_entries(session), 1) if entry.get("use") != "off"}


def _paths(folder: Path, entry: Mapping[str, Any]) -> list[str]:
    patterns = entry.get("files", [])
    patterns = [patterns] if isinstance(patterns, str) else patterns
    with suppress(InputError):  # a store that does not answer is a finding of the project
        return [path for pattern in patterns for path in find_addresses(folder, str(pattern))]
    return []


def recording_names(session: Session) -> list[str]:
    """Return the names of the files of all datasets."""
    folder = session.path.parent
    return [Path(path.partition("#")[0]).name for entry in _entries(session) for path in _paths(folder, entry)]


def channel_names(session: Session) -> list[str]:
    """Return the names of the channels of all files, each once."""
    files = (file for entry in used_entries(session).values() for file in _described_files(session, entry))
    return list(dict.fromkeys(channel.name for file in files for channel in file.channels))


def channel_ranges(session: Session) -> dict[str, Range]:
    """Return the range of every channel of the training files."""
    ranges: dict[str, Range] = {}
    training = [entry for entry in _entries(session) if entry.get("use", "training") == "training"]
    for file in (file for entry in training for file in _described_files(session, entry)):
        for channel in file.channels:
            if channel.least is not None and channel.greatest is not None:
                known = ranges.get(channel.name, Range(channel.least, channel.greatest))
                low, high = min(known.least, channel.least), max(known.greatest, channel.greatest)
                ranges[channel.name] = Range(low, high)
    return ranges


def recorded_channels(session: Session, number: int) -> dict[str, str]:
    """Return all channels of the files of a dataset, counted from 0, with their units; none of data in partitions.

    There, channels that the project does not use cannot be drawn.
    """
    entries = [*used_entries(session).values()]
    if number >= len(entries) or session.reads_partitions:
        return {}
    files = _described_files(session, entries[number])
    return {channel.name: channel.unit for file in files for channel in file.channels}


def _file(folder: Path, path: str, databases: tuple[DatabaseFile, ...]) -> RecordingFile:
    plain = Path(path.partition("#")[0])
    try:
        return _described(str(folder), path, databases, plain.stat().st_size)
    except OSError as error:
        return RecordingFile(plain.name, [], error=error.strerror or str(error))


@while_unchanged(512)
def _described(folder: str, path: str, databases: tuple[DatabaseFile, ...], size: int) -> RecordingFile:
    """Describe a recording; `size` is that of its file."""
    for file in (*recording_files(path), *(database.path for database in databases)):
        note_opened(file)
    shown = str(Path(path).relative_to(folder)) if Path(path).is_relative_to(folder) else path
    try:
        tables = describe(path, databases).tables
    except InputError as error:
        return RecordingFile(shown, [], size=size, error=str(error))
    several = len(tables) > 1
    channels = [(table.name if several else "", channel) for table in tables for channel in table.channels]
    sparsest = max((channel for _, channel in channels), key=lambda channel: channel.nan_share, default=None)
    times = [table.time for table in tables if table.time is not None]
    time = min(times, key=lambda each: math.inf if each.step is None else each.step, default=None)
    groups = [ChannelGroup(t.name, t.time.step) for t in tables if t.time is not None and t.time.step is not None]
    return RecordingFile(
        name=shown,
        size=size,
        samples=max((table.samples for table in tables), default=0),
        step=None if time is None else time.step,
        groups=groups if len(groups) > 1 else [],
        length=None if time is None else time.end - time.begin,
        missing=0.0 if sparsest is None else sparsest.nan_share,
        sparsest="" if sparsest is None else sparsest.name,
        channels=[
            ChannelRow(
                name=channel.name,
                group=group,
                unit=channel.unit,
                least=None if channel.minimum is None else finite(channel.minimum),
                greatest=None if channel.maximum is None else finite(channel.maximum),
            )
            for group, channel in channels[:MAX_SIGNALS]
        ],
    )


def _inputs(session: Session) -> list[MappedInput]:
    """Return the inputs of the function and the targets of its criteria, each with its channel."""
    function, settings = session.function, session.settings
    if function is None:
        return []
    graph, mapped = function.graph, settings.get("channels", {})
    scalars = {*session.initial_names, *settings.get("parameters", {})}
    rows = [
        MappedInput(name, "input", graph.units.get(name, ""), str(mapped.get(name, name)))
        for name in graph.inputs
        if name not in scalars
    ]
    for number, entry in enumerate(settings.get("criterion", []), 1):
        target = entry.get("target")
        channel = target.get("channel") if isinstance(target, dict) else target
        node = str(entry.get("node", ""))
        if isinstance(channel, str):
            unit = graph.units.get(node, "")
            rows.append(MappedInput(node, "target", unit, channel, number))
    return rows
