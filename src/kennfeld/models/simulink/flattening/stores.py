"""Data stores: who writes a named memory, and which of its writers run before a reader within the step.

Tasks decide where each sample time is one. Within a task, priorities decide, those of the nearest blocks around both in
the system that they share; the lower number runs first. Where neither decides, a reader gets what the step before has
left.
"""

from collections.abc import Callable, Iterable
from functools import cmp_to_key
from typing import TypeAlias

from kennfeld.models.simulink.flattening.atoms import Atom

__all__ = ["Stores"]

Order: TypeAlias = Callable[[Atom, Atom], int]


def _by_priority(one: Atom, other: Atom) -> int:
    """-1 where the first block runs before the second by their priorities, 1 where after, 0 where none decides."""
    for (place, priority), (place_2, priority_2) in zip(one.places, other.places, strict=False):
        if place != place_2:
            if priority is None or priority_2 is None or priority == priority_2:
                return 0
            return -1 if priority < priority_2 else 1
    return 0


class Stores:
    """The writers of each data store in the order in which they run; `undecided` are pairs that nothing orders.

    `by_task` is -1 where the task of the first of two blocks runs before that of the second, 1 where after, else 0.
    """

    def __init__(self, atoms: Iterable[Atom], by_task: Order = lambda one, other: 0) -> None:
        self._by_task = by_task
        self.writers: dict[Atom, list[Atom]] = {}
        readers: list[Atom] = []
        for atom in atoms:
            if atom.store is not None and atom.kind == "DataStoreWrite":
                self.writers.setdefault(atom.store, []).append(atom)
            elif atom.store is not None:
                readers.append(atom)
        for writers in self.writers.values():
            writers.sort(key=cmp_to_key(self._order))
        self.undecided = [
            (writer, reader) for reader in readers for writer in self._of(reader) if self._open(writer, reader)
        ]

    def _order(self, one: Atom, other: Atom) -> int:
        return self._by_task(one, other) or _by_priority(one, other)

    def _open(self, writer: Atom, reader: Atom) -> bool:
        """Whether nothing says which runs first; code reads what it writes itself before it does."""
        return not self._order(writer, reader) and writer.places != reader.places

    def _of(self, reader: Atom) -> list[Atom]:
        return self.writers.get(reader.store, []) if reader.store is not None else []

    def before(self, reader: Atom) -> list[Atom]:
        """The writers that have run when a block reads; none of a block that writes."""
        if reader.kind != "DataStoreRead":
            return []
        return [writer for writer in self._of(reader) if self._order(writer, reader) < 0]
