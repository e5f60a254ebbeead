"""Ports that several blocks share, each for one element of a bus: In Bus Element and Out Bus Element."""

from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, System

__all__ = ["element_of", "elements", "port_label"]


def element_of(block: Block) -> str | None:
    """The way to an element, "a.b", of the bus at a port; None of a port that is a block's own."""
    if block.type not in ("Inport", "Outport"):
        return None
    shared = block.value("IsBusElementPort") or block.value("isBusElementPort") or "off"
    return (block.value("Element") or "").strip() if shared == "on" else None


def elements(system: System, kind: str, port: int) -> list[Block]:
    """The blocks of one kind that share a port, by its number."""
    return [one for one in system.of(kind) if element_of(one) is not None and port_number(one) == port]


def port_label(block: Block) -> str:
    """What a port at the top is called: as its block, or of an element of a bus as the port and the way to it.

    >>> port_label(Block("Inport", "In", "1", "In", {"IsBusElementPort": "on", "PortName": "Bus", "Element": "n"}))
    'Bus.n'
    """
    element = element_of(block)
    if element is None:
        return block.name
    name = (block.value("PortName") or block.name).strip()
    return f"{name}.{element}" if element else name
