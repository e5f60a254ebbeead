"""Data stores: who writes a named memory, and which of its writers run before a reader within the step.

Priorities decide, those of the nearest blocks around both in the system that they share; the lower number runs first.
Where they do not decide, a reader gets what the step before has left.
"""

from collections.abc import Iterable
from functools import cmp_to_key

from kennfeld.models.simulink.flattening.atoms import Atom

__all__ = ["Stores", "first_of"]


def first_of(one: Atom, other: Atom) -> int:
    """-1 where the first block runs before the second by their priorities, 1 where after, 0 where none decides."""
    for (place, priority), (place_2, priority_2) in zip(one.places, other.places, strict=False):
        if place != place_2:
            if priority is None or priority_2 is None or priority == priority_2:
                return 0
            return -1 if priority < priority_2 else 1
    return 0


class Stores:
    """The writers of each data store in the order in which they run; `undecided` are pairs that no priority orders."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.writers: dict[Atom, list[Atom]] = {}
        readers: list[Atom] = []
        for atom in atoms:
            if atom.store is not None and atom.kind == "DataStoreWrite":
                self.writers.setdefault(atom.store, []).append(atom)
            elif atom.store is not None:
                readers.append(atom)
        for writers in self.writers.values():
            writers.sort(key=cmp_to_key(first_of))
        self.undecided = [
            (writer, reader) for reader in readers for writer in self._of(reader) if self._open(writer, reader)
        ]

    @staticmethod
    def _open(writer: Atom, reader: Atom) -> bool:
        """Whether no priority says which runs first; code reads what it writes itself before it does."""
        return not first_of(writer, reader) and writer.places != reader.places

    def _of(self, reader: Atom) -> list[Atom]:
        return self.writers.get(reader.store, []) if reader.store is not None else []

    def before(self, reader: Atom) -> list[Atom]:
        """The writers that have run when a block reads; none of a block that writes."""
        if reader.kind != "DataStoreRead":
            return []
        return [writer for writer in self._of(reader) if first_of(writer, reader) < 0]
