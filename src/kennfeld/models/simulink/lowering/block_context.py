"""Interface of block handlers: fields, inputs, states, and the graph under construction."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, elementwise, truncate
from kennfeld.models.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.signals import (
    CONSTANT,
    CONTINUOUS,
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    as_vector,
    common_shape,
    fastest_sample_time,
    fit_to_shape,
    scalar,
    size_text,
)

if TYPE_CHECKING:
    from kennfeld.models.simulink.lowering.compiler import BlockCompiler


Then = Callable[[Signal], Signal]

_REMEDY = "Define its variables in a script, a .mat, .sldd or calibration file given as parameters."


class BlockContext:
    """One block while it is lowered.

    Fields are read by name; inputs are numbered from 0. Signals are arrays of graph nodes, on which operations act
    element by element. States are created by `discrete_state` and `continuous_state`, whose updates are called once all
    blocks are lowered.
    """

    def __init__(self, compiler: "BlockCompiler", flat: FlatBlock) -> None:
        self.compiler = compiler
        self.flat = flat
        self.type = compiler.block_type(flat)
        self.memories = self.before = 0

    @property
    def builder(self) -> GraphBuilder:
        """The graph under construction."""
        return self.compiler.builder

    def field_text(self, name: str, default: str | None = None) -> str:
        """Return a field as written, or its default."""
        written = self.flat.block.value(name)
        if written is None and self.flat.block.mask is not None:
            written = next((p.expression for p in self.flat.block.mask.parameters if p.name == name), None)
        if written is None and self.flat.block.reference is not None:
            written = self.flat.block.reference.parameters.get(name)
        if written is None:
            written = self.type.defaults.get(name, default) if self.type is not None else default
        if written is None:
            raise UnsupportedError(f"the file does not specify its {name}")
        return written.strip()

    def option(self, name: str, *known: str) -> str:
        """Return a field that must be one of the known words; raise `UnsupportedError` otherwise."""
        written = self.field_text(name)
        if written not in known:
            raise UnsupportedError(f"{name} {written[:60]!r} is not supported")
        return written

    def is_on(self, name: str) -> bool:
        """Return True if a field is on."""
        return self.field_text(name, "off") == "on"

    def parameter(self, name: str, default: str | None = None) -> Signal:
        """Return a field as a signal whose variables stay parameters; rows and columns become vectors."""
        nodes = self._array(name, self.field_text(name, default))
        if not nodes.size:
            raise UnsupportedError(f"its {name} is empty")
        return Signal(as_vector(nodes), CONSTANT)

    def matrix(self, name: str) -> Nodes:
        """Return a field as a matrix of nodes, Int[rows, columns]."""
        return self._array(name, self.field_text(name))

    def _array(self, name: str, text: str) -> Nodes:
        field = f"{self.flat.path}:{name}"
        try:
            variable = self.flat.scope.variables.get(field)
            if field in self.compiler.declared.promoted:
                return self.compiler.promoted_literal(field, text, self.flat.scope, variable)
            if variable is not None:
                return self.compiler.expressions.freeze(variable.value)
            return self.compiler.expressions.array(text, self.flat.scope)
        except EvaluationError as error:
            raise UnsupportedError(
                f"its {name} ({text[:60]}) has no value: {error}", _REMEDY, error.undefined
            ) from None

    def numeric_array(self, name: str, default: str | None = None) -> Numbers:
        """Return a field as constants, Float[rows, columns]."""
        text = self.field_text(name, default)
        variable = self.flat.scope.variables.get(f"{self.flat.path}:{name}")
        if variable is not None and isinstance(variable.value, np.ndarray):
            return np.atleast_2d(variable.value)
        try:
            return self.compiler.expressions.numbers(text, self.flat.scope)
        except EvaluationError as error:
            raise UnsupportedError(
                f"its {name} ({text[:60]}) has no value: {error}", _REMEDY, error.undefined
            ) from None

    def evaluate(self, text: str) -> Numbers:
        """Return the numbers of an expression that is part of a field."""
        try:
            return self.compiler.expressions.numbers(text, self.flat.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"{text[:60]} has no value: {error}", _REMEDY, error.undefined) from None

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

    def remark(self, sentence: str) -> None:
        """Add a remark to the import report; the sentence continues the path of the block."""
        self.compiler.remarks[f"{self.flat.path} {sentence}"] = None

    def source(self, index: int = 0) -> SignalSource | None:
        """Return the source of an input, None if it is unconnected."""
        return self.flat.inputs[index] if index < len(self.flat.inputs) else None

    def input_or_bus(self, index: int) -> SignalOrBus:
        """Return the signal or bus at an input; 0 if it is unconnected."""
        source = self.source(index)
        return self.compiler.value(source) if source is not None else self.constant(0.0)

    def input(self, index: int = 0) -> Signal:
        """Return the signal at an input."""
        signal = self.input_or_bus(index)
        if isinstance(signal, ExternalBus):
            signal = signal.signal
        if isinstance(signal, Signal) and index == 0:
            self._check_frame(signal)
        if isinstance(signal, Bus):
            only = [member for member in signal.members.values() if isinstance(member, Signal)]
            if len(only) == len(signal.members) == 1:
                return only[0]
            raise UnsupportedError(
                f"its input {index + 1} is a bus", "Select one signal of the bus with a Bus Selector."
            )
        return signal

    def _check_frame(self, signal: Signal) -> None:
        """Raise `UnsupportedError` if the rows of an input are successive samples."""
        if signal.shape[0] > 1 and self.field_text("InputProcessing", "").startswith("Columns"):
            remedy = "Set its input processing to elements as channels, or bind it."
            raise UnsupportedError(f"its input is a frame of {signal.shape[0]} samples, which is not supported", remedy)

    def bus(self, index: int = 0) -> SignalOrBus:
        """Return the bus at an input; that of a model input provides any signal by name."""
        source = self.source(index)
        arriving = self.input_or_bus(index)
        if isinstance(arriving, Bus) or source is None or source.flat.type not in ("Inport", "From"):
            return arriving
        return self.compiler.inputs.open_bus(source.flat)

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
        return Signal(np.array([self.builder.const(value) for value in values], dtype=np.int64), CONSTANT)

    def apply(self, op: str, *args: Signal) -> Signal:
        """Apply a graph operation element by element; scalars are broadcast."""
        spread = self.broadcast(*args)
        period = fastest_sample_time([arg.period for arg in args])
        return Signal(elementwise(self.builder, op, *(arg.nodes for arg in spread)), period)

    def broadcast(self, *args: Signal) -> list[Signal]:
        """Return the signals in their common shape; raise `UnsupportedError` if they do not match."""
        shape = common_shape(*(arg.shape for arg in args))
        if shape is None:
            sizes = ", ".join(size_text(arg.shape) for arg in args)
            raise UnsupportedError(f"its inputs have the sizes {sizes}, which do not match")
        return [Signal(fit_to_shape(arg.nodes, shape), arg.period) for arg in args]

    def select(self, condition: Signal, yes: Signal, no: Signal) -> Signal:
        """Return one signal where a condition holds, else the other."""
        return self.apply("select", condition, yes, no)

    def reduce(self, op: str, args: Sequence[Signal]) -> Signal:
        """Reduce signals by a binary operation, from first to last."""
        result = args[0]
        for arg in args[1:]:
            result = self.apply(op, result, arg)
        return result

    def clip(self, x: Signal, lower: Signal, upper: Signal) -> Signal:
        """Limit a signal; infinite limits have no effect."""
        if not self._is_constant(lower, -math.inf):
            x = self.apply("max", x, lower)
        return x if self._is_constant(upper, math.inf) else self.apply("min", x, upper)

    def _is_constant(self, signal: Signal, value: float) -> bool:
        return all(self.builder.value(node) == value for node in signal.flat)

    def truncate(self, x: Signal) -> Signal:
        """Round a signal toward zero."""
        return Signal(truncate(self.builder, x.nodes), x.period)

    def is_among(self, x: Signal, values: Iterable[float]) -> Signal:
        """Return 1 if a signal equals one of several values, else 0."""
        equal = [self.apply("eq", x, self.constant(value)) for value in values]
        return self.reduce("or", equal) if equal else self.constant(0.0)

    @property
    def time(self) -> Signal:
        """Time since the start in s."""
        return scalar(self.builder.input("t"))

    @property
    def base_step(self) -> Signal:
        """Length of a model step in s."""
        return scalar(self.builder.input("dt"))

    def sample_step(self) -> Signal:
        """Return the sample time of the block in s, specified or inherited."""
        period = self.period()
        if period in (CONTINUOUS, CONSTANT):
            return self.base_step
        return self.constant(period)

    def period(self) -> float:
        """Return the sample time of the block in s: as specified, or inherited as far as it is known in this pass."""
        stated = self.compiler.timing.specified_period(self.flat)
        if stated is not None:
            return stated
        return self.compiler.timing.inherited_period(self.flat)

    def hold_in_minor_steps(self, x: Signal) -> Signal:
        """Hold a signal during the minor steps of the solver."""
        return self.compiler.timing.hold_in_minor_steps(x)

    def discrete_state(self, init: Signal, then: Then, latency: int = 1, ported: bool = False) -> Signal:
        """Return a discrete state at the start of the step.

        Args:
            init: initial value.
            then: maps the state to its next value; called once all blocks are lowered.
            latency: number of steps until the next value is read.
            ported: True for the state at the block's state port.
        """
        self.memories += 1
        return self.compiler.memories.create(self, STATE_PORT if ported else self.memories, init, then, latency)

    def continuous_state(
        self,
        init: Signal,
        slope: Then,
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
        return self.compiler.continuous.integrate(
            self, STATE_PORT if ported else self.memories, init, slope, reset, limits
        )

    def suggest_dimensions(self, index: int, shape: tuple[int, ...]) -> None:
        """Suggest the shape of an input whose memory or inport does not determine it."""
        source = self.source(index)
        if source is not None:
            self.compiler.shapes.wish(source.flat, shape)

    def zero_crossing(self, x: Signal, kind: str) -> Signal:
        """Return 1 if a signal crosses zero as a trigger detects it: rising, falling or either.

        A signal that reaches zero and stays there has crossed it; leaving zero on the other side later does not count
        again.
        """
        before = self.discrete_state(self.apply("sign", x), lambda before: self._crossing_sign(before, x))
        zero, one = self.constant(0.0), self.constant(1.0)
        rests = self.apply("eq", x, zero)
        up = self.apply("and", self.apply("le", before, zero), self.apply("gt", x, zero))
        down = self.apply("and", self.apply("ge", before, zero), self.apply("lt", x, zero))
        rising = self.apply("or", up, self.apply("and", self.apply("eq", before, self.constant(-1.0)), rests))
        falling = self.apply("or", down, self.apply("and", self.apply("eq", before, one), rests))
        return self._select_edge(kind, rising, falling)

    def _crossing_sign(self, before: Signal, x: Signal) -> Signal:
        """Return the sign of a signal; at zero, half the sign of the crossing by which it arrived in this step."""
        half = self.apply("mul", self.constant(-0.5), before)
        arrived = self.select(self.apply("eq", self.apply("abs", before), self.constant(1.0)), half, self.constant(0.0))
        return self.select(self.apply("eq", x, self.constant(0.0)), arrived, self.apply("sign", x))

    def level_crossing(self, x: Signal, kind: str) -> Signal:
        """Return 1 if a signal becomes positive (rising), ceases to be positive (falling), or either."""
        before = self.apply("gt", self.discrete_state(x, lambda _: x), self.constant(0.0))
        now = self.apply("gt", x, self.constant(0.0))
        rising = self.apply("and", now, self.apply("not", before))
        falling = self.apply("and", before, self.apply("not", now))
        return self._select_edge(kind, rising, falling)

    def _select_edge(self, kind: str, rising: Signal, falling: Signal) -> Signal:
        if kind == "either":
            return self.apply("or", rising, falling)
        return rising if kind == "rising" else falling
