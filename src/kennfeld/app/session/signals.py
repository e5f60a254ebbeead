"""Signals that can be drawn: channels, nodes of the function, and errors, over the samples of a dataset."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.app.session.envelope import PixelEnvelope
from kennfeld.app.session.live_model import Evaluation, LiveDataset, LiveModel
from kennfeld.arrays import Float

Kind = Literal["channel", "target", "node", "start", "error", "start error"]
MAX_KEPT = 64  # envelopes of values that have not changed


@dataclass(frozen=True)
class SignalName:
    """The quantity that a line shows.

    Attributes:
        kind: a channel; the target of a criterion, NaN where it is not scored; a node at the present values or at those
            of the start; the error of a criterion at the present values or at those of the start.
        name: of the channel or node; the number of the criterion for targets and errors.
    """

    kind: Kind
    name: str


class Signals:
    """The signals of a model at the start and at the present values, computed when they are first drawn."""

    def __init__(self, model: LiveModel, start: Evaluation) -> None:
        self._model, self._start, self._now = model, start, start
        self._fixed: dict[tuple[int, SignalName], PixelEnvelope] = {}
        self._moving: dict[tuple[int, SignalName], PixelEnvelope] = {}

    def follow(self, now: Evaluation) -> None:
        """Use other present values."""
        self._now, self._moving = now, {}

    def envelope(self, recording: LiveDataset, signal: SignalName) -> PixelEnvelope:
        """Return a signal over the samples of a dataset.

        Raises:
            KeyError: there is no such channel, node or criterion.
        """
        kept = self._moving if signal.kind in ("node", "error") else self._fixed
        key = (recording.number, signal)
        if key not in kept:
            if len(kept) >= MAX_KEPT:
                kept.pop(next(iter(kept)))
            kept[key] = PixelEnvelope(np.ascontiguousarray(self._values(recording, signal), dtype=np.float64))
        return kept[key]

    def _values(self, recording: LiveDataset, signal: SignalName) -> Float:
        match signal.kind:
            case "channel":
                return recording.channel(signal.name)
            case "target":
                return self._measured(recording, int(signal.name))
            case "node":
                return self._node(recording, signal.name, self._now)
            case "start":
                return self._node(recording, signal.name, self._start)
            case "error":
                return _row(self._now, recording, signal)
            case "start error":
                return _row(self._start, recording, signal)

    def _measured(self, recording: LiveDataset, criterion: int) -> Float:
        """Return what a criterion compares its node with."""
        measured: Float = (
            self._start.outputs[recording.number][criterion] - self._start.errors[recording.number][criterion]
        )
        return measured

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
