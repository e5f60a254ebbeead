"""Recordings that are read again only if their files or settings have changed."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from kennfeld.app.session.activity import Activity
from kennfeld.app.session.memory import return_unused
from kennfeld.base.errors import ArgumentError, InputError, KennfeldError
from kennfeld.base.file_state import note_opened, version_of
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.preprocessing.calculated import Calculated
from kennfeld.preprocessing.pipeline import LoadedData, load_datasets, prepare_dataset
from kennfeld.preprocessing.recipe import DataSettings
from kennfeld.preprocessing.recording_sources import is_remote, recording_files
from kennfeld.preprocessing.recordings import (
    ChannelRequest,
    DatasetChannels,
    ReadingWatch,
    RecordingReader,
    find_recordings,
)
from kennfeld.preprocessing.units import Units


class RecordedData:
    """The recordings that were read last; called like `load_datasets`.

    Args:
        activity: called for each file that is read; may stop the reading.
    """

    def __init__(self, activity: Activity | None = None) -> None:
        self._activity = activity or Activity()
        self._key: tuple[object, ...] = ()
        self._loaded = LoadedData()
        self._recipe: tuple[DataSettings, ChannelRequest, Calculated] | None = None
        self._further: dict[int, dict[str, Channel | KennfeldError | None]] = defaultdict(
            dict
        )  # by dataset, what only plots need

    def __call__(self, settings: DataSettings, request: ChannelRequest, calculated: Calculated) -> LoadedData:
        """Return the datasets of a project, see `load_datasets`."""
        texts = (settings.datasets, dict(settings.channels), dict(settings.calculated), dict(settings.units), request)
        paths = matching_files(settings)
        key = (repr(texts), *_versions(paths))
        if key != self._key:
            self._loaded = load_datasets(settings, request, calculated, self._watch(paths))
            self._key, self._recipe = key, (settings, request, calculated)
            self._further.clear()
            return_unused()
        return self._loaded

    def _watch(self, paths: Iterable[str]) -> ReadingWatch:
        """Return what tells of each file that has been read."""
        files = [file for path in paths for file in recording_files(path)]
        size = size_of_files(files)
        done = 0

        def watch(_: int, __: int) -> None:
            nonlocal done
            done += 1
            self._activity.say(f"Reading recordings, {done} of {len(files)} files", min(1.0, done / len(files)))

        number = count_noun(len(files), "file")
        self._activity.say(f"Reading recordings, {number}, {size / 1e6:.3g} MB", 0.0 if len(files) > 1 else None)
        return watch

    def further_channels(self, number: int, dataset: Dataset, names: Collection[str]) -> Mapping[str, Channel]:
        """Return channels of the recordings that the project does not use, prepared as the others are.

        Args:
            number: of the dataset, counted from 0.
            dataset: as it was loaded.
            names: of the channels; those that the recordings lack are not returned.

        Raises:
            KennfeldError: one of them cannot be read, or has other samples than the dataset.
        """
        kept = self._further[number]
        unknown = [name for name in dict.fromkeys(names) if name not in kept]
        try:
            if unknown:
                read = self._read_further(number, dataset, unknown)
                # after the reading, as a file may change while it is read
                self._require_unchanged(number)
                kept |= {name: read.get(name) for name in unknown}
                return_unused()
        except KennfeldError as error:
            if len(unknown) == 1:
                kept[unknown[0]] = error
            for name in unknown if len(unknown) > 1 else ():  # one of them must not keep the others from being read
                with suppress(KennfeldError):
                    self.further_channels(number, dataset, [name])
        for name in names:
            if isinstance(reason := kept[name], KennfeldError):
                raise reason
        return {name: channel for name in names if isinstance(channel := kept[name], Channel)}

    def _require_unchanged(self, number: int) -> None:
        """Raise `ArgumentError` if recordings have changed since they were read: their channels would not match."""
        assert self._recipe is not None
        settings = self._recipe[0]
        if tuple(_versions(matching_files(settings))) != self._key[1:]:
            name = settings.datasets[number].name or ", ".join(settings.datasets[number].files)
            raise ArgumentError(f"the recordings of {name} have changed since they were read: read the project again")

    def _read_further(self, number: int, dataset: Dataset, names: list[str]) -> dict[str, Channel]:
        assert self._recipe is not None
        settings, request, calculated = self._recipe
        entry = settings.datasets[number]
        # prepared like the dataset, with shifts, raster and plateaus, so that samples match
        wider = replace(request, optional={**request.optional, **dict.fromkeys(names, "a plot")})
        channels = DatasetChannels.of(entry, wider, calculated)
        reader = RecordingReader(settings, entry, channels, [*channels.findings])
        read = prepare_dataset(reader, Units(settings.units, wider.units), wider)
        if read is None or reader.failed:
            raise InputError(reader.findings)
        if read.samples != dataset.samples:
            message = f"{join_names(names)} have other samples than the channels of {dataset.name}"
            raise ArgumentError(f"{message}: set raster in the settings of the dataset to resample all of them")
        return {name: read[name] for name in names if name in read}


def matching_files(settings: DataSettings) -> tuple[str, ...]:
    """Return the recordings and databases of bus logs that match the patterns of a project, except those in stores."""
    patterns = (pattern for entry in settings.datasets for pattern in (*entry.files, *entry.database_files))
    local = (pattern for pattern in patterns if not is_remote(pattern))
    return tuple(path for pattern in local for path in find_recordings(settings.folder, pattern))


def size_of_files(paths: Iterable[Path | str]) -> int:
    """Return the number of bytes of files; those that are gone count as empty."""
    size = 0
    for path in paths:
        with suppress(OSError):
            size += Path(path).stat().st_size
    return size


def _versions(paths: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield each recording and each database of bus logs with what tells it from others under its path."""
    for path in paths:
        files = recording_files(path)
        for file in files:
            note_opened(file)
        yield path, version_of(files)
