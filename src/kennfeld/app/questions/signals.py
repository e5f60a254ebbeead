"""The signals of a dataset that can be drawn."""

from collections.abc import Sequence

from kennfeld.app.questions.recordings import recorded_channels
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import Kind
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True)
class AskedSignals:
    """A dataset by its number, which counts from 0."""

    dataset: int


@dataclass(frozen=True)
class SignalRow:
    """A signal that can be drawn, and the group of the list in which it is."""

    kind: Kind
    name: str
    unit: str
    label: str
    group: str


@dataclass(frozen=True)
class SignalRows:
    """The signals of a dataset."""

    signals: Sequence[SignalRow]


def signals(session: Session, asked: AskedSignals) -> SignalRows:
    """Return the channels, nodes, targets and errors of a dataset, each with its unit.

    Channels that the project does not use are read from the recordings when they are first drawn.
    """
    view, number = session.require_view(), asked.dataset
    problem, graph = view.model.problem, view.model.problem.model.graph
    used = {channel.name: channel.unit for channel in view.model.recordings[number].bound.dataset.channels}
    recorded = {name: unit for name, unit in recorded_channels(session, number).items() if name not in used}
    rows = [SignalRow("channel", name, unit, name, "channel") for name, unit in used.items()]
    rows += [SignalRow("node", name, graph.units.get(name, ""), name, "node") for name in graph.names]
    for i, criterion in enumerate(problem.criteria):
        node, unit = criterion.node, view.model.unit(i)
        rows += [SignalRow("error", str(i), unit, f"Error of {node}", "error")]
        rows += [SignalRow("target", str(i), unit, f"Target of {node}", "target")]
        rows += [SignalRow("start error", str(i), unit, f"Error of {node} at the start", "error, start")]
    rows += [
        SignalRow("start", name, graph.units.get(name, ""), f"{name} at the start", "node, start")
        for name in graph.names
    ]
    rows += [SignalRow("channel", name, unit, name, "channel, not used") for name, unit in recorded.items()]
    return SignalRows(rows)
