"""Which blocks a block needs: those that its outputs depend on within the step, and those that it ever depends on.

The order in which blocks are built: each behind what it needs; what closes memories when all else is there.

Where blocks wait for each other, the loop is noted, and a signal that stands in for one of them breaks it.
"""

from collections.abc import Callable, Iterable

from kennfeld.graph.bounded_builder import BoundedGraphBuilder
from kennfeld.models.simulink.flattening.flat_model import (
    DataStoreOrder,
    FlatBlock,
    SignalSource,
    resets_with_subsystem,
)
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import BlockFailures, stand_ins
from kennfeld.models.simulink.lowering.pass_state import PendingCompletions
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.signals import SignalOrBus

__all__ = ["BlockDependencies", "BuildOrder"]

_CONTROLLED = ("Held", "Control", "Pass", "DataStoreWrite")  # they ask themselves whether they run


class BlockDependencies:
    """What blocks need. `built` are the outputs of those that are there; `ahead` tells sources that always are."""

    def __init__(
        self,
        site: Callable[[FlatBlock], BlockContext],
        stores: DataStoreOrder,
        ahead: Callable[[SignalSource], bool],
        failures: BlockFailures,
    ) -> None:
        self.built: dict[FlatBlock, tuple[SignalOrBus, ...]] = {}
        self._site = site
        self._stores = stores
        self._ahead = ahead
        self._failures = failures

    def ever(self, atom: FlatBlock) -> list[FlatBlock]:
        """The blocks that a block depends on in this step or in later ones."""
        found = [source.atom for source in atom.inputs if source is not None]
        found += self._stores.writers.get(atom, ())
        return [*found, atom.control] if atom.control is not None else found

    def now(self, atom: FlatBlock) -> list[FlatBlock]:
        """The blocks that a block's outputs depend on within the step."""
        sources = self._sources(atom)
        if sources is None:
            return []
        found = [source.atom for source in sources if not self._ahead(source)]
        if atom.control is not None and (atom.kind in _CONTROLLED or resets_with_subsystem(atom)):
            found.append(atom.control)
        if atom.earlier is not None:
            found += self._left_by(atom.earlier)
        return [*found, *(self._stores.before(atom) if atom.store is not None else ())]

    def _sources(self, atom: FlatBlock) -> list[SignalSource] | None:
        """The sources at the inputs that a block's outputs depend on; None where that cannot be told."""
        site, kind = self._site(atom), BLOCK_TYPES.get(atom.kind)
        with self._failures.noting(atom):
            every = range(len(atom.inputs)) if kind is not None else ()
            wanted = every if kind is None or kind.needs is None else kind.needs(site)
            sources = [atom.inputs[index] for index in wanted if index < len(atom.inputs)]
            return [source for source in sources if source is not None]
        return None

    def _left_by(self, atom: FlatBlock) -> list[FlatBlock]:
        """What has to be there so that the next pass of a block can read its memory."""
        site = self._site(atom)
        remembers = atom in self.built and (site.memories or site.before)
        return [atom, *self.ever(atom)] if remembers else [atom]


class BuildOrder:
    """Builds blocks by `build` behind those that they need; `values` are the outputs of all that are built.

    `loops` are the algebraic loops that were met.
    """

    def __init__(
        self,
        builder: BoundedGraphBuilder,
        needs: BlockDependencies,
        agenda: PendingCompletions,
        failures: BlockFailures,
        build: Callable[[FlatBlock], tuple[SignalOrBus, ...]],
    ) -> None:
        self.builder = builder
        self.needs = needs
        self.agenda = agenda
        self.failures = failures
        self.values = needs.built
        self.loops: list[tuple[FlatBlock, ...]] = []
        self._build = build
        self._begun: dict[FlatBlock, None] = {}  # those that wait for others, the one that waits for all first

    def demand(self, atoms: Iterable[FlatBlock]) -> None:
        """Build blocks and all that they need, memories included."""
        for atom in atoms:
            self.visit(atom)
        while (left := self.agenda.next()) is not None:
            atom, complete = left
            self.visit(atom)
            for needed in self.needs.ever(atom):
                self.visit(needed)
            self.builder.place = atom.path
            with self.failures.noting(atom):
                complete()

    def visit(self, root: FlatBlock) -> None:
        """Build a block and what it needs within the step."""
        waiting = len(self._begun)  # not none where a block is built that others are built for
        try:
            self._walk([root])
        finally:
            for atom in list(self._begun)[waiting:]:
                del self._begun[atom]

    def _walk(self, stack: list[FlatBlock]) -> None:
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

    def _loop(self, atoms: tuple[FlatBlock, ...]) -> None:
        """Note an algebraic loop; one of its blocks gets signals that stand in."""
        self.loops.append(atoms)
        self.values[atoms[0]] = stand_ins(self.builder, atoms[0])

    def meanwhile(
        self, atom: FlatBlock, outputs: tuple[SignalOrBus, ...], goals: Iterable[FlatBlock]
    ) -> list[FlatBlock]:
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
