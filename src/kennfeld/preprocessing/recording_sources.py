"""Sources of recordings: files on a disk that all machines see, or in an object store, by fsspec.

A file is known by its address and its state: size and time of its last change, or what the store says instead. A file
that has changed is another one. What is kept of it on a machine depends on its version there.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from kennfeld.base import file_state
from kennfeld.base.consent_gate import require_address
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.companions import files_of
from kennfeld.measurement.source import locate
from kennfeld.preprocessing.recordings import find_recordings

_MARK = "://"
_TAGS = ("ETag", "etag", "generation", "md5Hash", "content_md5")  # of the content, in the words of different stores
_TIMES = ("mtime", "LastModified", "last_modified", "updated", "modify", "created")
_PACKAGES = {
    "s3": "s3fs",
    "s3a": "s3fs",
    "gs": "gcsfs",
    "gcs": "gcsfs",
    "abfs": "adlfs",
    "abfss": "adlfs",
    "az": "adlfs",
    "http": "aiohttp",
    "https": "aiohttp",
    "sftp": "paramiko",
}
_LOCAL = ("file", "local", "memory")  # protocols that leave this machine alone
_CHAIN = "::"
# protocols of fsspec that combine others, or run code: templates of references, and tasks of a cluster
_REFUSED = (
    "reference",
    "dask",
    "generic",
    "dir",
    "cached",
    "filecache",
    "blockcache",
    "simplecache",
    "jupyter",
    "jlab",
)
CREDENTIALS = "Check the address, and the credentials of this machine for the store."


@dataclass(frozen=True)
class RecordingSource:
    """A recording in the state in which it was listed; a sheet may follow its address after a `#`."""

    address: str
    state: str

    @property
    def name(self) -> str:
        """The last part of the address, for messages."""
        return self.address.rpartition("/")[2] if is_remote(self.address) else PurePath(self.address).name


def is_remote(address: str) -> bool:
    """Return whether an address names an object store, such as `s3://bucket/drive.mf4`, not a file of this system."""
    return _MARK in address


def store_of(address: str) -> str:
    """Return the store of an address; empty for files of this system.

    >>> store_of("s3://fleet/drives/*.mf4"), store_of("file:///data/drive.csv")
    ('s3://fleet', '')
    """
    protocol, _, path = address.partition(_MARK)
    return "" if protocol in _LOCAL else f"{protocol}{_MARK}{path.partition('/')[0]}"


def find_sources(folder: Path, pattern: str) -> list[RecordingSource]:
    """Return the recordings that a path, an address or a pattern matches, in the order of their names.

    Raises:
        InputError: the library of an object store is missing, or the store refuses.
    """
    if not is_remote(pattern):
        return [
            RecordingSource(str(Path(path).absolute()), state_of(path)) for path in find_recordings(folder, pattern)
        ]
    whole, _, sheet = pattern.partition("#")
    system, path = _open_store(whole)
    try:
        system.invalidate_cache()  # of an earlier listing
        several = any(mark in path for mark in "*?[")
        files = system.glob(path, detail=True) if several else {path: system.info(path)}
        return [
            RecordingSource(_address(whole, name, sheet), _state(system, name, facts))
            for name, facts in sorted(files.items())
            if facts.get("type") != "directory"
        ]
    except FileNotFoundError:
        return []
    except Exception as error:  # of many kinds, one for each store
        raise InputError.of(Location(pattern), f"cannot be listed ({_reason(error)})", CREDENTIALS) from error


def _address(pattern: str, name: str, sheet: str) -> str:
    """Return the address of a file that a store lists by name."""
    whole = name if _MARK in name else f"{pattern.partition(_MARK)[0]}{_MARK}{name}"
    return f"{whole}#{sheet}" if sheet else whole


def _state(system: Any, name: str, facts: Mapping[str, Any]) -> str:
    """Return the state of a file in a store, by what all ways to ask for it tell alike."""
    tags = [str(facts[key]).strip('"') for key in _TAGS if facts.get(key)]
    times = [_time_text(facts[key]) for key in _TIMES if facts.get(key)]
    # a tag of the content before a time: a file that is written again with the same content stays the same
    known = tags[:1] or times[:1]
    return f"{facts.get('size')}-{known[0]}" if known else str(system.ukey(name))


def _time_text(time: Any) -> str:
    """Return a time as text; the same store may say a number or a date."""
    return str(time.timestamp() if isinstance(time, datetime) else time)


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


def find_addresses(folder: Path, pattern: str) -> list[str]:
    """Return the paths or addresses that a pattern matches; errors as for `find_sources`."""
    if is_remote(pattern):
        return [source.address for source in find_sources(folder, pattern)]
    return find_recordings(folder, pattern)


def size_in_store(address: str) -> int:
    """Return the size of a file of an object store in bytes, 0 if the store does not tell."""
    try:
        system, path = _open_store(_without_sheet(address))
        return int(system.size(path) or 0)
    except Exception:  # of many kinds, one for each store
        return 0


def state_of(address: str) -> str:
    """Return the state of a file; an empty one if it cannot be found."""
    whole = _without_sheet(address)
    if is_remote(address):
        system, path = _open_store(whole)
        try:
            return _state(system, path, system.info(path))
        except FileNotFoundError:
            return ""
    # the whole address first: a file may have a # in its own name
    for file in (Path(address), Path(whole)):
        if file.is_file():
            status = file.stat()
            return f"{status.st_size}-{status.st_mtime_ns}"
    return ""


def version_of(source: RecordingSource) -> str:
    """Return what tells the content of a recording from others under its address, on this machine.

    The state tells machines that they see the same file, and is only what all of them know of it; this one takes all
    times of the file into account, the files beside it that hold its values, and the content of one that is recent.
    """
    if is_remote(source.address):
        return source.state
    return f"{source.state} {file_state.version_of(recording_files(source.address))}"


@while_unchanged(1024)
def recording_files(path: str) -> tuple[Path, ...]:
    """Return the files of a recording, the named one first; a sheet may follow its path."""
    try:
        files = tuple(files_of(locate(path)))
    except (InputError, OSError):  # reported when it is read
        files = (Path(_without_sheet(path)),)
    note_opened(files[0])
    return files


def _without_sheet(address: str) -> str:
    whole, _, inner = address.rpartition("#")
    is_member = "/" not in inner or whole.lower().endswith(".zip")  # else a folder has the mark in its name
    return whole if whole and is_member else address


@contextmanager
def local_file(source: RecordingSource) -> Iterator[str]:
    """Yield the path of a recording on this machine; one from an object store is copied for the time of the block.

    Raises:
        InputError: it has changed since it was listed, or cannot be read.
    """
    try:
        state = state_of(source.address)
    except InputError:
        raise
    except Exception as error:
        raise InputError.of(Location(source.address), f"cannot be read ({_reason(error)})", CREDENTIALS) from error
    if state != source.state:
        message = "has changed since it was listed" if state else "there is no such file on this machine"
        remedy = "Use paths that all workers see, and keep the files while a calibration runs."
        raise InputError.of(Location(source.address), message, remedy)
    if not is_remote(source.address):
        yield source.address
        return
    whole, _, sheet = source.address.partition("#")
    system, path = _open_store(whole)
    with TemporaryDirectory(prefix="kennfeld-") as folder:
        copy = Path(folder) / path.rpartition("/")[2]
        try:
            system.get_file(path, str(copy))
        except Exception as error:
            raise InputError.of(Location(source.address), f"cannot be read ({_reason(error)})", CREDENTIALS) from error
        yield f"{copy}#{sheet}" if sheet else str(copy)


def _open_store(address: str) -> tuple[Any, str]:
    """Return the file system of an address, and the path in it, if a gate of the process lets it through."""
    protocol = address.partition(_MARK)[0]
    if _CHAIN in address or protocol in _REFUSED:
        raise InputError.of(Location(address), "not an address of one file or pattern", "Name an object store.")
    if store := store_of(address):
        require_address("store", store)
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(address)
        return system, str(path)
    except (ImportError, ValueError) as error:
        package = _PACKAGES.get(protocol, "fsspec" if isinstance(error, ImportError) else "")
        install = f"Install {package} where Kennfeld runs, also on the workers."
        remedy = install if package else "Check the protocol; fsspec lists those that it knows."
        raise InputError.of(Location(address), f"cannot be read ({error})", remedy) from error
