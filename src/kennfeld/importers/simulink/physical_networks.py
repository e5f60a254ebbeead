"""Remedies for blocks of physical networks: the binds that replace the outputs of a network."""

from collections.abc import Iterable
from dataclasses import replace

from kennfeld.importers.simulink.import_report import UnsupportedBlock
from kennfeld.importers.simulink.lowering.diagnostics import PHYSICAL_NETWORK

_MAX_BINDS = 20
_INNER = "No output needs it: only the outputs of the network that the function needs have to be bound."


def with_network_binds(blocks: Iterable[UnsupportedBlock]) -> tuple[UnsupportedBlock, ...]:
    """Return unsupported blocks; those that lead out of a physical network have all of its binds as remedy.

    >>> converter = UnsupportedBlock("Plant/PS-Simulink Converter", "Reference", PHYSICAL_NETWORK, "", True)
    >>> print(with_network_binds([converter])[0].remedy)
    Bind its outputs: bind = { "Plant/PS-Simulink Converter" = "channel or formula" }.
    """
    blocks = tuple(blocks)
    outputs = [block.path for block in blocks if block.why == PHYSICAL_NETWORK and block.stops]
    binds = ", ".join(f'"{path}" = "channel or formula"' for path in outputs[:_MAX_BINDS])
    more = f", and {len(outputs) - _MAX_BINDS} more" if len(outputs) > _MAX_BINDS else ""
    remedy = f"Bind its outputs: bind = {{ {binds}{more} }}."
    return tuple(
        replace(block, remedy=remedy if block.stops else _INNER) if block.why == PHYSICAL_NETWORK else block
        for block in blocks
    )
