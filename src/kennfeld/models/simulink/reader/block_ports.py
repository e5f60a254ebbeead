"""How many ports a block has where its file leaves that to the type, and which one an Inport or Outport is.

Ports that several blocks share, each for one element of a bus: In Bus Element and Out Bus Element.
"""

import re

from kennfeld.models.simulink.reader.model_tree import ModelBlock, Ports, System

__all__ = ["element_of", "elements", "port_label", "port_number", "ports_of"]

# Files leave out the ports of a block that has as many as a fresh one of its type: one input and one output, but for
_SOURCES = (
    "BandLimitedWhiteNoise",
    "Clock",
    "Constant",
    "DataStoreRead",
    "DigitalClock",
    "DiscretePulseGenerator",
    "EnumeratedConstant",
    "ForIterator",
    "From",
    "FromFile",
    "FromWorkspace",
    "Ground",
    "InportShadow",
    "Inport",
    "RandomNumber",
    "SignalGenerator",
    "Sin",
    "StateReader",
    "Step",
    "UniformRandomNumber",
)
_SINKS = (
    "DataStoreWrite",
    "Display",
    "Goto",
    "Outport",
    "Record",
    "Scope",
    "StateWriter",
    "Stop",
    "Terminator",
    "ToFile",
    "ToWorkspace",
)
_LOOSE = (
    "ActionPort",
    "DataStoreMemory",
    "EnablePort",
    "EventListener",
    "GotoTagVisibility",
    "ResetPort",
    "TriggerPort",
)
_USUAL = (
    dict.fromkeys(_SOURCES, Ports(0, 1))
    | dict.fromkeys(_SINKS, Ports(1, 0))
    | dict.fromkeys(_LOOSE, Ports(0, 0))
    | {"Lookup2D": Ports(2, 1), "Merge": Ports(2, 1), "Switch": Ports(3, 1)}
    | dict.fromkeys(("SubSystem", "ModelReference"), Ports(0, 0))
)
_ONE_AND_ONE = Ports(1, 1)


def port_number(block: ModelBlock) -> int:
    """The number of an Inport or Outport; 1 where the file says none.

    >>> port_number(ModelBlock("Inport", "u", "1", "u", {"Port": "3"}))
    3
    """
    written = (block.value("Port") or "1").strip()
    return int(written) if re.fullmatch(r"\d{1,9}", written) else 1


def ports_of(block: ModelBlock) -> Ports:
    """The ports that the file counts, else those of a fresh block of the type.

    >>> ports_of(ModelBlock("Switch", "S", "1", "S")).inputs
    3
    """
    return block.ports if block.ports is not None else _USUAL.get(block.type, _ONE_AND_ONE)


def element_of(block: ModelBlock) -> str | None:
    """The way to an element, "a.b", of the bus at a port; None of a port that is a block's own."""
    if block.type not in ("Inport", "Outport"):
        return None
    shared = block.value("IsBusElementPort") or block.value("isBusElementPort") or "off"
    return (block.value("Element") or "").strip() if shared == "on" else None


def elements(system: System, kind: str, port: int) -> list[ModelBlock]:
    """The blocks of one kind that share a port, by its number."""
    return [one for one in system.of(kind) if element_of(one) is not None and port_number(one) == port]


def port_label(block: ModelBlock) -> str:
    """What a port at the top is called: as its block, or of an element of a bus as the port and the way to it.

    >>> port_label(ModelBlock("Inport", "In", "1", "In", {"IsBusElementPort": "on", "PortName": "Bus", "Element": "n"}))
    'Bus.n'
    """
    element = element_of(block)
    if element is None:
        return block.name
    name = (block.value("PortName") or block.name).strip()
    return f"{name}.{element}" if element else name
