"""Cache of recordings that are slow to read.

Its folder holds two kinds of files. `<file>.json` is a note on a measurement file: size, modification times and hash of
the content. `<content>-<selection>-<check>.parquet` is a recording that was read from a content, stored without loss:
`check` is the hash of the entry itself, so that a damaged one is ignored. If anything fails, the file itself is read.
"""

import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, field, fields, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.atomic_files import write_whole
from kennfeld.dataset import Channel, Clock, Dataset
from kennfeld.errors import Finding, InputError, Location
from kennfeld.lazy_dataclass import dataclass
from kennfeld.measurement.arrow_numbers import array_of, view_of
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.measurement.file_kind import FileKind, MeasurementFile, locate
from kennfeld.measurement.reader import read_leniently

_NOTES = b"kennfeld"
_STORED = ("name", "channels", "time", "starts", "clock", "findings")  # what is written of a dataset
_ADDED = ("files",)  # by whoever reads the entry

_WORTH = {
    FileKind.PARQUET: math.inf,
    FileKind.FEATHER: math.inf,
    FileKind.CSV: 0.5,
}  # s of reading that make an entry worthwhile
_WORTH_ELSE = 0.2
_MAX_SIZE = 2_000_000_000  # bytes of a folder
_SETTLED = 2_000_000_000  # ns; a file that was changed shorter before it was hashed may change unnoticed
_STALE = 3600.0  # s; older temporary files belong to a process that has ended
_ERRORS = (OSError, ValueError, KeyError, TypeError, RecursionError)


def to_parquet(dataset: Dataset) -> bytes | None:
    """Return a recording as Parquet; None if it has settings that the format does not store.

    Bytes of equal significance are stored together and compressed by zstd at its lowest level: less than half the size,
    and faster to read than plain numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    new = Dataset(dataset.name, dataset.channels, dataset.time, dataset.starts)
    others = [attribute.name for attribute in fields(Dataset) if attribute.name not in (*_STORED, *_ADDED)]
    if not dataset.channels or any(getattr(dataset, name) != getattr(new, name) for name in others):
        return None
    columns = [channel.values for channel in dataset.channels]
    columns += [] if dataset.time is None else [dataset.time]
    notes = {
        "channels": [[c.name, c.unit, c.description] for c in dataset.channels],
        "time": dataset.time is not None,
        "starts": dataset.starts.tolist(),
        "clock": None if dataset.clock is None else asdict(dataset.clock),
        "findings": [asdict(finding) for finding in dataset.findings],
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
        return Dataset(name, channels, time, starts, clock=clock, findings=findings)
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError):
        return None


def _numbers(column: Any) -> Float:
    """Return the numbers as a read-only view."""
    if str(column.type) != "double" or column.null_count or (column.buffers()[1] is None and len(column)):
        raise ValueError("written by somebody else")
    return view_of(column)


@dataclass(frozen=True)
class _FileState:
    """State of a measurement file when its content was hashed; `failed` are selections with missing channels."""

    size: int
    changed: tuple[int, int]  # ns: when the content was, and when anything of the file was
    at: int  # ns
    content: str
    failed: dict[str, list[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, path: Path) -> "_FileState":
        """Return the current state of a file. Raises `OSError`."""
        import hashlib

        at, stat = time.time_ns(), path.stat()
        with path.open("rb") as file:
            content = hashlib.file_digest(file, _digest).hexdigest()
        return cls(stat.st_size, (stat.st_mtime_ns, stat.st_ctime_ns), at, content)

    @classmethod
    def from_json(cls, text: bytes) -> "_FileState":
        """Parse the note on a file. Raises `ValueError`, `KeyError` or `TypeError` if it is damaged."""
        note: dict[str, Any] = json.loads(text)
        first, second = note["changed"]
        failed = {str(key): [str(name) for name in names] for key, names in dict(note["failed"]).items()}
        content = note["content"]
        if not (isinstance(content, str) and content.isalnum()):  # it is part of names and patterns of files
            raise ValueError(f"{content!r} is not a hash")
        return cls(int(note["size"]), (int(first), int(second)), int(note["at"]), content, failed)

    def holds(self, stat: os.stat_result) -> bool:
        """Return whether the file is certainly unchanged, without reading its content."""
        same = (self.size, *self.changed) == (stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
        return same and self.at - max(self.changed) > _SETTLED


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
        key = _key(source, channels, raster, units)
        stored = self._find(source, key)
        if stored is not None:
            return stored
        before, began = source.path.stat(), time.perf_counter()
        dataset = read_leniently(path, channels, raster, units or {}, databases)
        if time.perf_counter() - began >= _worth(source.kind):
            with contextlib.suppress(*_ERRORS):
                self._store(source, before, key, dataset)
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
            state = self._known_state(source)
            return None if state is None else state.failed.get(_key(source, channels, raster))
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
        if source.kind is not FileKind.MDF and not databases:  # other kinds are listed quickly
            return
        with contextlib.suppress(*_ERRORS):
            state = self._known_state(source) or _FileState.of(source.path)
            self._write_note(source, state, {**state.failed, _key(source, channels, raster): list(names)})

    def _find(self, source: MeasurementFile, key: str) -> Dataset | None:
        with contextlib.suppress(*_ERRORS):
            state = self._known_state(source)
            entries = () if state is None else self.folder.glob(f"{state.content}-{key}-*.parquet")
            recordings = (_read_entry(entry, source.stem) for entry in entries)
            return next((recording for recording in recordings if recording is not None), None)
        return None

    def _known_state(self, source: MeasurementFile) -> _FileState | None:
        """Return the note on a file if its content has not changed; else remove its entries."""
        note = self._note_path(source)
        if not note.is_file():
            return None
        known = _FileState.from_json(note.read_bytes())
        if known.holds(source.path.stat()):
            return known
        now = _FileState.of(source.path)
        if now.content == known.content:
            self._write_note(source, now, known.failed)
            return known
        for entry in self.folder.glob(f"{known.content}-*.parquet"):
            _remove(entry)
        _remove(note)
        return None

    def _store(self, source: MeasurementFile, before: os.stat_result, key: str, dataset: Dataset) -> None:
        content = to_parquet(dataset)
        if content is None or len(content) > self.most:
            return
        state = self._known_state(source) or _FileState.of(source.path)
        after = source.path.stat()
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
            return  # it may have changed while it was read
        self._create_folder()
        write_whole(self.folder / f"{state.content}-{key}-{_hash(content)}.parquet", content)
        self._write_note(source, state, state.failed)
        self._limit_size()

    def _create_folder(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        ignored = self.folder / ".gitignore"
        if not ignored.exists():
            write_whole(ignored, "*\n")

    def _note_path(self, source: MeasurementFile) -> Path:
        return self.folder / f"{_hash(str(source.path.resolve()).encode('utf-8', 'surrogateescape'))}.json"

    def _write_note(self, source: MeasurementFile, state: _FileState, failed: dict[str, list[str]]) -> None:
        self._create_folder()
        write_whole(self._note_path(source), json.dumps({"file": str(source.path), **asdict(state), "failed": failed}))

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


def _worth(kind: FileKind) -> float:
    """Return the time of reading in s that makes an entry worthwhile."""
    if kind is FileKind.MDF and "asammdf" in sys.modules:
        return 0.0  # loading that library again takes longer than reading the entry
    return _WORTH.get(kind, _WORTH_ELSE)


def _read_entry(entry: Path, name: str) -> Dataset | None:
    """Return the recording of an entry; remove it and return None if it is damaged."""
    content = entry.read_bytes()
    recording = from_parquet(content, name) if entry.stem.rpartition("-")[2] == _hash(content) else None
    with contextlib.suppress(OSError):
        if recording is None:
            entry.unlink(missing_ok=True)
        else:
            os.utime(entry)
    return recording


def _key(
    source: MeasurementFile,
    channels: Sequence[str] | None,
    raster: float | None,
    units: Mapping[str, str] | None = None,
) -> str:
    """Return a hash of the selection, the settings and the version of the readers."""
    names = None if channels is None else list(dict.fromkeys(channels))
    step = None if raster is None else float(raster).hex()
    databases = [[_content_of(file), file.path.name, file.bus, file.network] for file in source.databases]
    key = [_readers(), source.kind.value, source.sheet, names, step, sorted((units or {}).items()), databases]
    return _hash(json.dumps(key).encode())


def _content_of(database: DatabaseFile) -> str:
    """Return the hash of a database; an empty one if it cannot be read, so that reading it reports the problem."""
    try:
        return _hash(database.loaded().content or b"")
    except InputError:
        return ""


@cache
def _readers() -> list[Any]:
    """Return the hash of the readers' source and the versions of their libraries; a change makes entries invalid."""
    texts = [file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py"))]
    libraries = []
    for library in ("asammdf", "can", "python_calamine", "pyarrow", "h5py", "nptdms"):
        with contextlib.suppress(ImportError, ValueError, OSError):
            spec = find_spec(library)
            stat = Path(spec.origin).stat() if spec and spec.origin else None
            libraries.append([library, stat and stat.st_size, stat and stat.st_mtime_ns])
    return [_hash(b"\0".join(texts)), libraries]


def _digest() -> Any:
    import hashlib  # not needed where there is nothing to look up

    return hashlib.blake2b(digest_size=20)


def _hash(content: bytes) -> str:
    digest = _digest()
    digest.update(content)
    return str(digest.hexdigest())


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
