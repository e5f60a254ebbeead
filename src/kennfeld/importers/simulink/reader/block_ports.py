"""Port numbers, and bus element ports (In Bus Element, Out Bus Element)."""

import re

from kennfeld.importers.simulink.reader.model_tree import ModelBlock, System


def port_number(block: ModelBlock) -> int:
    """Read the number of an Inport or Outport, 1 if the file does not specify it.

    >>> port_number(ModelBlock("Inport", "u", "1", "u", {"Port": "3"}))
    3
    """
    written = (block.value("Port") or "1").strip()
    # a text that is not a number, or too long for one, counts as the default
    return int(written) if re.fullmatch(r"\d{1,9}", written) else 1


def element_of(block: ModelBlock) -> str | None:
    """Read the path "a.b" of a bus element at a port, None if the block is a plain port."""
    if block.type not in ("Inport", "Outport"):
        return None
    shared = any(block.is_set_to(name, "on") for name in ("IsBusElementPort", "isBusElementPort"))
    return (block.value("Element") or "").strip() if shared else None


def elements(system: System, kind: str, port: int) -> list[ModelBlock]:
    """List the bus element ports of one kind that share a port number."""
    return [block for block in system.of(kind) if element_of(block) is not None and port_number(block) == port]


def port_label(block: ModelBlock) -> str:
    """Name a root port: as its block, or by port and path of a bus element.

    >>> port_label(ModelBlock("Inport", "In", "1", "In", {"IsBusElementPort": "on", "PortName": "Bus", "Element": "n"}))
    'Bus.n'
    """
    element = element_of(block)
    if element is None:
        return block.name
    name = (block.value("PortName") or block.name).strip()
    return f"{name}.{element}" if element else name
