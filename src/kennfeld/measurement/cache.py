"""Cache of recordings that are slow to read.

Its folder holds two kinds of files. `<file>.json` is a note on a recording: the sizes, the times and the hashes of its
files. `<content>-<selection>-<check>.parquet` is a recording that was read from a content, stored without loss: `check`
is the hash of the entry itself, so that a damaged one is ignored. If anything fails, the file itself is read.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, field, fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.code_digest import code_digest
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_state import FileState, digest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Clock, Dataset
from kennfeld.files.recordings import MDF
from kennfeld.measurement.arrow_numbers import array_of, view_of
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.measurement.companions import files_of
from kennfeld.measurement.reader import read_leniently
from kennfeld.measurement.source import MeasurementFile, locate

_NOTES = b"kennfeld"
_STORED = (
    "name",
    "channels",
    "time",
    "piece_starts",
    "clock",
    "findings",
    "start_time",
)  # what is written of a dataset
_ADDED = ("files",)  # by whoever reads the entry

_MAX_SIZE = 2_000_000_000  # bytes of a folder
_STALE = 3600.0  # s; older temporary files belong to a process that has ended
_ERRORS = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, InputError)


def to_parquet(dataset: Dataset) -> bytes | None:
    """Return a recording as Parquet; None if it has settings that the format does not store.

    Bytes of equal significance are stored together and compressed by zstd at its lowest level: less than half the size,
    and faster to read than plain numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    new = Dataset(dataset.name, dataset.channels, dataset.time, dataset.piece_starts)
    others = [attribute.name for attribute in fields(Dataset) if attribute.name not in (*_STORED, *_ADDED)]
    if not dataset.channels or any(getattr(dataset, name) != getattr(new, name) for name in others):
        return None
    columns = [channel.values for channel in dataset.channels]
    columns += [] if dataset.time is None else [dataset.time]
    notes = {
        "channels": [[c.name, c.unit, c.description] for c in dataset.channels],
        "time": dataset.time is not None,
        "starts": dataset.piece_starts.tolist(),
        "clock": None if dataset.clock is None else asdict(dataset.clock),
        "findings": [asdict(finding) for finding in dataset.findings],
        "start_time": None if dataset.start_time is None else dataset.start_time.isoformat(),
    }
    table = pa.table(
        [array_of(values) for values in columns],
        schema=pa.schema([(str(i), pa.float64()) for i in range(len(columns))], {_NOTES: json.dumps(notes)}),
    )
    sink = pa.BufferOutputStream()
    settings = {"compression": "zstd", "compression_level": 1, "use_byte_stream_split": True}
    rows = max(dataset.samples, 1)  # one group, so that each column is one array
    pq.write_table(table, sink, row_group_size=rows, use_dictionary=False, write_statistics=False, **settings)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def from_parquet(content: bytes, name: str) -> Dataset | None:
    """Return the recording under a name, None if the bytes were not written by `to_parquet`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        # `read_table` would load all that reads folders; threads of Arrow can abort a process that ends early
        table = pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
        notes: dict[str, Any] = json.loads((table.schema.metadata or {})[_NOTES])
        columns = [_numbers(column.combine_chunks()) for column in table.columns]
        time = columns.pop() if notes["time"] else None
        channels = tuple(
            Channel(label, values, unit, description)
            for (label, unit, description), values in zip(notes["channels"], columns, strict=True)
        )
        clock = None if notes["clock"] is None else Clock(**notes["clock"])
        findings = tuple(Finding(**f | {"location": Location(**f["location"])}) for f in notes["findings"])
        starts = np.array(notes["starts"], dtype=np.int64)
        begin = None if notes["start_time"] is None else datetime.fromisoformat(notes["start_time"])
        return Dataset(name, channels, time, starts, clock=clock, findings=findings, start_time=begin)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError):
        return None


def _numbers(column: Any) -> Float:
    """Return the numbers as a read-only view."""
    if str(column.type) != "double" or column.null_count or (column.buffers()[1] is None and len(column)):
        raise ValueError("written by somebody else")
    return view_of(column)


@dataclass(frozen=True)
class _Note:
    """States of the files of a recording by path; `failed` are selections with missing channels."""

    files: dict[str, FileState]
    failed: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, source: MeasurementFile) -> "_Note":
        """Return the present states. Raises `OSError`."""
        return cls({str(path.absolute()): FileState.of(path) for path in files_of(source)})

    @classmethod
    def from_json(cls, text: bytes) -> "_Note":
        """Parse a note. Raises `ValueError`, `KeyError`, `TypeError` or `AttributeError` if it is damaged."""
        note: dict[str, Any] = json.loads(text)
        failed = {str(key): [str(name) for name in names] for key, names in dict(note["failed"]).items()}
        return cls({path: FileState.from_json(state) for path, state in note["files"].items()}, failed)

    @property
    def content(self) -> str:
        """The hash of all contents."""
        contents = [state.content for state in self.files.values()]
        return contents[0] if len(contents) == 1 else digest("".join(contents).encode())

    def holds(self) -> bool:
        """Return whether the files are certainly unchanged, without reading their contents. Raises `OSError`."""
        return all(state.holds(Path(path).stat()) for path, state in self.files.items())


@dataclass(frozen=True)
class Cache:
    """Cached recordings in a folder, which is created with the first entry.

    >>> Cache(Path(".kennfeld/cache")).read("drive.mf4", ["Speed"], raster=0.1)  # doctest: +SKIP
    """

    folder: Path
    most: int = _MAX_SIZE

    def read(
        self,
        path: str | Path,
        channels: Sequence[str] | None = None,
        raster: float | None = None,
        *,
        units: Mapping[str, str] | None = None,
        databases: tuple[DatabaseFile, ...] = (),
    ) -> Dataset:
        """Read a file as `read_leniently` does, from the cache if possible."""
        source = replace(locate(path), databases=databases)
        stored = self._find(source, channels, raster, units)
        if stored is not None:
            return stored
        before, began = _stats(source), time.perf_counter()
        dataset = read_leniently(path, channels, raster, units or {}, databases)
        if time.perf_counter() - began >= _worth(source):
            with contextlib.suppress(*_ERRORS):
                self._store(source, before, _key(source, channels, raster, units), dataset)
        return dataset

    def load_failed(
        self,
        path: str | Path,
        channels: Sequence[str] | None,
        raster: float | None,
        databases: tuple[DatabaseFile, ...] = (),
    ) -> list[str] | None:
        """Return the channel names of a file that is known to lack some of these channels; None if unknown."""
        source = replace(locate(path), databases=databases)
        with contextlib.suppress(*_ERRORS):
            known = self._known(source)
            return None if known is None else known.failed.get(_key(source, channels, raster))
        return None

    def keep_failed(
        self,
        path: str | Path,
        channels: Sequence[str] | None,
        raster: float | None,
        names: Sequence[str],
        databases: tuple[DatabaseFile, ...] = (),
    ) -> None:
        """Store the channel names of a file that lacks some of these channels."""
        source = replace(locate(path), databases=databases)
        if source.format is not MDF and not databases:  # other kinds are listed quickly
            return
        with contextlib.suppress(*_ERRORS):
            known = self._known(source) or _Note.of(source)
            self._write_note(source, replace(known, failed={**known.failed, _key(source, channels, raster): [*names]}))

    def _find(
        self,
        source: MeasurementFile,
        channels: Sequence[str] | None,
        raster: float | None,
        units: Mapping[str, str] | None,
    ) -> Dataset | None:
        """Return a stored recording; None, without the digest of the code, of a file that nothing is known of."""
        with contextlib.suppress(*_ERRORS):
            known = self._known(source)
            if known is None:
                return None
            entries = self.folder.glob(f"{known.content}-{_key(source, channels, raster, units)}-*.parquet")
            recordings = (_read_entry(entry, source.stem) for entry in entries)
            return next((recording for recording in recordings if recording is not None), None)
        return None

    def _known(self, source: MeasurementFile) -> _Note | None:
        """Return the note on a recording if its content has not changed; else remove its entries."""
        path = self._note_path(source)
        if not path.is_file():
            return None
        known = _Note.from_json(path.read_bytes())
        # a file that is gone counts as a changed one
        with contextlib.suppress(OSError):
            if known.holds():
                return known
            # a copy or a checkout changes the times alone, so the content decides
            now = _Note.of(source)
            if now.content == known.content:
                self._write_note(source, replace(now, failed=known.failed))
                return known
        for entry in self.folder.glob(f"{known.content}-*.parquet"):
            _remove(entry)
        _remove(path)
        return None

    def _store(self, source: MeasurementFile, before: Mapping[str, os.stat_result], key: str, dataset: Dataset) -> None:
        content = to_parquet(dataset)
        if content is None or len(content) > self.most:
            return
        note = self._known(source) or _Note.of(source)
        if not all(path in before and state.describes(before[path]) for path, state in note.files.items()):
            return  # it may have changed while it was read
        self._create_folder()
        write_whole(self.folder / f"{note.content}-{key}-{digest(content)}.parquet", content)
        self._write_note(source, note)
        self._limit_size()

    def _create_folder(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        ignored = self.folder / ".gitignore"
        if not ignored.exists():
            write_whole(ignored, "*\n")

    def _note_path(self, source: MeasurementFile) -> Path:
        return self.folder / f"{digest(str(source.path.resolve()).encode('utf-8', 'surrogateescape'))}.json"

    def _write_note(self, source: MeasurementFile, note: _Note) -> None:
        self._create_folder()
        write_whole(self._note_path(source), json.dumps(asdict(note)))

    def _limit_size(self) -> None:
        """Remove the least recently used entries until the folder is within its size limit."""
        total = 0
        for _, size, entry in sorted(self._entries(), reverse=True):
            total += size
            if total > self.most:
                _remove(entry)
        for temporary in self.folder.glob(".*-*"):
            if time.time() - temporary.stat().st_mtime > _STALE:
                _remove(temporary)

    def _entries(self) -> Iterator[tuple[int, int, Path]]:
        """Yield the time of last use, the size and the path of each entry."""
        for entry in self.folder.glob("*.parquet"):
            with contextlib.suppress(OSError):  # another run may remove it
                stat = entry.stat()
                yield stat.st_mtime_ns, stat.st_size, entry


def _stats(source: MeasurementFile) -> dict[str, os.stat_result]:
    """Return size and times of the files of a recording."""
    with contextlib.suppress(OSError):
        return {str(path.absolute()): path.stat() for path in files_of(source)}
    return {}


def _worth(source: MeasurementFile) -> float:
    """Return the time of reading in s that makes an entry worthwhile."""
    if source.format is MDF:
        from kennfeld.measurement.mdf import library_is_loaded

        if library_is_loaded():
            return 0.0  # loading that library again takes longer than reading the entry
    return source.reader.costly


def _read_entry(entry: Path, name: str) -> Dataset | None:
    """Return the recording of an entry; remove it and return None if it is damaged."""
    content = entry.read_bytes()
    recording = from_parquet(content, name) if entry.stem.rpartition("-")[2] == digest(content) else None
    with contextlib.suppress(OSError):
        if recording is None:
            entry.unlink(missing_ok=True)
        else:
            # the time of modification serves as that of the last use
            os.utime(entry)
    return recording


def _key(
    source: MeasurementFile,
    channels: Sequence[str] | None,
    raster: float | None,
    units: Mapping[str, str] | None = None,
) -> str:
    """Return a hash of the selection, the settings and the version of the code."""
    names = None if channels is None else list(dict.fromkeys(channels))
    step = None if raster is None else float(raster).hex()
    databases = [[_content_of(file), file.path.name, file.bus, file.network] for file in source.databases]
    key = [code_digest(), source.format.name, source.sheet, names, step, sorted((units or {}).items()), databases]
    return digest(json.dumps(key).encode())


def _content_of(database: DatabaseFile) -> str:
    """Return the hash of a database; an empty one if it cannot be read, so that reading it reports the problem."""
    try:
        return digest(database.loaded().content or b"")
    except InputError:
        return ""


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
