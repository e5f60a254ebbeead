"""One pass that lowers all blocks, and its repetition to a fixed point.

Sizes and sample times of states in feedback are unknown when they are first read. They are guessed, and the pass is
repeated with the results until nothing changes.
"""

from collections.abc import Callable, Collection, Iterable

from kennfeld.graph.bounded_builder import BoundedGraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.calibration_parameters import DeclaredParameters
from kennfeld.models.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.models.simulink.flattening.flat_model import (
    STATE_PORT,
    DataStoreOrder,
    FlatBlock,
    FlatModel,
    SignalSource,
)
from kennfeld.models.simulink.flattening.iterated_subsystems import LOOPS
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.block_order import BlockDependencies, BuildOrder
from kennfeld.models.simulink.lowering.continuous_states import ContinuousStates
from kennfeld.models.simulink.lowering.diagnostics import (
    PARAMETER_ERRORS,
    BlockFailures,
    UnsupportedError,
    placeholder_outputs,
    placeholder_signal,
    unsupported_reason,
)
from kennfeld.models.simulink.lowering.discrete_states import DataStores, DiscreteStates
from kennfeld.models.simulink.lowering.pass_state import (
    DimensionInference,
    InferredAttributes,
    ModelInputs,
    PendingCompletions,
)
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, BlockType
from kennfeld.models.simulink.lowering.scheduling import ExecutionConditions, ModelClock, SampleTimes
from kennfeld.models.simulink.lowering.state_ports import StatePorts, is_known_at_step_start
from kennfeld.models.simulink.reader.model_tree import join_path, split_path
from kennfeld.models.simulink.signals import Bus, ExternalBus, Signal, SignalOrBus
from kennfeld.models.simulink.variables.m_files import FunctionFiles
from kennfeld.models.simulink.variables.mask_scope import Scope, Variable

_MAX_PASSES = 500
_MAX_OPERATIONS = 20_000_000  # over all passes
_UNSETTLED = "the sizes or sample times of its feedback signals cannot be determined"
_UNSETTLED_REMEDY = "Set the initial values of the delays and integrators in the loop to the size of their signals."


class BlockCompiler:
    """One pass over the blocks.

    `bound` returns the signals that replace bound blocks; `clock` holds the steps of the model. `timing` holds sample
    times, `gates` execution conditions, `memories`, `continuous` and `contents` the states, `visits` the build order,
    `failures` the unsupported blocks and `remarks` sentences for the report.
    """

    def __init__(
        self,
        flat: FlatModel,
        clock: ModelClock,
        promoted: Iterable[str],
        bound: Callable[["BlockCompiler", FlatBlock], SignalOrBus | tuple[SignalOrBus, ...]],
        guesses: InferredAttributes,
    ) -> None:
        self.flat, self.clock, self.bound = flat, clock, bound
        self.builder = BoundedGraphBuilder()
        self.declared = DeclaredParameters(frozenset(promoted))
        self.expressions = ParameterExpressions(self.builder, self.declared)
        self.failures = BlockFailures()
        self.inputs = ModelInputs(self.builder, guesses)
        self.shapes = DimensionInference(guesses)
        self.timing = SampleTimes(clock, self.expressions, guesses, self.failures)
        self.stores = DataStoreOrder(flat.blocks, self.timing.task_order)
        self.gates = ExecutionConditions(self.timing, self.value)
        agenda = PendingCompletions()
        self.ports = StatePorts(self.timing, self.shapes, agenda)
        self.memories = DiscreteStates(self.gates, self.ports, self._known_inputs)
        self.continuous = ContinuousStates(self.memories)
        self.contents = DataStores(self.memories, self.stores, self.signal)
        self.needs = BlockDependencies(self.block_context, self.stores, self._ahead, self.failures)
        self.visits = BuildOrder(self.builder, self.needs, agenda, self.failures, self._build)
        self.counts: dict[str, int] = {}
        self.remarks: dict[str, None] = {}
        self.files = FunctionFiles(())
        self._sites: dict[FlatBlock, BlockContext] = {}

    def demand(self, blocks: Iterable[FlatBlock]) -> None:
        """Lower blocks and everything they depend on, states included."""
        self.visits.demand(blocks)
        self.continuous.resolve_initial_values()

    def finish(self, solver: str) -> None:
        """Advance the continuous states once everything they depend on is lowered."""
        self.continuous.advance(solver)

    def block_type(self, flat: FlatBlock) -> BlockType | None:
        """Return the registered type of a block."""
        return BLOCK_TYPES.get(flat.type)

    def block_context(self, flat: FlatBlock) -> BlockContext:
        """Return the context of a block."""
        if flat not in self._sites:
            self._sites[flat] = BlockContext(self, flat)
        return self._sites[flat]

    def _build(self, flat: FlatBlock) -> tuple[SignalOrBus, ...]:
        """Lower a block whose inputs are lowered."""
        kind = self.block_type(flat)
        self.builder.place = flat.path
        if flat in self.failures:
            return placeholder_outputs(self.builder, flat)
        if kind is None:
            self.failures.note(flat, *unsupported_reason(flat), flat.undefined)
            self.visits.agenda.add(flat)  # blocks upstream are checked all the same
            return placeholder_outputs(self.builder, flat)
        if any(not wired.sound for wired in self._known_inputs(flat)):
            self._report_undefined(flat, kind)
            return placeholder_outputs(self.builder, flat)
        made: SignalOrBus | tuple[SignalOrBus, ...] | None = None
        with self.failures.note_errors(flat):
            made = self._call_handler(flat, kind)
        if made is None:
            return placeholder_outputs(self.builder, flat)
        outputs = made if isinstance(made, tuple) else (made,)
        return tuple(self._sampled(flat, wired) for wired in outputs) if kind.held else outputs

    def _sampled(self, flat: FlatBlock, wired: SignalOrBus) -> SignalOrBus:
        return self.timing.sample(flat, wired, self.block_context(flat).memories > 0)

    def _report_undefined(self, flat: FlatBlock, kind: BlockType) -> None:
        """Look for further undefined variables behind an unsupported block, to report all at once."""
        try:
            self._call_handler(flat, kind)
        except UnsupportedError as unsupported:
            if unsupported.undefined:
                self.failures.note(flat, *unsupported.parts)
        except PARAMETER_ERRORS:
            return

    def _call_handler(self, flat: FlatBlock, kind: BlockType) -> SignalOrBus | tuple[SignalOrBus, ...]:
        """Call the handler of a block; if it fails, its states are not completed."""
        begun = len(self.visits.agenda)
        try:
            return kind.rule(self.block_context(flat))
        except (UnsupportedError, *PARAMETER_ERRORS):
            self.visits.agenda.drop((flat, flat.last), since=begun)
            raise

    def value(self, source: SignalSource) -> SignalOrBus:
        """Return the signal or bus of a block that is lowered, or at its state port."""
        if self._ahead(source):
            return self.ports.signal(source.flat)
        if source.flat not in self.visits.values:
            raise UnsupportedError(f"its input from {source.flat.path} is computed after it")
        outputs = self.visits.values[source.flat]
        if source.port == STATE_PORT and source.flat.type != "DiscreteIntegrator" and outputs[-1].sound:
            self.failures.note(source.flat, "its state port is used, which is not supported")
            return placeholder_signal(self.builder)
        port = len(outputs) - 1 if source.port == STATE_PORT else source.port  # a state port is the last output
        return outputs[port] if port < len(outputs) else placeholder_signal(self.builder)

    def signal(self, source: SignalSource) -> Signal:
        """Return the signal of a block output that is not a bus."""
        signal = self.value(source)
        if isinstance(signal, ExternalBus):
            return signal.signal
        if isinstance(signal, Bus):
            raise UnsupportedError(f"the output of {source.flat.path} is a bus")
        return signal

    def outputs(self, flat: FlatBlock) -> tuple[SignalOrBus, ...]:
        """Return the outputs of a lowered block, () for others."""
        return self.visits.values.get(flat, ())

    def note_unbound_output(self, flat: FlatBlock, number: int) -> Signal:
        """Record that an output is not bound although another output of the block is."""
        self.failures.note(flat, f"its output {number} is not bound", f'Bind it too: "{flat.path}:{number}".')
        return placeholder_signal(self.builder)

    def _ahead(self, source: SignalSource) -> bool:
        return is_known_at_step_start(source, self.block_context)

    def _known_inputs(self, flat: FlatBlock) -> list[SignalOrBus]:
        """Return the signals at the inputs of a block that are known so far."""
        there = self.visits.values
        return [self.value(s) for s in flat.inputs if s is not None and (s.flat in there or self._ahead(s))]

    def promoted_literal(self, name: str, text: str, scope: Scope, variable: Variable | None) -> Nodes:
        """Return the nodes of a literal promoted to a parameter; `given` replaces its value."""
        literal = Variable(self.expressions.numbers(text, scope), source="a literal of the block")
        return self.declared.array(self.builder, name, variable or literal)

    def note_iteration_count(self, path: str, count: int) -> None:
        """Record the iteration count that an input requires."""
        if self.counts.setdefault(path, count) != count:
            raise UnsupportedError(f"its inputs require {self.counts[path]} and {count} iterations")

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
