"""Signals that can be drawn: channels, nodes of the function, and errors, over the samples of a dataset."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import field
from typing import Literal

import numpy as np

from kennfeld.app.session.envelope import PixelEnvelope
from kennfeld.app.session.live_model import Evaluation, LiveDataset, LiveModel
from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass

Kind = Literal["channel", "target", "node", "start", "error", "start error"]
MOVING = ("node", "error", "target")  # kinds that may change with the values: a target may be a node
MAX_KEPT = 64  # envelopes of values that have not changed


@dataclass(frozen=True)
class SignalName:
    """The quantity that a line shows.

    Attributes:
        kind: a channel; the target of a criterion, NaN where it is not scored; a node at the present values or at those
            of the start; the error of a criterion at the present values or at those of the start.
        name: of the channel or node; the number of the criterion for targets and errors.
        unit: of a channel that the project does not use; for the page alone, and not compared.
    """

    kind: Kind
    name: str
    unit: str = field(default="", compare=False)


@dataclass(frozen=True)
class SignalRange:
    """Values of a signal, with both ends."""

    signal: SignalName
    least: float
    greatest: float


@dataclass(frozen=True)
class GridPoint:
    """A value of a table, by its number in C order."""

    parameter: str
    value: int


@dataclass(frozen=True)
class SampleSelection:
    """Samples of a dataset: those between two positions at which every signal is within its range.

    With `point`, only those whose lookup gives this value of a table a weight.
    """

    ranges: tuple[SignalRange, ...] = ()
    begin: float = -np.inf
    end: float = np.inf
    point: GridPoint | None = None

    @property
    def moving(self) -> bool:
        """True if other samples may be selected when the values change."""
        return self.point is not None or any(part.signal.kind in MOVING for part in self.ranges)


ReadChannels = Callable[[LiveDataset, Collection[str]], Mapping[str, Float]]
Informed = Callable[[LiveDataset, GridPoint], Bool]  # marks the samples that look a value up


class Signals:
    """The signals of a model at the start and at the present values, computed when they are first drawn.

    Args:
        model: the model.
        start: the errors at the initial values.
        read_channels: reads channels that the calibration does not need; leaves out those that the recordings lack.
        informed: marks the samples that inform a value of a table.
    """

    def __init__(
        self,
        model: LiveModel,
        start: Evaluation,
        read_channels: ReadChannels | None = None,
        informed: Informed | None = None,
    ) -> None:
        self._model, self._start, self._now = model, start, start
        self._read_channels, self._informed = read_channels, informed
        self._lit: dict[tuple[int, SampleSelection], PixelEnvelope] = {}
        self._fixed: dict[tuple[int, SignalName, SampleSelection | None], PixelEnvelope] = {}
        self._moving: dict[tuple[int, SignalName, SampleSelection | None], PixelEnvelope] = {}

    def follow(self, now: Evaluation) -> None:
        """Use other present values."""
        # envelopes of channels and of the start stay
        self._now, self._moving, self._lit = now, {}, {}

    def envelope(
        self, recording: LiveDataset, signal: SignalName, only: SampleSelection | None = None
    ) -> PixelEnvelope:
        """Return a signal over the samples of a dataset; NaN at samples that `only` does not select.

        Raises:
            KeyError: there is no such channel, node or criterion.
        """
        moving = signal.kind in MOVING or (only is not None and only.moving)
        kept = self._moving if moving else self._fixed
        key = (recording.number, signal, only)
        if key not in kept:
            values = self._values(recording, signal)
            if only is not None:
                values = np.where(self.selected(recording, only), values, np.nan)
            if len(kept) >= MAX_KEPT:
                kept.pop(next(iter(kept)))
            kept[key] = PixelEnvelope(np.ascontiguousarray(values, dtype=np.float64))
        return kept[key]

    def prepare(self, recording: LiveDataset, chosen: Iterable[SignalName]) -> None:
        """Read what the calibration does not need of these signals, all of it at once."""
        names = [signal.name for signal in chosen if signal.kind == "channel"]
        further = [name for name in names if name not in recording.bound.dataset]
        if further and self._read_channels is not None:
            self._read_channels(recording, further)

    def values(self, recording: LiveDataset, signal: SignalName) -> Float:
        """Return a signal over the samples of a dataset, Float[samples]; raises as `envelope` does."""
        return self.envelope(recording, signal).values

    def selected(self, recording: LiveDataset, selection: SampleSelection) -> Bool:
        """Mark the selected samples of a dataset, Bool[samples]; NaN is in no range."""
        chosen = (recording.position >= selection.begin) & (recording.position <= selection.end)
        for part in selection.ranges:
            values = self.values(recording, part.signal)
            chosen &= (values >= part.least) & (values <= part.greatest)
        if selection.point is not None and self._informed is not None:
            chosen &= self._informed(recording, selection.point)
        return chosen

    def lit(self, recording: LiveDataset, selection: SampleSelection) -> PixelEnvelope:
        """Return 1 for the selected samples of a dataset, 0 for the others."""
        key = recording.number, selection
        if key not in self._lit:
            # of one selection at a time
            self._lit = {key: PixelEnvelope(self.selected(recording, selection).astype(np.float64))}
        return self._lit[key]

    def _values(self, recording: LiveDataset, signal: SignalName) -> Float:
        match signal.kind:
            case "channel":
                return self._channel(recording, signal.name)
            case "target":
                return self._now.measured(recording.number, int(signal.name))
            case "node":
                return self._node(recording, signal.name, self._now)
            case "start":
                return self._node(recording, signal.name, self._start)
            case "error":
                return _row(self._now, recording, signal)
            case "start error":
                return _row(self._start, recording, signal)

    def _channel(self, recording: LiveDataset, name: str) -> Float:
        if name in recording.bound.dataset or self._read_channels is None:
            return recording.channel(name)
        return self._read_channels(recording, [name])[name]

    def _node(self, recording: LiveDataset, name: str, evaluation: Evaluation) -> Float:
        if name not in self._model.problem.graph.names:
            raise KeyError(name)
        scored = [criterion.node for criterion in self._model.problem.criteria]
        if name in scored:
            output: Float = evaluation.outputs[recording.number][scored.index(name)]
            return output
        values: Float = self._model.nodes(recording, [name], evaluation.parameters)[0]
        return values


def _row(evaluation: Evaluation, recording: LiveDataset, signal: SignalName) -> Float:
    errors: Float = evaluation.errors[recording.number][int(signal.name)]
    return errors
