"""Gates before this process reaches out to what a project names: a scheduler, an object store, a folder elsewhere.

Code of files has a gate of its own, `graph.external_function.code_gate`. Gates are set by commands and the app, which
ask the user; in Python, the caller has decided.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal

Kind = Literal["scheduler", "store", "folder"]
Gate = Callable[[Kind, str], None]

_gates: list[Gate] = []


@contextmanager
def address_gate(gate: Gate) -> Iterator[None]:
    """Call `gate` within the block, in all threads of this process, before an address is used.

    It is given the kind and the name of the address, and may raise `InputError`.
    """
    _gates.append(gate)
    try:
        yield
    finally:
        _gates.remove(gate)


def require_address(kind: Kind, name: str) -> None:
    """Ask the gates whether an address may be used. Raises what they raise."""
    for gate in tuple(_gates):
        gate(kind, name)
