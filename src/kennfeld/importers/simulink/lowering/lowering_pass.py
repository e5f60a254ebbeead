"""One pass over the blocks: the graph under construction, its states and sample times, and the outputs so far."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable

from kennfeld.graph.builder import BoundedGraphBuilder
from kennfeld.importers.simulink.calibration_parameters import DeclaredParameters
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import (
    STATE_PORT,
    DataStoreOrder,
    FlatBlock,
    FlatModel,
    SignalSource,
)
from kennfeld.importers.simulink.float_types import FloatType
from kennfeld.importers.simulink.lowering.block_order import BlockDependencies, BuildOrder
from kennfeld.importers.simulink.lowering.continuous_states import ContinuousStates
from kennfeld.importers.simulink.lowering.diagnostics import BlockFailures, UnsupportedError, placeholder_signal
from kennfeld.importers.simulink.lowering.discrete_states import DataStores, DiscreteStates
from kennfeld.importers.simulink.lowering.pass_state import (
    DimensionInference,
    InferredAttributes,
    ModelInputs,
    PendingCompletions,
)
from kennfeld.importers.simulink.lowering.registry import Outputs
from kennfeld.importers.simulink.lowering.scheduling import ExecutionConditions, ModelClock, SampleTimes
from kennfeld.importers.simulink.lowering.single_precision import FloatTypes, SinglePrecisionBuilder
from kennfeld.importers.simulink.lowering.state_ports import StatePorts, is_known_at_step_start
from kennfeld.importers.simulink.signals import Bus, ExternalBus, Signal, SignalOrBus
from kennfeld.importers.simulink.variables.m_files import FunctionFiles


class LoweringPass(ABC):
    """One pass over the blocks.

    `bound` returns the signals that replace bound blocks; `clock` holds the steps of the model. `timing` holds sample
    times, `gates` execution conditions, `memories`, `continuous` and `contents` the states, `visits` the build order,
    `failures` the unsupported blocks and `warnings` sentences for the report. Signals of type single are rounded if the
    type of ports that inherit theirs, `inherited`, is given.
    """

    def __init__(
        self,
        flat: FlatModel,
        clock: ModelClock,
        promoted: Iterable[str],
        bound: Callable[["LoweringPass", FlatBlock], Outputs],
        guesses: InferredAttributes,
        inherited: FloatType | None = None,
    ) -> None:
        self.flat, self.clock, self.bound = flat, clock, bound
        self.builder = BoundedGraphBuilder() if inherited is None else SinglePrecisionBuilder()
        self.declared = DeclaredParameters(frozenset(promoted))
        self.expressions = ParameterExpressions(self.builder, self.declared)
        self.failures = BlockFailures()
        self.inputs = ModelInputs(self.builder, guesses)
        self.shapes = DimensionInference(guesses)
        # each part works with those created before it; the methods of this class close the circle
        self.timing = SampleTimes(clock, self.expressions, guesses, self.failures)
        self.stores = DataStoreOrder(flat.blocks, self.timing.task_order)
        self.gates = ExecutionConditions(self.timing, self.value)
        agenda = PendingCompletions()
        self.ports = StatePorts(self.timing, self.shapes, agenda)
        self.floats = FloatTypes(self.builder, guesses, self.known_inputs, self.readers, inherited or FloatType.UNKNOWN)
        self.memories = DiscreteStates(self.gates, self.ports, self.floats, self.known_inputs)
        self.continuous = ContinuousStates(self.memories)
        self.contents = DataStores(self.memories, self.stores, self.signal)
        self.needs = BlockDependencies(self.feedthrough, self.remembers, self.stores, self.failures)
        self.visits = BuildOrder(self.builder, self.needs, agenda, self.build)
        # a count that a signal determines is known only here, and the model is flattened with it once more
        self.counts: dict[str, int] = {}  # iterations that inputs require, by subsystem path
        self.warnings: dict[str, None] = {}
        self.files = FunctionFiles(())

    @abstractmethod
    def build(self, flat: FlatBlock) -> tuple[SignalOrBus, ...]:
        """Lower a block whose inputs are lowered."""

    @abstractmethod
    def feedthrough(self, flat: FlatBlock) -> Iterable[int]:
        """Return the inputs that affect the outputs of a block in the same step."""

    @abstractmethod
    def remembers(self, flat: FlatBlock) -> bool:
        """Return True if a lowered block has discrete states."""

    def value(self, source: SignalSource) -> SignalOrBus:
        """Return the signal or bus of a block that is lowered, or at its state port."""
        # such an output needs no order: it is known before any block of the step is lowered
        if is_known_at_step_start(source):
            return self.ports.signal(source.flat)
        if source.flat not in self.visits.values:
            raise UnsupportedError(f"its input from {source.flat.path} is computed after it")
        outputs = self.visits.values[source.flat]
        if source.port == STATE_PORT and source.flat.type != "DiscreteIntegrator" and outputs[-1].sound:
            self.failures.note(source.flat, "its state port is used, which is not supported")
            return placeholder_signal(self.builder)
        port = len(outputs) - 1 if source.port == STATE_PORT else source.port  # a state port is the last output
        # a block that is not supported has fewer outputs; it is reported, and those behind it are still checked
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

    def readers(self, flat: FlatBlock) -> list[FlatBlock]:
        """Return the blocks that read the outputs of a block."""
        return self.flat.readers.get(flat, [])

    def is_lowered(self, source: SignalSource) -> bool:
        """Return True if the signal of a source is known so far."""
        return source.flat in self.visits.values or is_known_at_step_start(source)

    def known_inputs(self, flat: FlatBlock) -> list[SignalOrBus]:
        """Return the signals at the inputs of a block that are known so far."""
        return [self.value(source) for source in flat.inputs if source is not None and self.is_lowered(source)]
