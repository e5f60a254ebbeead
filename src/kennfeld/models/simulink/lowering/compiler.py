"""Lowering of all blocks by their handlers, repeated to a fixed point.

Sizes and sample times of states in feedback are unknown when they are first read. They are guessed, and the pass is
repeated with the results until nothing changes.
"""

from collections.abc import Callable, Collection, Iterable
from functools import cached_property

from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.flattening.iterated_subsystems import LOOPS
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import (
    PARAMETER_ERRORS,
    UnsupportedError,
    placeholder_outputs,
    unsupported_reason,
)
from kennfeld.models.simulink.lowering.lowering_pass import LoweringPass
from kennfeld.models.simulink.lowering.pass_state import InferredAttributes
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, BlockType, Outputs
from kennfeld.models.simulink.reader.model_tree import join_path, split_path
from kennfeld.models.simulink.signals import SignalOrBus

_MAX_PASSES = 500
_MAX_OPERATIONS = 20_000_000  # over all passes
_UNSETTLED = "the sizes or sample times of its feedback signals cannot be determined"
_UNSETTLED_REMEDY = "Set the initial values of the delays and integrators in the loop to the size of their signals."


class BlockCompiler(LoweringPass):
    """A pass that calls the handlers of the blocks."""

    def demand(self, blocks: Iterable[FlatBlock]) -> None:
        """Lower blocks and everything they depend on, states included."""
        self.visits.demand(blocks)
        self.continuous.resolve_initial_values()

    @cached_property
    def _contexts(self) -> dict[FlatBlock, BlockContext]:
        return {}

    def block_context(self, flat: FlatBlock) -> BlockContext:
        """Return the context of a block."""
        if flat not in self._contexts:
            self._contexts[flat] = BlockContext(self, flat)
        return self._contexts[flat]

    def feedthrough(self, flat: FlatBlock) -> Iterable[int]:
        kind = BLOCK_TYPES.get(flat.type)
        if kind is None:
            return ()
        return range(len(flat.inputs)) if kind.needs is None else kind.needs(self.block_context(flat))

    def remembers(self, flat: FlatBlock) -> bool:
        context = self.block_context(flat)
        return context.memories + context.before > 0

    def build(self, flat: FlatBlock) -> tuple[SignalOrBus, ...]:
        self.builder.place = flat.path
        kind = BLOCK_TYPES.get(flat.type)
        outputs = self._outputs(flat, kind) if flat not in self.failures else None
        if kind is None or outputs is None:
            return placeholder_outputs(self.builder, flat)
        outputs = outputs if isinstance(outputs, tuple) else (outputs,)
        if not kind.held:
            return outputs
        remembers = self.block_context(flat).memories > 0
        return tuple(self.timing.sample(flat, wired, remembers) for wired in outputs)

    def _outputs(self, flat: FlatBlock, kind: BlockType | None) -> Outputs | None:
        """Return the outputs of a block, None if it or its inputs are not supported."""
        if kind is None:
            self.failures.note(flat, *unsupported_reason(flat), flat.undefined)
            self.visits.agenda.add(flat)  # blocks upstream are checked all the same
        elif any(not wired.sound for wired in self.known_inputs(flat)):
            self._report_undefined(flat, kind)
        else:
            with self.failures.note_errors(flat):
                return self._call_handler(flat, kind)
        return None

    def _report_undefined(self, flat: FlatBlock, kind: BlockType) -> None:
        """Look for further undefined variables behind an unsupported block, to report all at once."""
        try:
            self._call_handler(flat, kind)
        except UnsupportedError as unsupported:
            if unsupported.undefined:
                self.failures.note(flat, *unsupported.parts)
        except PARAMETER_ERRORS:
            return

    def _call_handler(self, flat: FlatBlock, kind: BlockType) -> Outputs:
        """Call the handler of a block; if it fails, its states are not completed."""
        begun = len(self.visits.agenda)
        try:
            return kind.rule(self.block_context(flat))
        except (UnsupportedError, *PARAMETER_ERRORS):
            self.visits.agenda.drop((flat, flat.last), since=begun)
            raise

    def note_conflicting_counts(self, paths: Collection[str]) -> None:
        """Record that inputs and parameters require different iteration counts."""
        for flat in self.flat.blocks:
            if flat.type in LOOPS and join_path(*split_path(flat.path)[:-1]) in paths:
                self.failures.note(flat, "its inputs and its parameters require different iteration counts")


def compile_to_fixed_point(
    make: Callable[[InferredAttributes], BlockCompiler], goals: Collection[FlatBlock]
) -> BlockCompiler:
    """Repeat passes until all inferred attributes agree; otherwise record the failure at the first goal."""
    guesses = InferredAttributes()
    compiler = make(guesses)
    stopped: BlockCompiler | None = None
    asked = 0
    for _ in range(min(_MAX_PASSES, len(compiler.flat.blocks) + 10)):
        if asked > _MAX_OPERATIONS:
            break
        guesses.changed = False
        compiler = make(guesses)
        compiler.demand(goals)
        asked += compiler.builder.asked
        doubled = guesses.taken | (compiler.inputs.keys() & compiler.declared.parameters.keys())
        guesses.changed |= doubled != guesses.taken
        guesses.taken = doubled
        if guesses.changed:
            continue
        wishes = compiler.shapes.wishes
        if not compiler.failures or not wishes or stopped is not None:
            return stopped if stopped is not None and len(stopped.failures) <= len(compiler.failures) else compiler
        stopped, guesses.wished = compiler, wishes
        guesses.shapes.update(wishes)
    compiler.failures.note(next(iter(goals)), _UNSETTLED, _UNSETTLED_REMEDY)
    return compiler
