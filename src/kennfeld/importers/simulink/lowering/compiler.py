"""Lowering of all blocks by their handlers, repeated to a fixed point.

Sizes and sample times of states in feedback are unknown when they are first read. They are guessed, and the pass is
repeated with the results until nothing changes.
"""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.importers.simulink.flattening.iterated_subsystems import LOOPS
from kennfeld.importers.simulink.lowering.block_context import BlockContext
from kennfeld.importers.simulink.lowering.diagnostics import (
    PARAMETER_ERRORS,
    UnsupportedError,
    placeholder_outputs,
    unsupported_reason,
)
from kennfeld.importers.simulink.lowering.lowering_pass import LoweringPass
from kennfeld.importers.simulink.lowering.pass_state import InferredAttributes
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES, BlockType, Outputs
from kennfeld.importers.simulink.reader.model_tree import join_path, split_path
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, limit
from kennfeld.importers.simulink.variables.data_types import BusType
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_MAX_PASSES = 500
_MAX_OPERATIONS = 20_000_000  # over all passes
_UNSETTLED = "the sizes or sample times of its feedback signals cannot be determined"
_UNSETTLED_REMEDY = "Set the initial values of the delays and integrators in the loop to the size of their signals."


class BlockCompiler(LoweringPass):
    """A pass that calls the handlers of the blocks."""

    def demand(self, blocks: Iterable[FlatBlock]) -> None:
        """Lower blocks and everything they depend on, states included."""
        self.visits.demand(blocks)
        self._check_buses()
        self.continuous.close()

    def _check_buses(self) -> None:
        """Lower the bus creators behind which only single signals are used, to compare them with their objects."""
        for flat in self.flat.blocks:
            if flat.type != "BusCreator" or flat in self.visits.values:
                continue
            # what nothing else needs is not lowered for that, and a bus without an object is not checked
            known = [source is not None and source.flat in self.visits.values for source in flat.inputs]
            if any(known) and isinstance(flat.output_type, BusType):
                self._call_handler_for_check(flat)

    def _call_handler_for_check(self, flat: FlatBlock) -> None:
        with self.failures.note_errors(flat):
            self._call_handler(flat, BLOCK_TYPES[flat.type])

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
        if flat in self.failures:
            self.visits.agenda.add(flat)  # blocks upstream are checked all the same
            self._find_undefined(flat, kind)
        if kind is None or outputs is None:
            return placeholder_outputs(self.builder, flat)
        outputs = self.floats.outputs(flat, kind, outputs if isinstance(outputs, tuple) else (outputs,))
        if (limits := self.block_context(flat).type_limits) is not None:
            outputs = tuple(_limited(wired, limits) for wired in outputs)
        if not kind.held:
            return outputs
        remembers = self.block_context(flat).memories > 0
        return tuple(self.timing.sample(flat, wired, remembers) for wired in outputs)

    def _outputs(self, flat: FlatBlock, kind: BlockType | None) -> Outputs | None:
        """Return the outputs of a block, None if it or its inputs are not supported."""
        if kind is None:
            self.failures.note(flat, *unsupported_reason(flat), flat.undefined)
        # the names of a bus are known whether its signals are supported or not; a delay in a loop depends on them
        elif not kind.routes and any(not wired.sound for wired in self.known_inputs(flat)):
            self._report_undefined(flat, kind)
        else:
            with self.failures.note_errors(flat):
                return self._call_handler(flat, kind)
        return None

    def _report_undefined(self, flat: FlatBlock, kind: BlockType) -> None:
        """Look for further undefined variables behind an unsupported block, to report all at once."""
        with self._ignoring_all_but_undefined(flat):
            self._call_handler(flat, kind)

    def _find_undefined(self, flat: FlatBlock, kind: BlockType | None) -> None:
        """Add the other undefined variables of a block that lacks one, in all its expressions."""
        names, begun = tuple[str, ...](), len(self.visits.agenda)
        # each call stops at the first variable without a value: with that one as NaN, the next call finds the next
        while kind is not None and self.failures[flat].undefined != names:
            names = self.failures[flat].undefined
            with self.expressions.assuming(names), self._ignoring_all_but_undefined(flat):
                self.timing.specified_sample_time(flat)
                self._call_handler(flat, kind)
        self.visits.agenda.drop((flat, flat.last), since=begun)

    @contextmanager
    def _ignoring_all_but_undefined(self, flat: FlatBlock) -> Iterator[None]:
        """Suppress errors of a handler, but record undefined variables."""
        try:
            yield
        except (UnsupportedError, *PARAMETER_ERRORS) as error:
            if isinstance(error, UnsupportedError | EvaluationError) and error.undefined:
                self.failures.note(flat, str(error), error.remedy, error.undefined)

    def is_reached(self, flat: FlatBlock) -> bool:
        """Return False for a block behind an unsupported one, which was therefore not checked."""
        lowered = (source for source in flat.inputs if source is not None and source.flat in self.visits.values)
        return all(self._is_sound(source) for source in lowered)

    def _is_sound(self, source: SignalSource) -> bool:
        outputs = self.outputs(source.flat)
        return not outputs or outputs[min(source.port, len(outputs) - 1)].sound

    def _call_handler(self, flat: FlatBlock, kind: BlockType) -> Outputs:
        """Call the handler of a block; if it fails, its states are not completed."""
        begun = len(self.visits.agenda)
        try:
            with self.floats.rounding(flat):
                return kind.rule(self.block_context(flat))
        except (UnsupportedError, *PARAMETER_ERRORS):
            self.visits.agenda.drop((flat, flat.last), since=begun)
            raise

    def note_conflicting_counts(self, paths: Collection[str]) -> None:
        """Record that inputs and parameters require different iteration counts."""
        for flat in self.flat.blocks:
            if flat.type in LOOPS and join_path(*split_path(flat.path)[:-1]) in paths:
                self.failures.note(flat, "its inputs and its parameters require different iteration counts")


def _limited(wired: SignalOrBus, limits: tuple[float, float]) -> SignalOrBus:
    """Return a signal within the limits of its type; a bus has the types of its object."""
    return limit(wired, *limits) if isinstance(wired, Signal) and wired.sound else wired


def compile_to_fixed_point(
    make: Callable[[InferredAttributes], BlockCompiler], goals: Collection[FlatBlock]
) -> BlockCompiler:
    """Repeat passes until all inferred attributes agree; otherwise record the failure at the first goal."""
    guesses = InferredAttributes()
    compiler = make(guesses)
    stopped: BlockCompiler | None = None
    operations = 0
    # a pass carries a size at least one state further, so that more passes than blocks mean growth without end
    for _ in range(min(_MAX_PASSES, len(compiler.flat.blocks) + 10)):
        if operations > _MAX_OPERATIONS:
            break
        guesses.changed = False
        compiler = make(guesses)
        compiler.demand(goals)
        operations += compiler.builder.asked
        # an input called like a parameter gets another name in the next pass
        doubled = guesses.taken | (compiler.inputs.keys() & compiler.declared.parameters.keys())
        guesses.changed |= doubled != guesses.taken
        guesses.taken = doubled
        if guesses.changed:
            continue
        wishes = compiler.shapes.wishes
        if guesses.wish(wishes, only_certain=True):
            stopped = None
            continue
        # of the attempts without and with suggested sizes, the one with fewer failures
        if stopped is None or len(compiler.failures) < len(stopped.failures):
            stopped = compiler
        # a failure may come from a scalar that a block downstream expects to be a vector: try its size, once each
        if not compiler.failures or not guesses.wish(wishes, only_certain=False):
            return stopped
    compiler.failures.note(next(iter(goals)), _UNSETTLED, _UNSETTLED_REMEDY)
    return compiler
