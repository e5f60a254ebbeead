"""Order in which blocks are lowered: dependencies, build order and algebraic loops.

Each block follows those it depends on; states are completed at the end. A dependency cycle is recorded as an algebraic
loop and broken by a placeholder signal.
"""

from collections.abc import Callable, Iterable
from dataclasses import field

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import BoundedGraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import DataStoreOrder, FlatBlock, resets_with_subsystem
from kennfeld.importers.simulink.lowering.diagnostics import BlockFailures, placeholder_outputs
from kennfeld.importers.simulink.lowering.pass_state import PendingCompletions
from kennfeld.importers.simulink.lowering.state_ports import is_known_at_step_start
from kennfeld.importers.simulink.signals import SignalOrBus

# these evaluate their own execution condition
_CONTROLLED = ("ConditionalOutput", "ConditionalSubsystem", "IterationCondition", "DataStoreWrite")


@dataclass
class BlockDependencies:
    """Dependencies of blocks; `values` are the outputs so far.

    `feedthrough` returns the inputs of a block that affect its outputs in the same step, `remembers` if it has states.
    """

    feedthrough: Callable[[FlatBlock], Iterable[int]]
    remembers: Callable[[FlatBlock], bool]
    stores: DataStoreOrder
    failures: BlockFailures
    values: dict[FlatBlock, tuple[SignalOrBus, ...]] = field(default_factory=dict)

    def all_dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks that a block depends on in this step or a later one."""
        blocks = [source.flat for source in flat.inputs if source is not None]
        blocks += self.stores.writers.get(flat, ())
        return [*blocks, flat.control] if flat.control is not None else blocks

    def step_dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks that the outputs of a block depend on in the same step."""
        blocks: list[FlatBlock] | None = None
        with self.failures.note_errors(flat):
            sources = [flat.inputs[index] for index in self.feedthrough(flat) if index < len(flat.inputs)]
            blocks = [source.flat for source in sources if source is not None and not is_known_at_step_start(source)]
        if blocks is None:
            return []
        if flat.control is not None and (flat.type in _CONTROLLED or resets_with_subsystem(flat)):
            blocks.append(flat.control)
        if flat.previous_pass is not None:
            # needed before the next iteration can read its state
            blocks.append(flat.previous_pass)
            if flat.previous_pass in self.values and self.remembers(flat.previous_pass):
                blocks += self.all_dependencies(flat.previous_pass)
        return [*blocks, *(self.stores.writers_before(flat) if flat.data_store is not None else ())]


@dataclass
class BuildOrder:
    """Lowers blocks by `build` in dependency order; `values` are the outputs so far, `loops` the algebraic loops."""

    builder: BoundedGraphBuilder
    needs: BlockDependencies
    agenda: PendingCompletions
    build: Callable[[FlatBlock], tuple[SignalOrBus, ...]]
    loops: list[tuple[FlatBlock, ...]] = field(default_factory=list)
    # blocks waiting for others, outermost first, with what they depend on
    _begun: dict[FlatBlock, list[FlatBlock]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values = self.needs.values

    def demand(self, blocks: Iterable[FlatBlock]) -> None:
        """Lower blocks and everything they depend on, states included."""
        for flat in blocks:
            self.visit(flat)
        # a completion may lower blocks whose states are completed in turn
        while (pending := self.agenda.next()) is not None:
            flat, complete = pending
            self.visit(flat)
            # what a state takes at the end of the step, feedthrough or not
            for needed in self.needs.all_dependencies(flat):
                self.visit(needed)
            self.builder.place = flat.path
            with self.needs.failures.note_errors(flat):
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
            # depth first without recursion; a block may be on the stack twice, and is done when it is met again
            flat = stack[-1]
            if flat in self.values:
                self._begun.pop(stack.pop(), None)
                continue
            missing = [needed for needed in self._dependencies(flat) if needed not in self.values]
            if not missing:
                self.values[flat] = self.build(flat)
                continue
            # a block that waits for this one, directly or through others
            looped = next((needed for needed in missing if needed in self._begun), None)
            if looped is not None:
                begun = list(self._begun)
                self.loops.append(tuple(begun[begun.index(looped) :]))
                self.values[looped] = placeholder_outputs(self.builder, looped)  # breaks the algebraic loop
            else:
                stack.extend(reversed(missing))

    def _dependencies(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return what a block depends on in the same step, and note that it waits for that."""
        # the dependencies of an iteration grow once the one before it is lowered; those of others stay
        if flat not in self._begun or flat.previous_pass is not None:
            self._begun[flat] = self.needs.step_dependencies(flat)
        return self._begun[flat]

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
