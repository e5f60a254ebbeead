"""Recordings that are read again only if their files or settings have changed."""

from collections.abc import Iterator
from pathlib import Path

from kennfeld.preprocessing.calculated import Calculated
from kennfeld.preprocessing.pipeline import LoadedData, load_datasets
from kennfeld.preprocessing.recipe import DataSettings
from kennfeld.preprocessing.recordings import ChannelRequest, find_recordings


class RecordedData:
    """The recordings that were read last; called like `load_datasets`."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._loaded = LoadedData()

    def __call__(self, settings: DataSettings, request: ChannelRequest, calculated: Calculated) -> LoadedData:
        """Return the datasets of a project, see `load_datasets`."""
        texts = (settings.datasets, dict(settings.channels), dict(settings.calculated), dict(settings.units), request)
        key = (repr(texts), *_files(settings))
        if key != self._key:
            self._loaded = load_datasets(settings, request, calculated)
            self._key = key
        return self._loaded


def _files(settings: DataSettings) -> Iterator[tuple[str, int, int]]:
    """Yield each file with its time of change and its size."""
    for pattern in (pattern for entry in settings.datasets for pattern in entry.files):
        for path in find_recordings(settings.folder, pattern):
            file = Path(path.partition("#")[0])
            if file.is_file():
                state = file.stat()
                yield path, state.st_mtime_ns, state.st_size
