"""Excerpts of recordings whose data are evaluated in partitions; read again only if files or settings have changed."""

from collections.abc import Collection, Mapping

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.base.formatting import join_names
from kennfeld.base.task_runner import SerialRunner
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.calculated import Calculated
from kennfeld.preprocessing.pipeline import LoadedData
from kennfeld.preprocessing.prepared_files import PreparedFiles
from kennfeld.preprocessing.recipe import DataSettings
from kennfeld.preprocessing.recording_sources import find_sources, version_of
from kennfeld.preprocessing.recordings import ChannelRequest
from kennfeld.project.partitioned_loading import PartitionedLoading


class PartitionedData(PartitionedLoading):
    """The excerpts that were read last. This process prepares files; what it keeps on disk, runs use as well.

    Args:
        project: name of the project file.
        files: folder of prepared files.
        size: samples of a partition.
    """

    def __init__(self, project: str, files: PreparedFiles, size: int) -> None:
        super().__init__(project, SerialRunner(), files, size)
        self.settings = project, files, size
        self._key: tuple[object, ...] = ()
        self._loaded = LoadedData()

    def __call__(self, settings: DataSettings, request: ChannelRequest, calculated: Calculated) -> LoadedData:
        """Return the datasets of a project with an excerpt of each file as samples."""
        texts = (settings.datasets, dict(settings.channels), dict(settings.calculated), dict(settings.units), request)
        try:
            patterns = (pattern for entry in settings.datasets for pattern in (*entry.files, *entry.database_files))
            sources = [source for pattern in patterns for source in find_sources(settings.folder, pattern)]
            key = (repr(texts), *((source.address, version_of(source)) for source in sources))
        except InputError:  # reported by the loading
            key = ()
        # the key is set after the loading: if that fails, the next call reads again
        if not key or key != self._key:
            self._key = ()
            self._loaded = super().__call__(settings, request, calculated)
            self._key = key
        return self._loaded

    def further_channels(self, number: int, dataset: Dataset, names: Collection[str]) -> Mapping[str, Channel]:
        """Refuse channels that the project does not use, which no excerpt has.

        Raises:
            ArgumentError: there are names.
        """
        if names:
            message = f"{join_names(list(names))} cannot be drawn, since the data are in partitions"
            raise ArgumentError(f"{message}: use a channel of the function, or set partition = 0 with fewer files")
        return {}


def count_samples(problem: Problem) -> int:
    """Return the number of samples of all partitions, training and test."""
    assert problem.partitions is not None
    return sum(part.samples for part in (*problem.partitions.training, *problem.partitions.test))
