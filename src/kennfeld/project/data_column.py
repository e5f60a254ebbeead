"""A column of the data that an axis is looked up with: a channel, or a node that depends on data alone."""

from collections.abc import Mapping
from dataclasses import replace

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import Graph
from kennfeld.preprocessing.calculated import evaluate_expression


@dataclass(frozen=True)
class DataColumn:
    """A column over the samples of any dataset.

    Attributes:
        channel: its channel, unless it is a node.
        graph: the graph of the node `value`.
        channels: channel of each input of the graph that has another name.
    """

    channel: str = ""
    graph: Graph | None = None
    channels: Mapping[str, str] | None = None

    @property
    def is_timed(self) -> bool:
        """True if its values depend on the samples before."""
        return self.graph is not None and self.graph.is_timed

    def values(self, data: Dataset) -> Float | None:
        """Return the values over all samples of a dataset, Float[samples]; None if it lacks a channel."""
        if self.graph is None:
            return data[self.channel].values if self.channel in data else None
        names = {name: (self.channels or {}).get(name, name) for name in self.graph.inputs}
        if not all(channel in data for channel in names.values()):
            return None
        inputs = tuple(replace(data[channel], name=name) for name, channel in names.items())
        return evaluate_expression(self.graph, replace(data, channels=inputs))
