"""The recordings of the project of a session: whole, or an excerpt of data in partitions; read again once changed."""

from collections.abc import Collection
from dataclasses import replace

from kennfeld.app.session.activity import Activity
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.partitioned_data import PartitionedData
from kennfeld.app.session.recorded_data import RecordedData
from kennfeld.base.arrays import Float
from kennfeld.project import Project


class ProjectRecordings:
    """Reads the recordings of a project, and keeps them for the next version of it.

    Args:
        activity: called with the progress of what takes a while.
    """

    def __init__(self, activity: Activity) -> None:
        self._activity = activity
        self._data: RecordedData | PartitionedData = RecordedData(activity)

    def provide(self, project: Project) -> Project:
        """Return a project that reads its recordings again only if they have changed; an excerpt, if in partitions."""
        size = project.file.cluster.partition_size
        if not size:
            if not isinstance(self._data, RecordedData):
                self._data = RecordedData(self._activity)
        elif not isinstance(self._data, PartitionedData) or self._data.settings[1:] != (project.prepared_files, size):
            self._data = PartitionedData(project.file.path.name, project.prepared_files, size)
        return replace(project, load=self._data)

    def further_channels(self, recording: LiveDataset, names: Collection[str]) -> dict[str, Float]:
        """Return the channels that the recordings have of these, which only plots need, over the drawn samples."""
        channels = self._data.further_channels(recording.number, recording.bound.dataset, names)
        return {name: recording.at_samples(channel.values) for name, channel in channels.items()}
