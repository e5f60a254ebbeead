"""A recording that is written into a file for other tools."""

from collections.abc import Iterator, Sequence
from datetime import datetime

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Dataset


@dataclass(frozen=True, eq=False)
class WritableRecording:
    """Channels over the time stamps of one recording, in parts that follow each other.

    Attributes:
        name: differs from that of all others in the file.
        dataset: the dataset that it belongs to.
        use: "training" or "test".
        file: the file that it was recorded in; empty if that is unknown.
        start_time: the instant of time stamp 0; as `Dataset.start_time`.
        parts: all have the same channels, and time stamps or none; together the time increases.
        pieces: the number of its piece for each sample of each part, Int[samples].
    """

    name: str
    dataset: str
    use: str
    file: str
    start_time: datetime | None
    parts: Sequence[Dataset]
    pieces: Sequence[Int]

    @property
    def samples(self) -> int:
        """Number of samples of all parts."""
        return sum(part.samples for part in self.parts)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channels of the first part."""
        return self.parts[0].channels

    @property
    def is_timed(self) -> bool:
        """True if samples have time stamps."""
        return self.parts[0].time is not None

    @property
    def description(self) -> str:
        """The comment for other tools: dataset, file and start time."""
        begin = f"recorded from {self.start_time.isoformat(' ')}" if self.start_time is not None else ""
        points = "" if self.is_timed else "points without time"
        return ", ".join(filter(None, [f"{self.use} dataset {self.dataset}", self.file, begin, points]))

    def time(self) -> Float:
        """Return the time stamps in s, Float[samples]."""
        return np.concatenate([part.time for part in self.parts if part.time is not None])

    def values(self, channel: str) -> Float:
        """Return the values of a channel, Float[samples]."""
        return np.concatenate([part[channel].values for part in self.parts])

    def blocks(self, size: int) -> Iterator[tuple[Dataset, slice, Int]]:
        """Yield parts with a slice of at most `size` samples, and their pieces, Int[samples], in order."""
        for part, pieces in zip(self.parts, self.pieces, strict=True):
            for first in range(0, part.samples, size):
                here = slice(first, min(first + size, part.samples))
                yield part, here, pieces[here]
