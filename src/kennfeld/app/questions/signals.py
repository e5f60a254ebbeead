"""The signals of a dataset that can be drawn."""

from kennfeld.app.answer import Answer, Given
from kennfeld.app.questions.recordings import recorded_channels
from kennfeld.app.session.session import Session


def signals(session: Session, given: Given) -> Answer:
    """Return the channels, nodes, targets and errors of a `dataset`, each with its unit.

    Channels that the project does not use are read from the recordings when they are first drawn.
    """
    view, number = session.require_view(), int(given["dataset"])
    problem, graph = view.model.problem, view.model.problem.model.graph
    used = {channel.name: channel.unit for channel in view.model.recordings[number].bound.dataset.channels}
    recorded = {name: unit for name, unit in recorded_channels(session, number).items() if name not in used}
    rows = [_row("channel", name, unit, name, "channel") for name, unit in used.items()]
    rows += [_row("node", name, graph.units.get(name, ""), name, "node") for name in graph.names]
    for i, criterion in enumerate(problem.criteria):
        node, unit = criterion.node, view.model.unit(i)
        rows += [_row("error", str(i), unit, f"Error of {node}", "error")]
        rows += [_row("target", str(i), unit, f"Target of {node}", "target")]
        rows += [_row("start error", str(i), unit, f"Error of {node} at the start", "error, start")]
    rows += [
        _row("start", name, graph.units.get(name, ""), f"{name} at the start", "node, start") for name in graph.names
    ]
    rows += [_row("channel", name, unit, name, "channel, not used") for name, unit in recorded.items()]
    return Answer({"signals": rows})


def _row(kind: str, name: str, unit: str, label: str, group: str) -> dict[str, str]:
    return {"kind": kind, "name": name, "unit": unit, "label": label, "group": group}
