"""Order in which blocks are lowered: dependencies, build order and algebraic loops.

Each block follows those it depends on; states are completed at the end. A dependency cycle is recorded as an algebraic
loop and broken by a placeholder signal.
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
from kennfeld.models.simulink.lowering.diagnostics import BlockFailures, placeholder_outputs
from kennfeld.models.simulink.lowering.pass_state import PendingCompletions
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.signals import SignalOrBus

# these evaluate their own execution condition
_CONTROLLED = ("ConditionalOutput", "ConditionalSubsystem", "IterationCondition", "DataStoreWrite")


class BlockDependencies:
    """Dependencies of blocks; `built` are the outputs so far, `ahead` recognizes sources known at step start."""

    def __init__(
        self,
        block: Callable[[FlatBlock], BlockContext],
        stores: DataStoreOrder,
        ahead: Callable[[SignalSource], bool],
        failures: BlockFailures,
    ) -> None:
        self.built: dict[FlatBlock, tuple[SignalOrBus, ...]] = {}
        self._site = block
        self._stores = stores
        self._ahead = ahead
        self._failures = failures

    def all_dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks that a block depends on in this step or a later one."""
        blocks = [source.flat for source in flat.inputs if source is not None]
        blocks += self._stores.writers.get(flat, ())
        return [*blocks, flat.control] if flat.control is not None else blocks

    def step_dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks that the outputs of a block depend on in the same step."""
        sources = self._sources(flat)
        if sources is None:
            return []
        blocks = [source.flat for source in sources if not self._ahead(source)]
        if flat.control is not None and (flat.type in _CONTROLLED or resets_with_subsystem(flat)):
            blocks.append(flat.control)
        if flat.previous_pass is not None:
            blocks += self._iteration_dependencies(flat.previous_pass)
        return [*blocks, *(self._stores.writers_before(flat) if flat.data_store is not None else ())]

    def _sources(self, flat: FlatBlock) -> list[SignalSource] | None:
        """Return the sources of the inputs with feedthrough, None if they cannot be determined."""
        block, kind = self._site(flat), BLOCK_TYPES.get(flat.type)
        with self._failures.note_errors(flat):
            every = range(len(flat.inputs)) if kind is not None else ()
            wanted = every if kind is None or kind.needs is None else kind.needs(block)
            sources = [flat.inputs[index] for index in wanted if index < len(flat.inputs)]
            return [source for source in sources if source is not None]
        return None

    def _iteration_dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks needed before the next iteration of a block can read its state."""
        block = self._site(flat)
        remembers = flat in self.built and (block.memories or block.before)
        return [flat, *self.all_dependencies(flat)] if remembers else [flat]


class BuildOrder:
    """Lowers blocks by `build` in dependency order; `values` are the outputs so far, `loops` the algebraic loops."""

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
        self._begun: dict[FlatBlock, None] = {}  # blocks waiting for others, outermost first

    def demand(self, blocks: Iterable[FlatBlock]) -> None:
        """Lower blocks and everything they depend on, states included."""
        for flat in blocks:
            self.visit(flat)
        while (left := self.agenda.next()) is not None:
            flat, complete = left
            self.visit(flat)
            for needed in self.needs.all_dependencies(flat):
                self.visit(needed)
            self.builder.place = flat.path
            with self.failures.note_errors(flat):
                complete()

    def visit(self, root: FlatBlock) -> None:
        """Lower a block and what it depends on in the same step."""
        waiting = len(self._begun)  # not 0 if called while a block is being lowered
        try:
            self._walk([root])
        finally:
            for flat in list(self._begun)[waiting:]:
                del self._begun[flat]

    def _walk(self, stack: list[FlatBlock]) -> None:
        while stack:
            flat = stack[-1]
            if flat in self.values:
                self._begun.pop(stack.pop(), None)
                continue
            self._begun[flat] = None
            missing = [needed for needed in self.needs.step_dependencies(flat) if needed not in self.values]
            if not missing:
                self.values[flat] = self._build(flat)
                continue
            looped = next((needed for needed in missing if needed in self._begun), None)
            if looped is not None:
                begun = list(self._begun)
                self._loop(tuple(begun[begun.index(looped) :]))
            else:
                stack.extend(reversed(missing))

    def _loop(self, blocks: tuple[FlatBlock, ...]) -> None:
        """Record an algebraic loop and give one of its blocks placeholder signals."""
        self.loops.append(blocks)
        self.values[blocks[0]] = placeholder_outputs(self.builder, blocks[0])

    def build_dependents(
        self, flat: FlatBlock, outputs: tuple[SignalOrBus, ...], goals: Iterable[FlatBlock]
    ) -> list[FlatBlock]:
        """Lower blocks that depend on preliminary outputs of a block that is being lowered; return those lowered."""
        known = set(self.values)
        self.values[flat] = outputs
        try:
            for goal in goals:
                self.visit(goal)
        finally:
            del self.values[flat]
        return [flat for flat in self.values if flat not in known]
