"""Interface of block handlers: fields, inputs, states, and the graph under construction."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError, evaluating
from kennfeld.importers.simulink.lowering.lowering_pass import LoweringPass
from kennfeld.importers.simulink.lowering.pass_state import undefined_reason
from kennfeld.importers.simulink.lowering.registry import field_text
from kennfeld.importers.simulink.lowering.type_effects import saturation_limits
from kennfeld.importers.simulink.reader.dialog_words import begins_with_word, match_word
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    CONTINUOUS,
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    SignalRule,
    apply,
    as_vector,
    constant,
    period_of,
    select,
)
from kennfeld.importers.simulink.variables.data_types import DataType, PlainType, UndefinedType
from kennfeld.importers.simulink.variables.mask_scope import Variable
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, truncate

_REMEDY = "Define its variables in a script, a .mat, .sldd or calibration file given as parameters."


class BlockContext:
    """One block while it is lowered.

    Fields are read by name; inputs are numbered from 0. Signals are arrays of graph nodes, on which operations act
    element by element. States are created by `discrete_state` and `continuous_state`, whose updates are called once all
    blocks are lowered.
    """

    def __init__(self, compiler: LoweringPass, flat: FlatBlock) -> None:
        self.compiler = compiler
        self.flat = flat
        self.memories = self.before = 0

    def of(self, flat: FlatBlock) -> "BlockContext":
        """Return a context in which to read the fields and inputs of another block."""
        return BlockContext(self.compiler, flat)

    @property
    def builder(self) -> GraphBuilder:
        """The graph under construction."""
        return self.compiler.builder

    def field_text(self, name: str, default: str | None = None) -> str:
        """Return a field as written, or its default."""
        written = field_text(self.flat, name)
        written = default if written is None else written
        if written is None:
            raise UnsupportedError(f"the file does not specify its {name}")
        return written.strip()

    def option(self, name: str, *known: str) -> str:
        """Return which of the known words a field is; raise `UnsupportedError` otherwise."""
        written = self.field_text(name)
        word = match_word(written, known)
        if word is None:
            raise UnsupportedError(f"{name} {written[:60]!r} is not supported")
        return word

    def is_set_to(self, name: str, *words: str, default: str | None = None) -> bool:
        """Return True if a field is one of some words; `default` stands for a field without a value."""
        return match_word(self.field_text(name, default), words) is not None

    def begins_with(self, name: str, word: str, default: str | None = None) -> bool:
        """Return True if a field begins with a word."""
        return begins_with_word(self.field_text(name, default), word)

    def field_name(self, *names: str) -> str:
        """Return the first of several names of one field that the file contains, else the last name."""
        return next((name for name in names if self.flat.block.value(name) is not None), names[-1])

    @property
    def output_type(self) -> DataType | None:
        """The data type that the block specifies for its output, None if it is inherited."""
        return self.flat.output_type

    @property
    def is_boolean(self) -> bool:
        """True if the block converts its output to boolean, 1 unless it is 0."""
        kind = self.output_type
        return isinstance(kind, PlainType) and kind.name in ("boolean", "logical", "bool")

    @functools.cached_property
    def type_limits(self) -> tuple[float, float] | None:
        """The limits of the integer or fixed-point type to which the block saturates its output, None without."""
        return saturation_limits(self.flat, self.compiler.readers)

    def is_on(self, name: str) -> bool:
        """Return True if a field is on."""
        return self.is_set_to(name, "on", default="off")

    def parameter(self, name: str, default: str | None = None) -> Signal:
        """Return a field as a signal whose variables stay parameters; rows and columns become vectors."""
        nodes = self._array(name, self.field_text(name, default))
        if not nodes.size:
            raise UnsupportedError(f"its {name} is empty")
        return self.signal(as_vector(nodes), CONSTANT)

    def matrix(self, name: str) -> Nodes:
        """Return a field as a matrix of nodes, Int[rows, columns]."""
        return self._array(name, self.field_text(name))

    def _array(self, name: str, text: str) -> Nodes:
        """Return a field as an array of nodes, rounded if the block computes in single precision."""
        return self.compiler.floats.rounded_nodes(self._unrounded_array(name, text))

    def _unrounded_array(self, name: str, text: str) -> Nodes:
        field = f"{self.flat.path}:{name}"
        variable = self.flat.scope.variables.get(field)
        expressions = self.compiler.expressions
        with evaluating(f"its {name} ({text[:60]}) has no value", _REMEDY):
            # a promoted literal is a parameter of its own; a value for any other field only replaces its numbers
            if field in self.compiler.declared.promoted:
                literal = Variable(expressions.numbers(text, self.flat.scope), source="a literal of the block")
                return self.compiler.declared.array(self.builder, field, variable or literal)
            if variable is not None:
                return expressions.freeze(variable.value)
            return expressions.array(text, self.flat.scope)

    def numeric_array(self, name: str, default: str | None = None) -> Numbers:
        """Return a field as constants, Float[rows, columns]."""
        text = self.field_text(name, default)
        # a value given under the name of the field takes precedence over its expression
        variable = self.flat.scope.variables.get(f"{self.flat.path}:{name}")
        if variable is not None and isinstance(variable.value, np.ndarray):
            return np.atleast_2d(variable.value)
        with evaluating(f"its {name} ({text[:60]}) has no value", _REMEDY):
            return self.compiler.expressions.numbers(text, self.flat.scope)

    def evaluate(self, text: str) -> Numbers:
        """Return the numbers of an expression that is part of a field."""
        with evaluating(f"{text[:60]} has no value", _REMEDY):
            return self.compiler.expressions.numbers(text, self.flat.scope)

    def numeric_field(self, name: str, default: str | None = None) -> float:
        """Return a field as one constant."""
        numbers = self.numeric_array(name, default)
        if numbers.size != 1:
            raise UnsupportedError(f"its {name} must be scalar, got {numbers.size} values")
        return float(numbers.item())

    def integer_field(self, name: str, least: int = 0, most: int = 100_000) -> int:
        """Return a field as an integer within limits."""
        value = self.numeric_field(name)
        if not (value.is_integer() and least <= value <= most):
            raise UnsupportedError(f"its {name} must be an integer from {least} to {most}, got {value:g}")
        return int(value)

    def initial_output(self) -> Signal | None:
        """Return the initial output, None if the block does not specify one."""
        return None if self.field_text("InitialOutput") in ("[]", "") else self.parameter("InitialOutput")

    def warn(self, sentence: str) -> None:
        """Add a warning to the import report; the sentence continues the path of the block."""
        self.compiler.warnings[f"{self.flat.path} {sentence}"] = None

    def warn_of_unknown_width(self, signal: Signal) -> None:
        """Add a warning if the result depends on the width of an input that nothing specifies."""
        # that of a bus is reported in any case, by its port
        if signal.width is not None and signal.width.name not in self.compiler.inputs.widths and signal.width.key:
            self.warn(f"combines the elements of its input: {signal.width.note}")

    def source(self, index: int = 0) -> SignalSource | None:
        """Return the source of an input, None if it is unconnected."""
        return self.flat.inputs[index] if index < len(self.flat.inputs) else None

    def input_or_bus(self, index: int) -> SignalOrBus:
        """Return the signal or bus at an input; 0 if it is unconnected."""
        source = self.source(index)
        return self.compiler.value(source) if source is not None else self.constant(0.0)

    def input(self, index: int = 0, frames: bool = False) -> Signal:
        """Return the signal at an input, whose rows must not be successive samples unless `frames`."""
        signal = self.input_or_bus(index)
        if isinstance(signal, ExternalBus):
            signal = signal.signal
        if isinstance(signal, Signal) and index == 0 and not frames:
            self._check_frame(signal)
        if isinstance(signal, Bus):
            signal = self._vector_of(signal, index)
        own = signal if signal.builder is self.builder else replace(signal, builder=self.builder)
        return self.compiler.floats.operand(own)

    def _vector_of(self, bus: Bus, index: int) -> Signal:
        """Return a bus as the vector of its signals, as Simulink does where a block takes no buses."""
        members = [member for member in bus.members.values() if isinstance(member, Signal)]
        if len(members) < len(bus.members) or not members:
            remedy = "Select one signal of the bus with a Bus Selector."
            raise UnsupportedError(f"its input {index + 1} is a bus", remedy)
        # a bus of one signal counts as that signal
        if len(members) == 1:
            return members[0]
        self.warn(f"takes the bus at its input {index + 1} as a vector: {join_names(list(bus.members), 6)}")
        return self.joined(members)

    def joined(self, members: Sequence[Signal]) -> Signal:
        """Return a vector of all elements, which is a row or column if one of the signals is."""
        shapes = {member.shape for member in members if member.nodes.ndim == 2 and member.size > 1}
        if any(min(shape) > 1 for shape in shapes) or len({shape[0] == 1 for shape in shapes}) > 1:
            raise UnsupportedError("its bus contains matrices, or rows and columns, which are not one vector")
        nodes = [node for member in members for node in member.flat]
        shape = next(((1, len(nodes)) if shape[0] == 1 else (len(nodes), 1) for shape in shapes), None)
        return replace(self.signal(nodes, period_of(members), shape), sound=all(member.sound for member in members))

    def _check_frame(self, signal: Signal) -> None:
        """Raise `UnsupportedError` if the rows of an input are successive samples."""
        if signal.shape[0] > 1 and self.begins_with("InputProcessing", "Columns", default=""):
            remedy = "Set its input processing to elements as channels, or bind it."
            raise UnsupportedError(f"its input is a frame of {signal.shape[0]} samples, which is not supported", remedy)

    def bus(self) -> SignalOrBus:
        """Return the bus at the first input; that of a model input provides any signal by name."""
        source = self.source()
        arriving = self.input_or_bus(0)
        if isinstance(arriving, Bus) or source is None:
            return arriving
        kind = source.flat.output_type
        if source.flat.type not in ("Inport", "From"):
            if isinstance(kind, UndefinedType) and kind.is_bus:
                raise UnsupportedError(f"its input 1 is a bus, but {undefined_reason(kind)}")
            return arriving
        why = undefined_reason(kind) if isinstance(kind, UndefinedType) else "its port does not name a bus object"
        return self.compiler.inputs.open_bus(source.flat, why)

    @property
    def inputs(self) -> list[Signal]:
        """Signals at all inputs."""
        return [self.input(index) for index in range(self.input_count)]

    @property
    def input_count(self) -> int:
        """Number of inputs."""
        return len(self.flat.inputs)

    def constant(self, *values: float) -> Signal:
        """Return a vector of constants."""
        return constant(self.builder, *values)

    def signal(
        self, nodes: Nodes | Sequence[int], period: float = CONTINUOUS, shape: tuple[int, ...] | None = None
    ) -> Signal:
        """Return a signal of an array of nodes, or of nodes in the order of the columns of `shape`."""
        array = np.array(nodes, dtype=np.int64)
        return Signal(array if shape is None else array.reshape(shape, order="F"), period, builder=self.builder)

    def reduce(self, op: str, args: Sequence[Signal]) -> Signal:
        """Combine signals by an operation from first to last; 0 if there are none."""
        return functools.reduce(functools.partial(apply, op), args) if args else self.constant(0.0)

    def truncate(self, x: Signal) -> Signal:
        """Round a signal toward zero."""
        return replace(self.signal(truncate(self.builder, x.nodes), x.period), type=x.type)

    def is_among(self, x: Signal, values: Iterable[float]) -> Signal:
        """Return 1 if a signal equals one of several values, else 0."""
        return self.reduce("or", [apply("eq", x, value) for value in values])

    @property
    def time(self) -> Signal:
        """Time since the start in s."""
        return self.signal([self.builder.time()])

    @property
    def base_step(self) -> Signal:
        """Length in s of the model step that ends at the sample."""
        return self.signal([self.builder.step()])

    def time_tolerance(self, share: float = 1e-6) -> float:
        """Return a share of the step in s, for rounded times; 0 if the data define the step."""
        return share * (self.compiler.clock.step or 0.0)

    def sample_step(self) -> Signal:
        """Return the sample time of the block in s, specified or inherited; then the step that ends at the sample."""
        return self._sample_time(self.builder.step)

    def next_sample_step(self) -> Signal:
        """Return the sample time of the block in s, specified or inherited; then the step that begins at the sample."""
        return self._sample_time(self.builder.next_step)

    def _sample_time(self, step: Callable[[], int]) -> Signal:
        return self.signal([step()]) if self.period() in (CONTINUOUS, CONSTANT) else self.constant(self.period())

    def period(self) -> float:
        """Return the sample time of the block in s: as specified, or inherited as far as it is known in this pass."""
        return self.compiler.timing.period(self.flat)

    def hold_in_minor_steps(self, x: Signal) -> Signal:
        """Hold a signal during the minor steps of the solver."""
        return self.compiler.timing.hold_in_minor_steps(x)

    def is_true(self, index: int) -> Signal:
        """Return 1 if an input, held during minor steps, is not 0."""
        return apply("ne", self.hold_in_minor_steps(self.input(index)), 0.0)

    def discrete_state(
        self, init: Signal, then: SignalRule, latency: int = 1, ported: bool = False, sampled: bool = True
    ) -> Signal:
        """Return a discrete state at the start of the step.

        Args:
            init: initial value.
            then: maps the state to its next value; called once all blocks are lowered.
            latency: number of steps until the next value is read.
            ported: True for the state at the block's state port.
            sampled: False if the state is written in every step, not at the hits of the block's own sample time only.
        """
        self.memories += 1
        number = STATE_PORT if ported else self.memories
        return self.compiler.memories.create(self.flat, number, init, then, latency, sampled)

    def feedback(self, init: Signal, rule: SignalRule) -> Signal:
        """Return y = rule(y'), in which y' is the value of y in the previous sample, at first `init`."""
        results: list[Signal] = []
        # the next state is y itself, which the completion reads after the rule has made it
        results.append(rule(self.discrete_state(init, lambda _: results[0])))
        return results[0]

    def unconditional_feedback(self, init: Signal, rule: SignalRule) -> Signal:
        """Return the same as `feedback` with the value of the previous step, even if the subsystem does not run."""
        results: list[Signal] = []
        self.before += 1
        # negative, below that of a state port: numbers of discrete states count up from 1
        number = STATE_PORT - self.before
        before = self.compiler.memories.delay_unconditionally(self.flat, number, init, lambda: results[0])
        results.append(rule(before))
        return results[0]

    def continuous_state(
        self,
        init: Signal,
        slope: SignalRule,
        reset: Signal | None = None,
        limits: tuple[Signal, Signal] | None = None,
        ported: bool = False,
    ) -> Signal:
        """Return a continuous state, which the solver advances.

        Args:
            init: initial value.
            slope: maps the state to its time derivative; called once all blocks are lowered.
            reset: condition that sets the state to `init`.
            limits: lower and upper limit.
            ported: True for the state at the block's state port.
        """
        self.memories += 1
        number = STATE_PORT if ported else self.memories
        return self.compiler.continuous.integrate(self.flat, number, init, slope, reset, limits)

    def suggest_dimensions(self, shape: tuple[int, ...]) -> None:
        """Suggest the shape of the first input, whose memory or inport does not determine it."""
        source = self.source()
        if source is not None:
            self.compiler.shapes.wish(self.input(), source.flat, shape, self.flat.path)

    def zero_crossing(self, x: Signal, kind: str) -> Signal:
        """Return 1 if a signal crosses zero as a trigger detects it: rising, falling or either.

        A signal that reaches zero has crossed it; leaving zero on the other side in the next step does not count again.
        """
        # the state is the sign of x; at zero, +-1/2 is the crossing by which it arrived just now, and 0 none
        before = self.discrete_state(apply("sign", x), lambda before: self._crossing_sign(before, x))
        rests = apply("eq", x, 0.0)
        # as rt_ZCFcn of generated code does: from below to zero, or to above unless the last step counted its arrival
        rising = (before <= 0.0) & (x > 0.0) | apply("eq", before, -1.0) & rests
        falling = (before >= 0.0) & (x < 0.0) | apply("eq", before, 1.0) & rests
        return _select_edge(kind, rising, falling)

    def _crossing_sign(self, before: Signal, x: Signal) -> Signal:
        """Return the sign of a signal; at zero, half the sign of the crossing by which it arrived in this step."""
        arrived = select(apply("eq", abs(before), 1.0), -0.5 * before, 0.0)
        return select(apply("eq", x, 0.0), arrived, apply("sign", x))

    def level_crossing(self, x: Signal, kind: str) -> Signal:
        """Return 1 if a signal becomes positive (rising), ceases to be positive (falling), or either."""
        # begins with x itself: the first step has no edge
        before = self.discrete_state(x, lambda _: x) > 0.0
        now = x > 0.0
        return _select_edge(kind, now & ~before, before & ~now)


def _select_edge(kind: str, rising: Signal, falling: Signal) -> Signal:
    if kind == "either":
        return rising | falling
    return rising if kind == "rising" else falling
