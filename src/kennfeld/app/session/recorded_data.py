"""Recordings that are read again only if their files or settings have changed."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import ArgumentError, InputError
from kennfeld.preprocessing.calculated import Calculated
from kennfeld.preprocessing.pipeline import LoadedData, load_datasets, prepare_dataset
from kennfeld.preprocessing.recipe import DataSettings
from kennfeld.preprocessing.recordings import ChannelRequest, DatasetChannels, RecordingReader, find_recordings
from kennfeld.preprocessing.units import Units


class RecordedData:
    """The recordings that were read last; called like `load_datasets`."""

    def __init__(self) -> None:
        self._key: tuple[object, ...] = ()
        self._loaded = LoadedData()
        self._recipe: tuple[DataSettings, ChannelRequest, Calculated] | None = None
        self._further: dict[int, dict[str, Channel]] = defaultdict(dict)  # by dataset, channels that only plots need

    def __call__(self, settings: DataSettings, request: ChannelRequest, calculated: Calculated) -> LoadedData:
        """Return the datasets of a project, see `load_datasets`."""
        texts = (settings.datasets, dict(settings.channels), dict(settings.calculated), dict(settings.units), request)
        key = (repr(texts), *_files(settings))
        if key != self._key:
            self._loaded = load_datasets(settings, request, calculated)
            self._key, self._recipe = key, (settings, request, calculated)
            self._further.clear()
        return self._loaded

    def further_channel(self, number: int, dataset: Dataset, name: str) -> Channel:
        """Return a channel of the recordings that the project does not use, prepared as the others are.

        Args:
            number: of the dataset, counted from 0.
            dataset: as it was loaded.
            name: of the channel.

        Raises:
            KeyError: the recordings have no such channel.
            ArgumentError: it cannot be read over the samples of the dataset.
        """
        kept = self._further[number]
        if name not in kept:
            kept |= self._read_further(number, dataset, [*kept, name])
        return kept[name]

    def _read_further(self, number: int, dataset: Dataset, names: list[str]) -> dict[str, Channel]:
        assert self._recipe is not None
        settings, request, calculated = self._recipe
        entry = settings.datasets[number]
        wider = replace(request, optional={**request.optional, **dict.fromkeys(names, "a plot")})
        channels = DatasetChannels.of(entry, wider, calculated)
        reader = RecordingReader(settings, entry, channels, [*channels.findings])
        read = prepare_dataset(reader, Units(settings.units, wider.units), wider)
        if read is None or reader.failed:
            raise InputError(reader.findings)
        if read.samples != dataset.samples:
            message = f"{names[-1]} has other samples than the channels of {dataset.name}"
            raise ArgumentError(f"{message}: set raster in the settings of the dataset to resample all of them")
        return {name: read[name] for name in names if name in read}


def _files(settings: DataSettings) -> Iterator[tuple[str, int, int]]:
    """Yield each file with its time of change and its size."""
    for pattern in (pattern for entry in settings.datasets for pattern in entry.files):
        for path in find_recordings(settings.folder, pattern):
            file = Path(path.partition("#")[0])
            if file.is_file():
                state = file.stat()
                yield path, state.st_mtime_ns, state.st_size
