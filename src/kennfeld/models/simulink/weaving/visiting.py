"""The order in which blocks are built: each behind what it needs; what closes memories when all else is there.

Where blocks wait for each other, the loop is noted, and a signal that stands in for one of them breaks it.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable

from kennfeld.models.simulink.expressions.signals import Wired
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.effort import BoundedLoom
from kennfeld.models.simulink.weaving.failures import Failures, stand_ins
from kennfeld.models.simulink.weaving.needs import Needs

__all__ = ["Agenda", "Visits"]


class Agenda:
    """What is left to be done for blocks when all blocks in their way are built."""

    def __init__(self) -> None:
        self._open: deque[tuple[Atom, Callable[[], None]]] = deque()

    def add(self, atom: Atom, complete: Callable[[], None] = lambda: None) -> None:
        """Have a block and all that it needs built, and then something done for it."""
        self._open.append((atom, complete))

    def __len__(self) -> int:
        return len(self._open)

    def leave(self, atoms: Collection[Atom], since: int) -> None:
        """Do nothing for some blocks of what was added behind the first ones; what they need is built all the same."""
        for at in range(since, len(self._open)):
            if self._open[at][0] in atoms:
                self._open[at] = (self._open[at][0], lambda: None)

    def next(self) -> tuple[Atom, Callable[[], None]] | None:
        """What was added first of all that is left; None of nothing."""
        return self._open.popleft() if self._open else None


class Visits:
    """Builds blocks by `build` behind those that they need; `values` are the outputs of all that are built.

    `loops` are the algebraic loops that were met.
    """

    def __init__(
        self,
        loom: BoundedLoom,
        needs: Needs,
        agenda: Agenda,
        failures: Failures,
        build: Callable[[Atom], tuple[Wired, ...]],
    ) -> None:
        self.loom = loom
        self.needs = needs
        self.agenda = agenda
        self.failures = failures
        self.values = needs.built
        self.loops: list[tuple[Atom, ...]] = []
        self._build = build
        self._begun: dict[Atom, None] = {}  # those that wait for others, the one that waits for all first

    def demand(self, atoms: Iterable[Atom]) -> None:
        """Build blocks and all that they need, memories included."""
        for atom in atoms:
            self.visit(atom)
        while (left := self.agenda.next()) is not None:
            atom, complete = left
            self.visit(atom)
            for needed in self.needs.ever(atom):
                self.visit(needed)
            self.loom.place = atom.path
            with self.failures.noting(atom):
                complete()

    def visit(self, root: Atom) -> None:
        """Build a block and what it needs within the step."""
        waiting = len(self._begun)  # not none where a block is built that others are built for
        try:
            self._walk([root])
        finally:
            for atom in list(self._begun)[waiting:]:
                del self._begun[atom]

    def _walk(self, stack: list[Atom]) -> None:
        while stack:
            atom = stack[-1]
            if atom in self.values:
                self._begun.pop(stack.pop(), None)
                continue
            self._begun[atom] = None
            missing = [needed for needed in self.needs.now(atom) if needed not in self.values]
            if not missing:
                self.values[atom] = self._build(atom)
                continue
            looped = next((needed for needed in missing if needed in self._begun), None)
            if looped is not None:
                begun = list(self._begun)
                self._loop(tuple(begun[begun.index(looped) :]))
            else:
                stack.extend(reversed(missing))

    def _loop(self, atoms: tuple[Atom, ...]) -> None:
        """Note an algebraic loop; one of its blocks gets signals that stand in."""
        self.loops.append(atoms)
        self.values[atoms[0]] = stand_ins(self.loom, atoms[0])

    def meanwhile(self, atom: Atom, outputs: tuple[Wired, ...], goals: Iterable[Atom]) -> list[Atom]:
        """Build blocks while another one is built that they depend on, with its outputs as they are by then.

        The blocks that were built for it.
        """
        known = set(self.values)
        self.values[atom] = outputs
        try:
            for goal in goals:
                self.visit(goal)
        finally:
            del self.values[atom]
        return [one for one in self.values if one not in known]
