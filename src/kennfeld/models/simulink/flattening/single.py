"""A chart or MATLAB Function by itself: a system of that block between ports of its own."""

from collections.abc import Iterator

from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, Endpoint, Line, System

__all__ = ["single"]


def single(block: Block, inside: System) -> System:
    """The system of a block whose content is no system of blocks, with ports as those that stand in it.

    Each event from outside is an input of its own.
    """
    made: list[tuple[Block, Line | None]] = [*_ports(block, inside, "Inport"), *_ports(block, inside, "Outport")]
    if any(True for _ in inside.of("TriggerPort")):
        made += _events(block, len([port for port, _ in made if port.type == "Inport"]))
    return System((block, *(port for port, _ in made)), tuple(line for _, line in made if line is not None))


def _ports(block: Block, inside: System, kind: str) -> Iterator[tuple[Block, Line]]:
    for port in inside.of(kind):
        number = port_number(port)
        made = _port(kind, port.name.removesuffix("()"), number)
        if kind == "Inport":
            yield made, Line(Endpoint(made.sid, "out"), (Endpoint(block.sid, "in", number),))
        else:
            yield made, Line(Endpoint(block.sid, "out", number), (Endpoint(made.sid, "in"),))


def _port(kind: str, name: str, number: int) -> Block:
    return Block(kind, name, f"{kind} {number}", name, {"Port": str(number)})


def _events(block: Block, before: int) -> Iterator[tuple[Block, Line | None]]:
    """An input for each event, joined to the vector that triggers the chart."""
    events = [one.name for one in block.chart.events if one.scope == "INPUT_EVENT"] if block.chart is not None else []
    joint = Block("Mux", "events", "Mux", "events", {"Inputs": str(len(events))})
    yield joint, Line(Endpoint(joint.sid, "out"), (Endpoint(block.sid, "trigger"),))
    for at, name in enumerate(events, 1):
        made = _port("Inport", name, before + at)
        yield made, Line(Endpoint(made.sid, "out"), (Endpoint(joint.sid, "in", at),))
