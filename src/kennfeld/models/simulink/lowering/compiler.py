"""Passes over the blocks until every guess is right.

Sizes and sample times of memories that are fed back are not known when they are first read: they are guessed, and the
graph is built again with what was found until nothing changes.

Blocks to graph: one pass over the blocks, which puts its parts to work and keeps the outputs of every block.
"""

from collections.abc import Callable, Collection, Iterable

from kennfeld.graph.bounded_builder import BoundedGraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.calibration_parameters import DeclaredParameters
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
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
    placeholder_signal,
    stand_ins,
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

__all__ = ["BlockCompiler", "compile_to_fixed_point"]

_MOST_PASSES = 500
_MOST_ASKED = 20_000_000  # operations of all passes
_UNSETTLED = "the sizes or sample times of the signals that are fed back before it do not settle"
_MEND = "Give the delays and integrators before it initial values of the size of their signals."


class BlockCompiler:
    """One pass over the blocks. `bound` gives the nodes of blocks that are cut, `clock` the steps of the model.

    `timing` knows sample times, `gates` conditional subsystems, `memories`, `continuous` and `contents` what lasts
    until the next step, `visits` the order of the blocks, `failures` what could not be built, and `remarks` what
    blocks tell of themselves.
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
        self.expressions = Expressions(self.builder, self.declared)
        self.failures = BlockFailures()
        self.inputs = ModelInputs(self.builder, guesses)
        self.shapes = DimensionInference(guesses)
        self.timing = SampleTimes(clock, self.expressions, guesses, self.failures)
        self.stores = DataStoreOrder(flat.atoms, self.timing.task_order)
        self.gates = ExecutionConditions(self.timing, self.value)
        agenda = PendingCompletions()
        self.ports = StatePorts(self.timing, self.shapes, agenda)
        self.memories = DiscreteStates(self.gates, self.ports, self._arriving)
        self.continuous = ContinuousStates(self.memories)
        self.contents = DataStores(self.memories, self.stores, self.signal)
        self.needs = BlockDependencies(self.site, self.stores, self._ahead, self.failures)
        self.visits = BuildOrder(self.builder, self.needs, agenda, self.failures, self._built)
        self.counts: dict[str, int] = {}
        self.remarks: dict[str, None] = {}
        self.files = FunctionFiles(())
        self._sites: dict[FlatBlock, BlockContext] = {}

    def demand(self, atoms: Iterable[FlatBlock]) -> None:
        """Build blocks and all that they need, memories included."""
        self.visits.demand(atoms)
        self.continuous.settle()

    def finish(self, solver: str) -> None:
        """Advance the continuous states, now that everything they depend on is there."""
        self.continuous.advance(solver)

    # blocks

    def kind(self, atom: FlatBlock) -> BlockType | None:
        """What the registry knows of a block's type."""
        return BLOCK_TYPES.get(atom.kind)

    def site(self, atom: FlatBlock) -> BlockContext:
        """The site of a block."""
        if atom not in self._sites:
            self._sites[atom] = BlockContext(self, atom)
        return self._sites[atom]

    def _built(self, atom: FlatBlock) -> tuple[SignalOrBus, ...]:
        """The outputs of a block whose inputs are there."""
        kind = self.kind(atom)
        self.builder.place = atom.path
        if atom in self.failures:
            return stand_ins(self.builder, atom)
        if kind is None:
            self.failures.note(atom, *unsupported_reason(atom), atom.undefined)
            self.visits.agenda.add(atom)  # what stands before it is looked at all the same
            return stand_ins(self.builder, atom)
        if any(not wired.sound for wired in self._arriving(atom)):
            self._look_for_values(atom, kind)
            return stand_ins(self.builder, atom)
        made: SignalOrBus | tuple[SignalOrBus, ...] | None = None
        with self.failures.noting(atom):
            made = self._ruled(atom, kind)
        if made is None:
            return stand_ins(self.builder, atom)
        outputs = made if isinstance(made, tuple) else (made,)
        return tuple(self._sampled(atom, wired) for wired in outputs) if kind.held else outputs

    def _sampled(self, atom: FlatBlock, wired: SignalOrBus) -> SignalOrBus:
        return self.timing.sampled(atom, wired, self.site(atom).memories > 0)

    def _look_for_values(self, atom: FlatBlock, kind: BlockType) -> None:
        """Note a variable without a value behind a block that stops: all of them are told at once."""
        try:
            self._ruled(atom, kind)
        except UnsupportedError as unsupported:
            if unsupported.undefined:
                self.failures.note(atom, *unsupported.parts)
        except PARAMETER_ERRORS:
            return

    def _ruled(self, atom: FlatBlock, kind: BlockType) -> SignalOrBus | tuple[SignalOrBus, ...]:
        """What a block's rule makes; where it stops half-way, the memories it has begun are not completed."""
        begun = len(self.visits.agenda)
        try:
            return kind.rule(self.site(atom))
        except (UnsupportedError, *PARAMETER_ERRORS):
            self.visits.agenda.leave((atom, atom.last), since=begun)
            raise

    # signals

    def value(self, source: SignalSource) -> SignalOrBus:
        """The signal of a block's output; the block has been built already, unless it is its state port."""
        if self._ahead(source):
            return self.ports.signal(source.atom)
        if source.atom not in self.visits.values:
            raise UnsupportedError(f"its input from {source.atom.path} comes too late")
        outputs = self.visits.values[source.atom]
        if source.port == STATE_PORT and source.atom.kind != "DiscreteIntegrator" and outputs[-1].sound:
            self.failures.note(source.atom, "its state port is read, which is not supported")
            return placeholder_signal(self.builder)
        port = len(outputs) - 1 if source.port == STATE_PORT else source.port  # a state port is the last output
        return outputs[port] if port < len(outputs) else placeholder_signal(self.builder)

    def signal(self, source: SignalSource) -> Signal:
        """The signal of a block's output, which is no bus."""
        found = self.value(source)
        if isinstance(found, ExternalBus):
            return found.signal
        if isinstance(found, Bus):
            raise UnsupportedError(f"the output of {source.atom.path} is a bus")
        return found

    def outputs(self, atom: FlatBlock) -> tuple[SignalOrBus, ...]:
        """The outputs of a block that has been built; none of others."""
        return self.visits.values.get(atom, ())

    def missing(self, atom: FlatBlock, number: int) -> Signal:
        """The signal of an output that is not bound though another of the block is."""
        self.failures.note(atom, f"its output {number} is not bound", f'Bind it as well: "{atom.path}:{number}".')
        return placeholder_signal(self.builder)

    def _ahead(self, source: SignalSource) -> bool:
        return is_known_at_step_start(source, self.site)

    def _arriving(self, atom: FlatBlock) -> list[SignalOrBus]:
        """The signals at the inputs of a block as far as they are there."""
        there = self.visits.values
        return [self.value(s) for s in atom.inputs if s is not None and (s.atom in there or self._ahead(s))]

    # parameters

    def promoted(self, name: str, text: str, scope: Scope, given: Variable | None) -> Nodes:
        """The nodes of a literal that is a parameter by its block and field; `given` has another value for it."""
        literal = Variable(self.expressions.numbers(text, scope), source="a literal of the block")
        return self.declared.array(self.builder, name, given or literal)

    # passes of subsystems

    def counted(self, path: str, count: int) -> None:
        """Note how many passes a subsystem needs, as one of its inputs says."""
        if self.counts.setdefault(path, count) != count:
            raise UnsupportedError(f"its inputs ask for {self.counts[path]} and for {count} passes")

    def uncounted(self, paths: Collection[str]) -> None:
        """Note that subsystems have another number of passes than their inputs ask for."""
        for atom in self.flat.atoms:
            if atom.kind in LOOPS and join_path(*split_path(atom.path)[:-1]) in paths:
                self.failures.note(atom, "its inputs and its parameters ask for different numbers of passes")


def compile_to_fixed_point(
    make: Callable[[InferredAttributes], BlockCompiler], goals: Collection[FlatBlock]
) -> BlockCompiler:
    """The pass in which every guess was right; where none is, that is what stops the first of the goals."""
    guesses = InferredAttributes()
    compiler = make(guesses)
    stopped: BlockCompiler | None = None
    asked = 0
    for _ in range(min(_MOST_PASSES, len(compiler.flat.atoms) + 10)):
        if asked > _MOST_ASKED:
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
    compiler.failures.note(next(iter(goals)), _UNSETTLED, _MEND)
    return compiler
