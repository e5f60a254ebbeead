"""How many ports a block has where its file leaves that to the type, and which one an Inport or Outport is."""

import re

from kennfeld.models.simulink.files.tree import Block, Ports

__all__ = ["port_number", "ports_of"]

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


def port_number(block: Block) -> int:
    """The number of an Inport or Outport; 1 where the file says none.

    >>> port_number(Block("Inport", "u", "1", "u", {"Port": "3"}))
    3
    """
    written = (block.value("Port") or "1").strip()
    return int(written) if re.fullmatch(r"\d{1,9}", written) else 1


def ports_of(block: Block) -> Ports:
    """The ports that the file counts, else those of a fresh block of the type.

    >>> ports_of(Block("Switch", "S", "1", "S")).inputs
    3
    """
    return block.ports if block.ports is not None else _USUAL.get(block.type, _ONE_AND_ONE)
