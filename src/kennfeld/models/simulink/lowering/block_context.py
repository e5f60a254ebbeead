"""What a block's rule works with: the block's parameters, its inputs, memory, and the graph under construction."""

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
)

if TYPE_CHECKING:
    from kennfeld.models.simulink.lowering.compiler import BlockCompiler

__all__ = ["BlockContext", "Then"]

Then = Callable[[Signal], Signal]

_GIVE = "Give its variables among the parameters: a script, a .mat, .sldd or calibration file."


class BlockContext:
    """One block while it is built."""

    def __init__(self, compiler: "BlockCompiler", atom: FlatBlock) -> None:
        self.compiler = compiler
        self.atom = atom
        self.kind = compiler.kind(atom)
        self.memories = self.before = 0

    @property
    def builder(self) -> GraphBuilder:
        """The graph under construction."""
        return self.compiler.builder

    # parameters

    def text(self, name: str, otherwise: str | None = None) -> str:
        """A parameter as written; its default where the file says nothing."""
        written = self.atom.block.value(name)
        if written is None and self.atom.block.mask is not None:
            written = next((p.expression for p in self.atom.block.mask.parameters if p.name == name), None)
        if written is None and self.atom.block.reference is not None:
            written = self.atom.block.reference.parameters.get(name)
        if written is None:
            written = self.kind.defaults.get(name, otherwise) if self.kind is not None else otherwise
        if written is None:
            raise UnsupportedError(f"the file does not say its {name}")
        return written.strip()

    def chosen(self, name: str, *known: str) -> str:
        """A parameter that is one of a few words; raises `UnsupportedError` for any other."""
        written = self.text(name)
        if written not in known:
            raise UnsupportedError(f"{name} is {written[:60]!r}, which is not supported")
        return written

    def on(self, name: str) -> bool:
        """Whether a parameter is switched on."""
        return self.text(name, "off") == "on"

    def parameter(self, name: str, otherwise: str | None = None) -> Signal:
        """A parameter as a signal, vectors of one row or column as vectors; named variables stay parameters."""
        nodes = self._array(name, self.text(name, otherwise))
        if not nodes.size:
            raise UnsupportedError(f"its {name} is empty")
        return Signal(as_vector(nodes), CONSTANT)

    def matrix(self, name: str) -> Nodes:
        """A parameter as a matrix of nodes, Int[rows, columns]."""
        return self._array(name, self.text(name))

    def _array(self, name: str, text: str) -> Nodes:
        field = f"{self.atom.path}:{name}"
        try:
            given = self.atom.scope.variables.get(field)
            if field in self.compiler.declared.promoted:
                return self.compiler.promoted(field, text, self.atom.scope, given)
            if given is not None:
                return self.compiler.expressions.fixed(given.value)
            return self.compiler.expressions.array(text, self.atom.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"its {name} ({text[:60]}) has no value: {error}", _GIVE, error.undefined) from None

    def numbers(self, name: str, otherwise: str | None = None) -> Numbers:
        """A parameter as fixed numbers, Float[rows, columns]."""
        text = self.text(name, otherwise)
        given = self.atom.scope.variables.get(f"{self.atom.path}:{name}")
        if given is not None and isinstance(given.value, np.ndarray):
            return np.atleast_2d(given.value)
        try:
            return self.compiler.expressions.numbers(text, self.atom.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"its {name} ({text[:60]}) has no value: {error}", _GIVE, error.undefined) from None

    def evaluated(self, text: str) -> Numbers:
        """The numbers of an expression that is part of a parameter."""
        try:
            return self.compiler.expressions.numbers(text, self.atom.scope)
        except EvaluationError as error:
            raise UnsupportedError(f"{text[:60]} has no value: {error}", _GIVE, error.undefined) from None

    def number(self, name: str, otherwise: str | None = None) -> float:
        """A parameter as one fixed number."""
        found = self.numbers(name, otherwise)
        if found.size != 1:
            raise UnsupportedError(f"its {name} has {found.size} values where one is expected")
        return float(found.item())

    def whole(self, name: str, least: int = 0, most: int = 100_000) -> int:
        """A parameter as a whole number within limits."""
        found = self.number(name)
        if not (found.is_integer() and least <= found <= most):
            raise UnsupportedError(f"its {name} is {found:g}, not a whole number from {least} to {most}")
        return int(found)

    def initial_output(self) -> Signal | None:
        """The initial output that a block states; None where it states none."""
        return None if self.text("InitialOutput") in ("[]", "") else self.parameter("InitialOutput")

    def remark(self, sentence: str) -> None:
        """Tell what somebody should know of the block; the sentence continues its path."""
        self.compiler.remarks[f"{self.atom.path} {sentence}"] = None

    # inputs

    def source(self, index: int = 0) -> SignalSource | None:
        """Where the wire at an input begins, counted from 0; None where nothing is connected."""
        return self.atom.inputs[index] if index < len(self.atom.inputs) else None

    def wired(self, index: int) -> SignalOrBus:
        """What arrives at an input, counted from 0; 0 where nothing is connected."""
        source = self.source(index)
        return self.compiler.value(source) if source is not None else self.constant(0.0)

    def input(self, index: int = 0) -> Signal:
        """The signal at an input, counted from 0."""
        found = self.wired(index)
        if isinstance(found, ExternalBus):
            found = found.signal
        if isinstance(found, Signal) and index == 0:
            self._check_frame(found)
        if isinstance(found, Bus):
            only = [member for member in found.members.values() if isinstance(member, Signal)]
            if len(only) == len(found.members) == 1:
                return only[0]
            raise UnsupportedError(f"its input {index + 1} is a bus", "Select one signal of the bus before the block.")
        return found

    def _check_frame(self, found: Signal) -> None:
        """Raise `UnsupportedError` where the rows of an input are samples one after the other."""
        if found.shape[0] > 1 and self.text("InputProcessing", "").startswith("Columns"):
            remedy = "Set its input processing to elements as channels, or bind it."
            raise UnsupportedError(f"its input is a frame of {found.shape[0]} samples, which is not supported", remedy)

    def bus(self, index: int = 0) -> SignalOrBus:
        """What arrives at an input that takes a bus: of a port from outside, signals are picked by their names."""
        source = self.source(index)
        found = self.wired(index)
        if isinstance(found, Bus) or source is None or source.atom.kind not in ("Inport", "From"):
            return found
        return self.compiler.inputs.opened(source.atom)

    @property
    def inputs(self) -> list[Signal]:
        """The signals at all inputs."""
        return [self.input(index) for index in range(self.count)]

    @property
    def count(self) -> int:
        """How many inputs it has."""
        return len(self.atom.inputs)

    # signals

    def constant(self, *values: float) -> Signal:
        """A vector of constants."""
        return Signal(np.array([self.builder.const(value) for value in values], dtype=np.int64), CONSTANT)

    def call(self, op: str, *args: Signal) -> Signal:
        """An operation of the graph, element by element; scalars expand."""
        spread = self.spread(*args)
        period = fastest_sample_time([arg.period for arg in args])
        return Signal(elementwise(self.builder, op, *(arg.nodes for arg in spread)), period)

    def spread(self, *args: Signal) -> list[Signal]:
        """The signals in their common shape; raises `UnsupportedError` where they do not fit each other."""
        shape = common_shape(*(arg.shape for arg in args))
        if shape is None:
            sizes = ", ".join("x".join(map(str, arg.shape)) for arg in args)
            raise UnsupportedError(f"its inputs have the sizes {sizes}, which do not fit each other")
        return [Signal(fit_to_shape(arg.nodes, shape), arg.period) for arg in args]

    def select(self, condition: Signal, yes: Signal, no: Signal) -> Signal:
        """One signal where a condition holds, else the other."""
        return self.call("select", condition, yes, no)

    def fold(self, op: str, args: Sequence[Signal]) -> Signal:
        """An operation from the first signal to the last."""
        made = args[0]
        for arg in args[1:]:
            made = self.call(op, made, arg)
        return made

    def clip(self, x: Signal, lower: Signal, upper: Signal) -> Signal:
        """A signal within limits; infinite ones are left out."""
        if not self._is(lower, -math.inf):
            x = self.call("max", x, lower)
        return x if self._is(upper, math.inf) else self.call("min", x, upper)

    def _is(self, signal: Signal, value: float) -> bool:
        return all(self.builder.value(node) == value for node in signal.flat)

    def truncated(self, x: Signal) -> Signal:
        """A signal without what is behind its decimal point."""
        return Signal(truncate(self.builder, x.nodes), x.period)

    def among(self, x: Signal, values: Iterable[float]) -> Signal:
        """1 where a signal is one of several values."""
        equal = [self.call("eq", x, self.constant(value)) for value in values]
        return self.fold("or", equal) if equal else self.constant(0.0)

    # time

    @property
    def time(self) -> Signal:
        """The time since the start in s."""
        return scalar(self.builder.input("t"))

    @property
    def major_step(self) -> Signal:
        """The length of a step of the model in s."""
        return scalar(self.builder.input("dt"))

    def step(self) -> Signal:
        """The block's own sample time in s: as stated, or as inherited."""
        period = self.period()
        if period in (CONTINUOUS, CONSTANT):
            return self.major_step
        return self.constant(period)

    def period(self) -> float:
        """The block's own sample time: as stated, or that of its inputs as far as it is known by now."""
        stated = self.compiler.timing.stated_period(self.atom)
        if stated is not None:
            return stated
        return self.compiler.timing.guessed_period(self.atom)

    def discrete(self, x: Signal) -> Signal:
        """A signal as a block that only runs at major steps sees it."""
        return self.compiler.timing.at_major(x)

    # memory

    def remember(self, init: Signal, then: Then, latency: int = 1, ported: bool = False) -> Signal:
        """A memory as read now; `then` maps it to what it holds after the block has run, asked when all is built.

        The memory that is `ported` is what the block's state port shows.
        """
        self.memories += 1
        return self.compiler.memories.remember(self, STATE_PORT if ported else self.memories, init, then, latency)

    def integrate(
        self,
        init: Signal,
        slope: Then,
        reset: Signal | None = None,
        limits: tuple[Signal, Signal] | None = None,
        ported: bool = False,
    ) -> Signal:
        """A continuous state, advanced by the solver; one that is `ported` is what the block's state port shows."""
        self.memories += 1
        return self.compiler.continuous.integrate(
            self, STATE_PORT if ported else self.memories, init, slope, reset, limits
        )

    def wish(self, index: int, shape: tuple[int, ...]) -> None:
        """Say which shape an input has to have, in case that the memory or inport before it has none of its own."""
        source = self.source(index)
        if source is not None:
            self.compiler.shapes.wish(source.atom, shape)

    def edge(self, x: Signal, kind: str) -> Signal:
        """1 where a signal crosses zero in the way of a trigger: rising, falling, either.

        A signal that comes to rest at zero has crossed it; where it leaves zero on the other side, it has so once.
        """
        before = self.remember(self.call("sign", x), lambda before: self._side(before, x))
        zero, one = self.constant(0.0), self.constant(1.0)
        rests = self.call("eq", x, zero)
        up = self.call("and", self.call("le", before, zero), self.call("gt", x, zero))
        down = self.call("and", self.call("ge", before, zero), self.call("lt", x, zero))
        rising = self.call("or", up, self.call("and", self.call("eq", before, self.constant(-1.0)), rests))
        falling = self.call("or", down, self.call("and", self.call("eq", before, one), rests))
        return self._of_kind(kind, rising, falling)

    def _side(self, before: Signal, x: Signal) -> Signal:
        """The sign of a signal; at zero half of the sign of the way on which it came there in this step."""
        half = self.call("mul", self.constant(-0.5), before)
        arrived = self.select(self.call("eq", self.call("abs", before), self.constant(1.0)), half, self.constant(0.0))
        return self.select(self.call("eq", x, self.constant(0.0)), arrived, self.call("sign", x))

    def sampled_edge(self, x: Signal, kind: str) -> Signal:
        """1 where a signal begins to be positive (rising), ceases to be so (falling), or does either."""
        before = self.call("gt", self.remember(x, lambda _: x), self.constant(0.0))
        now = self.call("gt", x, self.constant(0.0))
        rising = self.call("and", now, self.call("not", before))
        falling = self.call("and", before, self.call("not", now))
        return self._of_kind(kind, rising, falling)

    def _of_kind(self, kind: str, rising: Signal, falling: Signal) -> Signal:
        if kind == "either":
            return self.call("or", rising, falling)
        return rising if kind == "rising" else falling
